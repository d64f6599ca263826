"""The lattice and W: exact discrete propagation, one ray a grain."""

import math

import numpy as np
import pytest

from holopath_addon.engine.tracing.kernel_table import Lattice, kernel_table

PITCH, WAVELENGTH = 8e-6, 516.5e-9
SLOPE = math.tan(math.asin(WAVELENGTH / (2 * PITCH)))


def summed_kernel(lattice, level, table):
    """Sum of the lattice's rays from one grain: W times the weights, on the signed offsets."""
    offsets = lattice.offsets(PITCH)
    reach = int(offsets.max())
    total = np.zeros((2 * reach + 1, 2 * reach + 1), np.complex128)
    weights = lattice.weights(offsets[[level]])[1][0]
    for (i, j), weight in zip(lattice.indices, weights, strict=True):
        x, y = offsets[level, abs(i)] * (-1) ** (i < 0), offsets[level, abs(j)] * (-1) ** (j < 0)
        total[reach + y, reach + x] += weight * table[level, abs(y), abs(x)]
    return total


def spectra(lattice, level, straight=0.0):
    """Spectra of the sum of a lattice's rays, and of the angular spectrum method, within the recordable band; and
    frequencies, cycles a pixel.
    """
    level %= lattice.levels
    total = summed_kernel(lattice, level, kernel_table(lattice, PITCH, WAVELENGTH, straight))
    reach, n = len(total) // 2, 512
    grid = np.zeros((n, n), np.complex128)
    grid[: len(total), : len(total)] = total
    spectrum = np.fft.fft2(np.roll(grid, (-reach, -reach), (0, 1)))
    f = np.fft.fftfreq(n)
    squared = f[:, None] ** 2 + f**2
    u = squared * (WAVELENGTH / PITCH) ** 2
    dz = (level + 0.5) / lattice.levels * lattice.depth_limit
    band = squared <= 0.25
    exact = np.exp(2j * np.pi * dz / WAVELENGTH * (1 - np.sqrt(1 - np.where(band, u, 0))))
    return spectrum[band], exact[band], np.sqrt(squared[band])


@pytest.mark.parametrize("level", [1, 100, -1])
def test_rays_sum_to_the_angular_spectrum_kernel(level):
    """Against the transfer function within the recordable band, on a grid of our choosing; the rest is cut."""
    spectrum, exact, _ = spectra(Lattice.of(SLOPE, 2e-3, PITCH, cone=1.6), level)
    # a seventh to a tenth without the fit
    assert np.linalg.norm(spectrum - exact) < 0.1 * np.linalg.norm(exact)
    assert abs(np.angle(np.vdot(exact, spectrum))) < 0.01


@pytest.mark.parametrize("depth", [0.5e-3, 0.6e-3, 0.8e-3, 1e-3, 1.5e-3, 3e-3])
def test_kernels_near_the_plane_keep_their_tails(depth):
    """Cut to 1.15 times the geometric cone, those within a millimeter err by up to 10 % of their energy."""
    lattice = Lattice.of(SLOPE, depth, PITCH)
    for level in (-lattice.levels // 2, -1):
        spectrum, exact, _ = spectra(lattice, level)
        assert np.linalg.norm(spectrum - exact) ** 2 < 0.035 * np.linalg.norm(exact) ** 2


def test_every_depth_has_the_same_energy():
    lattice = Lattice.of(SLOPE, 2e-3, PITCH)
    table = kernel_table(lattice, PITCH, WAVELENGTH)
    f = np.fft.fftfreq(128)
    band = f[:, None] ** 2 + f**2 <= 0.25
    for level in (0, 20, 80, 140, lattice.levels - 1):
        total = summed_kernel(lattice, level, table)
        spectrum = np.fft.fft2(total, s=(128, 128))
        assert (np.abs(spectrum[band]) ** 2).mean() == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("straight", [1.0, 0.74, 0.4, 0.0])
@pytest.mark.parametrize("depth", [0.3e-3, 2.5e-3])
def test_even_surfaces_are_as_bright_at_every_depth(straight, depth):
    """Whatever fraction of their light goes straight on, and the rest everywhere; all of it without a phase error.

    The table of random phases is off by half where all is in phase.
    """
    lattice = Lattice.of(SLOPE, depth, PITCH)
    table, plain = (kernel_table(lattice, PITCH, WAVELENGTH, share) for share in (straight, 0.0))
    f = np.fft.fftfreq(128)
    band = f[:, None] ** 2 + f**2 <= 0.25
    known, usual = [], []
    for level in range(0, lattice.levels, 15):
        spectrum = np.fft.fft2(summed_kernel(lattice, level, table), s=(128, 128))
        ahead, all_over = np.abs(spectrum[0, 0]) ** 2, (np.abs(spectrum[band]) ** 2).mean()
        known.append(straight * ahead + (1 - straight) * all_over)
        usual.append(np.abs(summed_kernel(lattice, level, plain).sum()) ** 2)
        if straight == 1:
            assert ahead == pytest.approx(1, abs=0.002)
    assert known == pytest.approx([1] * len(known), abs=0.005 if straight else 0.03)
    assert np.ptp(usual) > 0.5


def test_kernels_of_surfaces_in_phase_keep_coarse_textures():
    """Within an eighth of the band they err by a fiftieth, those of random phases by a fifth."""
    lattice = Lattice.of(SLOPE, 2.5e-3, PITCH)
    coarse, whole = [], []
    for straight in (0.0, 1.0):
        errors = []
        for level in range(40, lattice.levels, 50):
            spectrum, exact, f = spectra(lattice, level, straight)
            error = np.abs(spectrum - exact) ** 2
            errors.append((error[f < 0.0625].mean(), error.mean()))
        for found, value in zip((coarse, whole), np.sqrt(np.mean(errors, axis=0)), strict=True):
            found.append(value)
    assert coarse[0] > 0.15 and coarse[1] < 0.03
    assert whole[1] < 1.6 * whole[0]


def test_one_ray_a_grain_at_the_depth_limit():
    lattice = Lattice.of(SLOPE, 2e-3, PITCH)
    offsets = lattice.offsets(PITCH)[-1]
    assert (np.diff(offsets) == 1).all()


def test_most_bounds_the_rays():
    assert Lattice.of(SLOPE, 5e-3, PITCH, max_rays=100).rays <= 100
    assert Lattice.of(SLOPE, 5e-3, PITCH, max_rays=1).rays == 1
    # fewer are those in the middle, as close to each other
    assert Lattice.of(SLOPE, 5e-3, PITCH, max_rays=100).spacing == Lattice.of(SLOPE, 5e-3, PITCH).spacing
    assert Lattice.of(SLOPE, 1e-9, PITCH).rays > 1
