"""Pictures through points of the pupil, against the geometry of a point at a known depth."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.viewing.light_field import pinhole_pictures, pupil_points, pupil_row, quilt


def middle(picture):
    """Column and row of the light's middle."""
    light = picture.sum(axis=-1)
    rows, columns = np.indices(light.shape)
    return (columns * light).sum() / light.sum(), (rows * light).sum() / light.sum()


def test_a_point_shifts_by_its_disparity(build, camera, small):
    depth = 0.5
    disc = {"type": "disk", "to_world": build.T().translate([0.01, 0, -depth]).scale(0.01)}
    scene = build.scene(disc={**disc, **build.emissive(build.gray(1.0))})
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


def test_views_agree_at_the_focus(build, camera, small):
    """A thing there stays where it is; one at twice the distance moves by the difference of the disparities."""
    depth, shift = 0.5, 0.02
    pixels = small.width / (2 * math.tan(camera.fov_x / 2))
    for away, moved in ((depth, 0.0), (2 * depth, shift * pixels * (1 / depth - 1 / (2 * depth)))):
        disc = {"type": "disk", "to_world": build.T().translate([0, 0, -away]).scale(0.02 * away)}
        scene = build.scene(disc={**disc, **build.emissive(build.gray(1.0))})
        points = [(0.0, 0.0), (shift, 0.0)]
        ahead, beside = pinhole_pictures(scene, camera, small, points, spp=64, focus=depth)
        assert middle(beside)[0] - middle(ahead)[0] == pytest.approx(moved, abs=0.1)
    assert moved > 0.3


def test_a_row_lies_across_the_pupil(camera, small):
    mapping = DepthMapping.of(small, camera, 0.5)
    radius = mapping.pupil_radius(small.widest_slope)
    np.testing.assert_allclose(pupil_row(2, small, mapping), [(-radius / 2, 0), (radius / 2, 0)])
    part = engine.Pupil(1e-4, 2e-4, radius / 10)
    np.testing.assert_allclose(pupil_row(1, small, mapping, part), [(1e-4, 2e-4)])


def test_a_quilt_begins_at_the_lower_left():
    views = np.arange(6)[:, None, None, None] + np.zeros((6, 2, 3, 1), int)
    found = quilt(views, 3)
    assert found.shape == (4, 9, 1)
    assert found[::2, ::3, 0].tolist() == [[3, 4, 5], [0, 1, 2]]
    assert quilt(np.arange(24).reshape(1, 4, 6), 1).tolist() == np.arange(24).reshape(4, 6).tolist()
