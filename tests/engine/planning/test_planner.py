"""The plan: its survey, its decisions, and its errors."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.planning import planner
from holopath_addon.engine.waves.phase_fields import speckle_contrast


def test_recording_plane_halves_the_depths_in_view(build, camera, small):
    plan = engine.plan(build.two_planes(build.emissive), camera, small, engine.Settings(planes=1))
    assert plan.near == pytest.approx(0.5, rel=1e-3)
    assert plan.z_high == pytest.approx(3e-3, abs=1e-5)
    assert plan.z_low == pytest.approx(0.5e-3 + 2.5e-3 * 0.5 / 2, abs=1e-5)
    assert plan.planes[0].z == pytest.approx((plan.z_low + plan.z_high) / 2)


def test_flat_picture_needs_few_rays(build, camera, small):
    flat, one = (
        build.scene(plane=build.plane(1.0, build.emissive(build.gray(1.0)))),
        engine.Settings(planes=1),
    )
    flat, deep = (
        engine.plan(scene, camera, small, one) for scene in (flat, build.two_planes(build.emissive))
    )
    assert flat.rays_per_pixel < deep.rays_per_pixel / 5


def test_many_instances_are_warned_of(build):
    """The warning has the measured costs: 0.43 s a launch of 100 instances, 4.3 of 400 and 24.4 of 1000."""

    def caution(count):
        group = {"type": "shapegroup", "mesh": {"type": "cube"}}
        shapes = {
            f"shape{n}": {"type": "instance", "group": {"type": "ref", "id": "group"}} for n in range(count)
        }
        return planner.instances_caution(build.scene(group=group, **shapes))

    assert caution(99) == []
    (sentence,) = caution(200)
    assert sentence.startswith("The scene has 200 instances: ") and " 1.4 s " in sentence
    for count, seconds in ((100, 0.43), (200, 1.27), (400, 4.3), (1000, 24.4)):
        assert planner.instances_cost(count) == pytest.approx(seconds, rel=0.15)


@pytest.mark.parametrize(
    ("settings", "warns"),
    [
        ({"frames": 1, "despeckle": 60}, True),
        ({"frames": 5, "despeckle": 1}, True),
        ({"frames": 6, "despeckle": 60}, False),
        ({"frames": 1}, False),
        ({"frames": 1, "despeckle": 60, "phase_field": "designed"}, False),  # as asked
        ({"frames": 1, "despeckle": 60, "randomness": 0.2}, False),  # smooth all the same
        ({"speckle": 0.4, "despeckle": 60}, False),
        ({"frames": 1, "despeckle": 60, "method": "direct"}, False),
        ({"frames": 1, "despeckle": 60, "method": "point"}, False),
    ],
    ids=str,
)
def test_steps_that_take_smooth_phases_from_few_frames_are_warned_of(settings, warns):
    caution = planner.despeckling_caution(engine.Settings(**settings))
    assert len(caution) == warns
    if warns:
        frames = "1 frame " if settings["frames"] == 1 else "5 frames "
        assert caution[0].startswith(f"With {frames}") and caution[0].endswith("set Despeckle to 0.")


def test_the_plan_warns_of_steps_that_few_frames_lose_by(build, camera, small):
    settings = engine.Settings(frames=1, despeckle=60)
    plan = engine.plan(build.two_planes(build.emissive), camera, small, settings)
    assert plan.settings.phase_field == "designed"
    assert [text for text in plan.warnings if "Despeckle" in text] == planner.despeckling_caution(settings)


def test_too_few_rays_and_too_small_an_aperture_are_warned_of(build, camera, small):
    scene = build.two_planes(build.emissive)
    assert any(
        "rays a pixel" in w
        for w in engine.plan(scene, camera, small, engine.Settings(spp=20, planes=1)).warnings
    )
    through = replace(small, depth_far=-40e-3, depth_near=40e-3)  # its middle lies in the SLM
    assert any(
        "aperture at -40 mm" in w or "aperture at 40 mm" in w
        for w in engine.plan(scene, camera, through).warnings
    )
    far = replace(small, depth_far=80e-3, depth_near=85e-3)
    assert any("aperture" in w for w in engine.plan(scene, camera, far).warnings)
    assert engine.plan(scene, camera, small).warnings == ()


def test_drafts_model_little(build, camera, small):
    """Drafts have no mirrors, two planes and a few rays a pixel, without warnings. Fixed decisions count."""
    parts = {
        "mirror": build.plane(0.8, {"bsdf": {"type": "conductor"}}, 0.2, 0.2, slant=30),
        "pane": build.plane(0.6, build.emissive(build.texture(64, 3)), 0.1, 0.2, x=-0.1),
        "wall": build.plane(2.0, build.emissive(build.texture(64, 3))),
    }
    scene, draft = build.scene(**parts), engine.Settings(quality="draft", frames=24)
    plan = engine.plan(scene, camera, small, draft)
    assert (plan.chain, plan.bins, plan.passes, plan.warnings) == (0, 1, 4, ())
    assert len(plan.planes) == 2
    assert sum(plane.plain + plane.chained for plane in plan.planes) <= 100
    assert any(d.name == "specular hits" and "as drafts do" in d.reason for d in plan.decisions)
    assert engine.plan(scene, camera, small, replace(draft, fixed={"chain": 2})).chain == 2
    field = engine.render(scene, camera, small, draft, plan)
    focus = [0.6, 2.0]
    truth = engine.reference(scene, camera, small, focus, spp=64, near=field.near)
    for picture, reference in zip(engine.reconstruct(field, focus), truth, strict=True):
        assert engine.psnr(picture, reference, 16) > 22
        picture, reference = (light[16:-16, 16:-16] for light in (picture, reference))
        assert picture.mean() / reference.mean() == pytest.approx(1, abs=0.05)


def test_captured_share_against_a_monte_carlo_count(small):
    rng = np.random.default_rng(0)
    width = small.width * small.pitch
    start = rng.uniform(-width / 2, width / 2, (200_000, 2))
    radius = small.max_slope(516.5e-9) * np.sqrt(rng.random(len(start)))
    angle = rng.uniform(0, 2 * np.pi, len(start))
    end = start + 20e-3 * radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    inside = (np.abs(end) < width / 2).all(1).mean()
    assert small.captured_share(20e-3) == pytest.approx(inside, abs=0.02)


def test_mirrors_are_named(build, camera, small):
    scene = build.scene(mirror=build.plane(1.0, {"bsdf": {"type": "conductor"}}), sky={"type": "constant"})
    plan = engine.plan(scene, camera, small)
    assert plan.chain > 0 and any("mirror" in d.reason for d in plan.decisions)


def test_nothing_in_view(build, camera, small):
    behind = build.scene(plane=build.plane(-1.0, build.emissive(build.gray(1.0))))
    with pytest.raises(engine.InvalidInput, match="Nothing is in the camera's view"):
        engine.plan(behind, camera, small)


def test_plan_is_plain_words_and_json(build, camera, small):
    import json

    plan = engine.plan(build.two_planes(build.emissive), camera, small)
    assert all(d.reason for d in plan.decisions)
    assert "recording plane" in str(plan)
    text = json.dumps(plan.to_dict(), allow_nan=False)
    assert json.loads(text)["rays_per_pixel"] == plan.rays_per_pixel
    assert engine.Plan.from_dict(json.loads(text)) == plan


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
    """The range is 60 pitch^2 / wavelength: 7.4 mm at 8 µm in green, 1.6 mm at 3.74 µm."""
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


def difference(field, other):
    """Relative difference of two fields, up to a common phase of each wavelength."""
    a, b = (np.moveaxis(f.data, 1, 0).reshape(f.data.shape[1], -1) for f in (field, other))
    turn = (a.conj() * b).sum(1, keepdims=True)
    return np.linalg.norm(a * turn / abs(turn) - b) / np.linalg.norm(b)


def small_display(side=128, wavelengths=(516.5e-9,)):
    return engine.Hologram(side, side, 8e-6, wavelengths, 1e-3, 6e-3)


@pytest.fixture
def two_balls(build):
    """Two small balls in the dark, at two depths."""
    return build.scene(
        near=build.ball(0.04, [0, 0, -0.8], build.emissive(build.texture(128, 2))),
        far=build.ball(0.06, [-0.2, 0.1, -1.8], build.emissive(build.texture(128, 4))),
    )


def test_tiles_have_the_rays_that_they_need(two_balls, camera):
    """Empty tiles have no rays; the picture is the same as with all rays everywhere."""
    display, settings = small_display(192), engine.Settings(fixed={"passes": 16})
    plan = engine.plan(two_balls, camera, display, settings)
    field = engine.render(two_balls, camera, display, settings, plan)
    everywhere = replace(plan, regions=False)
    whole = engine.render(two_balls, camera, display, settings, everywhere)
    assert field.report["rays"]["wave rays"] < 0.4 * whole.report["rays"]["wave rays"]
    assert field.report["rays"]["wave rays"] == pytest.approx(
        192**2 * sum(plane.plain + plane.chained for plane in plan.planes), rel=0.5
    )
    assert difference(field, whole) < 0.1
    for depth in (0.8, 1.8):
        truth = engine.reference(two_balls, camera, display, [depth], spp=64, near=field.near)[0]
        a, b = (engine.psnr(engine.reconstruct(f, [depth])[0], truth, 10) for f in (field, whole))
        assert a > b - 0.3


def test_chains_are_followed_where_mirrors_are_seen(build, camera):
    """Tiles without mirrors have first hits alone, and the same light."""
    scene = build.scene(
        wall=build.plane(1.6, build.emissive(build.texture(128, 1))),
        glass={"type": "sphere", "center": [-0.1, 0, -0.8], "radius": 0.03, "bsdf": {"type": "dielectric"}},
    )
    display, settings = small_display(192), engine.Settings(fixed={"passes": 16})
    plan = engine.plan(scene, camera, display, settings)
    assert plan.splits == 2 and 0 < plan.planes[0].chained < 0.6 * plan.planes[0].rays
    field = engine.render(scene, camera, display, settings, plan)
    whole = engine.render(scene, camera, display, settings, replace(plan, regions=False))
    assert field.report["rays"]["wave rays"] < 0.7 * whole.report["rays"]["wave rays"]
    assert difference(field, whole) < 0.1


def test_surfaces_are_where_they_are_beside_glass(build, camera, small):
    """Outliers of images are left out of the depth range, but no small thing near the viewer."""
    parts = {
        "near": build.plane(0.4, build.emissive(build.texture(64, 3)), 0.003, 0.003),
        "wall": build.plane(2.0, build.emissive(build.texture(64, 3))),
    }
    ball = {"type": "sphere", "center": [0.1, 0, -1.2], "radius": 0.05, "bsdf": {"type": "dielectric"}}
    plain, glass = (
        engine.plan(build.scene(**each), camera, small) for each in (parts, parts | {"ball": ball})
    )
    assert glass.chain and glass.near == plain.near
    assert glass.z_high >= plain.z_high - 1e-9 and glass.z_low <= plain.z_low + 1e-9


def test_baselines_need_no_memory_for_what_they_do_not_compute(build, camera):
    far = engine.Hologram(512, 512, 3.74e-6, (516.5e-9,), 80e-3, 85e-3)
    scene = build.two_planes(build.emissive)
    direct = engine.plan(scene, camera, far, engine.Settings(method="rgbd", frames=1))
    assert direct.memory_bytes < 1e9


def test_fixed_vertices_are_the_maximum_depth():
    """Baked light has them, too, and the paths that it is compared with."""
    settings = planner.resolved(engine.Settings(method="fast", fixed={"max_depth": 2}))
    assert settings.max_depth == 2


@pytest.mark.parametrize(("visible", "hits"), [(True, 3), (False, 2)])
def test_a_lamp_inside_glass_counts_by_its_light(build, camera, visible, hits):
    """A ball's back mirrors a lamp: 4 % in few pixels, of which each is as bright as the wall."""
    place = build.T().look_at(origin=[1.2, 2, 0.6], target=[0, 0, -1.4], up=[0, 1, 0]).scale(1.2)
    area = {"type": "rectangle", "to_world": place, **build.emissive(build.gray(3))}
    point = {"type": "point", "position": [1.2, 2, 0.6], "intensity": build.gray(20)}
    scene = build.scene(
        ball={"type": "sphere", "center": [0, -0.02, -0.6], "radius": 0.05, "bsdf": {"type": "dielectric"}},
        wall=build.plane(2.05, build.diffuse(build.texture(256, 1))),
        lamp=area if visible else point,
    )
    assert engine.plan(scene, camera, small_display(128), engine.Settings()).chain == hits


