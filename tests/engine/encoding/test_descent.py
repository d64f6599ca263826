"""Optimization of phases: gradients, stages, and images."""

import itertools
import math
import types
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.baselines.frame_mean import FrameMean, carried
from holopath_addon.engine.encoding import channel, descent, encoder
from holopath_addon.engine.encoding import views as views_module
from holopath_addon.engine.encoding.double_phase import MAX_SPREAD, MIN_SPREAD, even_double_phase, spread_for
from holopath_addon.engine.encoding.phases import Phases
from holopath_addon.engine.encoding.targets import AmplitudeTarget, ComplexTarget
from holopath_addon.engine.encoding.views import ViewedVolume, Views, ViewTargets
from holopath_addon.engine.pixels import EvenSteps
from holopath_addon.engine.waves.display_model import DisplayModel
from holopath_addon.engine.waves.propagation import FreeSpace, circular_band, propagate, transfer_function
from holopath_addon.engine.waves.supervision import FramePool
from holopath_addon.engine.waves.target_images import TargetImages, Viewpoint
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

GREEN, PITCH = 516.5e-9, 8e-6
BORDER = 25


def band_limited(shape, frames=1, colors=1, seed=0, radius=0.5):
    """Random complex fields, smooth where the radius (cycles a pixel) is small."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(frames, colors, *shape)) + 1j * rng.normal(size=(frames, colors, *shape))
    fy, fx = (np.fft.fftfreq(n) for n in shape)
    data = np.fft.ifft2(np.fft.fft2(noise) * (np.hypot(fx[None, :], fy[:, None]) <= radius))
    return data / np.abs(data).mean()


def wave_field(data, **hologram):
    colors = (GREEN, 640e-9, 455e-9)[: data.shape[1]]
    size = data.shape[-1], data.shape[-2]
    display = engine.Hologram(*size, PITCH, colors, **{"depth_far": 1e-3, "depth_near": 2e-3, **hologram})
    return engine.WaveField(data.astype(np.complex64), display, engine.Camera(np.eye(4), 0.6), 0.5)


def many(data, batch=4):
    """The argument `extra_frames` of `encode`: batches of frames."""
    colors = list(range(data.shape[1]))
    return lambda progress: (
        (colors, data[n : n + batch].astype(np.complex64)) for n in range(0, len(data), batch)
    )


def smooth(frames, seed=0, shape=(64, 64)):
    """Frames of one even gradient, each with phases of its own."""
    rows, columns = np.indices(shape) / 64
    amplitude = 0.4 + 0.5 * rows + 0.3 * np.sin(9 * columns)
    speckled = band_limited(shape, frames, seed=seed)
    return amplitude * speckled / np.abs(speckled)


@pytest.fixture
def pool():
    with FramePool() as pool:
        yield pool


def targets_of(kind, fields, pool):
    """``gradient(light)`` of a loss, and the light as it depends on phases."""
    if kind == "amplitude":
        return AmplitudeTarget(fields, PITCH, GREEN, [1e-3, 2e-3, 3e-3], pool)
    return ComplexTarget(fields, kind == "stop", pool)


@pytest.mark.parametrize("kind", ["flat", "random"])
def test_smooth_phases_are_told_of(kind):
    """Amplitude supervision shows an image of flat phases with 44.6 dB instead of 19.9."""
    rows, columns = np.indices((48, 48))
    picture = 0.5 + 0.3 * np.sin(rows / 5) * np.cos(columns / 7) + 0j
    if kind == "random":
        picture *= np.exp(2j * math.pi * np.random.default_rng(0).random(picture.shape))
    field = wave_field(propagate(picture, PITCH, GREEN, -1.5e-3)[None, None])
    advice = engine.encode(field, "sgd", max_steps=3).report.get("advice", "")
    assert ("amplitude supervision" in advice) == (kind == "flat")
    assert "advice" not in engine.encode(field, "sgd", supervision="amplitude", max_steps=3).report


def test_what_is_advised_for_smooth_phases_shows_more_at_all_depths():
    """Two halves at two depths, which amplitudes of one plane would show worse than the complex field: 12 and 16 dB."""
    rows, columns = np.indices((64, 64))
    picture = 0.5 + 0.3 * np.sin(rows / 5) * np.cos(columns / 7) + 0j
    ends = 1.2e-3, 1.9e-3
    halves = (columns < 32, columns >= 32)
    data = sum(propagate(picture * half, PITCH, GREEN, -z) for half, z in zip(halves, ends, strict=True))
    field = replace(wave_field(data[None, None]), plan={"z_low": ends[0], "z_high": ends[1]})
    focus = [float(field.mapping.z_to_depth(z)) for z in ends]
    expected = engine.reconstruct(field, focus)

    def decibels(**options):
        images = engine.reconstruct(engine.encode(field, "sgd", max_steps=60, **options).field(), focus)
        return min(engine.psnr(*pair, 8) for pair in zip(images, expected, strict=True))

    advised = {"supervision": "amplitude", "compared_planes": 7}
    assert decibels(**advised) > decibels() + 4


def test_amplitude_supervision_tells_what_is_true():
    """Light of the phases by an angular spectrum on a grid of a thousand pixels, which the descent does not have."""
    side, distance, reports = 64, 1.5e-3, []
    rows, columns = np.indices((side, side))
    picture = 0.5 + 0.3 * np.sin(rows / 5) * np.cos(columns / 7)
    field = wave_field(propagate(picture, PITCH, GREEN, -distance)[None, None])
    phase = engine.encode(
        field, "sgd", supervision="amplitude", progress=lambda _, text: reports.append(text)
    )
    u = (GREEN / PITCH * np.hypot.outer(*[np.fft.fftfreq(1024)] * 2)) ** 2
    kernel = np.exp(-2j * math.pi * distance / GREEN * u / (1 + np.sqrt(1 - u)))
    kernel *= u <= (GREEN / PITCH / 2) ** 2

    def image(light):
        return np.abs(np.fft.ifft2(np.fft.fft2(light, (1024, 1024)) * kernel)[:side, :side])

    expected, shown = image(field.data[0, 0]), image(np.exp(1j * phase.data[0, 0].astype(float)))
    gain = (shown * expected).sum() / (shown**2).sum()
    amplitude = np.abs(field.data)
    white = np.quantile(amplitude, 0.95) / np.sqrt((amplitude**2).mean())
    true = 10 * math.log10(white**2 * (expected**2).mean() / ((gain * shown - expected) ** 2).mean())
    last = [float(text.split()[-2]) for text in reports if text.endswith("dB")][-1]
    assert true > 38 and last == pytest.approx(true, abs=1.5)  # 44.6 for 33 on a grid without a guard band


@pytest.mark.parametrize("kind", ["stop", "no stop", "amplitude", "frame mean", "views", "views elsewhere"])
def test_gradient_against_finite_differences(library, kind, pool):
    """Along random directions, in double precision, on sides that are odd and unequal."""
    rng = np.random.default_rng(3)
    fields = band_limited((27, 40), frames=3)[:, 0]
    made = library.asarray
    start = rng.uniform(0, 2 * np.pi, fields.shape)
    if kind == "frame mean":
        viewpoints = [Viewpoint(2e-3), Viewpoint(-1e-3, (0.1, -0.05, 0.2))]
        whole = made(fields.astype(np.complex64))
        pictures = TargetImages(fields.shape[-2:], PITCH, GREEN, viewpoints, on=whole)
        pictures.add(whole)
        mean = FrameMean(pictures, 1.3, pool)

        def gradient(light):
            loss, back = mean.gradient(light, 1)
            return loss, back, np.ones(light.shape[0])
    elif kind in ("views", "views elsewhere"):
        pitch, places = PITCH, None
        if kind == "views elsewhere":
            pitch, places = (0.8 * PITCH, PITCH), (EvenSteps(-0.4, 1.02, 27), EvenSteps(0.3, 1.25, 32))
        whole = made(fields.astype(np.complex64))
        volume = ViewedVolume(fields.shape[-2:], pitch, GREEN, -1e-3, 2e-3, places=places)
        views = Views(volume, 3, 0, on=whole)
        chosen = [
            (numbers[-1], share) for (_, numbers), share in zip(views.kinds, (0.5, 0.3, 0.2), strict=True)
        ]
        targets = ViewTargets(views, whole)
        targets.add(whole)

        def gradient(light):
            view_losses = descent.ViewLosses(light, targets, 1.0)
            view_losses.gain = 1.3
            back = view_losses.gradient(light, chosen)
            return sum(share * view_losses.losses[n] for n, share in chosen), back, np.ones(3)
    else:
        target = targets_of(kind, made(fields), pool)
        target.gradient(Phases(made(start), pool).light)
        held = vars(target).copy()

        def gradient(light):  # the scale stays as it is: it follows a step later
            for name in ("factors", "gain"):
                if name in held:
                    setattr(target, name, held[name])
            return target.gradient(light)

    loss, back, factors = gradient(Phases(made(start), pool).light)
    phases = Phases(made(start), pool)
    light, slopes = np.asarray(phases.light), np.asarray(back) * np.reshape(factors, (-1, 1, 1))
    slope = 2 * (light.conj() * slopes).imag
    assert slope.dtype == np.float64 and loss > 0
    phases.descend(back, factors, 1e-3)  # Adam's first step is as long for all
    moved = np.angle(np.exp(1j * (np.asarray(phases.values()) - start)))
    np.testing.assert_allclose(moved, -1e-3 * np.sign(slope), atol=1e-5)
    for _ in range(3):
        direction, step = rng.normal(size=start.shape), 1e-5
        ahead = gradient(Phases(made(start + step * direction), pool).light)[0]
        behind = gradient(Phases(made(start - step * direction), pool).light)[0]
        assert (ahead - behind) / (2 * step) == pytest.approx((slope * direction).sum(), rel=1e-4)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.complex64, 1e-5), (np.complex128, 1e-12)])
def test_adjoint_of_propagation(dtype, tolerance):
    """<A x, y> = <x, A* y>, with windows that are cut out of the padded grid."""
    rng = np.random.default_rng(4)
    x, y = (rng.normal(size=(2, 90, 75)) + 1j * rng.normal(size=(2, 90, 75))).astype(dtype)
    x[60:], x[:, 50:], y[60:], y[:, 50:] = 0, 0, 0, 0
    transfer = FreeSpace((90, 75), PITCH, GREEN)(7e-3).astype(dtype)
    forth = carried(x.copy(), transfer)
    forth[60:], forth[:, 50:] = 0, 0
    back = carried(y.copy(), np.conj(transfer))
    back[60:], back[:, 50:] = 0, 0
    size = np.linalg.norm(forth) * np.linalg.norm(y)
    assert abs(np.vdot(y, forth) - np.vdot(back, x)) < tolerance * size


@pytest.mark.parametrize("distance", [85e-3, -5e-3, 0.0])
def test_free_space_in_single_precision(distance):
    shape = (200, 300)
    exact = transfer_function(shape, PITCH, GREEN, distance)
    np.testing.assert_allclose(FreeSpace(shape, PITCH, GREEN)(distance), exact, atol=1e-4)


BENCHES = {
    "plain": {},
    "lens": {"optics": engine.Optics(engine.Beam("gaussian", (0.3e-3,)), lens=engine.Lens(0.1, 0.1))}
    | {"depth_far": -1e-3, "depth_near": 1e-3},
    "off axis": {"optics": engine.Optics(carrier="auto")},
}
MEASURED = [  # of pixels that differ, and of two phases
    engine.Levels(
        np.linspace(0.3, 6.0, 5),
        np.random.default_rng(8).uniform(0, 6, (24, 33)),
        np.random.default_rng(9).uniform(0.8, 1.2, (24, 33)),
    ),
    engine.Levels((0.0, 3.0)),
]


@pytest.mark.parametrize(
    ("bench", "options"),
    [
        ("plain", {"method": "dpac"}),
        ("plain", {"method": "sgd"}),
        ("plain", {"method": "sgd", "start": "dpac", "bits": 1}),
        ("plain", {"method": "sgd", "supervision": "amplitude", "compared_planes": 2}),
        ("plain", {"method": "joint", "bits": 2}),
        ("plain", {"method": "refine", "randomness": 0.3}),
        ("lens", {"method": "dpac"}),
        ("lens", {"method": "joint"}),
        ("off axis", {"method": "sgd", "bits": 3}),
        ("plain", {"method": "joint", "display": [DisplayModel(GREEN, falloff=0.2, crosstalk=0.4)] * 2}),
        ("off axis", {"method": "refine"}),
        ("plain", {"method": "joint", "levels": MEASURED}),
    ],
    ids=lambda value: value if isinstance(value, str) else "-".join(map(str, value.values()))[:24],
)
def test_libraries_of_arrays_agree(other_library, bench, options):
    """Whose phases are a library's own, and show what NumPy's show; roundings grow a little from step to step."""
    data = band_limited((24, 33), frames=2, colors=2, radius=0.3).astype(np.complex64)
    field, own = wave_field(data, **BENCHES[bench]), other_library.asarray(data)
    options = {"max_steps": 3, "extra_frames": many(data[:, :, ::-1])} | options
    expected, found = (engine.encode(replace(field, data=each), **options) for each in (data, own))
    assert isinstance(found.data, type(own)) and found.gains == pytest.approx(expected.gains, rel=1e-5)
    apart = np.abs(np.exp(1j * np.asarray(found.data)) - np.exp(1j * expected.data))
    assert np.median(apart) < 1e-6 and np.quantile(apart, 0.999) < 1e-3
    levels = options.get("levels")
    images = [engine.reconstruct(phase.field(levels=levels), [1.0]) for phase in (expected, found)]
    np.testing.assert_allclose(np.asarray(images[1]), images[0], atol=1e-4 * images[0].max())


def test_neither_phase_nor_gain_of_the_target_counts():
    data = band_limited((48, 64), frames=2)
    plain = engine.encode(wave_field(data), "sgd", max_steps=20, tolerance=0)
    turned = engine.encode(wave_field(3 * np.exp(0.7j) * data), "sgd", max_steps=20, tolerance=0)
    losses = [phase.report["stages"][0]["loss"] for phase in (plain, turned)]
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
    assert turned.gains[0] == pytest.approx(3 * plain.gains[0], rel=1e-3)


def test_light_in_the_band_is_the_field():
    """Nearer to the complex field than its phases alone, by what the stage says."""
    data = band_limited((64, 48), frames=2)
    field, band = wave_field(data), circular_band((64, 48))

    def error(phase):
        light, expected = (np.fft.fft2(f.data[:, 0])[:, band] for f in (phase.field(), field))
        scale = [np.vdot(a, b) / np.vdot(a, a) for a, b in zip(light, expected, strict=True)]
        return np.linalg.norm(np.array(scale)[:, None] * light - expected) / np.linalg.norm(expected)

    done = engine.encode(field, "sgd")
    assert error(done) < 0.65 * error(replace(done, data=np.angle(field.data)))
    # what is measured outside is what the stage reports
    assert error(done) ** 2 == pytest.approx(done.report["stages"][0]["loss"], rel=0.05)
    assert 5 < done.report["stages"][0]["steps"] < 300  # it stopped by itself


def test_a_warm_start_takes_fewer_steps():
    data = band_limited((64, 64), frames=1)
    first = engine.encode(wave_field(data), "sgd")
    changed = wave_field(data + 0.05 * band_limited((64, 64), seed=9))
    cold, warm = (engine.encode(changed, "sgd", start=start).report["stages"][0] for start in ("arg", first))
    assert warm["steps"] < 0.7 * cold["steps"] and warm["loss"] < 1.05 * cold["loss"]
    again = engine.encode(wave_field(data), "sgd", start=first, max_steps=3).report["stages"][0]
    assert again["loss"] < 1.05 * first.report["stages"][0]["loss"]  # nothing is spoiled at first
    with pytest.raises(engine.InvalidInput, match="1 frames and 1 wavelengths of 64 x 64"):
        engine.encode(wave_field(band_limited((32, 64))), "sgd", start=first)


def test_start_from_double_phase():
    field = wave_field(band_limited((64, 64), radius=0.1))
    phase = engine.encode(field, "sgd", start="dpac", max_steps=1, tolerance=0)
    pairs = engine.encode(field, "dpac")
    turn = np.angle(np.exp(1j * (phase.data - pairs.data)))
    assert np.abs(turn).max() < 0.3  # a step of Adam away


@pytest.mark.parametrize("bits", [1, 2, 4])
def test_few_levels_are_in_the_loop(bits):
    """Better than rounding afterwards, and nothing but the levels."""
    field = wave_field(band_limited((64, 64), frames=4))
    levels = 2 * math.pi / 2**bits
    phase = engine.encode(field, "sgd", bits=bits)
    np.testing.assert_allclose(phase.data / levels, np.round(phase.data / levels), atol=1e-5)
    assert phase.data.max() < 2 * math.pi - levels / 2
    afterwards = engine.encode(field, "sgd").field(engine.Modulator(bits)).data
    target = field.data[:, 0]
    band = circular_band((64, 64))

    def error(light):
        errors = []
        for a, b in zip(light[:, 0], target, strict=True):
            a, b = np.fft.fft2(a)[band], np.fft.fft2(b)[band]
            errors.append(1 - abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a) * np.vdot(b, b)).real)
        return np.mean(errors)

    assert error(phase.field().data) < error(afterwards)


@pytest.mark.parametrize("method", ["sgd", "joint"])
@pytest.mark.parametrize("shape", [(17, 31), (1, 1), (40, 2), (33, 64)])
def test_odd_and_small_sizes(shape, method):
    rng = np.random.default_rng(0)
    data = np.exp(2j * np.pi * rng.random((2, 1, *shape)))
    phase = engine.encode(wave_field(data), method, max_steps=8)
    assert phase.data.shape == data.shape and np.isfinite(phase.data).all()
    assert phase.data.min() >= 0 and phase.data.max() < 2 * math.pi and np.isfinite(phase.gains).all()


@pytest.mark.parametrize("method", ["dpac", "sgd", "joint", "refine"])
def test_darkness(method):
    """A black field, a black color and a black frame: no light is sent in, and nothing is divided by zero."""
    data = band_limited((32, 32), frames=3, colors=2)
    data[:, 0], data[1, 1] = 0, 0
    more = many(band_limited((32, 32), frames=6, colors=2))
    phase = engine.encode(wave_field(data), method, max_steps=10, extra_frames=more)
    assert phase.gains[0] == 0 and phase.gains[1] > 0
    assert np.isfinite(phase.data).all() and not phase.field().data[:, 0].any()
    black = engine.encode(wave_field(np.zeros((2, 1, 32, 32))), method, extra_frames=lambda progress: 1 / 0)
    assert black.gains == (0,) and not black.data.any()


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1e9])
def test_how_bright_the_field_is_does_not_matter(scale):
    data = band_limited((40, 40), frames=2)
    plain, scaled = (
        engine.encode(wave_field(f * data), "joint", max_steps=30, tolerance=0) for f in (1, scale)
    )
    assert scaled.gains[0] == pytest.approx(scale * plain.gains[0], rel=1e-3)
    turn = np.angle(np.exp(1j * (scaled.data - plain.data)))
    assert np.sqrt((turn**2).mean()) < 0.05


def test_frames_that_are_dark_in_a_group(monkeypatch):
    data = band_limited((32, 32), frames=3)
    data[1] = 0
    monkeypatch.setattr(encoder, "MAX_BYTES", 32 * 32 * encoder.BYTES["sgd"])
    phase = engine.encode(wave_field(data), "sgd", max_steps=9)
    assert [stage["steps"] for stage in phase.report["stages"]] == [9, 9]
    assert np.isfinite(phase.data).all() and phase.gains[0] > 0


def test_an_even_field_needs_no_step():
    phase = engine.encode(wave_field(np.ones((2, 1, 32, 32)), depth_far=-1e-6, depth_near=1e-6), "joint")
    assert np.isfinite(phase.data).all()


@pytest.mark.parametrize(("method", "steps", "brighter"), [("sgd", 60, 100), ("joint", 300, 50)])
def test_a_single_bright_pixel(method, steps, brighter):
    """A point of light is where it was, and the rest is dark beside it; all views take more steps.

    How dark is chance: by where the point is, `sgd` makes it 150 to 230 times as bright, and `joint` 40 to 140. It
    differs by roundings, too, and so by processors.
    """
    data = np.zeros((2, 1, 48, 48), complex)
    data[:, 0, 20, 30] = 1
    field = wave_field(data, depth_far=-1e-6, depth_near=1e-6)
    phase = engine.encode(field, method, max_steps=steps)
    image = engine.reconstruct(phase.field(), [1.0])[0, ..., 0]
    assert np.unravel_index(image.argmax(), image.shape) == (20, 30)
    assert image[20, 30] > brighter * np.median(image)


def test_what_does_not_fit():
    field = wave_field(band_limited((16, 16)))
    for options, says in (
        ({"method": "magic"}, "encoding 'magic'"),
        ({"supervision": "hope"}, "supervision 'hope'"),
        ({"start": "nothing"}, "the start 'nothing'"),
        ({"bits": 0}, "bits from 1 to 16, got 0"),
        ({"compared_planes": 0}, "compared_planes from 1 to 64, got 0"),
        ({"method": "refine", "extra_frames": many(field.data), "seconds": 0}, "more than 0"),
        ({"tolerance": 2}, "tolerance"),
        ({"max_steps": 0}, "one step"),
        ({"method": "refine"}, "needs extra frames of the scene"),
        ({"start": 3}, "the start 'arg', 'dpac' or a PhaseHologram, got int"),
        ({"method": "joint", "has_stop": False}, "only sgd"),
    ):
        with pytest.raises(engine.InvalidInput, match=says):
            engine.encode(field, **options)


def test_what_is_kept_when_mitsuba_wraps_the_wish_to_stop():
    def stopped(progress):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise RuntimeError("in a loop") from error

    with pytest.raises(engine.Cancelled) as stop:
        engine.encode(wave_field(band_limited((32, 32))), "refine", extra_frames=stopped, max_steps=3)
    assert stop.value.kept.report["stages"][0]["steps"] == 3
    with pytest.raises(ZeroDivisionError):
        engine.encode(
            wave_field(band_limited((32, 32))), "refine", extra_frames=lambda progress: 1 / 0, max_steps=3
        )


def test_a_field_with_nothing_that_can_be_seen():
    """A checkerboard's light lies in the corners of the spectrum, beyond the recordable circle."""
    rows, columns = np.indices((32, 32))
    for method in ("sgd", "joint"):
        phase = engine.encode(wave_field(((-1.0) ** (rows + columns))[None, None]), method)
        assert phase.gains == (0,) and np.isfinite(phase.data).all()


