"""The light of a display that is not ideal, in the descents: from phases to a field at the SLM's pixels, and back."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..waves.arrays import like, on_processor
from ..waves.display_model import GRID, DisplayLight

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..pixels import Pitch
    from ..waves.arrays import Array
    from ..waves.display_model import DisplayModel


class ShownLight:
    """Field behind the relay of a `DisplayModel`, of the middle of its source, and the adjoint.

    The processor computes it; arrays of other libraries than NumPy are copied there and back.

    Parameters
    ----------
    model : DisplayModel
    shape : (int, int)
        Rows and columns.
    pitch : float or (float, float)
        Metres.
    margin : int
        Pixels around the SLM into which light strays that is looked at.
    """

    def __init__(self, model: DisplayModel, shape: Sequence[int], pitch: Pitch, margin: int = 0) -> None:
        self._model = replace(model, size=0.0, bandwidth=0.0)
        self._optics = DisplayLight(self._model, shape, pitch, 0.0)
        self._pixels = tuple(n // GRID for n in self._optics.padded)
        self._window = np.ix_(*(np.arange(-margin, n + margin) for n in shape))
        # frequencies that pixels have, within those of the finer grid
        self._bins = np.ix_(*(np.r_[0 : (n + 1) // 2, -(n // 2) : 0] for n in self._pixels))

    def light(self, phases: Array) -> Array:
        """Field at the pixels and the margin, complex64, of phases in radians, shape (y, x)."""
        spectrum = self._optics.spectra(on_processor(phases))[self._model.wavelength]
        wave = self._optics.relayed(spectrum)[self._bins]
        light = scipy.fft.ifft2(wave, overwrite_x=True)[self._window] * np.float32(1 / GRID**2)
        return like(light, phases)

    def slope(self, phases: Array, back: Array) -> Array:
        """Gradient with respect to the phases, float32.

        Parameters
        ----------
        phases : array, shape (y, x)
            Radians.
        back : array, complex, shape of `light`
            G with dL = 2 Re sum conj(G) du for a change du of `light`.
        """
        share = np.float32(2 * math.sqrt(1 - abs(self._model.unmodulated) ** 2))
        turned = np.exp(np.complex64(-1j) * self._optics.blurred(on_processor(phases)))
        light = (turned * self._adjoint(on_processor(back))).imag * share
        return like(self._optics.at_pixels(light), phases)

    def phases_for(self, field: Array) -> Array:
        """Phases, float32, whose light is about a field: those of the field sent back to the pixels."""
        light = self._adjoint(on_processor(field))
        phases = np.angle(self._optics.at_pixels(light.real) + 1j * self._optics.at_pixels(light.imag))
        return like(phases, field)

    def _adjoint(self, back):
        """Of what is linear: from the field to the light within the pixels, times the beam's conjugate."""
        optics, count = self._optics, math.prod(self._pixels)
        field, wave = np.zeros(self._pixels, np.complex64), np.zeros(optics.padded, np.complex64)
        field[self._window] = back
        wave[self._bins] = scipy.fft.fft2(field, overwrite_x=True) * np.float32(1 / (count * GRID**2))
        return optics.spectra_adjoint(optics.relayed_adjoint(wave))
