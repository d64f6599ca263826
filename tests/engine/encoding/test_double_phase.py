"""Double phase."""

import math

import numpy as np
import pytest

from holopath_addon.engine.encoding import double_phase
from holopath_addon.engine.encoding.double_phase import MAX_SPREAD, MIN_SPREAD, even_double_phase, spread_for


def test_double_phase_is_exact_in_pairs():
    wave = np.full((4, 4), 0.6 * np.exp(0.3j), np.complex64)
    pairs = np.exp(1j * double_phase.double_phase(wave).astype(float))
    np.testing.assert_allclose((pairs[:, ::2] + pairs[:, 1::2]) / 2, wave[:, ::2], atol=1e-6)


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
