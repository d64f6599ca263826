"""Depth of the first surfaces."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.viewing.depth import image_depth_map

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


@pytest.fixture
def planned(camera, small):
    """The depths of what a scene's mirrors and glass show, as a plan of `small` sees it."""

    def depths(scene):
        settings = engine.Settings(quality="preview", frames=1, method="full")
        plan = engine.plan(scene, camera, small, settings)
        return image_depth_map(scene, camera, plan, WIDTH, HEIGHT), engine.depth_map(
            scene, camera, WIDTH, HEIGHT
        )

    return depths


def test_without_mirrors_images_lie_on_the_surfaces(build, planned):
    scene = build.scene(plane=build.plane(1.0, build.emissive(build.gray(1.0)), 5.0, slant=30.0))
    images, surfaces = planned(scene)
    np.testing.assert_allclose(images, surfaces, rtol=1e-5)


def test_depth_behind_a_flat_mirror(build, planned):
    """A lamp 0.5 m behind the viewer, in a mirror at 1 m that is turned by 10 degrees: its mirror image, a plane.

    The mirror at z = -1 - x tan 10° maps the lamp's plane z = 0.5 to one turned by 20°, by reflection.
    """
    slant = math.radians(10)
    mirror = build.plane(1.0, {"bsdf": {"type": "conductor"}}, 5.0, slant=10.0)
    lamp = {
        "type": "rectangle",
        "to_world": build.T().translate([0, 0, 0.5]).rotate([0, 1, 0], 180).scale(50),
    }
    images, surfaces = planned(build.scene(mirror=mirror, lamp={**lamp, **build.emissive(build.gray(1.0))}))
    normal = np.array([math.sin(slant), 0, math.cos(slant)])  # of the mirror, through (0, 0, -1)
    turned = np.array([0, 0, 1]) - 2 * normal[2] * normal  # the lamp's normal in the mirror
    foot = np.array([0, 0, 0.5]) - 2 * (normal @ np.array([0, 0, 1.5])) * normal
    columns = (np.arange(WIDTH) + 0.5 - WIDTH / 2) * 2 * math.tan(math.radians(10)) / WIDTH
    expected = turned @ foot / (turned[0] * columns - turned[2])
    np.testing.assert_allclose(images, np.broadcast_to(expected, images.shape), rtol=1e-3)
    assert expected.min() > 2.2 and surfaces.max() < 1.1


def test_depth_behind_a_pane_and_beside_it(build, planned):
    """A thick pane brings what is behind it nearer by t (1 - 1/n), near the axis; beside it, it is where it is."""
    glass = {"bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}}
    pane = {"type": "cube", "to_world": build.T().translate([0, 0, -0.7]).scale([0.05, 0.05, 0.05]), **glass}
    images, surfaces = planned(build.scene(pane=pane, far=build.plane(2.0, build.emissive(build.gray(1.0)))))
    middle = np.s_[HEIGHT // 2 - 2 : HEIGHT // 2 + 2, WIDTH // 2 - 2 : WIDTH // 2 + 2]
    np.testing.assert_allclose(images[middle], 2 - 0.1 * (1 - 1 / 1.5), atol=2e-3)
    np.testing.assert_allclose(surfaces[middle], 0.65, atol=1e-4)
    np.testing.assert_allclose(images[:, :2], 2.0, rtol=1e-4)