@pytest.mark.parametrize("method", ["sgd", "joint"])
def test_canceling_keeps_what_is_done(method):
    field = wave_field(band_limited((32, 32), frames=2, colors=2))
    reports = []

    def progress(done, message):
        if (
            "dB" in message and (done, message) not in reports[-1:]
        ):  # a step is told again while the next one is made
            reports.append((done, message))
        if len(reports) == 25:
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled) as stop:
        engine.encode(field, method, progress, tolerance=0, max_steps=20)
    kept = stop.value.kept
    assert kept.report["stopped"] and len(reports) == 25
    steps = [stage["steps"] for stage in kept.report["stages"]]
    assert steps[:2] == [20, 5]  # the fifth of the second color was told, and the last
    assert [done for done, _ in reports] == sorted(done for done, _ in reports) and "dB" in reports[-1][1]
    whole = engine.encode(field, method, tolerance=0, max_steps=20)
    if method == "sgd":
        np.testing.assert_array_equal(kept.data[:, 0], whole.data[:, 0])
    assert all(gain > 0 for gain in kept.gains)


def test_frames_that_do_not_fit_into_memory(monkeypatch):
    """Done in groups: better than one by one, if not as all together."""
    field = wave_field(band_limited((48, 48), frames=4))
    whole = engine.encode(field, "joint", max_steps=30)
    padded = ViewedVolume((48, 48), PITCH, GREEN, -2e-3, 2e-3).padded
    monkeypatch.setattr(encoder, "MAX_BYTES", 2 * padded[0] * padded[1] * encoder.BYTES["together"])
    parts = engine.encode(field, "joint", max_steps=30)
    stages = [stage["stage"] for stage in parts.report["stages"]]
    assert stages.count("joint") == 2 and stages.count("sgd") <= 2
    expected, *results = (
        engine.reconstruct(light, [1.0])[0]
        for light in (field, engine.encode(field, "sgd").field(), parts.field(), whole.field())
    )
    alone, grouped, together = (engine.psnr(image, expected) for image in results)
    assert alone + 1 < grouped < together


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


