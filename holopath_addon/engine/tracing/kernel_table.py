"""The lattice of directions and its kernel table W: weights of a ray's grain for a pixel of the recording plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike

TAILS = (
    1.6  # minimum reach beyond the geometric cone, pixels: diffraction, which a factor cuts off narrow cones
)
STEEPEST = 1.5  # maximum slope of directions for these tails, over the recordable slope
# Minimum directions along a radius: per pixel of the cone, and the bounds of their number. With few, most grains lie at
# the cone's rim, where weights of directions are right only at the table's depths.
DIRECTIONS_PER_PIXEL, MIN_DIRECTIONS = 8.0, (2.0, 4.2)
LEVELS = (256, 768)  # minimum and maximum depths of a table
# Depth levels in which the outermost ray walks a pixel: the kernel's phase then errs by 0.03 rad.
LEVELS_A_GRAIN = 16
FIT_STEPS = 4  # iterations of the fit; more gain little
SMOOTH_STEPS = 8  # the same for surfaces in phase
# Light in phase: the fraction that goes straight on, from even parts of surfaces; the frequency, cycles a pixel, from
# which the power that textures spread falls by the square; and the minimum weight of all other light.
STRAIGHT, TEXTURE, MIN_WEIGHT = 0.5, 0.04, 0.05
TINY = 1e-30  # avoids divisions by zero
WIDENED = 2  # maximum difference in reach of levels that are computed together, grains,
TOGETHER = 64  # their maximum number,
MAX_BINS = 1 << 20  # and the maximum number of bins of their spectra
SMALL = 40  # maximum pixels for which a convolution takes less work than two transforms


def reach_of(max_slope: float, depth_limit: ArrayLike, pitch: float, cone: float = 1.15) -> Any:
    """Radius, in pixels, to which a grain's kernel is cut at `depth_limit`; for the parameters see `Lattice.of`.

    With `TAILS` the cut costs 1 to 1.5 % of the kernel's energy, with the factor alone up to 10 % where the cone is 2
    to 5 pixels wide.
    """
    wide = max_slope * depth_limit / pitch
    return np.maximum(cone * wide, np.minimum(wide + TAILS, STEEPEST * wide))


def directions_of(max_slope: float, depth_limit: ArrayLike, pitch: float, cone: float = 1.15) -> Any:
    """Directions along a radius of the lattice; for the parameters see `Lattice.of`."""
    minimum = np.clip(DIRECTIONS_PER_PIXEL * max_slope * depth_limit / pitch, *MIN_DIRECTIONS)
    return np.maximum(reach_of(max_slope, depth_limit, pitch, cone), minimum)


@dataclass(frozen=True)
class Lattice:
    """Lattice of directions (i, j) spacing, i and j integer, within a cone.

    Attributes
    ----------
    indices : numpy.ndarray, int32, shape (rays, 2)
        i (towards +x) and j (towards +y) of each direction, from the axis outwards.
    spacing : float
        Slope between neighbors; pitch / depth_limit for one ray a grain at the farthest depth.
    depth_limit : float
        Maximum distance |dz| from the recording plane, meters.
    levels : int
        Depths of the table, up to the limit.
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
        max_rays: int | None = None,
        levels: int = LEVELS[0],
    ) -> Lattice:
        """Make a lattice with one direction a grain at `depth_limit`, or more where these are few, up to `reach_of`.

        Parameters
        ----------
        max_slope : float
            Slope of the widest recordable cone, `Hologram.max_slope`.
        depth_limit, pitch : float
            Meters.
        cone : float
            Minimum reach of the kernel over that of the geometric cone.
        max_rays : int, optional
            Maximum directions; a coarser lattice meets it, which aliases the far depths.
        levels : int
            Minimum depths of the table.
        """
        wide = reach_of(max_slope, depth_limit, pitch, cone)
        whole = reach = directions_of(max_slope, depth_limit, pitch, cone)
        levels = int(np.clip(math.ceil(LEVELS_A_GRAIN * reach), levels, LEVELS[1]))
        while True:
            n = math.floor(reach)
            j, i = np.mgrid[-n : n + 1, -n : n + 1]
            inside = i * i + j * j <= reach * reach
            if max_rays is None or inside.sum() <= max_rays or reach <= 0:
                break
            reach *= min(0.999, math.sqrt(max_rays / inside.sum()))
        i, j = i[inside], j[inside]
        order = np.lexsort((i, j, i * i + j * j))
        spacing = wide * pitch / depth_limit / whole if whole > 0 else max_slope
        return cls(np.stack([i[order], j[order]], axis=1).astype(np.int32), spacing, depth_limit, levels)

    @property
    def rays(self) -> int:
        """Number of directions, hence rays a pixel."""
        return len(self.indices)

    def offsets(self, pitch: float) -> np.ndarray:
        """Grain offset |o| of lattice index |i| at each depth level, in pixels of a pitch (meters).

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

    def weights(self, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Grains of the directions, and weights of the directions in them, on planes parallel to the recording plane.

        A weight is 1 over the directions of the same row that meet in the grain, times 1 over those of the same column.
        `LatticeEstimator.kernel` has the same on planes of any slope.

        Parameters
        ----------
        offsets : numpy.ndarray
            Some rows of `offsets`.

        Returns
        -------
        cell : numpy.ndarray, int32, shape (2, levels, rays)
            |oy| and |ox|.
        weight : numpy.ndarray, float32, shape (levels, rays)
        """
        i, j = np.abs(self.indices).T
        ends = self.ends
        # first and last direction in the same grain
        first = np.array([np.searchsorted(row, row) for row in offsets])
        last = np.array([np.searchsorted(row, row, "right") for row in offsets]) - 1

        def count(index, end):
            low, high = first[:, index], np.minimum(last[:, index], end)
            return np.where(low == 0, 2 * high + 1, high - low + 1)  # the middle grain has both signs

        weight = 1.0 / (count(i, ends[j]) * count(j, ends[i]))
        return np.stack([offsets[:, j], offsets[:, i]]), weight.astype(np.float32)


