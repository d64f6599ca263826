"""Notes on a computed hologram."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.waves import libraries
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Request


def test_notes_on_baked_light():
    bake = {"note": "", "coarser": 1.2, "traced": ()}
    assert pipeline.bake_notes(None) == pipeline.bake_notes(bake) == []
    bake = {"note": "It was torn.", "coarser": 2.04, "traced": tuple("abcdefghij")}
    torn, coarse, traced = pipeline.bake_notes(bake)
    assert torn == "It was torn." and "2.0 times larger" in coarse
    assert traced.startswith("10 shapes'") and traced.endswith("h, ....")


class OutOfMemoryError(RuntimeError):
    """Error with the name of CuPy's and PyTorch's."""


def test_a_note_says_that_the_cards_memory_ran_out(monkeypatch):
    """The images are complete nevertheless."""
    on_card = SimpleNamespace()
    monkeypatch.setattr(libraries, "choose", lambda: ("torch", ""))
    monkeypatch.setattr(libraries, "empty_array", lambda name: on_card)
    monkeypatch.setattr(libraries, "on_card", lambda array: None)
    monkeypatch.setattr(libraries, "like", lambda data, array: on_card)
    reconstructed = engine.reconstruct

    def on_a_full_card(field, *rest):
        if field.data is on_card:
            raise OutOfMemoryError
        return reconstructed(field, *rest)

    monkeypatch.setattr(engine, "reconstruct", on_a_full_card)
    hologram = engine.Hologram(32, 24, 8e-6, (500e-9,), depth_far=0.5e-3, depth_near=1e-3)
    camera = engine.Camera(np.eye(4), 0.3)
    field = engine.WaveField(np.ones((1, 1, 24, 32), np.complex64), hologram, camera, 0.5)
    images, notes = pipeline.reconstruct(field, [0.5], None, lambda done, message: None)
    np.testing.assert_array_equal(images, reconstructed(field, [0.5]))
    assert notes == [libraries.RAN_OUT]


@pytest.mark.parametrize("ran_out", [False, True])
def test_warnings_of_the_field_are_warnings_of_the_result(backend, monkeypatch, ran_out):
    """A note of the computation of waves appears once."""
    from benchmarks.scenes import FOV, GREEN, Scenes

    scenes = Scenes()
    scene, camera = scenes.two_planes(scenes.emissive), engine.Camera(np.eye(4), FOV)
    hologram = engine.Hologram(32, 32, 8e-6, (GREEN,), depth_far=0.1e-3, depth_near=0.4e-3)
    rendered, warnings = engine.render, {"warnings": [libraries.RAN_OUT]} if ran_out else {}

    def render(*given):
        field = rendered(*given)
        return replace(field, plan=field.plan | warnings)

    monkeypatch.setattr(engine, "render", render)
    settings = engine.Settings(frames=1, quality="draft", planes=1, max_depth=1)
    result = pipeline.compute(Request(hologram, settings, [1.0], scene=scene, camera=camera))
    assert result.plan.warnings.count(libraries.RAN_OUT) == ran_out and result.images.shape == (1, 32, 32, 1)


@pytest.mark.parametrize("pupil", [None, engine.Pupil(1e-3, 0.0, 2e-3)])
def test_the_preview_looks_through_what_the_stop_leaves_open(monkeypatch, pupil):
    """Behind a half stop around the zero order the largest open circle lies beside the middle."""
    looks = []

    class Preview:
        spp = 1

        def __init__(self, scene, camera, width, height, focus, aperture, vertices, center):
            looks.append((aperture, center))

        def refine(self, spp, progress):
            return np.zeros((24, 24, 3), np.float32)

    monkeypatch.setattr(engine, "Preview", Preview)
    optics = engine.Optics(stop=engine.Stop("half"), carrier=(0.0, 0.0))
    hologram = engine.Hologram(24, 24, 8e-6, (500e-9,), 0.1e-3, 0.4e-3, optics=optics)
    request = Request(hologram, engine.Settings(), pupil=pupil, camera=engine.Camera(np.eye(4), 0.3))
    pipeline._preview(request, SimpleNamespace(near=0.5), 1.0, 0.0, None, lambda image: None)
    ((aperture, center),) = looks
    reach = DepthMapping.of(hologram, request.camera, 0.5).pupil_radius(hologram.max_slope(500e-9))
    x, y, radius = optics.stop_circle
    assert max(abs(x), abs(y)) == pytest.approx(0.5, abs=0.03) == pytest.approx(radius, abs=0.05)
    expected = (radius * reach, (x * reach, y * reach)) if pupil is None else (1e-3, (1e-3, 0.0))
    assert (aperture, *center) == pytest.approx((min(expected[0], radius * reach), *expected[1]))
