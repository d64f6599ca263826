"""Levels around the circle."""

import math

import numpy as np
import pytest

from holopath_addon.engine.waves.modulator import even_levels, nearest, widest_gap

TURN = 2 * math.pi


@pytest.mark.parametrize("levels", [even_levels(4), np.array([0.3, 0.5, 4.0]), np.array([6.1, 6.2])])
def test_the_nearest_on_the_circle(levels):
    """Against the smallest chord of all; the gap is the arc that the phase lies in."""
    phases = np.random.default_rng(0).uniform(-20, 20, 500)
    found, gaps = nearest(phases, levels)
    chords = np.abs(np.exp(1j * phases[:, None]) - np.exp(1j * levels))
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * levels[chords.argmin(axis=1)]), atol=1e-9)
    assert (np.abs(found - phases) <= gaps / 2 + 1e-9).all()
    assert set(np.round(gaps, 9)) == set(np.round(np.diff(levels, append=levels[0] + TURN), 9))
    assert widest_gap(levels) == pytest.approx(gaps.max())