def kernel_table(lattice: Lattice, pitch: float, wavelength: float, straight: float = 0.0) -> np.ndarray:
    """Kernel table W(dz, o) = K(dz, o) / w(dz, o) sqrt((pi/4) / E(dz)) for dz > 0 and one quadrant of offsets.

    K is the carrier-free, band-limited kernel that takes the field of a grain at distance dz behind the
    plane (towards the viewer) back to the plane: the inverse DFT of exp(2 pi i dz / wavelength u / (1 +
    sqrt(1 - u))), u = (wavelength f)^2, over the circular band; its conjugate serves -dz. w is the sum of
    `Lattice.weights` over the directions that meet in the grain, 1 but at the cone's rim and beside the plane. E is
    the in-band energy of the kernel cut to the grains reached (pi/4 uncut). The cut kernel is fitted to the exact one's
    spectrum within the band by `FIT_STEPS` of Landweber's iteration, for what lies outside the band is cut from the
    field anyway: it gains 1 to 5 dB where the kernel is few grains wide. Each depth thereby becomes an exact discrete
    convolution at one ray a grain.

    That is for random phases, whose light goes everywhere. Light of even surfaces in phase goes straight on, where a
    cut kernel rings: their brightness would be off by half over depth. So the fit is weighted by the power P(f) of
    their light, by conjugate gradients (`_Grid.power`). And W keeps the brightness of an even surface whose phases send
    the fraction s of its light straight on, and the rest everywhere: s |H(0)|^2 + (1 - s) E / (pi/4) = 1, where H is
    the cut kernel's spectrum (Wiener-Khinchin theorem).

    Beside the table a handful of arrays of up to `MAX_BINS` bins take memory, 16 bytes a bin, whatever the depth.

    Parameters
    ----------
    lattice : Lattice
    pitch, wavelength : float
        Meters.
    straight : float
        Fraction s, see `straight_share`; 0 for random phases.

    Returns
    -------
    numpy.ndarray, complex64, shape (levels, reach + 1, reach + 1), indexed [level, |oy|, |ox|]
    """
    offsets = lattice.offsets(pitch)
    farthest = int(offsets.max()) + 1
    grid = _Grid.of(farthest, pitch, wavelength)
    power = grid.power(straight)
    together = max(1, min(TOGETHER, MAX_BINS // grid.detour.size))
    table = np.zeros((lattice.levels, farthest, farthest), np.complex64)
    sides, first = offsets.max(1) + 1, 0
    while first < lattice.levels:
        last = min(np.searchsorted(sides, sides[first] + WIDENED, "right"), first + together)
        levels, side = np.arange(first, last), sides[last - 1]
        dz = (levels + 0.5) / lattice.levels * lattice.depth_limit
        exact, within = grid.kernels(dz, side, grid.band), grid.within(side, grid.band)
        images = np.where(np.arange(side) == 0, 1.0, 2.0)
        images = np.outer(images, images)
        cell, weight = lattice.weights(offsets[levels])
        cell = (np.arange(len(levels))[:, None] * side + cell[0]) * side + cell[1]
        weights = np.bincount(cell.ravel(), weight.ravel(), exact.size).reshape(exact.shape) / images
        reached = weights > 0
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
        kernel *= np.sqrt(math.pi / 4 / energy)[:, None, None] / np.where(reached, weights, 1)
        table[levels, :side, :side] = kernel
        first = last
    return table


@dataclass(frozen=True)
class _Grid:
    """Quadrant of an even grid for even spectra: cosines over half the bins replace the Fourier transform.

    Attributes
    ----------
    to_space, to_frequency : numpy.ndarray, shape (pixels, bins) and (bins, pixels)
        Transforms along an axis.
    band : numpy.ndarray of bool, shape (bins, bins)
        The circular band.
    detour : numpy.ndarray, shape (bins, bins)
        Turns of the phase per meter.
    """

    to_space: np.ndarray
    to_frequency: np.ndarray
    band: np.ndarray
    detour: np.ndarray

    @classmethod
    def of(cls, side, pitch, wavelength):
        """Make a grid for kernels of `side` pixels in a quadrant."""
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
        """Power spectrum of a surface's light in the band, of which the fraction `straight` is in phase; mean 1."""
        bins = np.arange(len(self.band))
        images = np.where((bins == 0) | (bins == len(bins) - 1), 1.0, 2.0)
        images = np.outer(images, images) * self.band
        f = bins / (2 * (len(bins) - 1))
        texture = self.band / (1 + (f[:, None] ** 2 + f**2) / TEXTURE**2)
        in_phase = (1 - STRAIGHT) * texture * (images.sum() / (texture * images).sum())
        in_phase[0, 0] += STRAIGHT * images.sum()
        return straight * in_phase + max(1 - straight, MIN_WEIGHT) * self.band

    def kernels(self, dz, side, power):
        """Exact kernel of each of some evenly spaced distances, up to `side`, times a power spectrum."""
        # single precision halves memory; sums in double precision then agree to the table's last bit in all libraries
        spectrum = np.empty((len(dz), *self.detour.shape), np.complex64)
        wave = np.exp(2j * math.pi * dz[0] * self.detour) * power
        # a product takes a tenth of an exponential's time
        step = np.exp(2j * math.pi * (dz[1] - dz[0]) * self.detour) if len(dz) > 1 else 1.0
        for level in spectrum:
            level[:] = wave
            wave *= step
        return _along_both(self.to_space[:side], spectrum)

    def within(self, side, power):
        """Function that multiplies spectra of even images of `side` pixels by a power spectrum, such as the band.

        That is a convolution with the transform of the power. As one matrix it takes less work than two transforms, as
        long as it is small.
        """
        if side > SMALL:
            forward, backward = self.to_frequency[:, :side], self.to_space[:side]
            return lambda images: _along_both(backward, _along_both(forward, images) * power)
        matrix = _convolution(self.to_space @ power @ self.to_space.T, side)
        return lambda images: _times(matrix, images)


def _fitted(kernel, exact, within, reached, images):
    """Fit a stack of kernels, on the grains `reached`, to exact ones by conjugate gradients."""

    def inner(a, b):
        return (images * (a.conj() * b).real).sum((1, 2))[:, None, None]

    residual = (exact - within(kernel)) * reached
    step, size = residual, inner(residual, residual)
    for _ in range(SMOOTH_STEPS):
        image = within(step) * reached
        # TINY: where few grains are reached, the fit is exact soon
        length = size / np.maximum(inner(step, image), TINY)
        kernel = kernel + length * step
        residual = residual - length * image
        before, size = size, inner(residual, residual)
        step = residual + size / np.maximum(before, TINY) * step
    return kernel


def _convolution(kernel, side):
    """Matrix that convolves one quadrant of an even image with an even kernel; (y, x) are one index."""
    a = np.arange(side)
    apart, mirrored = np.abs(a[:, None] - a), a[:, None] + a
    images = np.where(a == 0, 0.0, 1.0)  # an axis is its own image
    rows = kernel[apart] + images[:, None] * kernel[mirrored]  # (y, y', x offset)
    both = rows[:, :, apart] + images * rows[:, :, mirrored]  # (y, y', x, x')
    return both.transpose(0, 2, 1, 3).reshape(side * side, side * side)


def _times(matrix, stack):
    """Multiply a real matrix by each complex image of a stack, in one product."""
    flat = stack.reshape(len(stack), -1)
    out = np.concatenate([flat.real, flat.imag]) @ matrix.T
    return (out[: len(stack)] + 1j * out[len(stack) :]).reshape(stack.shape)


def _along_both(matrix, stack):
    """Multiply each complex image of a stack by a real matrix from the left and by its transpose from the right.

    Few large products: many small ones take ten times as long where the library's threads have to wait for a core.
    """
    values = np.concatenate([stack.real, stack.imag])
    for _ in range(2):
        count, rows, columns = values.shape
        values = (values.reshape(-1, columns) @ matrix.T).reshape(count, rows, len(matrix)).swapaxes(1, 2)
    return values[: len(stack)] + 1j * values[len(stack) :]