def test_a_chain_that_is_too_short_is_warned_of(build, camera):
    """Two facing mirrors reflect all light but that of the middle one to four times."""
    half = 2 * math.tan(camera.fov_x / 2) / 9
    walls = {}
    for name, side in (("left", 1), ("right", -1)):
        place = build.T().translate([-side * half, 0, -1]).rotate([0, 1, 0], 90 * side).scale([1.2, 1, 1])
        walls[name] = {"type": "rectangle", "to_world": place, "bsdf": {"type": "conductor"}}
    scene = build.scene(end=build.plane(2.0, build.emissive(build.texture(64, 1))), **walls)

    def beyond(hits):
        warnings = engine.plan(
            scene, camera, small_display(), engine.Settings(max_specular_depth=hits)
        ).warnings
        return [int(re.match(r"(\d+)%", text)[1]) for text in warnings if "stays black" in text]

    assert beyond(6) == []
    # of nine equal strips the two outermost take four hits, the two beside them three
    assert beyond(3) == pytest.approx([22], abs=4) and beyond(2) == pytest.approx([44], abs=4)


@pytest.mark.parametrize("kind, chained", [("diffuse", False), ("conductor", True)])
def test_the_kernel_holds_what_is_planned(build, camera, kind, chained):
    """The program of a diffuse scene has no chains and no curvature."""
    import drjit as dr

    ball = {"type": "sphere", "center": [0, 0, -1], "radius": 0.2, "bsdf": {"type": kind}}
    scene = build.scene(ball=ball, sky={"type": "constant"})
    display = small_display(32)
    plan = engine.plan(scene, camera, display)
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        engine.render(scene, camera, display, plan=plan)
        programs = [str(kernel["ir"].getvalue()) for kernel in dr.kernel_history() if "ir" in kernel]
    tracing = [program for program in programs if "wave path tracer" in program]
    assert tracing and any("specular chain" in program for program in tracing) is chained


