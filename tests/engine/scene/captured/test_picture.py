"""A picture with depth as a scene, against analytic back-projection and Mitsuba's pinhole camera."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.scene.captured.picture import picture_mesh, picture_scene

WIDTH, HEIGHT, FOV = 24, 18, math.radians(50)


def tangents():
    """Of the lines of sight through pixels' centers, to the right and up."""
    pixel = 2 * math.tan(FOV / 2) / WIDTH
    across = (np.arange(WIDTH) - 0.5 * (WIDTH - 1)) * pixel
    up = (0.5 * (HEIGHT - 1) - np.arange(HEIGHT)) * pixel
    return np.meshgrid(across, up)


def steps():
    """A near block in front of a slanted wall."""
    across, _ = tangents()
    depth = 2 / (1 + 0.3 * across)  # the plane z = -2 + 0.3 x
    depth[5:12, 8:16] = 0.5
    return depth


def test_vertices_lie_on_the_plane_of_their_pixels():
    """Points of a slanted plane, back-projected, satisfy its equation, and project to where their texture is."""
    across, up = tangents()
    mesh = picture_mesh(2 / (1 + 0.3 * across - 0.2 * up), FOV)
    x, y, z = mesh.vertices.astype(float).T
    inside = ((mesh.uv > 0.03) & (mesh.uv < 0.97)).all(1)
    assert inside.sum() > 200
    np.testing.assert_allclose((-z + 0.3 * x - 0.2 * y)[inside], 2, rtol=1e-5)
    half = math.tan(FOV / 2)
    np.testing.assert_allclose(0.5 + x / -z / (2 * half), mesh.uv[:, 0], atol=1e-5)
    np.testing.assert_allclose(0.5 - y / -z / (2 * half) * WIDTH / HEIGHT, mesh.uv[:, 1], atol=1e-5)


def test_triangles_face_the_camera():
    mesh = picture_mesh(steps(), FOV)
    a, b, c = mesh.vertices[mesh.triangles].astype(float).swapaxes(0, 1)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0).all()


def test_no_triangle_spans_an_edge():
    """Depths of a triangle's corners differ by less than the block's distance from the wall."""
    mesh = picture_mesh(steps(), FOV)
    depth = -mesh.vertices[:, 2][mesh.triangles]
    assert np.ptp(depth, axis=1).max() < 0.3
    assert depth.min() == pytest.approx(0.5)


def test_a_pinhole_sees_the_picture(backend):
    """Exactly, with edges and all: by Mitsuba's own camera and integrator."""
    import mitsuba as mi

    image = np.random.default_rng(1).uniform(0.1, 3, (HEIGHT, WIDTH, 3)).astype(np.float32)
    scene, camera = picture_scene(image, steps(), FOV)
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": math.degrees(FOV),
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}},
        }
    )
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    shown = np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=16))
    np.testing.assert_allclose(shown, image, rtol=1e-4)
    seen = engine.depth_map(scene, camera, WIDTH, HEIGHT)
    # next to an edge there is no slope on one side
    np.testing.assert_allclose(seen, steps(), rtol=0.01)


@pytest.mark.parametrize(("reach", "black"), [(None, False), (0, True)])
def test_beside_an_edge_the_wall_goes_on(backend, reach, black):
    """From beside the camera a uniform picture is uniform; without its continuation there is a gap."""
    from holopath_addon.engine.viewing.preview import Preview

    scene, camera = picture_scene(np.ones((64, 64, 3)), _block(), FOV, reach)
    # the wall at 2 m moves by 2.3 pixels of 64 against the block at 0.5 m
    moved = camera.moved((0.022, 0, 0))
    shown = Preview(scene, moved, 64, 64).refine(16, lambda *_: None)[..., 0]
    assert (shown[8:-8, 8:-8].min() < 0.5) == black


def _block():
    depth = np.full((64, 64), 2.0)
    depth[20:44, 20:44] = 0.5
    return depth


def test_what_goes_on_keeps_its_slope(backend):
    """A slanted wall behind the block is met where its plane is, by lines from beside the camera."""
    depth = 2 / (1 + 0.3 * _across())
    depth[20:44, 20:44] = 0.5
    scene, camera = picture_scene(np.ones((64, 64, 3)), depth, FOV)
    moved = camera.moved((0.022, 0, 0))
    seen = engine.depth_map(scene, moved, 64, 64)[30]
    wall = (2 - 0.3 * 0.022) / (1 + 0.3 * _across()[30])  # the same plane from there
    behind = seen > 0.6
    assert behind.sum() > 36 and np.isfinite(seen[4:-4]).all()
    np.testing.assert_allclose(seen[4:-4][behind[4:-4]], wall[4:-4][behind[4:-4]], rtol=5e-3)


def _across():
    pixel = 2 * math.tan(FOV / 2) / 64
    return np.broadcast_to((np.arange(64) - 31.5) * pixel, (64, 64))


def good():
    return {"image": np.ones((HEIGHT, WIDTH, 3)), "depth": steps(), "fov_x": FOV}


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"depth": np.ones((HEIGHT, WIDTH + 1))}, "give \\(y, x, 3\\) and \\(y, x\\)"),
        ({"depth": np.where(np.arange(WIDTH) == 3, 0, steps())}, "18 of 432 depths are not positive.*column 3, row 0"),
        ({"depth": np.where(np.arange(WIDTH) == 3, math.inf, steps())}, "not positive and finite"),
        ({"image": np.full((HEIGHT, WIDTH, 3), -1.0)}, "negative"),
        ({"fov_x": math.pi}, "between 0 and 180 degrees"),
    ],
)  # fmt: skip
def test_what_it_refuses(wrong, text):
    with pytest.raises(engine.InvalidInput, match=text):
        picture_scene(**good() | wrong)
