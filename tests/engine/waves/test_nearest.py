"""Levels around the circle."""

import math

import numpy as np
import pytest

from holopath_addon.engine.errors import InvalidInput
from holopath_addon.engine.waves.modulator import Levels

TURN = 2 * math.pi


@pytest.mark.parametrize(
    "levels", [np.arange(16) * (TURN / 16), np.array([0.3, 0.5, 4.0]), np.array([6.1, 6.2])]
)
def test_the_nearest_on_the_circle(library, levels):
    """Compare with the smallest of all chords; the gap is the arc around the phase."""
    phases = np.random.default_rng(0).uniform(-20, 20, 500)
    found, gaps = map(np.asarray, Levels(levels[::-1] - TURN).nearest(library.asarray(phases)))
    chords = np.abs(np.exp(1j * phases[:, None]) - np.exp(1j * levels))
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * levels[chords.argmin(axis=1)]), atol=1e-9)
    assert (np.abs(found - phases) <= gaps / 2 + 1e-9).all()
    assert set(np.round(gaps, 9)) == set(np.round(np.diff(levels, append=levels[0] + TURN), 9))
    assert Levels(levels).widest_gap == pytest.approx(gaps.max())


def test_the_nearest_that_a_corrected_pixel_shows(library):
    """Its levels are turned back by the correction, which may be of any turn."""
    rng = np.random.default_rng(1)
    phases, correction = rng.uniform(-20, 20, (4, 5)).astype(np.float32), rng.uniform(-40, 40, (4, 5))
    levels = np.array([0.3, 0.5, 4.0])
    found = np.asarray(Levels(levels, correction).nearest(library.asarray(phases))[0])
    chords = np.abs(np.exp(1j * phases[..., None]) - np.exp(1j * (levels - correction[..., None])))
    expected = levels[chords.argmin(axis=-1)] - correction
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * expected), atol=1e-5)
    assert found.dtype == np.float32 and (np.abs(found - phases) <= np.pi + 1e-5).all()
    flat, _ = Levels(levels, correction).nearest(phases.ravel())
    assert np.array_equal(flat, found.ravel())


@pytest.mark.parametrize(
    ("turns", "count"), [(0.4, 15), (0.9, 15), (1.0, 15), (2.3, 15), (1.7, 150), (-1.7, 150)]
)
def test_the_nearest_where_the_response_varies(library, turns, count):
    """Each pixel makes its own share of the steps from the first level; of many, those within a turn from there."""
    rng = np.random.default_rng(2)
    rising = np.append(0, np.sort(rng.uniform(0, 1, count)))
    given = (
        1.1 + (rising if count > 15 else np.append(0, rng.permutation(1.2 * rising[1:] - 0.2))) * turns * TURN
    )
    phases, correction = rng.uniform(-20, 20, (6, 7)), rng.uniform(-40, 40, (6, 7)).astype(np.float32)
    variation = rng.uniform(0.7, 1.4, (6, 7)).astype(np.float32)
    levels = Levels(given, correction, variation)
    found, gaps = map(np.asarray, levels.nearest(library.asarray(phases)))
    correction = np.mod(correction.astype(float), TURN)
    steps = variation[..., None] * (given - given[0])
    if count > 15:
        steps = np.where(np.abs(steps) < TURN, steps, 0)
    each = given[0] + steps - correction[..., None]
    chords = np.abs(np.exp(1j * phases[..., None]) - np.exp(1j * each))
    best = np.take_along_axis(each, chords.argmin(axis=-1)[..., None], -1)[..., 0]
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * best), atol=1e-5)
    assert (np.abs(found - phases) <= gaps / 2 + 1e-9).all()
    for at in np.ndindex(6, 7):
        ring = np.unique(np.mod(each[at], TURN))
        arcs = np.diff(ring, append=ring[0] + TURN)
        assert np.abs(arcs - gaps[at]).min() < 1e-5
    assert levels.widest_gap >= gaps.max() - 0.1 and "variation" in levels.to_dict()
    even = Levels(given, variation=np.ones((6, 7)))
    np.testing.assert_allclose(even.nearest(phases)[0], Levels(given).nearest(phases)[0], atol=1e-6)
    assert "variation" not in Levels(given).to_dict()


@pytest.mark.parametrize(
    ("variation", "says"),
    [
        (np.ones(3), "Expected a map"),
        (np.full((2, 2), 3.0), "0.5 to 2"),
        (np.full((2, 2), np.nan), "0.5 to 2"),
    ],
)
def test_variations_that_cannot_be(variation, says):
    with pytest.raises(InvalidInput, match=says):
        Levels((0, 1), variation=variation)
