"""Light of a display that is not ideal, for descents: from phases to a field at the SLM's pixels, and its adjoint."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from ..waves import arrays
from ..waves.arrays import PROCESSOR
from ..waves.display_model import GRID, DisplayLight
from ..waves.propagation import resized

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..pixels import Pitch
    from ..waves.arrays import Array
    from ..waves.display_model import DisplayModel


class ShownLight:
    """Field behind the relay of a `DisplayModel` for the center of its source, and its adjoint.

    Parameters
    ----------
    model : DisplayModel
    shape : (int, int)
        Rows and columns of the SLM.
    pitch : float or (float, float)
        Pixel pitch, meters.
    margin : int
        Pixels of guard band around the SLM that fields include.
    on : array, optional
        Array whose library and device compute. Default: NumPy.
    """

    def __init__(
        self,
        model: DisplayModel,
        shape: Sequence[int],
        pitch: Pitch,
        margin: int = 0,
        on: Array = PROCESSOR,
    ) -> None:
        self._model = replace(model, size=0.0, bandwidth=0.0)
        self._optics = DisplayLight(self._model, shape, pitch, 0.0, on=on)
        self._pixels = tuple(n // GRID for n in self._optics.padded)
        self._margin, self._shape = margin, tuple(n + 2 * margin for n in shape)

    def light(self, phases: Array) -> Array:
        """Return the field at the pixels and the margin, complex64, of phases in radians, shape (y, x)."""
        wave = self._optics.relayed(self._optics.spectra(phases)[self._model.wavelength])
        for axis, count in enumerate(self._pixels):
            wave = resized(wave, count, axis)
        wave = self._roll(arrays.ifft2(wave, overwrite=True), self._margin)
        rows, columns = self._shape
        return wave[:rows, :columns] * (1 / GRID**2)

    def slope(self, phases: Array, back: Array) -> Array:
        """Return the gradient with respect to the phases, float32.

        Parameters
        ----------
        phases : array, shape (y, x)
            Radians.
        back : array, complex, shape of `light`
            G with dL = 2 Re sum conj(G) du for a change du of `light`.
        """
        xp, factor = arrays.namespace(back), 2 * math.sqrt(1 - abs(self._model.unmodulated) ** 2)
        light = self._adjoint(back)
        phasors = arrays.as_type(self._optics.blurred(phases), "complex64")
        phasors *= -1j
        phasors = arrays.into(phasors, xp.exp, phasors)
        light *= phasors
        return self._optics.at_pixels(xp.imag(light) * factor)

    def phases_for(self, field: Array) -> Array:
        """Return phases, float32, whose light is about a field: those of the field sent back to the pixels."""
        light, xp = self._adjoint(field), arrays.namespace(field)
        real, imaginary = (self._optics.at_pixels(part) for part in (xp.real(light), xp.imag(light)))
        return arrays.angle(real + 1j * arrays.as_type(imaginary, "complex64"))

    def _adjoint(self, back):
        """Adjoint of the linear part: from the field to the light within the pixels, times the beam's conjugate."""
        optics, (rows, columns) = self._optics, self._shape
        wave = arrays.zeros(self._pixels, "complex64", back)
        wave[:rows, :columns] = arrays.as_type(back, "complex64")
        wave = arrays.fft2(self._roll(wave, -self._margin), overwrite=True)
        wave *= 1 / (math.prod(self._pixels) * GRID**2)
        for axis, count in enumerate(optics.padded):
            wave = resized(wave, count, axis)
        return optics.spectra_adjoint(optics.relayed_adjoint(wave))

    @staticmethod
    def _roll(wave, pixels):
        """Shift a wave down and to the right, periodically."""
        return arrays.namespace(wave).roll(wave, (pixels, pixels), axis=(0, 1)) if pixels else wave
