"""The lattice and W: exact discrete propagation, one ray a grain."""

import math

import numpy as np
import pytest

from holopath_addon.engine.kernel_table import LEVELS, Lattice, kernel_table

PITCH, WAVELENGTH = 8e-6, 516.5e-9
SLOPE = math.tan(math.asin(WAVELENGTH / (2 * PITCH)))


def summed_kernel(lattice, level, table):
    """What the lattice's rays add up to from one grain: W times count, on the signed offsets."""
    offsets = lattice.offsets(PITCH)
    reach = int(offsets.max())
    total = np.zeros((2 * reach + 1, 2 * reach + 1), np.complex128)
    for i, j in lattice.indices:
        x, y = offsets[level, abs(i)] * (-1) ** (i < 0), offsets[level, abs(j)] * (-1) ** (j < 0)
        total[reach + y, reach + x] += table[level, abs(y), abs(x)]
    return total


@pytest.mark.parametrize("level", [1, 200, LEVELS - 1])
def test_rays_sum_to_the_angular_spectrum_kernel(level):
    """Against the inverse FFT of the transfer function, on a grid of our choosing."""
    lattice = Lattice.of(SLOPE, 2e-3, PITCH, cone=1.6)
    total = summed_kernel(lattice, level, kernel_table(lattice, PITCH, WAVELENGTH))
    reach, n = len(total) // 2, 512
    f = np.fft.fftfreq(n)
    squared = f[:, None] ** 2 + f**2
    u = squared * (WAVELENGTH / PITCH) ** 2
    dz = (level + 0.5) / LEVELS * lattice.depth_limit
    exact = np.fft.ifft2(
        np.where(squared <= 0.25, np.exp(2j * np.pi * dz / WAVELENGTH * (1 - np.sqrt(1 - u))), 0)
    )
    exact = np.roll(exact, (reach, reach), (0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    seen = total != 0
    scale = np.vdot(total[seen], exact[seen]) / np.vdot(total[seen], total[seen])
    assert abs(np.angle(scale)) < 0.01
    assert np.linalg.norm(scale * total[seen] - exact[seen]) < 0.02 * np.linalg.norm(exact[seen])


def test_every_depth_has_the_same_energy():
    lattice = Lattice.of(SLOPE, 2e-3, PITCH)
    table = kernel_table(lattice, PITCH, WAVELENGTH)
    f = np.fft.fftfreq(128)
    band = f[:, None] ** 2 + f**2 <= 0.25
    for level in (0, 50, 300, 500, LEVELS - 1):
        total = summed_kernel(lattice, level, table)
        spectrum = np.fft.fft2(total, s=(128, 128))
        assert (np.abs(spectrum[band]) ** 2).mean() == pytest.approx(1, abs=0.03)


def test_one_ray_a_grain_at_the_depth_limit():
    lattice = Lattice.of(SLOPE, 2e-3, PITCH)
    offsets = lattice.offsets(PITCH)[-1]
    assert (np.diff(offsets) == 1).all()


def test_most_bounds_the_rays():
    assert Lattice.of(SLOPE, 5e-3, PITCH, most=100).rays <= 100
    assert Lattice.of(SLOPE, 5e-3, PITCH, most=1).rays == 1
    assert Lattice.of(SLOPE, 1e-9, PITCH).rays > 1
