"""Light behind a lens, and in the far field: the Collins integral, by one transform.

S. A. Collins, J. Opt. Soc. Am. 60, 1168 (1970): with the ray matrix A, B, C, D from one plane to another,

    u'(x') = exp(i pi D x'^2 / (lambda B)) / sqrt(i lambda B) integral u(x) exp(i pi A x^2 / (lambda B))
             exp(-2 pi i x x' / (lambda B)) dx

along each axis. Behind a lens of focal length f, L from the SLM, A = 1 - s/f, B = L + s - L s/f, D = 1 - L/f at a
distance s; A = D = 1, B = z is Fresnel's diffraction over a distance z of free space.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..hologram import AerialImage
from ..pixels import axes
from . import arrays
from .propagation import bluestein, phasor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..hologram import Hologram
    from ..pixels import Pitch
    from .arrays import Array

WHOLE = 1e-9  # turns by which steps may differ from those of a Fourier transform
ROUND = (1 - math.sqrt(0.5)) / 2  # k of `spread_waves`: the image's corners meet the disk's edge


class Collins:
    """Propagation of one wavelength to another plane, with a grid of another pitch around the same axis.

    The curvature exp(i pi D x'^2 / (lambda B)) on that plane is omitted, as neither intensities nor the telecentric
    space of an `AerialImage` have it, and so is a constant phase. Fields are scaled by the sizes of pixels, so that the
    sum of their squares is the light's power on both planes.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the first plane. If it has more than the other plane, only the central ones are used, so
        that the other plane's pixels sample their light.
    pitch : float or (float, float)
        Pixel pitch of the first plane, meters.
    wavelength : float
        Meters.
    curvature, reach : float
        A, and B in meters, which is not 0.
    image_shape : (int, int)
        Rows and columns of the other plane.
    image_pitch : float
        Pitch of its square pixels, meters.
    """

    def __init__(
        self,
        shape: Sequence[int],
        pitch: Pitch,
        wavelength: float,
        curvature: float,
        reach: float,
        image_shape: Sequence[int],
        image_pitch: float,
    ) -> None:
        step = image_pitch / (wavelength * reach)
        bend = curvature / (wavelength * reach)
        self._axes = [
            _Axis(n, count, d * step, bend * d**2)
            for n, count, d in zip(shape, image_shape, axes(pitch), strict=True)
        ]

    @property
    def kind(self) -> str:
        """Kind of transform: ``Fourier`` if the pitch is that of an FFT, else ``chirp-z``."""
        return "Fourier" if all(axis.whole for axis in self._axes) else "chirp-z"

    @property
    def used(self) -> tuple[slice, ...]:
        """Rows and columns of the first plane that are used."""
        return tuple(axis.used for axis in self._axes)

    def propagate(self, fields: Array) -> Array:
        """Propagate fields to the other plane.

        Parameters
        ----------
        fields : array, complex, shape (..., y, x)

        Returns
        -------
        array, complex64, or complex128 of such fields
        """
        for axis, place in zip(self._axes, (-2, -1), strict=True):
            fields = axis.propagate(fields, place)
        return fields

    def adjoint(self, fields: Array) -> Array:
        """Apply the adjoint of `propagate`, to fields on the other plane."""
        for axis, place in zip(self._axes, (-2, -1), strict=True):
            fields = axis.adjoint(fields, place)
        return fields


class _Axis:
    """sqrt(abs(s)) exp(-2 pi i s x x') exp(i pi b x^2), with places x and x' in pixels from the middle.

    By `bluestein`; where s = 1 / n, it is a Fourier transform.

    Parameters
    ----------
    n, count : int
        Pixels on the planes.
    step, bend : float
        s and b, turns.
    """

    def __init__(self, n, count, step, bend):
        self._n, self._count = n, count
        used = min(n, count)
        start = (n - used) // 2
        self.used = slice(start, start + used)
        self.whole = used == count and abs(abs(step) * count - 1) < WHOLE
        j, k = np.arange(used), np.arange(count)
        center, image_center = (n - 1) / 2 - start, (count - 1) / 2
        size = abs(step)  # a negative step mirrors light: the conjugate of the transform of the conjugate
        self._mirrored = step < 0
        bend = -bend if self._mirrored else bend
        first = bend / 2 * (j - center) ** 2 + size * image_center * j
        last = size * center * (k - image_center)
        if not self.whole:
            first, last = first - size * j**2 / 2, last - size * k**2 / 2
            bins = scipy.fft.next_fast_len(2 * max(used, count) - 1)
            apart = scipy.fft.fftfreq(bins, 1 / bins)
            chirp = scipy.fft.fft(phasor(size * apart**2 / 2))
            self._chirp = (math.sqrt(size) * chirp).astype(np.complex64)
        self._ends = [phasor(turns).astype(np.complex64) for turns in (first, last)]

    def propagate(self, fields, place):
        xp, (first, last) = arrays.namespace(fields), self._ends
        fields = self._along(xp.moveaxis(fields, place, -1)[..., self.used], first, last, self._mirrored)
        return xp.moveaxis(fields, -1, place)

    def adjoint(self, fields, place):
        xp, (first, last) = arrays.namespace(fields), self._ends
        # the operation between the two chirps is symmetric, so its adjoint is its conjugate
        fields = self._along(xp.moveaxis(fields, place, -1), last, first, not self._mirrored)
        if self._count < self._n:
            wide = arrays.zeros((*fields.shape[:-1], self._n), fields.dtype, fields)
            wide[..., self.used] = fields
            fields = wide
        return xp.moveaxis(fields, -1, place)

    def _along(self, fields, first, last, conjugate):
        """Multiply the last axis by one chirp, transform it, and multiply by the other; or the same with conjugates."""
        xp, first, last = arrays.namespace(fields), arrays.like(first, fields), arrays.like(last, fields)
        fields = xp.conj(fields) if conjugate else fields
        if self.whole:
            fields = arrays.fft(fields * first, norm="ortho", overwrite=True) * last
        else:
            fields = bluestein(fields, first, arrays.like(self._chirp, fields), last)
        return xp.conj(fields) if conjugate else fields


def behind_lens(hologram: Hologram, wavelength: float) -> Collins | None:
    """Propagation from the SLM to a wavelength's pixels of the `AerialImage` behind the lens; None without a lens."""
    image = hologram.in_air
    if not isinstance(image, AerialImage):
        return None
    panel, lens, raster = image.panel, image.lens, image.raster(wavelength)
    shape = panel.height, panel.width
    return Collins(shape, panel.pitch, wavelength, lens.curvature, lens.reach, raster.shape, raster.pitch)


def spread_waves(frames: int, shape: Sequence[int]) -> np.ndarray:
    """Waves of even intensity on the plane of an image behind a lens, whose light fills the aperture evenly.

    A plane wave comes from the center of the SLM alone, and phases cannot leave the rest of it dark. Here each point of
    the image has its light from another point of the SLM: the local frequency is the gradient of
    (X^2 + Y^2) / 2 - k X^2 Y^2, with X and Y from -1 to 1 over the image, which maps its square to a disk to within
    1 %. Out of focus such an image grows in one frame and shrinks in the next.

    Parameters
    ----------
    frames : int
        Number of frames.
    shape : (int, int)
        Rows and columns of the image's own pixels.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, y, x), of unit modulus
    """
    rows, columns = shape
    y, x = ((2 * np.arange(n) + 1) / n - 1 for n in shape)
    along_y, along_x = y[:, None] ** 2, x[None, :] ** 2
    bent = rows * along_y + columns * along_x - 2 * ROUND * math.sqrt(rows * columns) * along_y * along_x
    return np.stack([phasor(bent / 8 * (-1) ** frame) for frame in range(frames)]).astype(np.complex64)
