"""The lattice of directions and its kernel table W: how one ray's grain adds to a pixel of the recording plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike

TAILS = 1.6  # pixels beyond the geometric cone that kernels have at least: diffraction, which a factor cuts when narrow
STEEPEST = 1.5  # recordable slopes that directions have at most for that, beside the plane
# Directions along a radius that a lattice has at least: so many a pixel of the cone, within bounds. With few, most
# grains are met by the cone's rim, where what a direction counts is right at the table's depths only.
FINER, LEAST_DIRECTIONS = 8.0, (2.0, 4.2)
LEVELS = (256, 768)  # fewest and most depths of a table
# depth steps in which the outermost ray walks a pixel: the kernel's phase then errs by 0.03 rad
LEVELS_A_GRAIN = 16
FIT_STEPS = 4  # more gain little
SMOOTH_STEPS = 8  # the same for surfaces in phase
# What light in phase is of: half of it goes straight on, from even parts of surfaces; the rest as textures spread it,
# with a power that falls by the square of frequencies from this one on, cycles a pixel. And what all else counts at
# least, as a share of all.
STRAIGHT, TEXTURE, LEAST_WEIGHT = 0.5, 0.04, 0.05
TINY = 1e-30  # stands for nothing where something is divided by it
WIDENED = 2  # grains by which levels that are computed together differ in reach at most
TOGETHER = 64  # and how many these are at most,
MOST_BINS = 1 << 20  # and how many bins of their spectra
SMALL = 40  # pixels up to which a convolution with a kernel as large is less work than two transforms


def reach_of(max_slope: float, depth_limit: ArrayLike, pitch: float, cone: float = 1.15) -> Any:
    """Pixels that a grain's kernel is cut to at `depth_limit`; parameters as of `Lattice.of`.

    With `TAILS` the error of what is kept has 1 to 1.5 % of the kernel's energy, with the factor alone up to 10 % where
    the cone is 2 to 5 pixels wide.
    """
    wide = max_slope * depth_limit / pitch
    return np.maximum(cone * wide, np.minimum(wide + TAILS, STEEPEST * wide))


def directions_of(max_slope: float, depth_limit: ArrayLike, pitch: float, cone: float = 1.15) -> Any:
    """Directions along a radius of the lattice; parameters as of `Lattice.of`."""
    least = np.clip(FINER * max_slope * depth_limit / pitch, *LEAST_DIRECTIONS)
    return np.maximum(reach_of(max_slope, depth_limit, pitch, cone), least)


@dataclass(frozen=True)
class Lattice:
    """Directions (i, j) spacing, i, j integer, within a cone.

    Attributes
    ----------
    indices : numpy.ndarray, int32, shape (rays, 2)
        i (towards +x) and j (towards +y) of each direction, from the axis outwards.
    spacing : float
        Slope between neighbours; pitch / depth_limit for one ray a grain at the farthest depth.
    depth_limit : float
        Largest distance |dz| from the recording plane that the table serves, metres.
    levels : int
        Depths up to there that the table holds.
    """

    indices: np.ndarray
    spacing: float
    depth_limit: float
    levels: int

    @classmethod
    def of(
        cls,
        max_slope: float,
        depth_limit: float,
        pitch: float,
        cone: float = 1.15,
        most: int | None = None,
        levels: int = LEVELS[0],
    ) -> Lattice:
        """One direction a grain at `depth_limit`, or more where these are few, as far as `reach_of` says.

        Parameters
        ----------
        max_slope : float
            Slope of the widest recordable cone, `Hologram.max_slope`.
        depth_limit, pitch : float
            Metres.
        cone : float
            The kernel's tails beyond the geometric cone, as a factor at least.
        most : int, optional
            Most directions; the lattice is coarsened to meet it, which aliases the far depths.
        levels : int
            Of the table at least.
        """
        wide = reach_of(max_slope, depth_limit, pitch, cone)
        whole = reach = directions_of(max_slope, depth_limit, pitch, cone)
        levels = int(np.clip(math.ceil(LEVELS_A_GRAIN * reach), levels, LEVELS[1]))
        while True:
            n = math.floor(reach)
            j, i = np.mgrid[-n : n + 1, -n : n + 1]
            inside = i * i + j * j <= reach * reach
            if most is None or inside.sum() <= most or reach <= 0:
                break
            reach *= min(0.999, math.sqrt(most / inside.sum()))
        i, j = i[inside], j[inside]
        order = np.lexsort((i, j, i * i + j * j))
        spacing = wide * pitch / depth_limit / whole if whole > 0 else max_slope
        return cls(np.stack([i[order], j[order]], axis=1).astype(np.int32), spacing, depth_limit, levels)

    @property
    def rays(self) -> int:
        """Directions, hence rays a pixel."""
        return len(self.indices)

    def offsets(self, pitch: float) -> np.ndarray:
        """Grain offset |o| in pixels of lattice index |i| at each depth level.

        The levels are (l + 1/2) / levels of the depth limit, so that rounding never meets a tie.

        Returns
        -------
        numpy.ndarray, int32, shape (levels, largest index + 1)
        """
        index = np.arange(np.abs(self.indices).max() + 1)
        step = self.spacing * self.depth_limit / pitch
        level = (np.arange(self.levels) + 0.5) / self.levels
        return np.floor(index[None, :] * (step * level[:, None]) + 0.5).astype(np.int32)

    @property
    def ends(self) -> np.ndarray:
        """Largest index i of the directions in row j, for |j| from 0 on; int32."""
        rows = np.abs(self.indices[:, 1])
        ends = np.zeros(rows.max() + 1, np.int32)
        np.maximum.at(ends, rows, self.indices[:, 0])
        return ends

    def shares(self, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the directions meet, and what share of their grain each is, of planes parallel to the recording plane.

        A share is 1 over the directions of the same row that meet in the grain, times 1 over those of the same column,
        as `LatticeEstimator.kernel` has it on planes of any slope.

        Parameters
        ----------
        offsets : numpy.ndarray
            Some rows of `offsets`.

        Returns
        -------
        cell : numpy.ndarray, int32, shape (2, levels, rays)
            |oy| and |ox|.
        share : numpy.ndarray, float32, shape (levels, rays)
        """
        i, j = np.abs(self.indices).T
        ends = self.ends
        # of the directions in the same grain
        first = np.array([np.searchsorted(row, row) for row in offsets])
        last = np.array([np.searchsorted(row, row, "right") for row in offsets]) - 1

        def together(index, end):
            low, high = first[:, index], np.minimum(last[:, index], end)
            return np.where(low == 0, 2 * high + 1, high - low + 1)  # the middle grain has both signs

        share = 1.0 / (together(i, ends[j]) * together(j, ends[i]))
        return np.stack([offsets[:, j], offsets[:, i]]), share.astype(np.float32)


