"""The thin-lens reference: independent halves, and what lies beyond its pupil."""

from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.viewing.reference import diffracted

RGB = (640e-9, 516.5e-9, 455.4e-9)
SIZE = 80, 64

GREEN = 516.5e-9


def test_both_references_agree(build, camera, small):
    """Our rays through a pupil against Mitsuba's own thin lens."""
    scene = build.two_planes(build.emissive)
    radius = DepthMapping.of(small, camera, 0.5).pupil_radius(small.max_slope(GREEN))
    ours = engine.reference(scene, camera, small, [1.0], engine.Pupil(0, 0, 2 * radius), spp=128, near=0.5)
    theirs = engine.reference(scene, camera, small, [1.0], spp=128, near=0.5)
    assert engine.psnr(ours[0], theirs[0]) > 35


@pytest.fixture
def display():
    return engine.Hologram(*SIZE, 8e-6, (GREEN,), 0.3e-3, 1.8e-3)


def test_halves_of_a_reference_are_independent(build, camera, display):
    """Halves of the same number of paths differ by as much as their noise; their mean is the reference."""
    scene = build.two_planes(build.diffuse)
    (truth,) = engine.reference(scene, camera, display, [0.5], spp=1024, near=0.5, seed=9)
    ((a, b),) = engine.reference(scene, camera, display, [0.5], spp=128, near=0.5, halves=True)
    # with independent noise, the errors of both have no correlation
    errors = [(np.sqrt(x) - np.sqrt(truth)).ravel() for x in (a, b)]
    assert abs(np.corrcoef(errors)[0, 1]) < 0.1
    assert (0.5 * (a + b)).mean() == pytest.approx(truth.mean(), rel=0.005)


def test_parts_of_the_pupil_that_lie_beyond_it_are_dark(build, camera, display):
    """Every color of a uniform wall is equally bright where any of its pupil is open, and black where none is."""
    scene = build.scene(wall=build.plane(1.0, build.emissive(build.gray(0.7)), 5.0))
    display = replace(display, wavelengths=RGB)
    mapping = DepthMapping.of(display, camera, 0.5)
    red, green, blue = (mapping.pupil_radius(display.max_slope(w)) for w in RGB)
    across = engine.Pupil(0.5 * (red + green), 0.0, red - blue)
    (picture,) = engine.reference(scene, camera, display, [1.0], across, 64, 0.5)
    np.testing.assert_allclose(picture[..., :2].mean((0, 1)), 0.7, rtol=0.03)
    outside = engine.Pupil(red + blue, 0.0, blue)
    assert engine.reference(scene, camera, display, [1.0], outside, 8, 0.5).max() == 0


def test_other_references_compile_nothing(build, camera, display):
    import drjit as dr

    scene = build.two_planes(build.diffuse)
    engine.reference(scene, camera, display, [0.5], spp=16, near=0.5)
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        shifted = replace(camera, shift_x=0.1)
        engine.reference(scene, shifted, display, [0.7], engine.Pupil(1e-4, 0.0, 2e-4), 16, 0.5, seed=4)
    kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert kernels and all(kernel["cache_hit"] for kernel in kernels)


def test_light_that_is_no_number_is_left_out(build, camera, display):
    """A broken texel is black, and nothing beside it is lost."""
    texture = np.full((8, 8, 3), 0.6, np.float32)
    texture[3, 3] = np.nan
    texels = {"type": "bitmap", "data": build.mi.TensorXf(texture), "raw": True, "filter_type": "nearest"}
    scene = build.scene(wall=build.plane(1.0, {"emitter": {"type": "area", "radiance": texels}}))
    (picture,) = engine.reference(scene, camera, display, [1.0], spp=16, near=0.5)
    assert np.isfinite(picture).all()
    assert picture.max() == pytest.approx(0.6, rel=1e-3) and picture.min() < 0.1


def test_pictures_of_other_wavelengths_than_the_hologram():
    hologram = engine.Hologram(16, 16, 8e-6, (516.5e-9,))
    with pytest.raises(engine.InvalidInput, match="of 1 wavelengths, got 3 and 1"):
        diffracted(np.ones((16, 16, 3)), hologram)