def between_planes(frames, seed, size=64):
    """Frames of two textures at 1.1 and 1.9 mm, with random phases, at the SLM."""
    rng = np.random.default_rng(seed)
    columns = np.indices((size, size))[1]
    data = 0
    for distance, amplitude in ((1.1e-3, columns % 12 < 6), (1.9e-3, columns % 20 < 8)):
        half = columns < size // 2 if distance < 1.5e-3 else columns >= size // 2
        there = half * (0.3 + 0.7 * amplitude) * np.exp(2j * np.pi * rng.random((frames, size, size)))
        data = data + np.fft.ifft2(
            np.fft.fft2(there) * transfer_function((size, size), PITCH, GREEN, -distance)
        )
    return data[:, None]


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


def test_longest_steps():
    """From smooth phases, random ones, and a field's own."""
    assert [descent.max_step(r) for r in (0.0, 0.1, 0.3, 1.0, None)] == pytest.approx(
        [0.1, 0.2, 0.3, 0.3, 0.2]
    )


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


@pytest.mark.parametrize(("spread", "share"), [(MIN_SPREAD, 0.5), (math.pi / 3, 0.25)])
def test_a_fraction_of_the_start_goes_straight_on(spread, share):
    """The rest goes to the corner of the Fourier plane, where no stop lets it through."""
    light = np.fft.fft2(np.exp(1j * even_double_phase((8, 10), spread))) / 80
    assert abs(light[0, 0]) ** 2 == pytest.approx(share)
    assert abs(light[4, 5]) ** 2 == pytest.approx(1 - share)
    assert abs(even_double_phase((3, 5))).min() == np.float32(MIN_SPREAD)


