"""Phases of one wavelength: how they begin, are refined, and end with their seconds."""

import itertools
import math
import types

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.encoding import channel, descent, encoder, options
from holopath_addon.engine.encoding.double_phase import MIN_SPREAD, even_double_phase
from holopath_addon.engine.encoding.views import ViewedVolume, ViewTargets
from holopath_addon.engine.waves.propagation import circular_band, propagate, transfer_function
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding
from tests.engine.encoding.fields import GREEN, PITCH, between_planes, many, on_levels, smooth, wave_field

BORDER = 25


@pytest.mark.slow
def test_loss_to_the_complex_field(build, camera, small):
    """Compare with a thin lens: 24 frames of phases, rounded to eight bits, show nearly the images of their field.

    A field on several recording planes loses more, but its phases show better images.
    """
    scene, focus = build.two_planes(build.emissive), (0.5, 1.0, 2.0)
    best, field = (
        engine.render(scene, camera, small, engine.Settings(frames=24, planes=planes))
        for planes in ("auto", 1)
    )
    truth = engine.reference(scene, camera, small, focus, spp=128, near=field.near)

    def quality(light):
        images = engine.reconstruct(light, focus)
        return np.array([engine.psnr(a, b, BORDER) for a, b in zip(images, truth, strict=True)])

    whole = quality(field)
    several, joint = (engine.encode(each, "joint", max_steps=300) for each in (best, field))
    loss = {
        method: whole - quality(engine.encode(field, method).field(engine.Modulator(8)))
        for method in ("dpac", "sgd")
    } | {"joint": whole - quality(joint.field(engine.Modulator(8)))}
    assert loss["joint"].max() < 0.3
    gain = quality(several.field(engine.Modulator(8))) - quality(joint.field(engine.Modulator(8)))
    assert gain.min() > -0.15 and gain.max() > 3
    assert loss["sgd"].min() > 1  # or there was nothing to lose
    assert (loss["dpac"] > loss["sgd"]).all()
    # what a checkerboard can show: through a pupil that the half band fills
    half_band = engine.Pupil(0, 0, 1.4 * field.mapping.pupil_radius(small.max_slope(GREEN)))
    expected = engine.reference(scene, camera, small, [1.0], half_band, 128, field.near)[0]
    decibels = [
        engine.psnr(engine.reconstruct(light, [1.0], half_band)[0], expected, BORDER)
        for light in (engine.encode(field, "dpac").field(), field)
    ]
    assert decibels[1] - 6 < decibels[0] and decibels[0] > 19.5


@pytest.mark.slow
def test_refined_phases_are_better_than_the_field(build, camera, small):
    """Compare with a thin lens, also between depths and through parts of the pupil."""
    scene, settings = build.three_planes(), engine.Settings(frames=8)
    field = engine.render(scene, camera, small, settings)
    radius = field.mapping.pupil_radius(small.max_slope(GREEN))
    before = engine.encode(field, "joint")
    after = pipeline.encode(field, Encoding("refine"), lambda *_: None, scene, settings)
    half = engine.Pupil(0.3 * radius, -0.4 * radius, radius)
    quarter = engine.Pupil(-0.3 * radius, 0.2 * radius, radius / 2)
    for focus, pupil, gain in ((0.5, None, 3), (1.1, None, 3), (1.0, half, 0), (1.0, quarter, 0)):
        expected = engine.reference(scene, camera, small, [focus], pupil, 128, field.near)[0]
        decibels = [
            engine.psnr(engine.reconstruct(light, [focus], pupil)[0], expected, BORDER)
            for light in (before.field(), field, after.field())
        ]
        assert decibels[2] > max(decibels[:2]) + gain, (focus, pupil, decibels)


def test_refined_phases_are_nearest_to_the_mean_of_many_frames():
    """Compare at depths, through parts of the pupil, and in brightness: they are closer than the field and `joint`."""
    field, more = wave_field(smooth(4)), smooth(64, seed=1)
    refined = engine.encode(field, "refine", extra_frames=many(more, 24), max_steps=100, eyebox=1)
    assert refined.report["stages"][1]["frames"] == 64
    radius = field.mapping.pupil_radius(field.hologram.max_slope(GREEN))
    part, brightness = engine.Pupil(0.2 * radius, -0.3 * radius, 0.8 * radius), []
    lights = refined.field(), field, engine.encode(field, "joint").field()
    for focus, pupil, gain in ((0.5, None, 5), (0.9, None, 5), (math.inf, None, 5), (1.0, part, 0.2)):
        expected = engine.reconstruct(wave_field(more), [focus], pupil)[0]
        after, *others = (engine.reconstruct(light, [focus], pupil)[0] for light in lights)
        best = max(engine.psnr(image, expected, 8) for image in others)
        assert engine.psnr(after, expected, 8) > best + gain
        inner = np.s_[
            8:-8, 8:-8
        ]  # edges are brighter than in the field, and depths share the light that this takes
        brightness.append(after[inner].mean() / expected[inner].mean())
    assert np.mean(brightness[:3]) == pytest.approx(1, abs=0.05)
    assert 1 / (1 + 1 / 4) < brightness[3] < 1.05  # of four frames' speckle the squared error is least there


