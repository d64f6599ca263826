"""The plan: what it sees, what it decides, what it refuses."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.planner import captured_share


def test_recording_plane_halves_the_depths_in_view(build, camera, small):
    plan = engine.plan(build.two_planes(build.emissive), camera, small)
    assert plan.near == pytest.approx(0.5, rel=1e-3)
    assert plan.z_high == pytest.approx(6e-3, abs=2e-5)
    assert plan.z_low == pytest.approx(1e-3 + 5e-3 * 0.5 / 2, abs=2e-5)
    assert plan.planes[0].z == pytest.approx((plan.z_low + plan.z_high) / 2)


def test_flat_picture_needs_few_rays(build, camera, small):
    flat = engine.plan(build.scene(plane=build.plane(1.0, build.emissive(build.grey(1.0)))), camera, small)
    deep = engine.plan(build.two_planes(build.emissive), camera, small)
    assert flat.rays_per_pixel < deep.rays_per_pixel / 5


def test_too_few_rays_and_too_small_an_aperture_are_warned_of(build, camera, small):
    scene = build.two_planes(build.emissive)
    assert any(
        "rays a pixel" in w for w in engine.plan(scene, camera, small, engine.Settings(spp=20)).warnings
    )
    far = replace(small, depth_far=80e-3, depth_near=85e-3)
    assert any("aperture" in w for w in engine.plan(scene, camera, far).warnings)
    assert engine.plan(scene, camera, small).warnings == ()


def test_captured_share_against_a_monte_carlo_count(small):
    rng = np.random.default_rng(0)
    width = small.width * small.pitch
    start = rng.uniform(-width / 2, width / 2, (200_000, 2))
    radius = small.max_slope(516.5e-9) * np.sqrt(rng.random(len(start)))
    angle = rng.uniform(0, 2 * np.pi, len(start))
    end = start + 20e-3 * radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    inside = (np.abs(end) < width / 2).all(1).mean()
    assert captured_share(small, 20e-3) == pytest.approx(inside, abs=0.02)


def test_mirrors_are_named(build, camera, small):
    scene = build.scene(mirror=build.plane(1.0, {"bsdf": {"type": "conductor"}}), sky={"type": "constant"})
    plan = engine.plan(scene, camera, small)
    assert plan.chain > 0 and any("mirror" in d.reason for d in plan.decisions)


def test_packets_are_chosen_by_the_scene(build, camera):
    """Not by measured speeds, which now and then would give another field."""
    display = engine.Hologram(64, 64, 8e-6, (516.5e-9,), 1e-3, 1.5e-3)
    for cells, coherent in ((4, True), (400, False)):
        x, y = np.meshgrid(np.linspace(-0.3, 0.3, cells + 1), np.linspace(-0.3, 0.3, cells + 1))
        wall = build.mesh(np.stack([x, y, -1 - 0 * x], axis=-1), {"bsdf": {"type": "diffuse"}})
        scene = build.scene(wall=wall, sky={"type": "constant"})
        plans = [engine.plan(scene, camera, display).to_dict() for _ in range(2)]
        for plan in plans:
            assert plan["coherent"] is coherent
            for name in ("seconds", "decisions"):  # as measured
                del plan[name]
        assert plans[0] == plans[1]


def test_nothing_in_view(build, camera, small):
    behind = build.scene(plane=build.plane(-1.0, build.emissive(build.grey(1.0))))
    with pytest.raises(engine.InvalidInput, match="Nothing is in the camera's view"):
        engine.plan(behind, camera, small)


def test_plan_is_plain_words_and_json(build, camera, small):
    import json

    plan = engine.plan(build.two_planes(build.emissive), camera, small)
    assert all(d.reason for d in plan.decisions)
    assert "recording plane" in str(plan)
    assert json.loads(json.dumps(plan.to_dict(), allow_nan=False))["rays_per_pixel"] == plan.rays_per_pixel


@pytest.mark.parametrize(
    "change",
    [
        {"frames": 0},
        {"spp": 0},
        {"quality": "best"},
        {"estimator": "x"},
        {"wrp": math.nan},
        {"max_depth": 0},
        {"seed": -1},
    ],
)
def test_impossible_settings_are_refused(change):
    with pytest.raises(engine.InvalidInput):
        engine.Settings(**change)


def test_the_plan_says_how_far_from_focus_designed_fields_serve(build, camera):
    """60 pitch^2 / wavelength: 7.4 mm at 8 µm in green, 1.6 mm at 3.74 µm."""
    scene = build.two_planes(build.emissive)
    for pitch, kind, says in (
        (8e-6, "designed", "21%"),
        (3.74e-6, "designed", "up to 1.6 mm"),
        (8e-6, "random", "35%"),
    ):
        hologram = engine.Hologram(128, 128, pitch, (516.5e-9,), 1e-3, 6e-3)
        plan = engine.plan(scene, camera, hologram, engine.Settings(frames=8, phase_field=kind))
        (reason,) = (d.reason for d in plan.decisions if d.name == "frames")
        assert f"{kind} phase fields" in reason and ("from focus" in reason) == (pitch < 5e-6)
        assert says in reason