def test_light_is_followed_as_far_as_it_counts(build, camera):
    display = small_display(64)
    shining = engine.plan(build.two_planes(build.emissive), camera, display)
    lit = engine.plan(build.two_planes(build.diffuse), camera, display)
    indirect = engine.plan(build.closed_box(), camera, display, engine.Settings(method="full"))
    assert shining.max_depth == 1 and lit.max_depth == 2 and indirect.max_depth > 4


def test_colorless_scenes_have_one_radiance(build, camera):
    display = small_display(96, (640e-9, 516.5e-9, 455.4e-9))
    gray = build.texture(64, 1, channels=1)
    fields = {}
    for name, texture in (("gray", gray), ("colored", build.texture(64, 1))):
        scene = build.scene(wall=build.plane(1.0, build.emissive(texture)))
        plan = engine.plan(scene, camera, display)
        assert plan.gray is (name == "gray")
        fields[name] = scene, plan
    scene, plan = fields["gray"]
    settings = engine.Settings(fixed={"passes": 16})
    field = engine.render(scene, camera, display, settings, plan)
    three = engine.render(scene, camera, display, settings, replace(plan, gray=False))
    assert difference(field, three) < 1e-3


def test_rays_once_where_no_glass_in_view_disperses(build, camera):
    display = small_display(64, (640e-9, 455.4e-9))
    ball = {"type": "sphere", "radius": 0.05, "bsdf": {"type": "dispersive_dielectric", "abbe": 30.0}}
    wall = build.plane(1.5, build.emissive(build.gray(1.0)))
    for x, traversals in ((0.0, 2), (3.0, 1)):
        scene = build.scene(wall=wall, ball={**ball, "center": [x, 0, -0.8]})
        assert engine.plan(scene, camera, display).traversals == traversals


