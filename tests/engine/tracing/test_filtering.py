"""Grains of one surface share their light: less noise, and nothing of textures and shadows lost."""

from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine

GREEN = 516.5e-9


def fields(scene, camera, pixels, passes, exact, other=None):
    """Relative errors of the field without the filter and with it, and their brightness, to that of many paths."""
    display = engine.Hologram(pixels, pixels, 8e-6, (GREEN,), 0.5e-3, 2e-3)
    settings = engine.Settings(method="full", fixed={"passes": exact, "filter": 0, **(other or {})})
    plan = engine.plan(scene, camera, display, settings)

    def light(passes, filtered, seed):
        fixed = {**(other or {}), "passes": passes, "filter": filtered}
        planned = engine.plan(scene, camera, display, replace(settings, fixed=fixed))
        planned = replace(
            plan, passes=passes, max_passes=passes, reach=planned.reach, textures=planned.textures
        )
        return engine.render(scene, camera, display, replace(settings, fixed=fixed, seed=seed), planned)

    truth, errors, brightness, told = light(exact, 0, 0).data, [], [], []
    for filtered in (0, 1):
        field = light(passes, filtered, 0)
        errors.append(np.linalg.norm(field.data - truth) / np.linalg.norm(truth))
        brightness.append(float((abs(field.data) ** 2).sum() / (abs(truth) ** 2).sum()))
        told.append(field.report["estimated"]["field_error"]["measured"])
    return errors, brightness, told


@pytest.mark.slow
def test_a_quarter_of_the_paths_where_light_is_indirect(build, camera):
    """Half the error at the same paths; the halves tell what is left, though not all of it."""
    errors, brightness, told = fields(build.closed_box(), camera, 48, 16, 512)
    assert errors[1] < 0.5 * errors[0]
    assert brightness[1] == pytest.approx(1, abs=0.02)
    assert errors[1] / 2 < told[1] < 1.3 * errors[1]


def test_textures_and_shadows_stay_sharp(build, camera):
    """Squares of two pixels, and the shadow of a ball before a lamp that is a point: no noise and no detail to lose."""
    checks = np.kron(np.indices((32, 32)).sum(0) % 2, np.ones((8, 8)))[..., None] * [0.7, 0.6, 0.5] + 0.1
    mi = build.mi
    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(checks.astype(np.float32)),
        "filter_type": "nearest",
        "raw": True,
    }
    scene = build.scene(
        wall=build.plane(1.2, build.diffuse(texture), 0.3),
        ball=build.ball(0.06, [0.05, 0.0, -1.0], build.diffuse(build.gray(0.5))),
        lamp={"type": "point", "position": [-0.2, 0.1, -0.6], "intensity": build.gray(0.4)},
    )
    errors, brightness, _ = fields(scene, camera, 96, 16, 512)
    assert errors[1] < 1.01 * errors[0]
    assert brightness[1] == pytest.approx(1, abs=0.01)


def test_rays_that_see_textures_alone(build, camera):
    """Checks finer than grains: rays without light take most of the error, as many as the halves say."""
    checks = np.random.default_rng(3).choice([0.02, 0.9], (256, 256, 1)) * np.ones(3)
    texture = {
        "type": "bitmap",
        "bitmap": build.mi.Bitmap(checks.astype(np.float32)),
        "filter_type": "nearest",
        "raw": True,
    }
    scene = build.scene(
        wall=build.plane(1.2, build.diffuse(texture), 0.3),
        lamp={"type": "point", "position": [-0.2, 0.1, -0.4], "intensity": build.gray(0.4)},
    )
    few, _, _ = fields(scene, camera, 48, 8, 512, {"textures": 0})
    more, brightness, told = fields(scene, camera, 48, 8, 512)
    assert more[1] < 0.5 * few[1]
    assert brightness[1] == pytest.approx(1, abs=0.01)
    assert more[1] / 2 < told[1] < 1.5 * more[1]


def test_lines_of_a_pixel_stay_dark(build, camera):
    """A sheet close before a wall: its shadow is narrower than what a grain's guides are averaged over."""
    lamp = {"type": "sphere", "center": [-0.1, 0.03, -0.7], "radius": 0.03}
    scene = build.scene(
        wall=build.plane(1.2, build.diffuse(build.gray(0.8)), 0.3),
        sheet=build.plane(1.19, build.diffuse(build.gray(0.8)), 0.05),
        lamp=lamp | build.emissive(build.gray(40.0)),
    )
    errors, brightness, _ = fields(scene, camera, 96, 16, 512)
    assert errors[1] < 1.35 * errors[0]  # 1.2 today, 1.7 by such guides alone
    assert brightness[1] == pytest.approx(1, abs=0.01)


def test_what_shines_shares_nothing(build, camera):
    """A picture that is its own light has no noise to lose, only detail."""
    scene = build.scene(screen=build.plane(1.0, build.emissive(build.texture(64, 3, contrast=2))))
    display = engine.Hologram(48, 48, 8e-6, (GREEN,), 0.5e-3, 2e-3)
    shared, alone = (
        engine.render(
            scene, camera, display, engine.Settings(method="full", fixed={"passes": 8, "filter": on})
        )
        for on in (1, 0)
    )
    np.testing.assert_array_equal(shared.data, alone.data)


def test_gloss_in_bins_of_the_pupil(build, camera):
    """Each bin shares with the same bin of other grains; brightness stays."""
    lamp = build.T().look_at(origin=[0.5, 0.8, 0.5], target=[0, 0, -1], up=[0, 1, 0]).scale(0.3)
    varnish = {"type": "roughplastic", "alpha": 0.1, "diffuse_reflectance": build.texture(64, 3)}
    scene = build.scene(
        wall=build.plane(1.2, {"bsdf": varnish}, slant=20),
        ball=build.ball(0.06, [0.03, 0.0, -0.8], {"bsdf": {"type": "roughconductor", "alpha": 0.15}}),
        lamp={"type": "rectangle", "to_world": lamp, **build.emissive(build.gray(10.0))},
    )
    errors, brightness, _ = fields(scene, camera, 64, 8, 256, {"bins": 2})
    assert errors[1] < 0.8 * errors[0]
    assert brightness[1] == pytest.approx(1, abs=0.02)
