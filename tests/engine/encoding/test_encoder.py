"""Phase-only encoding."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.encoding import encoder
from holopath_addon.engine.encoding.views import ViewedVolume
from tests.engine.encoding.fields import GREEN, PITCH, band_limited, many, wave_field


def test_what_passes_the_pupil_is_the_field(field):
    """A checkerboard's two phases average to the field: low frequencies of exp(i phase) are those of U / gain."""
    phase = engine.encode(field, "dpac")
    assert phase.data.dtype == np.float32 and phase.data.shape == field.data.shape
    assert phase.data.min() >= 0 and phase.data.max() < 2 * math.pi
    fy, fx = (np.fft.fftfreq(n) for n in field.data.shape[-2:])
    band = np.hypot(fx[None, :], fy[:, None]) < 0.12
    passed = np.fft.ifft2(np.fft.fft2(phase.field().data) * band)
    error = np.linalg.norm(passed - field.data) / np.linalg.norm(field.data)
    assert error < 0.12  # of slowly varying fields; every second pixel is half a pixel away
    arg_only = np.exp(1j * np.angle(field.data))
    arg_only = np.fft.ifft2(np.fft.fft2(arg_only) * band)
    scale = np.vdot(arg_only, field.data) / np.vdot(arg_only, arg_only)
    assert error < 0.4 * np.linalg.norm(scale * arg_only - field.data) / np.linalg.norm(field.data)


def test_frames_share_a_gain(field):
    """Brightness between frames is kept."""
    dim = field.data.copy()
    dim[1] *= 0.5
    dimmed = engine.encode(engine.WaveField(dim, field.hologram, field.camera, field.near), "dpac")
    waves = dimmed.field().data
    image = [np.abs(np.fft.fft2(w)[0, :4, :4]).sum() for w in waves[:, 0:1]]
    whole = [np.abs(np.fft.fft2(w)[0, :4, :4]).sum() for w in dim[:, 0:1]]
    assert image[1] / image[0] == pytest.approx(whole[1] / whole[0], rel=0.15)


def test_a_color_that_is_black(field):
    """A red scene has a hologram, and so has the black frame of an animation: no light is sent in."""
    data = field.data.copy()
    data[:, 1] = 0
    phase = engine.encode(engine.WaveField(data, field.hologram, field.camera, field.near), "dpac")
    assert phase.gains[1] == 0 and np.isfinite(phase.data).all() and not phase.field().data[:, 1].any()
    np.testing.assert_array_equal(phase.data[:, 0], engine.encode(field, "dpac").data[:, 0])


def test_double_phase_says_what_it_loses_on_axis():
    """Random phases: much of what goes astray misses a stop beside the zero order. Within it light is the field's."""
    rng, errors = np.random.default_rng(0), {}
    noise = (rng.normal(size=(2, 1, 1, 96, 96)) * [[[[[1]]]], [[[[1j]]]]]).sum(0)
    for carrier in ((0, 0), "auto"):
        hologram = engine.Hologram(96, 96, 8e-6, (520e-9,), optics=engine.Optics(carrier=carrier))
        mask = hologram.optics.stop_mask((96, 96))
        data = np.fft.ifft2(np.fft.fft2(noise) * mask).astype(np.complex64)
        phase = engine.encode(engine.WaveField(data, hologram, engine.Camera(np.eye(4), 0.4), 1.0), "dpac")
        shown = np.fft.ifft2(np.fft.fft2(phase.field().data) * mask)
        errors[carrier] = np.linalg.norm(shown - data) / np.linalg.norm(data)
        assert ("up to 7 dB more" in phase.report.get("advice", "")) == (carrier != "auto")
    assert errors["auto"] < 0.5 * errors[0, 0]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_cannot_be_encoded(field, value):
    bad = engine.WaveField(np.full_like(field.data, value), field.hologram, field.camera, field.near)
    with pytest.raises(engine.InvalidInput, match="not finite"):
        engine.encode(bad)
    with pytest.raises(engine.InvalidInput, match="dpac"):
        engine.encode(field, "magic")


def test_cancelled(field):
    def stop(done, message):
        raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        engine.encode(field, "dpac", stop)


def test_a_hologram_that_is_loaded_is_encoded_on(tmp_path):
    field = wave_field(band_limited((32, 32), frames=2))
    phase = engine.encode(field, "joint", max_steps=15)
    phase.save(tmp_path / "hologram")
    stored = engine.PhaseHologram.load(tmp_path / "hologram")
    np.testing.assert_array_equal(stored.data, phase.data)
    assert stored.gains == phase.gains and stored.report == phase.report
    assert stored.report["stages"][0]["stage"] == "sgd" and stored.report["stages"][1]["steps"] == 15


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
