"""Double phase."""

import numpy as np

from holopath_addon.engine.encoding import double_phase


def test_double_phase_is_exact_in_pairs():
    wave = np.full((4, 4), 0.6 * np.exp(0.3j), np.complex64)
    pairs = np.exp(1j * double_phase.double_phase(wave).astype(float))
    np.testing.assert_allclose((pairs[:, ::2] + pairs[:, 1::2]) / 2, wave[:, ::2], atol=1e-6)
