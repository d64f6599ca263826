"""Light behind a lens, and in the far field: Collins' integral, by one transform.

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

from ..hologram import Picture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..hologram import Hologram

WHOLE = 1e-9  # by which a scale is 1 at most


class Collins:
    """The way of one wavelength's light to another plane, on as many pixels of another pitch there.

    Left out are the curvature exp(i pi D x'^2 / (lambda B)) of the light on that plane, which neither intensities there
    nor the telecentric space of a `Picture` have, and a constant phase. Fields are scaled by the pixels' sizes: their
    squares, summed over all pixels, are the light's power in both planes.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    pitch, wavelength : float
        Meters.
    curvature, reach : float
        A, and B in meters, which is not 0.
    shortest : float, optional
        Wavelength, meters, whose light fills the pixels of the plane: their pitch there is
        shortest abs(B) / (pixels pitch). Longer waves reach farther. Default: this wavelength.
    """

    def __init__(
        self,
        shape: Sequence[int],
        pitch: float,
        wavelength: float,
        curvature: float,
        reach: float,
        shortest: float | None = None,
    ) -> None:
        scale = (shortest or wavelength) / wavelength
        self._axes = [_Axis(n, pitch, wavelength, curvature, reach, scale) for n in shape]

    @property
    def kind(self) -> str:
        """How it is computed: ``Fourier`` where the pitch is that of a Fourier transform, else ``chirp-z``."""
        return "Fourier" if all(axis.whole for axis in self._axes) else "chirp-z"

    def there(self, fields: np.ndarray) -> np.ndarray:
        """Fields on the other plane.

        Parameters
        ----------
        fields : numpy.ndarray, complex, shape (..., y, x)

        Returns
        -------
        numpy.ndarray, complex64, or complex128 of such fields, of the same shape
        """
        for axis, place in zip(self._axes, (-2, -1), strict=True):
            fields = axis.there(fields, place)
        return fields

    def back(self, fields: np.ndarray) -> np.ndarray:
        """The adjoint of `there`: fields on the first plane, whose light on the other is what can be sent there."""
        for axis, place in zip(self._axes, (-2, -1), strict=True):
            fields = axis.back(fields, place)
        return fields


class _Axis:
    """sqrt(scale / n) exp(-2 pi i scale x x' / n) exp(i pi A x^2 / (lambda B)), in pixels x and x' from the middle.

    A convolution with a chirp, as x x' = (x^2 + x'^2 - (x - x')^2) / 2: L. I. Bluestein, IEEE Trans. Audio
    Electroacoust. 18, 451 (1970). Where the scale is 1 it is a Fourier transform, between phases that put 0 in the middle.
    """

    def __init__(self, n, pitch, wavelength, curvature, reach, scale):
        self.whole, self._n, self._mirrored = abs(scale - 1) < WHOLE, n, reach < 0
        x = np.arange(n) - (n - 1) / 2
        bend = curvature * pitch**2 / (wavelength * reach) * x**2 / 2
        if reach < 0:  # the conjugate of a transform by abs(B)
            bend = -bend
        if self.whole:
            # (j - c) (k - c) = j k - c (j + k) + c^2, with c = (n - 1) / 2
            turn = (n - 1) / (2 * n) * np.arange(n)
            ends, self._bins = (turn + bend, turn - (n - 1) ** 2 / (4 * n)), None
        else:
            step = scale / (2 * n)
            ends = bend - step * x**2, -step * x**2
            self._bins = scipy.fft.next_fast_len(2 * n - 1)
            apart = scipy.fft.fftfreq(self._bins, 1 / self._bins)
            chirp = scipy.fft.fft(_phasor(step * apart**2) * (np.abs(apart) < n))
            self._chirp = (math.sqrt(scale / n) * chirp).astype(np.complex64)
        self._ends = [_phasor(turns).astype(np.complex64) for turns in ends]

    def there(self, fields, place):
        if self._mirrored:
            return self._along(fields.conj(), place, *self._ends).conj()
        return self._along(fields, place, *self._ends)

    def back(self, fields, place):
        # the matrix between the two chirps is symmetric, so its adjoint is its conjugate
        if self._mirrored:
            return self._along(fields, place, *self._ends[::-1])
        return self._along(fields.conj(), place, *self._ends[::-1]).conj()

    def _along(self, fields, place, first, last):
        first, last = (each if place == -1 else each[:, None] for each in (first, last))
        waves = fields * first
        if self._bins is None:
            return scipy.fft.fft(waves, axis=place, norm="ortho", overwrite_x=True) * last
        chirp = self._chirp if place == -1 else self._chirp[:, None]
        waves = scipy.fft.fft(waves, self._bins, axis=place) * chirp
        waves = scipy.fft.ifft(waves, axis=place, overwrite_x=True)
        return (waves[..., : self._n] if place == -1 else waves[..., : self._n, :]) * last


def behind_lens(hologram: Hologram, wavelength: float) -> Collins | None:
    """The way from the SLM to the grid of the `Picture` behind its lens; None where there is no such picture."""
    picture = hologram.picture
    if not isinstance(picture, Picture):
        return None
    panel, lens = picture.panel, picture.panel.optics.lens
    size = (panel.height, panel.width), panel.pitch
    return Collins(*size, wavelength, lens.curvature, lens.reach, picture.shortest)


def _phasor(turns):
    return np.exp(2j * math.pi * np.mod(turns, 1.0))
