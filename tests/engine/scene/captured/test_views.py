"""Views as a panel, against what pinholes and holograms of an analytic pattern show."""

import math

import numpy as np
import pytest

from benchmarks.scenes import GREEN
from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.scene.captured.views import view_scene

FOV, PANEL, BEHIND = 0.7, 0.5, 1.0
HALF = math.tan(FOV / 2)
RNG = np.random.default_rng(0)
VIEWS = RNG.uniform(0.1, 1, (2, 3, 12, 16, 3))
SPAN = 0.04, 0.02


def looked_through(scene, camera, points, width, height, focus):
    """Pictures through points of the viewers' plane, to the right and up, by Mitsuba's path tracer."""
    from holopath_addon.engine.viewing.preview import Preview

    pinhole = Preview(scene, camera, width, height, max_depth=1)
    for point in points:
        pinhole.look(camera, width, height, focus, center=point)
        yield pinhole.refine(16)


def test_each_viewpoint_sees_its_view(backend):
    """The first one is at the upper left. Between them is the mean of two, and outside of all the nearest one."""
    scene, camera = view_scene(VIEWS, SPAN, PANEL, FOV)
    seen = [
        ((-0.02, 0.01), VIEWS[0, 0]),
        ((0.0, 0.01), VIEWS[0, 1]),
        ((0.02, 0.01), VIEWS[0, 2]),
        ((-0.02, -0.01), VIEWS[1, 0]),
        ((0.01, -0.01), 0.5 * (VIEWS[1, 1] + VIEWS[1, 2])),
        ((0.02, 0.005), 0.75 * VIEWS[0, 2] + 0.25 * VIEWS[1, 2]),
        ((0.5, -0.3), VIEWS[1, 2]),
    ]
    shown = looked_through(scene, camera, [point for point, _ in seen], 16, 12, PANEL)
    for picture, (_, expected) in zip(shown, seen, strict=True):
        np.testing.assert_allclose(picture, expected, rtol=1e-4)


def test_parallel_views_are_put_together_at_the_panel(backend):
    """Of a painted plane there, which each viewpoint sees a pixel farther left than the one before: without ghosts."""
    step = 2 * HALF / 16 * PANEL  # a pixel of the plane
    plane = RNG.uniform(0.1, 1, (14, 20, 3))
    views = np.array([[plane[v : v + 12, u : u + 16] for u in range(5)] for v in range(3)])
    scene, camera = view_scene(views, (4 * step, 2 * step), math.inf, FOV, panel=PANEL)
    points = [(-2 * step, step), (1 * step, 0), (0.37 * step, -0.6 * step)]
    for picture in looked_through(scene, camera, points, 16, 12, PANEL):  # which follow the plane's middle
        np.testing.assert_allclose(picture[2:-2, 2:-2], plane[3:-3, 4:-4], rtol=1e-4)
    for picture in looked_through(scene, camera, [(-2 * step, step)], 16, 12, math.inf):
        np.testing.assert_allclose(picture[:-1, :-1], views[0, 0, :-1, :-1], rtol=1e-4)


def pattern(u, v, side):
    """What a pinhole at (u, v) sees of a pattern at `BEHIND`, where all that agree at `PANEL` look."""
    at_panel = ((np.arange(side) + 0.5) / side - 0.5) * 2 * HALF * PANEL
    right, up = u + (at_panel - u) * BEHIND / PANEL, v + (-at_panel - v) * BEHIND / PANEL
    frequency = 2 * math.pi / (16 / side * 2 * HALF * BEHIND)  # a cycle in 16 pixels
    return 0.5 + 0.45 * np.sin(frequency * right) * np.sin(frequency * up)[:, None]