def test_one_frame_that_is_hardly_random_shows_more():
    """Compare with the mean of many frames: phases that start with a random field keep their speckle."""
    more, field = between_planes(48, 1), wave_field(between_planes(1, 2))
    expected = engine.reconstruct(wave_field(more), [0.5, 1.0, math.inf])

    def decibels(**options):
        phase = engine.encode(field, "refine", extra_frames=many(more, 24), max_steps=120, **options)
        images = engine.reconstruct(phase.field(), [0.5, 1.0, math.inf])
        return np.mean([engine.psnr(a, b, 6) for a, b in zip(images, expected, strict=True)])

    smooth, rough = decibels(randomness=0.0), decibels()
    assert smooth > rough + 2.5  # 3.4, deviation 0.25
    assert (
        decibels(randomness=0.0, eyebox=1.0) < smooth - 0.5
    )  # parts of the pupil want what one frame has not
    assert decibels(randomness=1.0) < smooth - 2.4


def test_one_frame_shows_even_surfaces_without_grain():
    """Two dark ones beside a bright one: grain comes where steps lead the light past zero."""
    size, amplitude = 96, np.full((96, 96), 0.4)
    amplitude[8:40, 8:40], amplitude[56:88, 8:40], amplitude[30:66, 56:88] = 0.12, 0.2, 1.0
    phases = np.exp(2j * np.pi * np.random.default_rng(0).random((144, size, size)))
    back = transfer_function((size, size), PITCH, GREEN, -1.5e-3)
    more = np.fft.ifft2(np.fft.fft2(amplitude * phases) * back)[:, None]
    field = wave_field(more[:1])
    phase = engine.encode(field, "refine", extra_frames=many(more, 48), randomness=0.0, max_steps=150)
    shown = np.abs(propagate(phase.field().data[0, 0], PITCH, GREEN, 1.5e-3)) ** 2
    for rows in (slice(14, 34), slice(62, 82)):
        patch = shown[rows, 14:34]
        # 0.10 to 0.11 and 0.06 to 0.07; from steps of 0.3 radians and half of the intensity 0.34 to 0.41
        assert patch.std() < 0.2 * patch.mean()


def test_cancel_while_the_start_is_set_keeps_its_brightness(monkeypatch):
    """A start that leaves room for a bright spot has other light than that before, and needs another gain."""
    data = np.full((1, 1, 48, 48), 0.2 + 0j)
    data[..., 20:28, 20:28] = 1.0
    field, waits = wave_field(data), []
    start = channel.Channel._set_random_start

    def set_start(self, spread):
        start(self, spread)
        waits.append(spread)

    def progress(done, message):
        if len(waits) > 1:
            raise engine.Cancelled

    monkeypatch.setattr(channel.Channel, "_set_random_start", set_start)
    with pytest.raises(engine.Cancelled) as stop:
        engine.encode(field, "joint", progress, randomness=0.0)
    assert waits[1] > waits[0] == MIN_SPREAD
    band = circular_band((48, 48))
    energies = [
        (np.abs(np.fft.fft2(light)[..., band]) ** 2).sum() for light in (stop.value.kept.field().data, data)
    ]
    assert energies[0] == pytest.approx(energies[1], rel=1e-3)


@pytest.mark.parametrize("case", ["few levels", "behind a lens", "an earlier hologram"])
def test_where_no_start_is_smooth(monkeypatch, case):
    """Steps are as long as they were, and the start is left alone."""
    field, options, rates = wave_field(smooth(2, shape=(32, 32))), {}, []
    if case == "few levels":
        options["bits"] = 3
    elif case == "behind a lens":
        field = wave_field(
            smooth(2, shape=(32, 32)), depth_far=-1e-3, optics=engine.Optics(lens=engine.Lens(0.1))
        )
    else:
        options["start"] = engine.encode(field, "dpac")
    spreads, set_start = [], channel.Channel._set_random_start
    monkeypatch.setattr(
        channel.Channel,
        "_set_random_start",
        lambda self, spread: (spreads.append(spread), set_start(self, spread)),
    )
    max_step = descent.max_step
    monkeypatch.setattr(descent, "max_step", lambda r: rates.append(max_step(r)) or rates[-1])
    engine.encode(field, "joint", randomness=0.0, max_steps=1, **options)
    assert spreads == ([] if case == "an earlier hologram" else [MIN_SPREAD])
    assert rates == [descent.MAX_STEP if case == "an earlier hologram" else descent.MAX_STEP_RANDOM]