def test_the_start_is_as_far_below_the_largest_amplitude_as_the_picture_is():
    """A picture whose bright part is twice its mean begins at half of the largest amplitude."""
    picture = np.full((40, 50), 0.9 / 2)
    picture[:4] = 0.95
    assert (
        math.cos(spread_for(picture))
        == pytest.approx(picture.mean() / 0.95)
        == pytest.approx(0.526, abs=1e-3)
    )
    assert spread_for(np.ones((4, 4))) == MIN_SPREAD
    picture[...] = 0
    picture[7, :11] = 1  # hardly more than a percent of the pixels
    assert spread_for(picture) == MAX_SPREAD


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
    ],
)
def test_randomness_and_eyebox_that_do_not_fit(options, words):
    with pytest.raises(engine.InvalidInput, match=words):
        engine.encode(wave_field(smooth(2, shape=(32, 32))), **{"method": "joint", **options})


def test_the_whole_pupil_alone():
    volume = ViewedVolume((32, 32), PITCH, GREEN, 1e-3, 4e-3)
    views = Views(volume, 3, 0, eyebox=0)
    assert len(views.kinds) == 1 and views.kinds[0][0].weight == 1 and len(views) == len(views.kinds[0][1])
    weights = [kind.weight for kind, _ in Views(volume, 3, 0, eyebox=0.5).kinds]
    assert weights == pytest.approx([0.95, 0.025, 0.025])


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