def test_a_hologram_of_views_focuses_where_parallax_says(backend):
    """A pattern behind the panel is sharp at its own depth, not at the panel; parts of the pupil see it shifted."""
    side, border = 64, 12
    hologram = engine.Hologram(side, side, 8e-6, (GREEN,), 1e-3, 4e-3, near=PANEL)
    mapping = DepthMapping.of(hologram, engine.Camera(np.eye(4), FOV))
    radius = mapping.pupil_radius(hologram.max_slope(GREEN))
    points = np.linspace(-radius, radius, 13)
    views = np.array([[pattern(u, -down, side) for u in points] for down in points])
    scene, camera = view_scene(np.repeat(views[..., None], 3, -1), (2 * radius, 2 * radius), PANEL, FOV)
    settings = engine.Settings(method="light-field", frames=4, max_depth=1, spp=16, fixed={"steps": 60})
    field = engine.render(scene, camera, hologram, settings)

    def alike(shown, u, v):
        inner = slice(border, -border), slice(border, -border)
        return np.corrcoef(shown[0, ..., 0][inner].ravel(), pattern(u, v, side)[inner].ravel())[0, 1]

    panel, own = (alike(engine.reconstruct(field, [depth]), 0, 0) for depth in (PANEL, BEHIND))
    assert own > 0.5 and own > panel + 0.25
    for x, y in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)):
        part = engine.Pupil(x * radius, y * radius, 0.8 * radius)
        shown = engine.reconstruct(field, [PANEL], part)
        here, opposite = (alike(shown, sign * x * radius, sign * y * radius) for sign in (1, -1))
        assert here > 0.3 and opposite < -0.15


def test_a_lens_sees_through_views_what_it_sees_in_the_scene(build, camera):
    """Of parallel pinholes all over the pupil, put together between a card and a wall: by Mitsuba's thin lens."""
    from holopath_addon.engine.viewing.light_field import pinhole_pictures, pupil_points

    scene = build.scene(
        wall=build.plane(2.0, build.emissive(build.texture(32, 1, contrast=4))),
        card=build.plane(0.5, build.emissive(build.gray(0.9)), 0.25 * math.tan(camera.fov_x / 2)),
    )
    hologram = engine.Hologram(32, 32, 8e-6, (GREEN,), 1e-3, 3e-3, near=PANEL)
    points = pupil_points(9, hologram, DepthMapping.of(hologram, camera))
    views = pinhole_pictures(scene, camera, hologram, points.reshape(-1, 2), 16, 1).reshape(9, 9, 32, 32, 1)
    width = points[0, -1, 0] - points[0, 0, 0]
    shown, viewer = view_scene(views.repeat(3, -1), (width, width), math.inf, camera.fov_x, panel=0.8)
    depths, pupil = [0.5, 2.0], engine.Pupil(0, 0, width)  # the views are in a square around it

    def lens(scene, camera):
        return engine.reference(scene, camera, hologram, depths, pupil, 64, PANEL, 1)

    found, true = lens(shown, viewer), lens(scene, camera)
    for k in (0, 1):
        assert engine.psnr(found[k], true[k], 3) > max(26, engine.psnr(found[k], true[1 - k], 3) + 6)


@pytest.mark.parametrize("method", ["auto", "focal-stack"])
def test_methods_that_need_depth_are_refused(backend, method):
    scene, camera = view_scene(VIEWS, SPAN, PANEL, FOV)
    with pytest.raises(engine.InvalidInput, match=f"The method {method} .* Choose light-field"):
        engine.plan(scene, camera, engine.Hologram(16, 12, 8e-6), engine.Settings(method=method))


def test_the_digest_tells_views_and_their_places(backend):
    from holopath_addon.engine.scene.fingerprint import scene_digest

    changes = [{}, {"views": VIEWS[:, ::-1]}, {"span": (0.05, 0.02)}, {"focus": math.inf, "panel": PANEL}]
    given = {"views": VIEWS, "span": SPAN, "focus": PANEL}
    digests = [scene_digest(view_scene(**{**given, **change})[0]) for change in changes]
    assert len(set(digests)) == len(changes)
    assert scene_digest(view_scene(**given)[0]) == digests[0]


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"views": VIEWS[0]}, "give \\(view row, view column, y, x, 3\\)"),
        ({"views": VIEWS[:1, :1], "span": (0, 0)}, "There is one view"),
        ({"views": -VIEWS}, "negative or not finite"),
        ({"span": (0.04, 0)}, "span of the views down must be positive and finite, for 2 of them, not 0 m"),
        ({"views": VIEWS[:1]}, "span of the views down must be 0, for 1 of them, not 0.02 m"),
        ({"focus": 0.0}, "must be positive, not 0 m"),
        ({"focus": math.inf}, "positive, finite distance, not at inf m"),
        ({"fov_x": 4.0}, "between 0 and 180 degrees"),
        ({"aspect": 0.0}, "aspect of a view must be positive"),
    ],
)
def test_what_it_refuses(wrong, text):
    with pytest.raises(engine.InvalidInput, match=text):
        view_scene(**{"views": VIEWS, "span": SPAN, "focus": PANEL} | wrong)