def test_phases_begin_as_random_as_they_should():
    """And each frame for itself is left out; frames have maps of their own."""

    def at_once(done, message):
        if "All frames" in message:
            raise engine.Cancelled

    field, spread = wave_field(smooth(2, shape=(32, 32))), None
    for randomness in (0.0, 0.25, 1.0):
        with pytest.raises(engine.Cancelled) as stop:
            engine.encode(
                field,
                "refine",
                at_once,
                extra_frames=many(smooth(4, 1, (32, 32))),
                randomness=randomness,
                max_steps=10**9,
            )
        kept = stop.value.kept
        assert [stage["stage"] for stage in kept.report["stages"]] == ["extra frames", "refine"]
        spread = spread or float(np.median(np.abs(kept.data - math.pi)))  # of the smooth start
        turned = np.abs(np.angle(np.exp(1j * (kept.data - math.pi - even_double_phase((32, 32), spread)))))
        # one step that warms up is shorter than 0.02
        assert turned.max() < randomness * math.pi + 0.02 and turned.max() >= 0.95 * randomness * math.pi
        assert (np.abs(kept.data[0] - kept.data[1]).max() > 0.1) == (randomness > 0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"randomness": 1.5}, "randomness from 0 to 1"),
        ({"eyebox": -0.1}, "eyebox from 0 to 1"),
        ({"method": "sgd", "randomness": 0.2}, "sgd starts with the field's phases"),
        ({"randomness": 0.2, "start": "dpac"}, "begin with randomness 0.2 here.*Omit the start"),
        ({"randomness": 0.2, "supervision": "amplitude"}, "no frame is optimized by itself"),
        ({"method": "auto", "supervision": "amplitude"}, "begin with randomness 0.1 here"),
    ],
)
def test_randomness_and_eyebox_that_do_not_fit(options, words):
    with pytest.raises(engine.InvalidInput, match=words):
        engine.encode(wave_field(smooth(2, shape=(32, 32))), **{"method": "joint", **options})


def test_refinement_that_finds_no_rest_keeps_its_start(monkeypatch):
    data = smooth(3, shape=(32, 32))  # which is what they should be like
    field = wave_field(data)
    before = engine.encode(field, "sgd", max_steps=1)
    monkeypatch.setattr(descent, "MAX_STEP", 50.0)
    after = engine.encode(field, "refine", extra_frames=many(data), max_steps=1)
    np.testing.assert_allclose(np.exp(1j * after.data), np.exp(1j * before.data), atol=1e-5)


@pytest.fixture
def clock(monkeypatch):
    """Clock of encodings: 2 ms pass from one reading to the next, however slow the processor is."""
    ticks = itertools.count()
    clock = types.SimpleNamespace(perf_counter=lambda: 2e-3 * next(ticks))
    monkeypatch.setattr(encoder, "time", clock)
    monkeypatch.setattr(descent, "time", clock)
    return clock


@pytest.mark.parametrize("bits", [None, 2])
def test_refinement_takes_the_seconds_that_it_is_given(clock, monkeypatch, bits):
    """All of it: each color has its part, and few levels are kept."""
    field, seconds = wave_field(np.concatenate([smooth(2, n, (32, 32)) for n in (0, 5)], axis=1)), 0.6
    more = np.concatenate([smooth(24, n, (32, 32)) for n in (1, 6)], axis=1)
    # which knows that views take longer than a step: not by this clock
    monkeypatch.setattr(encoder._Joint, "_is_worthwhile", lambda *_: True)
    begun = clock.perf_counter()
    phase = engine.encode(
        field, "refine", extra_frames=many(more, 8), seconds=seconds, bits=bits, max_steps=10**9
    )
    assert 0.8 * seconds < clock.perf_counter() - begun < 1.2 * seconds
    refined = [stage for stage in phase.report["stages"] if stage["stage"] == "refine"]
    assert len(refined) == 2 and min(stage["steps"] for stage in refined) > 1
    if bits:
        on_levels(phase, bits)


