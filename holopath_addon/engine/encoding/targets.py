"""Targets for the light of single frames: a complex field on one plane, or amplitudes on several."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..optics import ON_AXIS, Optics
from ..pixels import Pitch
from ..waves import arrays
from ..waves.propagation import EVALUATION_GUARD, FreeSpace, padded_shape
from ..waves.supervision import blocks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..waves.arrays import Array
    from ..waves.supervision import FramePool

MIN_MAGNITUDE = 1e-20  # keeps dark pixels from a division by zero


class ComplexTarget:
    """Loss of the light's complex field on one plane.

    Any plane has the same loss, as propagation preserves scalar products.

    L = sum over frames and frequencies of |c U - T|^2 / sum |T|^2, with U and T the spectra of the light and of the
    target in the band that is compared (see `has_stop`; paper section 4.3). c_n = g exp(i phi_n) has one gain for all
    frames and a phase for each, by least squares, so that neither brightness nor a frame's phase is penalized.

    Parameters
    ----------
    fields : array, complex, shape (frame, y, x)
        Fields on the plane where light is compared: at the SLM, or behind a lens in its image.
    has_stop : bool
        Whether a stop in the Fourier plane blocks the light outside of the circle that a pixel grid records, so that it
        is not compared. Otherwise all frequencies are.
    pool : FramePool
    optics : Optics
        Optics; their stop, if any, takes the circle's place.
    pitch : float or (float, float)
        Pixel pitch, meters; needed only if pixels are not square.

    Attributes
    ----------
    energy : float
        Sum of |T|^2 over frames and frequencies; 0 for a dark target, which has no gradient.
    factors : numpy.ndarray, complex, shape (frame,), or None
        c of the next call of `gradient`; None before the first.
    """

    def __init__(
        self,
        fields: Array,
        has_stop: bool,
        pool: FramePool,
        optics: Optics = ON_AXIS,
        pitch: Pitch = 1.0,
    ) -> None:
        shape = fields.shape[-2:]
        self._band = optics.stop_mask(shape, pitch) if has_stop else np.ones(shape, bool)
        self._band, self._pool = arrays.like(self._band, fields, fields.dtype), pool
        self._spectra = pool.each(lambda frame: arrays.fft2(fields[frame, ...]) * self._band, fields.shape[0])
        self._energies = np.array(pool.each(lambda frame: _square(self._spectra[frame]), fields.shape[0]))
        self.energy = float(sum(self._energies))
        self.factors = None

    def gradient(self, light: Array) -> tuple[float, Array, np.ndarray]:
        """Return the loss, and its gradient with respect to the light.

        c is that of the previous call, and is then set to the best one for this light. The first call sets it twice.

        Parameters
        ----------
        light : array, complex, shape (frame, y, x)

        Returns
        -------
        loss : float
        back : array, complex, shape (frame, y, x)
            Times `weights` it is G with dL = 2 Re sum conj(G) du. The next call overwrites its memory.
        weights : numpy.ndarray, complex, shape (frame,)
        """
        if self.factors is None:
            self.factors = np.ones(light.shape[0], complex)
            self._back = arrays.empty(light.shape, light.dtype, light)
            self.gradient(light)
        factors = self.factors
        sums = self._pool.each(lambda frame: self._compare(light, frame, factors[frame]), light.shape[0])
        errors, error_overlaps = np.array(sums).T
        # |U|^2 and <T, U> from those of E = c U - T, without another pass
        energies = (errors.real + 2 * error_overlaps.real + self._energies) / np.abs(factors) ** 2
        overlaps = (error_overlaps + self._energies) / factors
        gain = np.abs(overlaps).sum() / energies.sum()
        self.factors = gain * np.exp(-1j * np.angle(overlaps))
        loss = float(errors.real.sum()) / self.energy
        pixels = math.prod(light.shape[1:])  # the adjoint of the FFT is its inverse times these
        return loss, self._back, np.conj(factors) * (pixels / self.energy)

    def _compare(self, light, frame, factor):
        """Write the inverse FFT of E = c U - T into `_back`; return |E|^2 and <T, E>."""
        wave = self._back[frame, ...]
        wave[...] = light[frame, ...]
        wave = arrays.fft2(wave, overwrite=True)
        square = overlap = 0.0
        for rows in blocks(wave):
            error, target = wave[rows, :], self._spectra[frame][rows, :]
            error *= self._band[rows, :]
            error *= complex(factor)
            error -= target
            square += _square(error)
            overlap += arrays.product(target, error)
        self._back[frame, ...] = arrays.ifft2(wave, overwrite=True)
        return square, overlap


class AmplitudeTarget:
    """Loss of the light's amplitudes on several planes, whose phases are free (Choi et al., ACM TOG 40(6), 240 (2021)).

    L = sum over frames, planes and pixels of (g |u_z| - a_z)^2 / sum a_z^2, with the gain g of the previous call.

    Parameters
    ----------
    fields : array, complex, shape (frame, y, x)
        Fields on the plane where light is compared, see `ComplexTarget`.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    distances : sequence of float
        Signed distances of the planes from there, meters.
    pool : FramePool
    optics : Optics
        Optics; light and target pass their stop.

    Attributes
    ----------
    energy : float
        Sum of a_z^2 over frames, planes and pixels; 0 for a dark target, which has no gradient.
    gain : float or None
        g of the next call of `gradient`; None before the first.
    """

    def __init__(
        self,
        fields: Array,
        pitch: Pitch,
        wavelength: float,
        distances: Sequence[float],
        pool: FramePool,
        optics: Optics = ON_AXIS,
    ) -> None:
        self._shape, self._pool = fields.shape[-2:], pool
        farthest = max(map(abs, distances))
        # its loss is reported as a PSNR: the guard band is that of images
        self._padded = padded_shape(self._shape, pitch, wavelength, farthest, EVALUATION_GUARD)
        space = FreeSpace(self._padded, pitch, wavelength, optics.stop_mask(self._padded, pitch), on=fields)
        self._transfers = [arrays.as_type(space(z), fields.dtype) for z in distances]
        rows, columns = self._shape
        xp = arrays.namespace(fields)

        def amplitudes(frame):
            spectrum = arrays.fft2(fields[frame, ...], self._padded)
            return [
                xp.abs(arrays.ifft2(spectrum * transfer)[:rows, :columns]) for transfer in self._transfers
            ]

        self._amplitudes = pool.each(amplitudes, fields.shape[0])
        squares = (arrays.as_type(a, "float64") ** 2 for planes in self._amplitudes for a in planes)
        self.energy = sum(map(arrays.total, squares))
        self.gain = None

    def gradient(self, light: Array) -> tuple[float, Array, np.ndarray]:
        """Return the loss, and its gradient with respect to the light, as `ComplexTarget.gradient` does.

        g is within `back`, and all weights are 1 / `energy`.
        """
        if self.gain is None:
            self.gain, self._back = 1.0, arrays.empty(light.shape, light.dtype, light)
            self.gradient(light)
        (gain, rows, columns), xp = (self.gain, *self._shape), arrays.namespace(light)
        errors, matches, energies = np.zeros((3, light.shape[0]))

        def compare(frame):
            spectrum, back = arrays.fft2(light[frame, ...], self._padded), 0
            for transfer, amplitude in zip(self._transfers, self._amplitudes[frame], strict=True):
                wave = arrays.ifft2(spectrum * transfer, overwrite=True)
                image = wave[:rows, :columns]
                magnitude = xp.abs(image)
                error = gain * magnitude - amplitude
                errors[frame] += _square(error)
                matches[frame] += arrays.product(magnitude, amplitude).real
                energies[frame] += _square(magnitude)
                image *= gain * error / xp.maximum(magnitude, MIN_MAGNITUDE)
                wave[rows:, :] = 0.0
                wave[:rows, columns:] = 0.0
                back = back + xp.conj(transfer) * arrays.fft2(wave, overwrite=True)
            self._back[frame, ...] = arrays.ifft2(back, overwrite=True)[:rows, :columns]

        self._pool.each(compare, light.shape[0])
        self.gain = float(matches.sum() / energies.sum())
        return errors.sum() / self.energy, self._back, np.full(light.shape[0], 1 / self.energy, complex)


def _square(wave):
    return arrays.product(wave, wave).real
