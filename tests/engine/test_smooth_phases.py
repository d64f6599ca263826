"""Surfaces that are in phase, in part: as bright as they are, wherever they lie and whatever lies before them."""

from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.planning.planner import resolved
from tests.engine.test_slopes import FOCUS, off, uniform

GREEN = 516.5e-9
INNER = slice(16, -16)
SMOOTH = {"phase_field": "smooth", "frames": 1, "randomness": 0.0}
slow = pytest.mark.slow


@pytest.mark.parametrize(
    ("turned", "randomness", "planes"),
    [
        pytest.param(turned, randomness, planes, marks=() if plain else slow)
        for turned in (0, 40, 66)
        for randomness in (0.0, 0.25, 0.5, 1.0)
        for planes in ("auto", 3)
        for plain in [(turned, randomness, planes) in ((66, 0.0, 3), (40, 0.5, "auto"))]
    ],
)
def test_planes_of_any_slope_are_as_bright_as_they_are(build, camera, turned, randomness, planes):
    """No lines where recording planes share the plane, and where its depth passes through levels of the tables."""
    plane = build.plane(1.0, {}, 4.0, 4.0, slant=turned)
    how = {**SMOOTH, "randomness": randomness, "frames": 12 if randomness else 1, "planes": planes}
    picture = uniform(build, camera, plane, FOCUS, **how)
    assert picture[INNER, INNER].mean() == pytest.approx(1, abs=0.02)
    known = np.zeros(picture.shape, bool)
    known[INNER, INNER] = True
    worst, spread = off(picture, known)
    assert worst < 0.08 and spread < 0.02


@pytest.mark.parametrize(
    ("depth", "randomness"),
    [
        pytest.param(depth, randomness, marks=() if randomness == 0 else slow)
        for depth in (0.41, 0.6, 1.2, 3.0)
        for randomness in (0.0, 0.25, 0.5)
    ],
)
def test_planes_at_any_depth_are_as_bright_as_they_are(build, camera, depth, randomness):
    """Brightness from a distant recording plane, which by the table of random phases is off by half."""
    hologram = engine.Hologram(96, 96, 8e-6, (GREEN,), 1e-3, 3.5e-3, near=0.4)
    scene = build.scene(plane=build.plane(depth, build.emissive(build.gray(1.0))))
    how = {**SMOOTH, "randomness": randomness, "frames": 12 if randomness else 1}
    settings = engine.Settings(max_depth=1, wrp=2.2e-3, planes=1, **how)
    pictures = engine.reconstruct(engine.render(scene, camera, hologram, settings), [0.5, depth])
    assert pictures[:, INNER, INNER].mean((1, 2, 3)) == pytest.approx([1, 1], abs=0.02)


def measure(build, camera, scene, depths, **how):
    """Brightness over that through a thin lens, and PSNR."""
    hologram = engine.Hologram(96, 96, 8e-6, (GREEN,), 0.5e-3, 2.5e-3, near=0.5)
    truth = engine.reference(scene, camera, hologram, depths, spp=64, near=0.5)
    field = engine.render(scene, camera, hologram, engine.Settings(**{**SMOOTH, **how}))
    pairs = list(zip(engine.reconstruct(field, depths), truth, strict=True))
    ratios = [picture[INNER, INNER].mean() / exact[INNER, INNER].mean() for picture, exact in pairs]
    return ratios, [engine.psnr(*pair, 16) for pair in pairs]


def before_a_wall(build, bsdf, thick=None, light=2.0):
    """A pane, turned, with an even wall behind and an even lamp in it."""
    T = build.T
    place = T().translate([0, 0, -0.5]).rotate([0, 1, 0], 45).scale([0.3, 0.3, thick or 1])
    lamp = T().translate([0.5, 0, -0.5]).rotate([0, 1, 0], -90).scale(0.4)
    return build.scene(
        pane={"type": "cube" if thick else "rectangle", "to_world": place, "bsdf": bsdf},
        side={"type": "rectangle", "to_world": lamp, **build.emissive(build.gray(light))},
        far=build.plane(1.0, build.emissive(build.gray(0.5))),
    )


