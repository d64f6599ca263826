"""Levels around the circle."""

import math

import numpy as np
import pytest

from holopath_addon.engine.waves.modulator import Levels

TURN = 2 * math.pi


@pytest.mark.parametrize(
    "levels", [np.arange(16) * (TURN / 16), np.array([0.3, 0.5, 4.0]), np.array([6.1, 6.2])]
)
def test_the_nearest_on_the_circle(levels):
    """Against the smallest chord of all; the gap is the arc that the phase lies in."""
    phases = np.random.default_rng(0).uniform(-20, 20, 500)
    found, gaps = Levels(levels[::-1] - TURN).nearest(phases)
    chords = np.abs(np.exp(1j * phases[:, None]) - np.exp(1j * levels))
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * levels[chords.argmin(axis=1)]), atol=1e-9)
    assert (np.abs(found - phases) <= gaps / 2 + 1e-9).all()
    assert set(np.round(gaps, 9)) == set(np.round(np.diff(levels, append=levels[0] + TURN), 9))
    assert Levels(levels).widest_gap == pytest.approx(gaps.max())


def test_the_nearest_that_a_corrected_pixel_shows():
    """Its levels are turned back by the correction, which may be of any turn."""
    rng = np.random.default_rng(1)
    phases, correction = rng.uniform(-20, 20, (4, 5)).astype(np.float32), rng.uniform(-40, 40, (4, 5))
    levels = np.array([0.3, 0.5, 4.0])
    found, _ = Levels(levels, correction).nearest(phases)
    chords = np.abs(np.exp(1j * phases[..., None]) - np.exp(1j * (levels - correction[..., None])))
    wanted = levels[chords.argmin(axis=-1)] - correction
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * wanted), atol=1e-5)
    assert found.dtype == np.float32 and (np.abs(found - phases) <= np.pi + 1e-5).all()
    flat, _ = Levels(levels, correction).nearest(phases.ravel())
    assert np.array_equal(flat, found.ravel())