def test_no_step_is_taken_that_is_not_worth_its_time():
    """Phases are those of `sgd` where there is no time to look at all views."""
    phase = engine.encode(wave_field(smooth(4, shape=(96, 96))), "joint", seconds=1e-3)
    assert [stage["stage"] for stage in phase.report["stages"]] == ["sgd"] and phase.gains[0] > 0


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


def on_levels(phase, bits):
    levels = phase.data * (2**bits / (2 * math.pi))
    np.testing.assert_allclose(levels, np.round(levels), atol=1e-4)


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
        if "All frames" in message and len(reports) > 200:
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled) as stop:
        engine.encode(field, "refine", progress, extra_frames=many(smooth(24, seed=1)))
    start, refined = stop.value.kept.report["stages"][0], stop.value.kept.report["stages"][-1]
    assert stop.value.kept.report["stopped"] and 0 < refined["steps"] < 400
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


def test_whole_views_are_pictures_where_colors_lie_apart(monkeypatch):
    """Their samples are the image's pixels, between those of the panel, as in `reconstruct`."""
    monkeypatch.setattr(views_module, "OPTIMIZATION_GUARD", 0)
    shape, optics = (47, 64), engine.Optics(color_scale=(1.03,), color_shift=((9e-6, -3e-6),))
    hologram = engine.Hologram(64, 47, (0.8 * PITCH, PITCH), (GREEN,), 1e-3, 3e-3, optics=optics)
    field = replace(wave_field(band_limited(shape, frames=2)), hologram=hologram)
    raster = hologram.raster(GREEN)
    places = hologram.picture.raster().lines_on(raster)
    volume = ViewedVolume(shape, raster.pitch, GREEN, 1e-3, 2e-3, places=places)
    targets = ViewTargets(Views(volume, frames=2, seed=3, eyebox=0))
    targets.add(field.data[:, 0])
    image = engine.reconstruct(field, [math.inf])[0, ..., 0]
    error = targets.intensities[targets.views.kinds[0][1][0]] - image
    assert np.sqrt((error**2).mean()) < 0.1 * image.mean()  # edges have other bins


