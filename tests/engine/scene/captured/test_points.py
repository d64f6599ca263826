"""Points with colors as a scene."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.scene.captured.points import COVERING, TILT, point_scene


def grid(side=20, depth=3.0):
    """Points on a square of 1 m that faces the viewer, each of its own color."""
    x, y = np.meshgrid((np.arange(side) + 0.5) / side - 0.5, 0.5 - (np.arange(side) + 0.5) / side)
    points = np.stack([x, y, np.full_like(x, -depth)], -1).reshape(-1, 3)
    colors = np.random.default_rng(0).uniform(0.1, 2, (side * side, 3)).astype(np.float32)
    return points, colors


def test_each_point_is_seen_where_it_is(backend):
    """A grid with the pixels' spacing, seen from the origin, is a picture of its colors, without gaps."""
    from holopath_addon.engine.viewing.preview import Preview

    points, colors = grid()
    scene, camera = point_scene(points, colors, fov_x=2 * math.atan(0.5 / 3.0), viewer="origin")
    shown = Preview(scene, camera, 100, 100).refine(1, lambda *_: None)
    # the middles of pixels of 5 x 5, and most of what surrounds them; with flat disks not even these
    np.testing.assert_allclose(shown[2::5, 2::5].reshape(-1, 3), colors, rtol=1e-3)
    whole = colors.reshape(20, 20, 3).repeat(5, 0).repeat(5, 1)
    assert (np.abs(shown - whole).max(-1) < 1e-2)[5:-5, 5:-5].mean() > 0.7
    assert shown[5:-5, 5:-5].min() > 0.05
    depth = engine.depth_map(scene, camera, 20, 20)
    np.testing.assert_allclose(depth[2:-2, 2:-2], 3.0, rtol=0.02)  # the spacing is 0.05 m


@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_from_the_front_all_points_are_in_view(backend, aspect):
    """And as large as may be: some point is near the frame."""
    points = np.random.default_rng(2).normal(size=(300, 3)) * (1, 2, 3) + (5, -4, 20)
    _, camera = point_scene(points, np.ones((300, 3)), aspect=aspect)
    x, y, z = (points - camera.position).T
    assert (z < 0).all()
    half = math.tan(camera.fov_x / 2)
    reach = np.maximum(np.abs(x) / half, np.abs(y) * aspect / half) / -z
    assert 0.9 < reach.max() <= 1.0


def test_the_radius_is_what_is_asked_for(backend):
    """A single disk, whose area is that of a hexagon; it faces the viewer from aside, too."""
    points, radius = np.array([[1.0, 0.0, -3.0]]), 0.2
    scene, camera = point_scene(points, np.ones((1, 3)), radius, math.radians(60), viewer="origin")
    pixel = 2 * math.tan(math.radians(30)) / 200
    depths = engine.depth_map(scene, camera, 200, 200)
    turned = math.atan(1 / 3)
    distance = math.hypot(1, 3) + TILT * radius
    area = np.isfinite(depths).sum() * pixel**2
    # solid angle over the cosine cubed
    expected = 1.5 * math.sqrt(3) * radius**2 / distance**2 / math.cos(turned) ** 3
    assert area == pytest.approx(expected, rel=0.05)


def test_points_that_stand_alone_stay_small(backend):
    points, colors = grid()
    points, colors = np.vstack([points, [[0, 0, -1.5]]]), np.vstack([colors, [[1, 1, 1]]])
    scene, camera = point_scene(points, colors, fov_x=2 * math.atan(0.5 / 3.0), viewer="origin")
    depth = engine.depth_map(scene, camera, 100, 100)
    # three times the grid's spacing, 0.05 m, seen at half the distance
    assert 0 < (depth < 2).mean() < math.pi * (2 * 3 * 0.05 * COVERING) ** 2


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"colors": np.ones((399, 3))}, "give \\(point, 3\\) of both"),
        ({"points": np.ones((0, 3)), "colors": np.ones((0, 3))}, "There are 0 points"),
        ({"points": np.full((400, 3), np.nan)}, "not finite"),
        ({"radius": 0.0}, "must be positive, not 0 m"),
        ({"points": np.ones((400, 3))}, "leave out the copies"),
        ({"points": np.ones((2, 3)), "colors": np.ones((2, 3))}, "too few"),
        ({"viewer": "behind"}, "Expected the viewer front or origin"),
        ({"points": -grid()[0], "viewer": "origin"}, "No point is before"),
    ],
)
def test_what_it_refuses(wrong, text):
    points, colors = grid()
    with pytest.raises(engine.InvalidInput, match=text):
        point_scene(**{"points": points, "colors": colors} | wrong)