def test_frames_that_are_not_there_in_time_are_done_without(clock):
    """Their tracing is given up, and the field's own frames are what phases go towards."""

    def endless(progress):
        while True:
            progress(0.1, "Radiance")
        yield

    field, begun = wave_field(smooth(2)), clock.perf_counter()
    phase = engine.encode(field, "refine", extra_frames=endless, seconds=2)
    assert clock.perf_counter() - begun < 2.4
    sgd, traced, refined = phase.report["stages"]
    assert traced["frames"] == 0 and 0.4 < traced["seconds"] < 1.4 and refined["steps"] >= encoder.MIN_STEPS
    assert refined["psnr_db"] > sgd["psnr_db"] + 2


def test_frames_that_came_together_leave_time_for_steps(clock, monkeypatch):
    """Adding all 24 of them takes 90 % of the seconds; without a limit all count, at once."""
    add, counts = ViewTargets.add, []

    def slow(self, fields):
        counts.append(len(fields))
        for _ in range(20 * len(fields)):
            clock.perf_counter()
        add(self, fields)

    monkeypatch.setattr(ViewTargets, "add", slow)
    field, more = wave_field(smooth(2, shape=(32, 32))), many(smooth(24, 1, (32, 32)), 24)
    phase = engine.encode(field, "refine", extra_frames=more, randomness=0.1, eyebox=0, seconds=1.07)
    traced, refined = phase.report["stages"]
    assert traced["frames"] == sum(counts) < 16 and traced["seconds"] < 0.6 and refined["steps"] > 100
    counts.clear()
    engine.encode(field, "refine", extra_frames=more, randomness=0.1, eyebox=0, max_steps=1)
    assert counts == [24]


@pytest.mark.parametrize("bits", [None, pytest.param(2, marks=pytest.mark.slow)])
def test_time_that_is_too_short_for_all_views_is_each_frame_s(clock, monkeypatch, bits):
    """Single frames, which otherwise have 1/10 of the seconds, then use all of them."""
    field, seconds = wave_field(np.concatenate([smooth(2, n, (96, 96)) for n in (0, 5)], axis=1)), 1.2
    enough = engine.encode(field, "joint", seconds=seconds, bits=bits, max_steps=100)  # of it all, 60 each
    assert sum(each["seconds"] for each in enough.report["stages"] if each["stage"] == "sgd") < 0.2 * seconds
    monkeypatch.setattr(encoder, "MIN_STEPS", 10**9)
    begun = clock.perf_counter()
    phase = engine.encode(field, "joint", seconds=seconds, bits=bits, tolerance=0)
    assert 0.8 * seconds < clock.perf_counter() - begun < 1.2 * seconds
    stages = phase.report["stages"]
    assert [each["stage"] for each in stages] == ["sgd"] * 4
    if bits:
        on_levels(phase, bits)
    else:
        pairs = zip(stages[:2], stages[2:], strict=True)
        assert all(after["psnr_db"] > before["psnr_db"] for before, after in pairs)


def test_colors_of_a_given_randomness_are_alike_by_the_clock(clock):
    """However short it is: each frame for itself would go towards a field that its phases do not come from."""
    field = wave_field(np.concatenate([smooth(1, n) for n in (0, 5)], axis=1))
    more = np.concatenate([smooth(8, n) for n in (1, 6)], axis=1)
    phase = engine.encode(field, "refine", extra_frames=many(more, 8), seconds=0.1, randomness=0.0)
    assert [each["stage"] for each in phase.report["stages"]] == ["extra frames", "refine", "refine"]
    assert all(each["steps"] > 0 for each in phase.report["stages"][1:])


def test_one_smooth_frame_is_not_asked_for_what_phases_cannot_be():
    """Without the scene, too, its pictures are the target; of random phases the field is."""
    rows, columns = np.indices((32, 32)) / 32
    flat = (0.4 + 0.5 * rows + 0.3 * np.sin(9 * columns))[None, None].astype(complex)
    stages = [
        [stage["stage"] for stage in engine.encode(wave_field(data), **how).report["stages"]]
        for data, how in (
            (flat, {"max_steps": 5}),
            (flat, {"max_steps": 5, "supervision": "amplitude"}),
            (smooth(1, shape=(32, 32)), {"max_steps": 5}),
        )
    ]
    assert stages == [["joint"], ["sgd"], ["sgd"]]


def test_no_step_is_taken_that_is_not_worth_its_time():
    """Phases are those of `sgd` where there is no time to look at all views."""
    phase = engine.encode(wave_field(smooth(4, shape=(96, 96))), "joint", seconds=1e-3)
    assert [stage["stage"] for stage in phase.report["stages"]] == ["sgd"] and phase.gains[0] > 0


