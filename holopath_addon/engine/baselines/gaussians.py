"""Gaussians: flat Gaussian disks on the surfaces, their waves blended from the farthest to the nearest.

Choi, Chao, Yang, Gopakumar and Wetzstein, Gaussian Wave Splatting for Computer-Generated Holography, ACM TOG 44(4)
(2025), in the form with random phases of the same group, Chao et al., Random-phase Wave Splatting, arXiv:2508.17480:

    U <- sqrt(1 - a) P(U) + sqrt(a L) exp(i phi),    a = exp(-((x - x0)^2 + (y - y0)^2) / (2 sigma^2))

with P the propagation to the next Gaussian, a its opacity and L its radiance. The phase phi is random all over its
disk, from one to the next and from frame to frame, so that the frame mean of |U|^2 is blended just as radiance is. The
first paper has one phase a Gaussian and blends amplitudes; spectra are then known in closed form, but as narrow as
1 / (2 sqrt(2) pi sigma): with all in phase there is no speckle, and hardly any light outside the pupil's middle. PSNR
of two balls before a wall at 256 x 256, mean over three foci, 8 frames, through the whole pupil and through a part a
quarter as wide, 0.6 of its radius from the middle:

                                  whole      part   light in the part
    all in phase, first paper   22.9 dB    4.3 dB    1 %
    one random phase each       18.8 dB   10.9 dB   19 %
    random all over them        19.2 dB   18.2 dB   90 %

At 64 frames the last reaches 26.0 dB with cells of up to 8 pixels as well as with one Gaussian a pixel (26.1 dB), as do
RGB-D layers (26.0 dB); one random phase each 25.4 dB, and 23.5 dB if they are large.

Gaussians are here not fitted to photographs: they are sampled from what the pupil's center sees, one in each cell of
a quadtree that is as coarse as radiance and depth allow, as wide and as inclined as the surface in it. Those that lie
within half a depth of focus are side by side on one surface rather than behind each other: their opacities add up,
until it is opaque, and a plane shows them all at once. What they cost is therefore what is seen, with FFTs the most of
it. Radiance is the same from all over the pupil, and what its center does not see is missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from ..waves.propagation import field_of, padded_shape, spectrum
from . import light_randomness
from .layers import gain_for, sliced, step_transfer
from .shots import picture_with_depth

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput

SIDES = (8, 4, 2, 1)  # pixels, of cells
SIGMA = 0.5  # of a cell's side: opacities then add up to 1 or more at its corners
CUT = 3.0  # standard deviations
CONTRAST = 0.05  # of the white: most that amplitudes in a cell differ
CHUNK = 1 << 20  # pixels of Gaussians at a time


@dataclass(frozen=True)
class Gaussians:
    """Gaussian disks as the pupil's center sees them: as high as wide, one in each cell.

    Attributes
    ----------
    row, column : numpy.ndarray, shape (n,)
        Of the centers, pixels.
    z, down, right : numpy.ndarray, shape (n,)
        Distance of the centers from the SLM, meters, and how much it grows with each row and column.
    side : numpy.ndarray of int, shape (n,)
        Of the cells, pixels.
    radiance : numpy.ndarray, shape (n, wavelength)
    """

    row: np.ndarray
    column: np.ndarray
    z: np.ndarray
    down: np.ndarray
    right: np.ndarray
    side: np.ndarray
    radiance: np.ndarray

    @classmethod
    def of(cls, radiance: np.ndarray, z: np.ndarray, thickness: float) -> Gaussians:
        """Sampled from a picture with depth.

        Parameters
        ----------
        radiance : numpy.ndarray, shape (wavelength, y, x)
        z : numpy.ndarray, shape (y, x)
            Meters from the SLM.
        thickness : float
            Most that the surface in a cell is off its Gaussian's plane, meters.
        """
        amplitude = np.sqrt(radiance)
        contrast = CONTRAST * max(float(np.percentile(amplitude, 95)), 1e-12)
        slopes = np.stack([_slope(z, axis) for axis in (0, 1)])
        left = np.ones(z.shape, bool)
        found = []
        for side in SIDES:
            depths, shades = _cells(z, side), _cells(amplitude, side)
            middle = 0.5 * (side - 1)
            place = np.indices((side, side)).reshape(2, 1, 1, -1) - middle
            slope = _cells(slopes, side).mean(-1)
            off = depths - depths.mean(-1, keepdims=True) - (slope[..., None] * place).sum(0)
            fits = (np.abs(off).max(-1) <= thickness) & (np.ptp(shades, -1) <= contrast).all(0)
            chosen = _cells(left, side).all(-1) & (fits | (side == 1))
            taken = np.kron(chosen, np.ones((side, side), bool))
            left[: taken.shape[0], : taken.shape[1]] &= ~taken
            rows, columns = np.nonzero(chosen)
            down, right = slope[:, chosen]
            found.append(
                cls(
                    rows * side + middle,
                    columns * side + middle,
                    depths.mean(-1)[chosen],
                    down,
                    right,
                    np.full(len(rows), side),
                    _cells(radiance, side).mean(-1)[:, chosen].T,
                )
            )
        return cls(*(np.concatenate([getattr(part, f.name) for part in found]) for f in fields(cls)))

    def between(self, low: float, high: float, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """What of the disks lies between two depths, seen from the pupil's center.

        Parameters
        ----------
        low, high : float
            Meters from the SLM.
        shape : (int, int)
            Rows and columns.

        Returns
        -------
        opacity : numpy.ndarray, shape (y, x)
        light : numpy.ndarray, shape (wavelength, y, x)
            Radiance times opacity.
        """
        sums = np.zeros((1 + self.radiance.shape[1], math.prod(shape)))
        for side in SIDES:
            reach = math.ceil(CUT * SIGMA * side)
            rise = (reach + 1) * (np.abs(self.down) + np.abs(self.right))
            touching = np.flatnonzero((self.side == side) & (self.z + rise >= low) & (self.z - rise <= high))
            offset = np.arange(-reach, reach + 1)
            together = max(1, CHUNK // offset.size**2)
            for first in range(0, len(touching), together):
                part = touching[first : first + together, None, None]
                row = np.floor(self.row[part]).astype(int) + offset[:, None]
                column = np.floor(self.column[part]).astype(int) + offset
                down, right = row - self.row[part], column - self.column[part]
                square = (down**2 + right**2) / (SIGMA * side) ** 2
                z = self.z[part] + self.down[part] * down + self.right[part] * right
                inside = (square <= CUT**2) & (z >= low) & (z < high)
                inside &= (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
                pixel, which = (row * shape[1] + column)[inside], np.broadcast_to(part, inside.shape)[inside]
                opacity = np.exp(-0.5 * square[inside])
                for total, weight in zip(sums, [opacity, *(opacity * self.radiance[which].T)], strict=True):
                    total += np.bincount(pixel, weight, total.size)
        total, light = sums[0], sums[1:]
        light /= np.maximum(total, 1)
        return np.minimum(total, 1).reshape(shape), light.reshape(-1, *shape)


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """The wave field at the SLM; parameters as of `baselines.BaselineInput`, progress may raise.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
    """
    radiance, z = picture_with_depth(job, lambda done, what: progress(0.3 * done, what))
    gaussians = Gaussians.of(radiance, z, 0.25 * job.hologram.depth_of_focus)
    depths, _ = sliced(job, z)
    return blended(job, gaussians, depths, lambda done, what: progress(0.3 + 0.7 * done, what))


def blended(job: BaselineInput, gaussians: Gaussians, depths: np.ndarray, progress: Progress) -> np.ndarray:
    """The wave at the SLM of Gaussians that are each blended in the plane next to it; parameters as of `field`.

    Parameters
    ----------
    gaussians : Gaussians
    depths : numpy.ndarray
        Of the planes, from the farthest to the nearest, meters from the SLM.
    """
    hologram, frames = job.hologram, job.settings.frames
    waves = np.zeros((frames, len(hologram.wavelengths), *job.shape), np.complex64)
    turn = np.complex64(2j * math.pi * light_randomness(frames))
    bounds = [-math.inf, *(0.5 * (depths[1:] + depths[:-1])), math.inf]
    steps = [*np.diff(depths), -depths[-1]]
    padded = [padded_shape(job.shape, hologram.pitch, w, max(np.abs(steps))) for w in hologram.wavelengths]
    for layer, step in enumerate(steps):
        opacity, light = gaussians.between(bounds[layer], bounds[layer + 1], job.shape)
        where = np.nonzero(opacity)
        passed = np.sqrt(1 - opacity[where], dtype=np.float32)
        for k, wavelength in enumerate(hologram.wavelengths):
            amplitude = gain_for(frames) * np.sqrt(light[k][where], dtype=np.float32)
            transfer = step_transfer(job, padded[k], wavelength, step)
            for m in range(frames):
                rng = np.random.default_rng((job.settings.seed, m, k, layer))
                phase = turn * rng.random(len(amplitude), dtype=np.float32)
                waves[m, k][where] = passed * waves[m, k][where] + amplitude * np.exp(phase)
                waves[m, k] = field_of(spectrum(waves[m, k], padded[k]) * transfer, job.shape)
            progress((layer + (k + 1) / len(hologram.wavelengths)) / len(steps), "Gaussians")
    return waves


def _cells(values, side):
    """Square cells of a picture, those cut by its edge left out: shape (..., row, column, pixel of the cell)."""
    rows, columns = values.shape[-2] // side, values.shape[-1] // side
    whole = values[..., : rows * side, : columns * side]
    whole = whole.reshape(*values.shape[:-2], rows, side, columns, side).swapaxes(-3, -2)
    return whole.reshape(*values.shape[:-2], rows, columns, side * side)


def _slope(z, axis):
    """Growth of z from pixel to pixel: of both neighbors' the smaller, which does not reach over an outline."""
    step = np.diff(z, axis=axis)
    before = np.concatenate([step.take([0], axis), step], axis)
    after = np.concatenate([step, step.take([-1], axis)], axis)
    return np.where(np.abs(before) < np.abs(after), before, after)