def test_views_are_those_of_a_field(monkeypatch):
    """Whole ones as `reconstruct` shows them, parts as `TargetImages` at every second or fourth pixel."""
    monkeypatch.setattr(
        views_module, "OPTIMIZATION_GUARD", 0
    )  # the grid of a field that has not been through an SLM
    shape = 47, 63  # whose padded ones are alike
    field = wave_field(band_limited(shape, frames=3))
    views = Views(ViewedVolume(shape, PITCH, GREEN, 1e-3, 2e-3), frames=3, seed=3)
    targets = ViewTargets(views)
    with FramePool():
        for m in range(3):
            targets.add(field.data[m : m + 1, 0])
    image = engine.reconstruct(field, [math.inf])[0, ..., 0]
    np.testing.assert_allclose(targets.intensities[views.kinds[0][1][0]], image, atol=3e-3 * image.max())
    for (_, numbers), apart in zip(views.kinds[1:], (2, 4), strict=True):
        pictures = TargetImages(shape, PITCH, GREEN, [views.viewpoints[n] for n in numbers])
        pictures.add(field.data[:, 0])
        for number, expected in zip(numbers, pictures.targets, strict=True):
            error = targets.intensities[number] - expected[::apart, ::apart]
            assert np.sqrt((error**2).mean()) < 0.2 * expected.mean()  # their edges have other bins


