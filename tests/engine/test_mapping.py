"""World and hologram space: the projective map, both modes."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine import Camera, Hologram, InvalidInput
from holopath_addon.engine.mapping import DepthMapping, border_pixels, pixels_beside

VOLUME = {"depth_far": 80e-3, "depth_near": 85e-3}
CAMERA = Camera(np.eye(4), math.radians(25), shift_x=0.1, shift_y=-0.05)


def mapping_of(mode, near=0.4):
    return DepthMapping.of(Hologram(640, 480, 8e-6, **VOLUME, depth_mapping=mode), CAMERA, near)


def test_fit_ends_at_the_volume_s_ends():
    mapping = mapping_of("fit")
    assert mapping.depth_to_z(math.inf) == pytest.approx(80e-3)
    assert mapping.depth_to_z(0.4) == pytest.approx(85e-3)


def test_eyepiece_is_a_thin_lens():
    """Newton: an object at the focal plane's offset x goes to F^2 / x."""
    mapping = mapping_of("eyepiece")
    focal = 640 * 8e-6 / (2 * math.tan(math.radians(12.5)))
    assert mapping.depth_to_z(0.5) - mapping.z_far == pytest.approx(focal**2 / 0.5)


@pytest.mark.parametrize("mode", ["fit", "eyepiece"])
def test_lines_stay_lines(mode):
    """Points along a world ray of the formula lie on the hologram-space line that it came from."""
    mapping = mapping_of(mode)
    x0, slope, plane = 0.3e-3, 0.02, 82e-3
    tangent = (x0 + slope * (mapping.z_far - plane)) / mapping.focal + mapping.center_x
    for depth in (0.3, 1.0, 50.0):
        world_x = slope * mapping.beta / mapping.focal + depth * tangent
        x_h = mapping.focal * (world_x / depth - mapping.center_x)
        assert x_h == pytest.approx(x0 + slope * (mapping.depth_to_z(depth) - plane), abs=1e-9)


def test_depths_there_and_back():
    mapping = mapping_of("fit")
    np.testing.assert_allclose(
        mapping.z_to_depth(mapping.depth_to_z([0.4, 1, 7, np.inf])), [0.4, 1, 7, np.inf]
    )


@pytest.mark.parametrize("depth", [0.0, -1.0, math.nan])
def test_focus_behind_the_camera_is_refused(depth):
    with pytest.raises(InvalidInput, match="Expected a focus distance of a positive number of meters"):
        mapping_of("fit").depth_to_z(depth)


def test_borders_reach_as_far_as_an_eyepiece_has_the_near_end():
    """By the thin lens: the near end of the scene is f^2 / D before the focal plane, not at the range's default end."""
    lens = engine.Lens(0.1, 0.1)
    hologram = engine.Hologram(
        1024, 1024, 8e-6, (516.5e-9,), depth_mapping="eyepiece", optics=engine.Optics(lens=lens)
    )
    view = engine.Camera(np.eye(4), 0.3)
    slope = math.tan(math.asin(516.5e-9 / 16e-6))
    for near in (0.5, 4.0):
        assert border_pixels(hologram, view, near) == math.ceil(slope * 0.1**2 / near / 8e-6)
    plain = engine.Hologram(8192, 8192, 8e-6, (516.5e-9,))
    assert (
        border_pixels(plain, view, 0.5) == 17 and pixels_beside(plain, view, 0.5) == 0
    )  # 67 megapixels at most
