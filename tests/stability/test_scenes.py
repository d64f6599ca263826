"""Edges of scenes: quick values of each sweep; all of them with the tests that are marked dense.

Where a test without pictures, or with fewer, keeps the promise every day, the pictures across the edge are slow.
"""

import math

import pytest

from benchmarks.stability import scenes
from benchmarks.stability.scenes import SWEEPS, camera_at, hologram_of, lit_planes
from benchmarks.stability.sweep import faults, walk
from holopath_addon import engine
from holopath_addon.engine.scene import variants

BY_NAME = {sweep.name: sweep for sweep in SWEEPS}
# What besides steps must hold at the quick values.
SPECIAL = {
    "recording plane": lambda figures: figures["psnr"] > 29,
    "slanted through the recording plane": lambda figures: (
        figures["least bright strip"] > 0.95 and figures["brightest strip"] < 1.05
    ),
    "mirror through its focus": lambda figures: abs(figures["error"]) < 1e-3,
    "lens through its focus": lambda figures: abs(figures["error"]) < 1e-2,
    "grazing incidence": lambda figures: (
        abs(figures["reflected"] - 1) < 0.005 and abs(figures["transmitted"] - 1) < 0.005
    ),
}
# And what keeps the promise by default.
SLOW = {
    "distance from the origin": "test_single_precision_is_warned_of, here",
    "size of a lamp": "test_rendering: planes under a lamp",
    "recording plane": "test_displays: distance, and test_slabs",
    "slanted through the recording plane": "test_rendering: slanted plane, strip by strip",
    "slope": "test_rendering: brightness over slope",
    "seeds": "test_radiance_cache: any seed; test_phase_fields: an even plane at any focus",
    "infinity": "test_rendering: points refocus at their depth, the sky is at infinity",
    "depth range": "rays for a depth range, and recording plane, here",
    "mirror through its focus": "test_images_go_through_infinity",
    "lens through its focus": "test_images_go_through_infinity",
    "grazing incidence": "test_shares_up_to_grazing",
    "mirrors in a row": "test_planner: a chain that is too short is told of",
    "glass in a row": "test_chains: media that touch; total reflection, here",
    "total reflection": "test_chains: total internal reflection in a prism",
    "scale": "distance from the origin, here, and test_radiance_cache: scale does not matter",
}


def test_images_go_through_infinity(backend):
    """The mirror equation and the lens maker's, at every value of the sweeps."""
    for power in BY_NAME["mirror through its focus"].values:
        assert abs(scenes.image_in_mirror(power)[1]["error"]) < 1e-3, power
    for distance in BY_NAME["lens through its focus"].values:
        assert abs(scenes.image_in_lens(distance)[1]["error"]) < 1e-2, distance


def test_shares_up_to_grazing(backend):
    """Fresnel's equations at every angle of the sweep but the last two, where a degree is all."""
    for degrees in BY_NAME["grazing incidence"].values[:-2]:
        shares = scenes.shares_at_a_pane(degrees)[1]
        assert shares["reflected"] == pytest.approx(1, abs=0.005), degrees
        assert shares["transmitted"] == pytest.approx(1, abs=0.005), degrees


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in BY_NAME]
)
def test_nothing_breaks_across_the_edge(backend, name):
    if name == "size of a lamp" and backend == variants.CUDA:
        pytest.skip("small spheres light too little there, which plans warn of")
    sweep = BY_NAME[name]
    rows = walk(sweep, sweep.quick)
    assert faults(sweep, rows) == []
    for value, figures in rows:
        if "brightness" in figures:
            assert figures["brightness"] == pytest.approx(1, abs=0.05), value
        assert SPECIAL.get(name, bool)(figures), (value, figures)


@pytest.mark.dense
@pytest.mark.parametrize("name", BY_NAME)
def test_nothing_breaks_anywhere(backend, name):
    sweep = BY_NAME[name]
    assert faults(sweep, walk(sweep)) == []


def test_too_many_rays_are_refused_in_a_sentence(backend):
    rows = dict(walk(BY_NAME["rays for a depth range"], (10, 200)))
    assert math.isfinite(rows[10]["seconds"])
    assert "reduce the depth range" in rows[200]["refused"]


@pytest.mark.parametrize(
    ("scale", "meters", "warns"),
    [pytest.param(1, 0, False, marks=pytest.mark.slow), (1e-3, 0, True), (1, 100, False), (1, 1e3, True)],
)
def test_single_precision_is_warned_of(backend, scale, meters, warns):
    place = (meters, meters, -meters)
    plan = engine.plan(lit_planes(scale, place), camera_at(place), hologram_of(0.5 * scale))
    assert any("off surfaces" in warning for warning in plan.warnings) == warns
