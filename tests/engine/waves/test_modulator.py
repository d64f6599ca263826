"""Light of a display with limits, compared with light computed point by point."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.waves.modulator import Modulator, gray_levels


@pytest.fixture
def phases():
    return np.random.default_rng(0).uniform(0, 2 * np.pi, (2, 1, 24, 31)).astype(np.float32)


def test_an_ideal_display_changes_nothing(phases):
    np.testing.assert_allclose(Modulator().light(phases), np.exp(1j * phases), atol=1e-6)


@pytest.mark.parametrize("bits", [1, 4, 8, 10])
def test_levels(library, phases, bits):
    shown = np.asarray(Modulator(bits).shown(library.asarray(phases)))
    turn = shown / (2 * math.pi) * 2**bits
    np.testing.assert_allclose(turn, gray_levels(phases, bits), atol=1e-3)
    error = np.angle(np.exp(1j * (shown - phases)))
    assert np.abs(error).max() <= math.pi / 2**bits + 1e-5


@pytest.mark.parametrize("fill_factor", [0.25, 0.5625, 1.0])
def test_fill_factor_against_pixels_in_full(phases, fill_factor):
    """The spectrum of pixels drawn as squares on a sixteen times finer grid, within the SLM's own range."""
    fine, (rows, columns) = 16, phases.shape[-2:]
    side = round(fine * math.sqrt(fill_factor))
    pixel = np.zeros((fine, fine))
    pixel[:side, :side] = 1
    light = np.exp(1j * phases[0, 0].astype(float))
    spectrum = np.fft.fft2(np.kron(light, pixel)) / fine**2
    fy, fx = (np.fft.fftfreq(n) for n in (rows, columns))
    iy, ix = (np.round(f * n).astype(int) for f, n in ((fy, rows), (fx, columns)))
    drawn = spectrum[np.ix_(iy, ix)]
    middle = (side - 1) / 2 / fine  # of a pixel, from where it begins
    drawn = drawn * np.exp(2j * np.pi * middle * (fy[:, None] + fx[None, :]))
    ours = np.fft.fft2(Modulator(fill_factor=fill_factor).light(phases)[0, 0])
    assert np.linalg.norm(ours - drawn) < 0.01 * np.linalg.norm(drawn)


def test_the_largest_fill_factor_is_the_limit_of_those_below(phases):
    whole, nearly = (Modulator(fill_factor=share).light(phases) for share in (1.0, 0.9999))
    np.testing.assert_allclose(whole, nearly, atol=1e-3)
    assert np.abs(whole - Modulator().light(phases)).max() > 0.1


def test_unmodulated_light(phases):
    """It keeps the light's power, and adds a spot in the middle of the spectrum."""
    light = Modulator(unmodulated=0.1).light(phases)[0, 0]
    plain = np.exp(1j * phases[0, 0])
    change = np.fft.fft2(light - math.sqrt(0.9) * plain)
    assert abs(change[0, 0]) == pytest.approx(math.sqrt(0.1) * change.size, rel=1e-4)
    assert np.abs(change.ravel()[1:]).max() < 1e-2
    assert (np.abs(light) ** 2).mean() == pytest.approx(1, abs=0.1)


def test_crosstalk(library):
    """A step of phase is an error function."""
    from scipy.special import erf

    step = np.zeros((1, 1, 9, 40), np.float32)
    step[..., 20:] = 2
    x = np.arange(40) - 19.5
    shown = np.asarray(Modulator(crosstalk=1.5).shown(library.asarray(step)))[0, 0, 4]
    np.testing.assert_allclose(shown, 1 + erf(x / (1.5 * math.sqrt(2))), atol=0.02)


def test_libraries_of_arrays_agree(other_library, phases):
    """Compare all effects of a modulator, for phases of any turn."""
    modulator = Modulator(bits=3, fill_factor=0.8, unmodulated=0.1, crosstalk=0.7)
    phases = 4 * phases - 9
    found = modulator.light(other_library.asarray(phases))
    assert isinstance(found, type(other_library.asarray(phases)))
    np.testing.assert_allclose(np.asarray(found), modulator.light(phases), atol=1e-5)


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        ({"bits": 0}, "1 to 16 bits"),
        ({"fill_factor": 0}, "fill factor"),
        ({"fill_factor": 1.01}, "fill factor"),
        ({"unmodulated": -0.1}, "unmodulated"),
        ({"crosstalk": math.nan}, "crosstalk"),
    ],
)
def test_impossible_limits(limits, says):
    with pytest.raises(engine.InvalidInput, match=says):
        Modulator(**limits)


def test_gray_levels(field):
    phase = engine.encode(field, "dpac")
    for bits in (1, 8, 10):
        levels = gray_levels(phase.data, bits)
        assert levels.min() >= 0 and levels.max() < 2**bits
        turns = np.abs(levels / 2**bits - phase.data / (2 * math.pi))
        assert np.minimum(turns, 1 - turns).max() <= 0.5 / 2**bits + 1e-6
