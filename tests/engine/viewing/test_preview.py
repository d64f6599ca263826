"""The picture that refines, against Mitsuba's own lens, and what a view may ask of it."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.viewing import preview

RGB = (640e-9, 516.5e-9, 455.4e-9)
GREEN = RGB[1]
SIZE = 80, 64


@pytest.fixture
def display():
    return engine.Hologram(*SIZE, 8e-6, (GREEN,), 0.3e-3, 1.8e-3)


def thin_lens(scene, camera, radius, focus):
    """Mitsuba's own sensor; it looks along +z with x to the left, the camera along -z."""
    import mitsuba as mi

    sensor = mi.load_dict(
        {
            "type": "thinlens",
            "to_world": mi.ScalarTransform4f(camera.to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])),
            "fov": math.degrees(camera.fov_x),
            "aperture_radius": radius,
            "focus_distance": min(focus, 1e5),
            "film": {"type": "hdrfilm", "width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"}},
        }
    )
    integrator = mi.load_dict({"type": "path", "max_depth": 8})
    return np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=1024, seed=3))[..., :3]


def test_as_mitsubas_thin_lens(build, camera, display, monkeypatch):
    """Lamps, shadows and two depths of which one is sharp: previews, and references with colors that share paths."""
    # strips of rows, the last of which overlaps another
    monkeypatch.setattr(sys.modules["holopath_addon.engine.viewing.reference"], "CHUNK_PATHS", 500_000)
    scene = build.two_planes(build.diffuse)
    display = replace(display, wavelengths=RGB)
    mapping = DepthMapping.of(display, camera, 0.5)
    radii = [mapping.pupil_radius(display.max_slope(w)) for w in RGB]
    for focus in (math.inf,):
        truth = np.stack([thin_lens(scene, camera, r, focus)[..., k] for k, r in enumerate(radii)], -1)
        found = engine.Preview(scene, camera, *SIZE, focus, radii[1]).refine(256)[..., 1:2]
        (shared,) = engine.reference(scene, camera, display, [focus], spp=256, near=0.5)
        assert engine.psnr(found, truth[..., 1:2]) > 38
        assert found.mean() == pytest.approx(truth[..., 1].mean(), rel=0.01)
        for k in range(3):
            assert engine.psnr(shared[..., k : k + 1], truth[..., k : k + 1]) > 40, k
            assert shared[..., k].mean() == pytest.approx(truth[..., k].mean(), rel=0.005)
    sharp = engine.Preview(scene, camera, *SIZE, 0.5, radii[1]).refine(64)[..., 1:2]
    assert engine.psnr(sharp, truth[..., 1:2]) < 30  # it is not the focus that they agree in


def test_the_mean_of_all_paths(build, camera):
    """Passes of any number of paths, chunks and seeds are parts of one mean; a pinhole is sharp at all depths."""
    scene = build.two_planes(build.diffuse)
    view = engine.Preview(scene, camera, *SIZE)
    first, then = view.refine(), view.refine(255)
    assert view.spp == 256
    assert first.shape == (SIZE[1], SIZE[0], 3) and first.dtype == np.float32
    other = engine.Preview(scene, camera, *SIZE, focus=0.3, seed=7).refine(256)
    assert engine.psnr(first, other) + 15 < engine.psnr(then, other)
    assert then.mean() == pytest.approx(other.mean(), rel=0.01)
    np.testing.assert_array_equal(engine.Preview(scene, camera, *SIZE).refine(), first)


def test_lens_shift(build, camera):
    """A shift by whole pixels moves the picture: right and up in the view are left and down in the picture."""
    scene = build.two_planes(build.emissive)
    shifted = replace(camera, shift_x=10 / SIZE[0], shift_y=6 / SIZE[0])
    whole, moved = (engine.Preview(scene, c, *SIZE).refine(64) for c in (camera, shifted))
    assert engine.psnr(moved[6:, :-10], whole[:-6, 10:]) > 30
    assert engine.psnr(moved[:-6, 10:], whole[6:, :-10]) < 20


def test_sky_and_clipping(build, camera):
    scene = build.scene(
        near=build.plane(
            1.0, {"bsdf": {"type": "twosided", "bsdf": build.diffuse(build.gray(0.5))["bsdf"]}}, 0.1
        ),
        sky={"type": "constant", "radiance": build.gray(0.8)},
    )
    middle, corner = np.s_[28:36, 36:44], np.s_[:4, :4]
    for changes, inside, outside in (
        ({}, 0.4, 0.8),
        ({"sees_sky": False}, 0.4, 0.0),
        ({"clip_start": 1.1}, 0.8, 0.8),
        ({"clip_end": 0.9}, 0.8, 0.8),
        ({"clip_start": 0.9, "clip_end": 1.1}, 0.4, 0.8),
    ):
        picture = engine.Preview(scene, replace(camera, **changes), *SIZE).refine(64)
        assert picture[middle].mean() == pytest.approx(inside, rel=0.03), changes
        assert picture[corner].mean() == pytest.approx(outside, abs=1e-4), changes


def test_other_views_compile_nothing(build, camera):
    import drjit as dr

    view = engine.Preview(build.two_planes(build.diffuse), camera, 40, 30)
    view.refine()
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        view.look(engine.Camera(np.eye(4), 0.6, 0.1, -0.2, 0.01, 30.0), 60, 50, 1.3, 0.004)
        view.refine(3)
        view.look(camera, 120, 90)
        view.refine()
    kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert len(kernels) == 2
    assert all(kernel["cache_hit"] for kernel in kernels)


def test_canceling_leaves_the_picture(build, camera, monkeypatch):
    monkeypatch.setattr(preview, "CHUNK_PATHS", 1000)
    view = engine.Preview(build.two_planes(build.diffuse), camera, *SIZE)
    before = view.refine()

    def progress(done, message):
        if done > 0.5:
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        view.refine(1, progress)
    assert view.spp == 1
    assert view.refine(3).mean() == pytest.approx(before.mean(), rel=0.05)
    assert view.spp == 4


def test_what_cannot_be_seen_is_refused(build, camera):
    scene = build.two_planes(build.emissive)
    with pytest.raises(engine.InvalidInput, match="focus distance"):
        engine.Preview(scene, camera, *SIZE, focus=-1.0, aperture=0.01)
    with pytest.raises(engine.InvalidInput, match="pixels"):
        engine.Preview(scene, camera, 0, 5)