@pytest.mark.parametrize(("frames", "each"), [(1, (4, 8)), (8, (4, 8)), (24, (12, 24)), (96, (12, 24))])
def test_parts_of_the_pupil_that_are_looked_through_lie_all_over_it(frames, each):
    """The two closest of n disks on a spiral are about as far apart as the area of the larger disk allows."""
    views = Views(ViewedVolume((32, 32), PITCH, GREEN, 1e-3, 4e-3), frames, seed=3)
    for (_, numbers), radius, count in zip(views.kinds[1:], (0.25, 0.125), each, strict=True):
        assert len(numbers) == count * len(views.kinds[0][1])
        parts = np.array([views.viewpoints[n].part for n in numbers])
        assert (parts[:, 2] == radius).all()
        middles, room = parts[:, :2], 0.5 - radius
        assert np.hypot(*middles.T).max() <= room
        apart = np.hypot(*(middles[:, None] - middles).T)[~np.eye(len(parts), dtype=bool)].min()
        assert apart > 0.8 * room * math.sqrt(math.pi / len(parts))


def test_light_that_passes_beside_the_slm_is_made_up_for():
    """Half of the cone of a pixel at an edge meets the SLM, a quarter in a corner, plus the part of half a pixel."""
    views = Views(ViewedVolume((128, 128), PITCH, GREEN, 1e-3, 4e-3), 8, seed=3)
    targets = ViewTargets(views)
    radius = math.tan(math.asin(GREEN / (2 * PITCH))) * 4e-3 / PITCH
    edge = 1 / 2 + 1 / (math.pi * radius)
    corner = 1 / 4 + 1 / (math.pi * radius) + 1 / (4 * math.pi * radius**2)
    for expected in targets.intensities:
        expected[:] = 1
    targets.unvignette()
    for _, numbers in views.kinds:
        farthest = targets.intensities[numbers[-1]]
        middle = len(farthest) // 2
        assert farthest[middle, middle] == pytest.approx(1, rel=1e-5)
        assert farthest[0, middle] == pytest.approx(1 / edge, rel=0.02)
        assert farthest[0, 0] == pytest.approx(1 / corner, rel=0.02)


