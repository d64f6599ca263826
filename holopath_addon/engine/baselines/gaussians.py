"""Gaussians: flat Gaussian disks on the surfaces, whose waves are blended from the farthest to the nearest.

Choi, Chao, Yang, Gopakumar and Wetzstein, Gaussian Wave Splatting for Computer-Generated Holography, ACM TOG 44(4)
(2025), in the form with random phases of the same group, Chao et al., Random-phase Wave Splatting, arXiv:2508.17480:

    U <- sqrt(1 - a) P(U) + sqrt(a L) exp(i phi),    a = exp(-((x - x0)^2 + (y - y0)^2) / (2 sigma^2))

with P the propagation to the next Gaussian, a its opacity and L its radiance. The phase phi is random all over a
disk, between disks and between frames, so that the frame mean of |U|^2 blends like radiance. The first paper has one
phase for each Gaussian and blends amplitudes. Spectra are then known in closed form, but are as narrow as
1 / (2 sqrt(2) pi sigma): with all in phase there is no speckle, and hardly any light outside the pupil's middle. PSNR
of two balls before a wall at 256 x 256, mean over three foci, 8 frames, through the whole pupil and through a part a
quarter as wide, 0.6 of its radius from the middle:

                                  whole      part   light in the part
    all in phase, first paper   22.9 dB    4.3 dB    1 %
    one random phase each       18.8 dB   10.9 dB   19 %
    random all over them        19.2 dB   18.2 dB   90 %

At 64 frames the last reaches 26.0 dB with cells of up to 8 pixels as well as with one Gaussian a pixel (26.1 dB), as do
RGB-D layers (26.0 dB); one random phase each 25.4 dB, and 23.5 dB if they are large.

Here Gaussians are not fitted to photographs. They are sampled from the view of the pupil's center, one in each cell of
a quadtree that is as coarse as radiance and depth allow, with the width and slope of the surface in it. Those within
half a depth of focus are taken to lie side by side on one surface: their opacities add up to 1 at most, and one plane
holds them all. The cost therefore depends on the visible surfaces, and FFTs are most of it. Radiance is the same all
over the pupil, and surfaces that its center does not see are missing.
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

SIDES = (8, 4, 2, 1)  # of cells, pixels
SIGMA = 0.5  # fraction of a cell's side: opacities then add up to 1 or more at its corners
CUT = 3.0  # standard deviations at which disks end
CONTRAST = 0.05  # maximum difference of amplitudes in a cell, fraction of the white
CHUNK = 1 << 20  # pixels of Gaussians at a time


@dataclass(frozen=True)
class Gaussians:
    """Gaussian disks as the pupil's center sees them: round, one in each cell.

    Attributes
    ----------
    row, column : numpy.ndarray, shape (n,)
        Places of the centers, pixels.
    z, down, right : numpy.ndarray, shape (n,)
        Distance of the centers from the SLM, meters, and its growth with each row and column.
    side : numpy.ndarray of int, shape (n,)
        Sides of the cells, pixels.
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
        """Sample Gaussians from an image with depth.

        Parameters
        ----------
        radiance : numpy.ndarray, shape (wavelength, y, x)
        z : numpy.ndarray, shape (y, x)
            Meters from the SLM.
        thickness : float
            Maximum distance of the surface in a cell from its Gaussian's plane, meters.
        """
        amplitude = np.sqrt(radiance)
        contrast = CONTRAST * max(float(np.percentile(amplitude, 95)), 1e-12)
        slopes = np.stack([_slope(z, axis) for axis in (0, 1)])
        free = np.ones(z.shape, bool)
        parts = []
        for side in SIDES:
            depths, shades = _cells(z, side), _cells(amplitude, side)
            middle = 0.5 * (side - 1)
            place = np.indices((side, side)).reshape(2, 1, 1, -1) - middle
            slope = _cells(slopes, side).mean(-1)
            off = depths - depths.mean(-1, keepdims=True) - (slope[..., None] * place).sum(0)
            fits = (np.abs(off).max(-1) <= thickness) & (np.ptp(shades, -1) <= contrast).all(0)
            selection = _cells(free, side).all(-1) & (fits | (side == 1))
            covered = np.kron(selection, np.ones((side, side), bool))
            free[: covered.shape[0], : covered.shape[1]] &= ~covered
            rows, columns = np.nonzero(selection)
            down, right = slope[:, selection]
            parts.append(
                cls(
                    rows * side + middle,
                    columns * side + middle,
                    depths.mean(-1)[selection],
                    down,
                    right,
                    np.full(len(rows), side),
                    _cells(radiance, side).mean(-1)[:, selection].T,
                )
            )
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def between(self, low: float, high: float, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Opacity and light of the parts of the disks between two depths, seen from the pupil's center.

        Parameters
        ----------
        low, high : float
            Depth range, meters from the SLM.
        shape : (int, int)
            Rows and columns of the images.

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
            batch_size = max(1, CHUNK // offset.size**2)
            for first in range(0, len(touching), batch_size):
                part = touching[first : first + batch_size, None, None]
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
    """Wave field at the SLM; parameters and result as of `baselines.field`."""
    radiance, z = picture_with_depth(job, lambda done, message: progress(0.3 * done, message))
    gaussians = Gaussians.of(radiance, z, 0.25 * job.hologram.depth_of_focus)
    depths, _ = sliced(job, z)
    return blended(job, gaussians, depths, lambda done, message: progress(0.3 + 0.7 * done, message))


def blended(job: BaselineInput, gaussians: Gaussians, depths: np.ndarray, progress: Progress) -> np.ndarray:
    """Wave field at the SLM of Gaussians, each blended in the nearest of some planes.

    Parameters
    ----------
    job : BaselineInput
    gaussians : Gaussians
    depths : numpy.ndarray
        Planes from the farthest to the nearest, meters from the SLM.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
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
    """Square cells of an image without those that its edge cuts: shape (..., row, column, pixel of the cell)."""
    rows, columns = values.shape[-2] // side, values.shape[-1] // side
    whole = values[..., : rows * side, : columns * side]
    whole = whole.reshape(*values.shape[:-2], rows, side, columns, side).swapaxes(-3, -2)
    return whole.reshape(*values.shape[:-2], rows, columns, side * side)


def _slope(z, axis):
    """Growth of z from pixel to pixel: the smaller one of both sides, which does not cross an outline."""
    step = np.diff(z, axis=axis)
    before = np.concatenate([step.take([0], axis), step], axis)
    after = np.concatenate([step, step.take([-1], axis)], axis)
    return np.where(np.abs(before) < np.abs(after), before, after)
