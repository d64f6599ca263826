"""Decisions that settings fix."""

import numpy as np
import pytest

from holopath_addon import engine


def small_display(side=128, wavelengths=(516.5e-9,)):
    return engine.Hologram(side, side, 8e-6, wavelengths, 1e-3, 6e-3)


def test_every_decision_can_be_fixed(build, camera):
    scene = build.two_planes(build.diffuse)
    fixed = {"chain": 3, "splits": 1, "max_depth": 5, "passes": 7, "slabs": 9, "bins": 3, "grey": 1}
    fixed |= {"dispersion": 1, "regions": 0, "chunk": 1 << 20, "filter": 0, "textures": 3, "beside": 2}
    display = small_display(48, (640e-9, 455.4e-9))
    settings = engine.Settings(method="full", fixed=fixed)
    plan = engine.plan(scene, camera, display, settings)
    for name in ("chain", "splits", "max_depth", "passes", "slabs", "bins", "chunk", "beside"):
        assert getattr(plan, name) == fixed[name], name
    assert plan.grey and not plan.regions
    assert set(fixed) | {"steps"} == set(engine.FIXABLE)  # steps are those of baselines
    field = engine.render(scene, camera, display, settings, plan)
    assert np.isfinite(field.data).all() and field.report["radiance_passes"] == 7


@pytest.mark.parametrize(
    "text, message",
    [
        ("chain", "Expected NAME=NUMBER"),
        ("chain=x", "Expected NAME=NUMBER"),
        ("chains=3", "There is no decision 'chains'"),
    ],
)
def test_words_that_fix_nothing(text, message):
    with pytest.raises(engine.InvalidInput, match=message):
        engine.parse_fixed(text)


def test_out_of_range(build, camera, small):
    assert engine.parse_fixed("chain=4, passes=64") == {"chain": 4, "passes": 64}
    with pytest.raises(engine.InvalidInput, match="whole number from 0 to 64, got 65"):
        engine.plan(build.two_planes(build.emissive), camera, small, engine.Settings(fixed={"chain": 65}))