@pytest.mark.parametrize("what", ["thin pane", pytest.param("thick pane", marks=slow), "varnish"])
def test_what_is_seen_over_one_another_adds_up(build, camera, what):
    """Intensities, not amplitudes: these would be 1.8 to 2 times as bright where both are as bright."""
    if what == "thin pane":
        scene = before_a_wall(build, {"type": "thindielectric", "int_ior": 1.9})
    elif what == "thick pane":  # with two reflections, which are 40 % of the light
        scene = before_a_wall(build, {"type": "dielectric", "int_ior": 1.5}, thick=0.02)
    else:
        plastic = {"type": "plastic", "int_ior": 1.9, "diffuse_reflectance": build.gray(0.3)}
        scene = before_a_wall(build, plastic, light=3.0)
    ratios, values = measure(build, camera, scene, [1.0, 0.7])
    assert ratios == pytest.approx([1, 1], abs=0.02)
    assert min(values) > (14 if what == "thick pane" else 30)


def test_one_frame_shows_a_picture(build, camera):
    """Images in focus, where designed phases show little but speckle."""
    scene = build.scene(plane=build.plane(1.0, build.emissive(build.texture(64, 3))))
    designed = {"phase_field": "designed", "randomness": None}
    values = [measure(build, camera, scene, [1.0], **how)[1][0] for how in ({}, designed)]
    values += [values[0] - values[1]]
    assert values[0] > 20 and values[2] > 8


@pytest.mark.parametrize(
    ("frames", "chosen", "kind", "randomness"),
    [
        (1, {}, "smooth", 0.0),
        (5, {}, "smooth", 0.0),
        (6, {}, "designed", None),
        (1, {"randomness": 0.2}, "smooth", 0.2),
        (24, {"randomness": 0.2}, "smooth", 0.2),
        (1, {"phase_field": "random"}, "random", None),
        (1, {"method": "direct"}, "designed", None),
        (8, {"speckle": 0.4}, "designed", None),
        (3, {"despeckle": 5}, "designed", None),
    ],
    ids=str,
)
def test_few_frames_choose_smooth_phases(frames, chosen, kind, randomness):
    """But where so much speckle is wished for, or less by steps, or random rays are, whose cone ends sharply."""
    chosen = {"speckle": None, **chosen}
    settings = resolved(engine.Settings(frames=frames, **chosen))
    assert (settings.phase_field, settings.randomness) == (kind, randomness)
    assert resolved(settings) == settings


def test_what_does_not_go_together_is_refused():
    for kind in ("designed", "random"):
        with pytest.raises(engine.InvalidInput, match=f"of smooth phase fields, not of {kind} ones"):
            resolved(engine.Settings(phase_field=kind, randomness=0.3))
    for paper in ({"method": "direct"}, {"estimator": "paper"}):
        with pytest.raises(engine.InvalidInput, match="need the estimator lattice"):
            resolved(engine.Settings(phase_field="smooth", **paper))
    # other people's methods have phases of their own
    resolved(engine.Settings(phase_field="smooth", method="point"))


def test_the_plan_says_what_they_leave(build, camera, small):
    scene = build.two_planes(build.emissive)
    for frames, randomness, says in (
        (1, None, "smooth phase fields of randomness 0 leave no speckle in the field; 100% of its light"),
        (2, 0.3, "randomness 0.3 leave a speckle contrast of about 48% in the field; 74% of its light"),
    ):
        plan = engine.plan(scene, camera, small, engine.Settings(frames=frames, randomness=randomness))
        (reason,) = (decision.reason for decision in plan.decisions if decision.name == "frames")
        assert says in reason


def test_frames_traced_along_are_the_same(build, camera, small):
    """Each set of phases has its own kernels, however it is traced."""
    hologram = replace(small, width=48, height=48)
    settings = engine.Settings(method="full", frames=2, quality="preview", max_depth=1)
    view = build.two_planes(build.emissive), camera, hologram, settings
    plan = engine.plan(*view)
    both = engine.render(*view, plan, extra_frames=24)
    (first,) = (fields for _, fields in engine.extra_frames(*view[:3], plan, lambda *_: None, count=24))
    np.testing.assert_array_equal(both.extra_frames, first)


def test_all_random_is_random(build, camera):
    """Equal to the last bit, over several reflections, too."""
    scene = before_a_wall(build, {"type": "thindielectric", "int_ior": 1.9})
    hologram = engine.Hologram(32, 32, 8e-6, (GREEN,), 0.5e-3, 2.5e-3, near=0.5)
    fields = [
        engine.render(scene, camera, hologram, engine.Settings(frames=2, quality="preview", **how)).data
        for how in ({"randomness": 1.0}, {"phase_field": "random"})
    ]
    np.testing.assert_array_equal(*fields)
