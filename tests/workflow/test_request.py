"""Requests of renders, and their progress."""

import itertools
import json

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.progress import SHARES
from holopath_addon.workflow import output, stills
from holopath_addon.workflow.request import Encoding, Origin, Outputs, Request

HOLOGRAM = engine.Hologram(32, 32, 8e-6, (516.5e-9,), depth_far=0.1e-3, depth_near=0.4e-3)
SETTINGS = engine.Settings(frames=1, quality="draft", planes=1, max_depth=1)


@pytest.fixture
def request_of(backend):
    """``request_of(**words)``: a `Request` of two shining planes."""
    from benchmarks.scenes import FOV, Scenes

    scenes = Scenes()
    scene, camera = scenes.two_planes(scenes.emissive), engine.Camera(np.eye(4), FOV)
    return lambda **words: Request(HOLOGRAM, SETTINGS, [1.0], **words).with_scene(
        scene, camera, [{"what": "a note"}]
    )


def test_a_built_request_has_its_scene_and_notes(request_of):
    request = request_of(origin=Origin("planes.blend", scene_state={"frame": 3}))
    assert request.scene is not None and request.origin.notes == [{"what": "a note"}]
    assert (request.origin.name, request.origin.scene_state) == ("planes.blend", {"frame": 3})


def test_inputs_differ_if_the_result_does(request_of):
    """JSON can hold them, and the same request has the same inputs."""
    words = [
        {},
        {"encoding": Encoding("sgd", bits=4)},
        {"encoding": Encoding("sgd", 2.0, 0.5)},
        {"outputs": Outputs(light_field=2)},
        {"pupil": engine.Pupil(0.0, 0.0, 1e-3)},
    ]
    inputs = [json.dumps(output.plain(request_of(**each).inputs), sort_keys=True) for each in words]
    assert len(set(inputs)) == len(words)
    assert json.dumps(output.plain(request_of().inputs), sort_keys=True) == inputs[0]


@pytest.mark.parametrize("method", ["none", "dpac", "sgd"])
@pytest.mark.parametrize("outputs", [Outputs(), Outputs(rgbd=True, contact_sheet="all.png")])
def test_progress_goes_on_to_the_end(request_of, tmp_path, method, outputs):
    done = []
    folder = tmp_path / "out"
    folder.mkdir()
    request = request_of(encoding=Encoding(method), outputs=outputs)
    stills.write(folder, request, lambda share, message: done.append(share), 0.0)
    assert done == sorted(done) and 0.9 < done[-1] <= 1


@pytest.mark.parametrize("work", SHARES)
def test_stages_end_one_after_another(work):
    ends = [0.0, *SHARES[work].values()]
    assert all(before <= after for before, after in itertools.pairwise(ends)) and ends[-1] <= 1