def test_refined_pictures_have_no_dark_border():
    """An even plane that shines: its pictures by a field of its size are dark where a part of the cone is lost."""
    side, distance = 48, 1e-3
    there = np.exp(2j * np.pi * np.random.default_rng(5).random((36, 64, 64)))
    there[:, side:], there[:, :, side:] = 0, 0
    data = np.fft.ifft2(np.fft.fft2(there) * transfer_function((64, 64), PITCH, GREEN, -distance))
    data = data[:, None, :side, :side]
    field = wave_field(data[:4], depth_far=distance)
    phase = engine.encode(field, "refine", extra_frames=many(data[4:]), max_steps=100)

    def edge(light):
        picture = engine.reconstruct(light, [math.inf])[0, ..., 0]
        rows = np.concatenate(
            [picture[:2, 8:-8], picture[-2:, 8:-8], picture[8:-8, :2].T, picture[8:-8, -2:].T]
        )
        return rows.mean() / picture[8:-8, 8:-8].mean()

    assert edge(wave_field(data, depth_far=distance)) < 0.75
    assert edge(phase.field()) == pytest.approx(1, abs=0.12)  # over seeds 0.91, deviation 0.005


def test_pictures_count_frames_as_they_come():
    """One by one or together, and as `reconstruct` shows them."""
    field = wave_field(band_limited((40, 56), frames=3))
    viewpoints = [Viewpoint(1e-3), Viewpoint(2e-3, (0.1, 0.05, 0.2))]
    together, single = (TargetImages((40, 56), PITCH, GREEN, viewpoints) for _ in range(2))
    together.add(field.data[:, 0])
    for m in range(3):
        single.add(field.data[m : m + 1, 0])
    np.testing.assert_allclose(single.targets, together.targets, rtol=1e-4, atol=1e-5)
    assert single.energy == pytest.approx(together.energy, rel=1e-5)
    image = engine.reconstruct(field, [math.inf])[0, ..., 0]
    np.testing.assert_allclose(together.targets[0], image, atol=2e-3 * image.max())
    radius = field.mapping.pupil_radius(field.hologram.max_slope(GREEN))
    pupil = engine.Pupil(0.2 * radius, -0.1 * radius, 0.8 * radius)
    image = engine.reconstruct(field, [field.near], pupil)[0, ..., 0]
    np.testing.assert_allclose(together.targets[1], image, atol=0.02 * image.max())


def test_a_hologram_that_is_loaded_is_encoded_on(tmp_path):
    field = wave_field(band_limited((32, 32), frames=2))
    phase = engine.encode(field, "joint", max_steps=15)
    phase.save(tmp_path / "hologram")
    stored = engine.PhaseHologram.load(tmp_path / "hologram")
    np.testing.assert_array_equal(stored.data, phase.data)
    assert stored.gains == phase.gains and stored.report == phase.report
    assert stored.report["stages"][0]["stage"] == "sgd" and stored.report["stages"][1]["steps"] == 15