def kernel_table(lattice: Lattice, pitch: float, wavelength: float, straight: float = 0.0) -> np.ndarray:
    """W(dz, o) = K(dz, o) / shares(dz, o) sqrt((pi/4) / E(dz)) for dz > 0 and one quadrant of offsets.

    K is the carrier-free, band-limited kernel that takes the field of a grain at distance dz behind the
    plane (towards the viewer) back to the plane: the inverse DFT of exp(2 pi i dz / wavelength u / (1 +
    sqrt(1 - u))), u = (wavelength f)^2, over the circular band; its conjugate serves -dz. shares is the sum of
    `Lattice.shares` over the directions that meet in the grain, 1 but at the rim of the cone and beside the plane. E is
    the in-band energy of the kernel cut to the grains reached (pi/4 uncut). The cut kernel is fitted to the exact one's
    spectrum within the band by `FIT_STEPS` of Landweber's iteration, for what lies outside the band is cut from the
    field anyway: it gains 1 to 5 dB where the kernel is few grains wide. Each depth thereby becomes an exact discrete
    convolution at one ray a grain.

    That is for random phases, whose light goes everywhere. Of surfaces in phase an even one's goes straight on, and a
    kernel that is cut rings there: over depth their brightness would be off by half. So the fit is weighted by the
    power P(f) of their light, by conjugate gradients (`_Grid.power`). And W makes the brightness of an even surface
    whose phases send the share s of its light straight on, and the rest everywhere, what it is,
    s |H(0)|^2 + (1 - s) E / (pi/4) = 1, where H is the cut kernel's spectrum (Wiener-Khinchin theorem).

    Beside the table memory is 16 bytes a bin for a handful of arrays of `MOST_BINS` at most, whatever the depth.

    Parameters
    ----------
    lattice : Lattice
    pitch, wavelength : float
        Metres.
    straight : float
        s, see `straight_share`; 0 for random phases.

    Returns
    -------
    numpy.ndarray, complex64, shape (levels, reach + 1, reach + 1), indexed [level, |oy|, |ox|]
    """
    offsets = lattice.offsets(pitch)
    farthest = int(offsets.max()) + 1
    grid = _Grid.of(farthest, pitch, wavelength)
    power = grid.power(straight)
    together = max(1, min(TOGETHER, MOST_BINS // grid.detour.size))
    table = np.zeros((lattice.levels, farthest, farthest), np.complex64)
    sides, first = offsets.max(1) + 1, 0
    while first < lattice.levels:
        last = min(np.searchsorted(sides, sides[first] + WIDENED, "right"), first + together)
        levels, side = np.arange(first, last), sides[last - 1]
        dz = (levels + 0.5) / lattice.levels * lattice.depth_limit
        exact, within = grid.kernels(dz, side, grid.band), grid.within(side, grid.band)
        images = np.where(np.arange(side) == 0, 1.0, 2.0)
        images = np.outer(images, images)
        cell, share = lattice.shares(offsets[levels])
        cell = (np.arange(len(levels))[:, None] * side + cell[0]) * side + cell[1]
        shares = np.bincount(cell.ravel(), share.ravel(), exact.size).reshape(exact.shape) / images
        reached = shares > 0
        kernel = exact * reached
        if straight:
            weighted = grid.kernels(dz, side, power), grid.within(side, power)
            kernel = _fitted(kernel, *weighted, reached, images)
        else:
            for _ in range(FIT_STEPS):
                kernel += (exact - within(kernel)) * reached
        energy = (images * (kernel.conj() * within(kernel)).real).sum((1, 2))
        if straight:
            ahead = np.abs((images * kernel).sum((1, 2))) ** 2
            energy = straight * (math.pi / 4) * ahead + (1 - straight) * energy
        kernel *= np.sqrt(math.pi / 4 / energy)[:, None, None] / np.where(reached, shares, 1)
        table[levels, :side, :side] = kernel
        first = last
    return table


@dataclass(frozen=True)
class _Grid:
    """A quadrant of even spectra on an even grid: cosines over half the bins replace the Fourier transform.

    Attributes
    ----------
    to_space, to_frequency : numpy.ndarray, shape (pixels, bins) and (bins, pixels)
        Along an axis.
    band : numpy.ndarray of bool, shape (bins, bins)
        The circular band.
    detour : numpy.ndarray, shape (bins, bins)
        Turns of the phase for each metre.
    """

    to_space: np.ndarray
    to_frequency: np.ndarray
    band: np.ndarray
    detour: np.ndarray

    @classmethod
    def of(cls, side, pitch, wavelength):
        """For kernels of `side` pixels in a quadrant."""
        n = max(128, 4 * side + 64)
        pixels, bins = np.arange(2 * side), np.arange(n // 2 + 1)
        cosine = np.cos(2 * math.pi / n * np.outer(pixels, bins))
        f = bins / n
        u = (wavelength / pitch) ** 2 * (f[:, None] ** 2 + f**2)
        return cls(
            cosine * np.where((bins == 0) | (bins == n // 2), 1.0, 2.0) / n,
            cosine.T * np.where(pixels == 0, 1.0, 2.0),
            f[:, None] ** 2 + f**2 <= 0.25,
            u / (1 + np.sqrt(np.maximum(1 - u, 0))) / wavelength,
        )

    def power(self, straight):
        """Power spectrum of a surface's light within the band, of which a share is in phase; its mean is 1."""
        bins = np.arange(len(self.band))
        images = np.where((bins == 0) | (bins == len(bins) - 1), 1.0, 2.0)
        images = np.outer(images, images) * self.band
        f = bins / (2 * (len(bins) - 1))
        texture = self.band / (1 + (f[:, None] ** 2 + f**2) / TEXTURE**2)
        in_phase = (1 - STRAIGHT) * texture * (images.sum() / (texture * images).sum())
        in_phase[0, 0] += STRAIGHT * images.sum()
        return straight * in_phase + max(1 - straight, LEAST_WEIGHT) * self.band

    def kernels(self, dz, side, power):
        """The exact kernel of each distance, as far as `side`, as light of a power spectrum meets it; distances are
        evenly spaced.
        """
        # half the memory; sums in double precision are the same, to the table's last bit, whatever library takes them
        spectrum = np.empty((len(dz), *self.detour.shape), np.complex64)
        wave = np.exp(2j * math.pi * dz[0] * self.detour) * power
        # a product is a tenth of the work of an exponential
        step = np.exp(2j * math.pi * (dz[1] - dz[0]) * self.detour) if len(dz) > 1 else 1.0
        for of_level in spectrum:
            of_level[:] = wave
            wave *= step
        return _along_both(self.to_space[:side], spectrum)

    def within(self, side, power):
        """What multiplies spectra of even images of `side` pixels by a power, as the band is one.

        That is a convolution with the transform of the power, hence one matrix, which is less work than the way to the
        spectrum as long as it is small.
        """
        if side > SMALL:
            there, back = self.to_frequency[:, :side], self.to_space[:side]
            return lambda images: _along_both(back, _along_both(there, images) * power)
        matrix = _convolution(self.to_space @ power @ self.to_space.T, side)
        return lambda images: _times(matrix, images)


def _fitted(kernel, exact, within, reached, images):
    """Kernels on what is `reached` that are nearer to exact ones than these, of a stack, by conjugate gradients."""

    def inner(a, b):
        return (images * (a.conj() * b).real).sum((1, 2))[:, None, None]

    rest = (exact - within(kernel)) * reached
    step, size = rest, inner(rest, rest)
    for _ in range(SMOOTH_STEPS):
        turned = within(step) * reached
        # where few grains are reached, nothing is left to do
        length = size / np.maximum(inner(step, turned), TINY)
        kernel = kernel + length * step
        rest = rest - length * turned
        before, size = size, inner(rest, rest)
        step = rest + size / np.maximum(before, TINY) * step
    return kernel


def _convolution(kernel, side):
    """Matrix that convolves what one quadrant holds of an even image with an even kernel; of (y, x) in one index."""
    a = np.arange(side)
    apart, mirrored = np.abs(a[:, None] - a), a[:, None] + a
    images = np.where(a == 0, 0.0, 1.0)  # an axis is its own image
    rows = kernel[apart] + images[:, None] * kernel[mirrored]  # (y, y', x offset)
    both = rows[:, :, apart] + images * rows[:, :, mirrored]  # (y, y', x, x')
    return both.transpose(0, 2, 1, 3).reshape(side * side, side * side)


def _times(matrix, stack):
    """A real matrix times each complex image of a stack, in one product."""
    flat = stack.reshape(len(stack), -1)
    out = np.concatenate([flat.real, flat.imag]) @ matrix.T
    return (out[: len(stack)] + 1j * out[len(stack) :]).reshape(stack.shape)


def _along_both(matrix, stack):
    """A real matrix times each complex one of a stack times its transpose, in few large products.

    Many small ones take ten times as long where the library's threads have to wait for a core.
    """
    values = np.concatenate([stack.real, stack.imag])
    for _ in range(2):
        count, rows, columns = values.shape
        values = (values.reshape(-1, columns) @ matrix.T).reshape(count, rows, len(matrix)).swapaxes(1, 2)
    return values[: len(stack)] + 1j * values[len(stack) :]
