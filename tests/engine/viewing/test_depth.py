"""Depth of the first surfaces."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine

WIDTH, HEIGHT = 60, 40


@pytest.fixture
def slanted(build):
    """A large plane that the axis meets at 1 m, its right side turned away by 30 degrees."""
    return build.scene(plane=build.plane(1.0, {"bsdf": {"type": "diffuse"}}, 5.0, slant=30.0))


def on_plane(tangent):
    """Depth D at which the ray D (tangent, y, -1) meets the plane z = -1 - x tan 30°."""
    return 1 / (1 - math.tan(math.radians(30)) * tangent)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.2)])
def test_slanted_plane(slanted, camera, shift):
    camera = replace(camera, shift_x=shift[0], shift_y=shift[1], clip_start=0.2)
    pixel = 2 * math.tan(camera.fov_x / 2) / WIDTH
    columns = (np.arange(WIDTH) + 0.5 - WIDTH / 2 + shift[0] * WIDTH) * pixel
    depth = engine.depth_map(slanted, camera, WIDTH, HEIGHT)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, np.broadcast_to(on_plane(columns), depth.shape), rtol=1e-5)

    turn = np.diag([0.0, 0.0, 1.0, 1.0])
    turn[:2, :2] = [[0, -1], [1, 0]]  # the top of the picture is the world's left
    rows = (np.arange(HEIGHT) + 0.5 - HEIGHT / 2 - shift[1] * WIDTH) * pixel
    depth = engine.depth_map(slanted, replace(camera, to_world=turn), WIDTH, HEIGHT)
    np.testing.assert_allclose(depth, np.broadcast_to(on_plane(rows)[:, None], depth.shape), rtol=1e-5)


def test_clipping_and_nothing(slanted, camera):
    cut = replace(camera, clip_start=0.95, clip_end=1.05)
    whole, depth = (engine.depth_map(slanted, c, WIDTH, HEIGHT) for c in (camera, cut))
    inside = (whole > 0.95) & (whole < 1.05)
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_allclose(depth[inside], whole[inside], rtol=1e-5)
    assert np.isinf(depth[~inside]).all()
