"""Pictures through points of the pupil, against the geometry of a point at a known depth."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.viewing.light_field import pinhole_pictures, pupil_points


def middle(picture):
    """Column and row of the light's middle."""
    light = picture.sum(axis=-1)
    rows, columns = np.indices(light.shape)
    return (columns * light).sum() / light.sum(), (rows * light).sum() / light.sum()


def test_a_point_shifts_by_its_disparity(build, camera, small):
    depth = 0.5
    disc = {"type": "disk", "to_world": build.T().translate([0.01, 0, -depth]).scale(0.01)}
    scene = build.scene(disc={**disc, **build.emissive(build.grey(1.0))})
    points = [(0.0, 0.0), (0.02, 0.0), (0.0, 0.03)]
    pictures = pinhole_pictures(scene, camera, small, points, spp=64)
    assert pictures.shape == (3, small.height, small.width, 1)
    (x, y), (right, _), (_, above) = map(middle, pictures)
    pixels = small.width / (2 * math.tan(camera.fov_x / 2))  # of a tangent of 1
    assert x == pytest.approx(0.5 * (small.width - 1) + 0.01 / depth * pixels, abs=0.05)
    assert right - x == pytest.approx(-0.02 / depth * pixels, abs=0.1)
    assert above - y == pytest.approx(0.03 / depth * pixels, abs=0.1)  # rows run down


def test_the_grid_lies_in_the_pupil(camera, small):
    mapping = DepthMapping.of(small, camera, 0.5)
    radius = mapping.pupil_radius(small.widest_slope)
    grid = pupil_points(3, small, mapping)
    assert grid.shape == (3, 3, 2)
    np.testing.assert_allclose(np.hypot(*grid[0, 0]), radius)
    assert grid[0, 0, 0] < 0 < grid[0, 0, 1] and not grid[1, 1].any()  # v down, u to the right
    part = engine.Pupil(1e-4, 0.0, radius / 10)
    np.testing.assert_allclose(pupil_points(1, small, mapping, part)[0, 0], (1e-4, 0.0))
    assert np.hypot(*(pupil_points(2, small, mapping, part)[1, 1] - (1e-4, 0))) == pytest.approx(radius / 20)
