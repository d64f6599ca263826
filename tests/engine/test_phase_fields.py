"""Random phase fields: band, statistics, seeds."""

import math

import numpy as np
import pytest

from holopath_addon.engine.phase_fields import pixel_transmission, random_phasors, recordable_fraction


def test_unit_modulus_and_independence():
    phasors = random_phasors(4, 96, 128, seed=3)
    np.testing.assert_allclose(np.abs(phasors), 1, atol=1e-5)
    for a in range(4):
        for b in range(a):
            assert abs(np.vdot(phasors[a], phasors[b])) / phasors[0].size < 4 / math.sqrt(phasors[0].size)


def test_fewer_frames_are_a_prefix_and_seeds_differ():
    np.testing.assert_array_equal(random_phasors(2, 32, 32, 5), random_phasors(4, 32, 32, 5)[:2])
    assert not np.array_equal(random_phasors(1, 32, 32, 5), random_phasors(1, 32, 32, 6))


def test_most_energy_lies_in_the_recordable_band():
    """The argument of a circular Gaussian field keeps pi/4 of the energy in the field's own component."""
    assert math.pi / 4 < recordable_fraction(random_phasors(4, 256, 256)) < 1


def test_pixel_transmission_against_a_direct_integral():
    scipy_integrate = pytest.importorskip("scipy.integrate")

    def over_y(x):
        top = math.sqrt(max(0.25 - x * x, 0))
        return np.sinc(x) ** 2 * scipy_integrate.quad(lambda y: np.sinc(y) ** 2, -top, top)[0]

    exact = scipy_integrate.quad(over_y, -0.5, 0.5)[0] / (math.pi / 4)
    assert pixel_transmission() == pytest.approx(exact, rel=2e-3)
