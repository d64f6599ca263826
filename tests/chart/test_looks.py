"""What the pupil's diffraction leaves of a picture."""

import numpy as np
import pytest

from benchmarks.chart.looks import HEADLINE, PUPILS, diffracted
from holopath_addon import engine


def test_a_point_through_a_quarter_of_the_pupil_is_an_airy_disk():
    """First dark ring at 0.61 / (cycles a pixel of the opening), 4.88 pixels for a quarter of the band's 0.5."""
    hologram = engine.Hologram(128, 128, 8e-6, (516.5e-9,))
    names = (*HEADLINE, *PUPILS)
    pictures = np.zeros((len(names), 128, 128, 1), np.float32)
    pictures[:, 64, 64] = 1
    seen = diffracted(pictures, (0.5, 1.0, 2.0), hologram)[..., 0]
    np.testing.assert_allclose(seen.sum((1, 2)), 1, rtol=1e-5)
    row = seen[names.index("pupil-quarter"), 64, 64:] / seen[names.index("pupil-quarter"), 64, 64]
    assert row[:8].argmin() == 5
    assert row[5] < 0.005
    # Airy's second ring: 1.75 % at 6.7 pixels
    assert row[6:9].max() == pytest.approx(0.0175, rel=0.2)
    assert seen[names.index("front"), 64, 66] < 0.05 * seen[names.index("front"), 64, 64]
