"""Optimization of phases: gradients, stages, and images."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.baselines.frame_mean import FrameMean, carried
from holopath_addon.engine.encoding import descent
from holopath_addon.engine.encoding.phases import Phases
from holopath_addon.engine.encoding.targets import AmplitudeTarget, ComplexTarget
from holopath_addon.engine.encoding.views import ViewedVolume, Views, ViewTargets
from holopath_addon.engine.pixels import EvenSteps
from holopath_addon.engine.waves.display_model import DisplayModel
from holopath_addon.engine.waves.propagation import FreeSpace, circular_band, propagate, transfer_function
from holopath_addon.engine.waves.target_images import TargetImages, Viewpoint
from tests.engine.encoding.fields import GREEN, PITCH, band_limited, many, wave_field


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


def test_longest_steps():
    """From smooth phases, random ones, and a field's own."""
    assert [descent.max_step(r) for r in (0.0, 0.1, 0.3, 1.0, None)] == pytest.approx(
        [0.1, 0.2, 0.3, 0.3, 0.2]
    )
