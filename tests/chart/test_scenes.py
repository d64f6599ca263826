"""Scenes of the chart that are built of more than Mitsuba's shapes: a head with hair, and a photograph with depth."""

import numpy as np
import pytest

from benchmarks.chart import photograph
from benchmarks.chart.portrait import CENTER, RADII, _surface
from benchmarks.chart.scenes import SCENES, built
from benchmarks.scenes import Scenes
from holopath_addon import engine
from holopath_addon.exchange import captures


def test_a_portrait_has_a_face_hair_and_a_wall_behind(backend):
    scene, camera = built("portrait", 64)
    depth = engine.depth_map(scene, camera, 64, 64)
    front, middle, back = SCENES["portrait"].foci
    assert depth.min() == pytest.approx(front, abs=0.03)  # the nose
    assert np.median(depth[24:40, 24:40]) == pytest.approx(-CENTER[2] - RADII[2], abs=0.03)
    assert (np.abs(depth - back) < 0.05).mean() > 0.01
    hair = depth[:, :12]  # beside the face: strands before the wall and one another
    assert (np.abs(hair - middle) < 0.12).mean() > 0.3
    assert np.abs(np.diff(hair, axis=1)).max() > 1


def test_the_nose_stands_out_of_the_face():
    nose, cheek = _surface(np.array([[0.0, -0.14, 0.99], [0.5, -0.14, 0.85]]))
    assert nose[2] > RADII[2] * 1.2
    assert cheek[2] < RADII[2]


def test_a_photograph_is_read_from_its_files(backend, tmp_path):
    """As a user's would be: by millimeters along the axis, and bytes in sRGB."""
    picture, depth = photograph.take(Scenes(), 32, tmp_path)
    distances = captures.read_depth(depth, "mm", None)
    options = captures.CaptureOptions(depth=str(depth), depth_unit="mm", fov=photograph.ANGLE)
    made = captures.open_capture(picture, options).build((32, 32))
    seen = engine.depth_map(made.scene, made.camera, 32, 32)
    assert distances.shape == seen.shape == (32, 32)
    assert np.median(np.abs(seen / distances - 1)) < 0.01
    front, _, back = SCENES["photograph"].foci
    assert distances.min() == pytest.approx(front, abs=0.1)
    assert distances.max() == pytest.approx(back, abs=0.05)
    assert captures.read_picture(picture).std() > 0.05