@pytest.mark.parametrize(
    ("frames", "eyebox", "most"), [(3, None, 100), (7, None, 100), (3, 0.5, 150), (2, None, 150)]
)
def test_more_seconds_do_not_take_light_from_parts_of_the_pupil(frames, eyebox, most, monkeypatch):
    """Three to seven frames light all of the pupil as they begin; after 100 steps it darkens where nobody looks."""
    monkeypatch.setattr(options, "MAX_STEPS", 150)
    field = wave_field(smooth(frames, shape=(16, 16)))
    phase = engine.encode(field, "joint", randomness=0.1, eyebox=eyebox, seconds=60)
    assert [stage["steps"] for stage in phase.report["stages"]] == [most]


@pytest.mark.parametrize(("method", "bits"), [("sgd", None), ("sgd", 2), ("joint", None), ("joint", 2)])
def test_other_descents_end_with_the_seconds(clock, method, bits):
    """They take fewer steps in each color."""
    field = wave_field(np.concatenate([smooth(2, n) for n in (0, 5)], axis=1))
    free = engine.encode(field, method, bits=bits)
    taken = sum(stage["seconds"] for stage in free.report["stages"])
    limited = engine.encode(field, method, bits=bits, seconds=taken / 10)
    for before, after in zip(free.report["stages"], limited.report["stages"], strict=method == "sgd"):
        assert 0 < after["steps"]
        assert before["stage"] != after["stage"] or after["steps"] <= before["steps"]
    assert sum(after["steps"] for after in limited.report["stages"]) < sum(
        before["steps"] for before in free.report["stages"]
    )
    if bits:
        on_levels(limited, bits)


def test_seconds_that_are_too_few_for_anything():
    """A step of the first stage, the frames that were first, no step that is not worth its time, and no error."""
    taken = []

    def endless(progress):
        while True:
            taken.append(None)
            yield [0], smooth(2, seed=1, shape=(32, 32)).astype(np.complex64)

    phase = engine.encode(wave_field(smooth(2, shape=(32, 32))), "refine", extra_frames=endless, seconds=1e-9)
    sgd, frames = phase.report["stages"]
    assert sgd["steps"] == 1 and frames["frames"] == 2 and len(taken) == 1
    assert phase.gains[0] > 0


def test_refinement_that_is_stopped_keeps_its_best_round():
    field, reports = wave_field(smooth(3)), []

    def progress(done, message):
        if (done, message) not in reports[-1:]:
            reports.append((done, message))
        if sum("All frames" in each for _, each in reports) > 60:
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled) as stop:
        engine.encode(field, "refine", progress, extra_frames=many(smooth(24, seed=1)))
    start, refined = stop.value.kept.report["stages"][0], stop.value.kept.report["stages"][-1]
    assert stop.value.kept.report["stopped"] and 60 <= refined["steps"] < 100
    assert refined["psnr_db"] > start["psnr_db"] + 2
    assert [done for done, _ in reports] == sorted(done for done, _ in reports)


def test_frames_that_are_refined_in_groups(monkeypatch):
    field, more = wave_field(smooth(4, shape=(32, 32))), many(smooth(24, 1, (32, 32)))
    padded = ViewedVolume((32, 32), PITCH, GREEN, 1e-3, 2e-3).padded
    monkeypatch.setattr(encoder, "MAX_BYTES", 2 * math.prod(padded) * encoder.BYTES["together"])
    phase = engine.encode(field, "refine", extra_frames=more, max_steps=60)
    stages = phase.report["stages"][-2:]
    assert [stage["stage"] for stage in stages] == ["refine", "refine"]
    assert phase.gains[0] > 0 and all(stage["steps"] == 60 for stage in stages)


@pytest.mark.parametrize("bits", [1, 3])
def test_refinement_for_few_bits(bits):
    field, more = wave_field(smooth(4, shape=(32, 32))), many(smooth(24, 1, (32, 32)))
    refined = engine.encode(field, "refine", extra_frames=more, bits=bits, max_steps=40)
    on_levels(refined, bits)
    expected = engine.reconstruct(wave_field(smooth(24, 1, (32, 32))), [1.0])[0]
    late = engine.encode(field, "refine", extra_frames=more, max_steps=40).field(engine.Modulator(bits))
    in_time, rounded = (
        engine.psnr(engine.reconstruct(light, [1.0])[0], expected, 4) for light in (refined.field(), late)
    )
    assert in_time > rounded + 0.5