@pytest.mark.slow
def test_the_error_of_the_field_is_estimated_and_measured(build, camera):
    """Noise of radiance paths agrees in the plan, in halves of the paths, and against many more paths."""
    scene = build.closed_box()
    display, settings = small_display(128), engine.Settings(method="full", fixed={"passes": 64})
    field = engine.render(scene, camera, display, settings)
    exact = engine.render(scene, camera, display, replace(settings, fixed={"passes": 2048}))
    true = difference(field, exact)
    errors = field.report["estimated"]["field_error"]
    assert errors["measured"] == pytest.approx(true, rel=0.25)
    assert 1 / 1.5 < errors["plan"] / true < 1.5


def test_more_paths_where_their_halves_differ(build, camera):
    """More paths follow where the plan has too few."""
    scene, display = build.closed_box(), small_display(64)
    settings = engine.Settings(method="full")
    plan = engine.plan(scene, camera, display, settings)
    few = replace(plan, passes=8, max_passes=256)
    reports = [
        engine.render(scene, camera, display, settings, replace(few, max_passes=most)).report
        for most in (8, 256)
    ]
    assert reports[0]["radiance_passes"] == 8 and reports[1]["radiance_passes"] > 8
    before, after = (report["estimated"]["field_error"]["measured"] for report in reports)
    assert after < 0.5 * before


def test_frames_for_a_target_speckle(build, camera):
    scene, display = build.two_planes(build.emissive), small_display(32)
    for kind in ("random", "designed"):
        settings = engine.Settings(speckle=0.2, phase_field=kind)
        field = engine.render(scene, camera, display, settings)
        frames = len(field.data)
        assert frames == planner.resolved(settings).frames
        assert speckle_contrast(kind, frames) <= 0.2 < speckle_contrast(kind, frames - 1)
    with pytest.raises(engine.InvalidInput, match="takes over 256 frames"):
        engine.plan(scene, camera, display, engine.Settings(speckle=0.01))


def test_reasons_of_decisions(build, camera):
    """Decisions name savings and errors in words."""
    plan = engine.plan(build.two_planes(build.diffuse), camera, small_display(128, (640e-9, 455.4e-9)))
    names = [d.name for d in plan.decisions]
    for name in ("regions", "light bounces", "radiance paths a pixel", "wavelengths", "frames", "padding"):
        assert name in names
    assert any("saves" in d.why for d in plan.decisions) and any(
        "error about" in d.why for d in plan.decisions
    )
    assert "error of the field" in str(plan)
