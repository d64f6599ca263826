"""The pilot's rays and paths."""

import math

import numpy as np
import pytest

from holopath_addon import engine


def test_packets_are_chosen_by_the_scene(build, camera):
    """Measured speeds do not choose packets, as fields would then differ now and then."""
    display = engine.Hologram(64, 64, 8e-6, (516.5e-9,), 1e-3, 1.5e-3)
    for cells, coherent in ((4, True), (400, False)):
        x, y = np.meshgrid(np.linspace(-0.3, 0.3, cells + 1), np.linspace(-0.3, 0.3, cells + 1))
        wall = build.mesh(np.stack([x, y, -1 - 0 * x], axis=-1), {"bsdf": {"type": "diffuse"}})
        scene = build.scene(wall=wall, sky={"type": "constant"})
        plans = [engine.plan(scene, camera, display).to_dict() for _ in range(2)]
        for plan in plans:
            assert plan["coherent"] is coherent
            for name in ("stages", "phases", "seconds", "decisions"):  # as measured
                del plan[name]
        assert plans[0] == plans[1]


def test_compiling_counts_where_the_pilot_compiled(build, camera, small, monkeypatch):
    """A first render's programs are the pilot's and some more."""
    from holopath_addon.engine.planning import pilot

    timed, radiance = pilot._timed, []
    for extra in (0.0, 1e3):  # far above what a busy machine adds by itself

        def slower(*work, extra=extra):
            seconds, _, result = timed(*work)
            return seconds, extra, result

        monkeypatch.setattr(pilot, "_timed", slower)
        radiance.append(engine.plan(build.two_planes(build.diffuse), camera, small).stages["radiance"])
    assert radiance[0] + 1e3 < radiance[1] < radiance[0] + 2e3


def paths_of(color, grains=4096, count=4):
    """Paths that all bring the color of their grain, at the first vertex."""
    from holopath_addon.engine.planning.pilot_light import Paths

    light = np.repeat(np.asarray(color, float)[..., None], count, axis=-1)
    by_vertices = [light.sum(0), *[0 * light[0]] * 4]
    return Paths(light, light, by_vertices, 0 * light + 0.5, np.ones((grains, count), bool), 0.0)


def test_a_small_colored_thing_is_not_gray(build, camera):
    """A mean over the view hides it, and one wavelength for all shows a blue lamp as black."""
    from holopath_addon.engine.planning.pilot_light import light_of

    color = np.ones((3, 4096))
    assert light_of(paths_of(color), 1, 8, 10.0).chroma == 0
    color[:, :12] = np.array([[0.0], [0.0], [1.0]])
    assert light_of(paths_of(color), 1, 8, 10.0).chroma == pytest.approx(3)
    white = build.emissive({"type": "rgb", "value": 0.5})
    blue = build.emissive({"type": "rgb", "value": [0.0, 0.0, 1.0]})
    scene = build.scene(wall=build.plane(2.0, white), lamp=build.plane(1.0, blue, 0.02))
    hologram = engine.Hologram(64, 64, 8e-6, (640e-9, 516.5e-9, 455.4e-9), 0.2e-3, 0.5e-3)
    assert not engine.plan(scene, camera, hologram).gray
    assert engine.plan(build.scene(wall=build.plane(2.0, white)), camera, hologram).gray


def test_where_the_pilot_finds_no_light_nothing_is_left_out():
    """What it missed may be lit: paths keep their vertices, and indirect light its brightness."""
    from holopath_addon.engine.planning import noise
    from holopath_addon.engine.planning.pilot_light import light_of

    light = light_of(paths_of(np.zeros((3, 4096))), 1, 8, 10.0)
    assert light.max_depth == 8 and light.bright == 0 and light.chroma == 3
    assert noise.radiance_limit(engine.Settings(quality="draft"), light, 4) == math.inf


def test_bounces_that_light_the_dark_alone_are_kept():
    """A bright sky over most of the view: what the rest has is under 0.5 % of the light, but all that it has."""
    from holopath_addon.engine.planning.pilot_light import light_of

    color = np.ones((3, 4096))
    color[:, 2900:] = 0.01
    paths = paths_of(color)
    bounced = np.where(color.sum(0)[:, None] < 0.1, paths.light.sum(0), 0)
    for number in range(5):
        paths.by_vertices[number] = [paths.light.sum(0) - bounced, bounced, *[0 * bounced] * 3][number]
    assert 0 < bounced.sum() < 0.005 * paths.light.sum()
    light = light_of(paths, 1, 8, 10.0)
    assert light.max_depth == 2 and light.lost_error == 0
    evenly = paths_of(np.ones((3, 4096)))
    for number in range(5):
        evenly.by_vertices[number] = [0.996, 0.004, 0, 0, 0][number] * evenly.light.sum(0)
    light = light_of(evenly, 1, 8, 10.0)
    assert light.max_depth == 1 and light.lost_error == pytest.approx(0.002, rel=0.01)  # half of the light's
