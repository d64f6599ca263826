"""Phase-only encoding."""

import math

import numpy as np
import pytest

from holopath_addon import engine


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
