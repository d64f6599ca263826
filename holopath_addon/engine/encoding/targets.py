"""Targets for the light of single frames: a complex field on one plane, or amplitudes on several."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..optics import ON_AXIS, Optics
from ..pixels import Pitch
from ..waves import arrays
from ..waves.propagation import JUDGING_GUARD, FreeSpace, padded_shape
from ..waves.supervision import blocks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..waves.arrays import Array
    from ..waves.supervision import Frames


class ComplexTarget:
    """Complex amplitudes on one plane; any plane is equivalent, as propagation preserves scalar products.

    L = sum over frames and frequencies of |c U - T|^2 / sum |T|^2, with U and T the spectra of the light and of the
    target within the circular aperture that a pixel grid records (paper section 4.3), and c the least-squares factor:
    a phase for each frame and a gain for all, so that neither is penalized.

    Parameters
    ----------
    fields : array, complex, shape (frame, y, x)
        Fields at the SLM.
    aperture : bool
        Whether light beyond the circle is free, as a stop in the Fourier plane blocks it.
    threads : Frames
    optics : Optics
        Optics whose stop replaces the circle.
    pitch : float or (float, float)
        Pixel pitch, meters; needed only if pixels are not square.

    Attributes
    ----------
    energy : float
        Energy of the target; 0 for a dark one.
    """

    def __init__(
        self,
        fields: Array,
        aperture: bool,
        threads: Frames,
        optics: Optics = ON_AXIS,
        pitch: Pitch = 1.0,
    ) -> None:
        shape = fields.shape[-2:]
        self._band = optics.passes(shape, pitch) if aperture else np.ones(shape, bool)
        self._band, self._threads = arrays.like(self._band, fields, fields.dtype), threads
        self._targets = threads.each(
            lambda frame: arrays.fft2(fields[frame, ...]) * self._band, fields.shape[0]
        )
        self._energies = np.array(threads.each(lambda frame: _square(self._targets[frame]), fields.shape[0]))
        self.energy = float(sum(self._energies))
        self.factors = None

    def gradient(self, light: Array) -> tuple[float, Array, np.ndarray]:
        """Return the loss, and its gradient with respect to the light.

        c is that of the previous step, and is then set to the best one for this light.

        Parameters
        ----------
        light : array, complex, shape (frame, y, x)

        Returns
        -------
        loss : float
        back : array
            Times `factors` it is G with dL = 2 Re sum conj(G) du. The next call overwrites its memory.
        factors : numpy.ndarray, complex
        """
        if self.factors is None:
            self.factors = np.ones(light.shape[0], complex)
            self._waves = arrays.empty(light.shape, light.dtype, light)
            self.gradient(light)
        factors = self.factors
        sums = self._threads.each(lambda frame: self._compare(light, frame, factors[frame]), light.shape[0])
        errors, overlaps = np.array(sums).T
        # of the spectra, from those of the errors E: U = (E + T) / c
        energies = (errors.real + 2 * overlaps.real + self._energies) / np.abs(factors) ** 2
        overlaps = (overlaps + self._energies) / factors
        gain = np.abs(overlaps).sum() / energies.sum()
        self.factors = gain * np.exp(-1j * np.angle(overlaps))
        loss = float(errors.real.sum()) / self.energy
        return loss, self._waves, np.conj(factors) * (math.prod(light.shape[1:]) / self.energy)

    def _compare(self, light, frame, factor):
        """Propagate c U - T back to the plane, into `_waves`; return its square and its product with T."""
        wave = self._waves[frame, ...]
        wave[...] = light[frame, ...]
        wave = arrays.fft2(wave, overwrite=True)
        square = overlap = 0.0
        for rows in blocks(wave):
            error, target = wave[rows, :], self._targets[frame][rows, :]
            error *= self._band[rows, :]
            error *= complex(factor)
            error -= target
            square += _square(error)
            overlap += arrays.product(target, error)
        self._waves[frame, ...] = arrays.ifft2(wave, overwrite=True)
        return square, overlap


class AmplitudeTarget:
    """Amplitudes on several planes, with free phases, as in prior work (Choi et al., ACM TOG 40(6), 240 (2021)).

    L = sum over frames, planes and pixels of (g |u_z| - a_z)^2 / sum a_z^2, with the gain g of the previous step.

    Parameters
    ----------
    fields : array, complex, shape (frame, y, x)
        Fields at the SLM.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    distances : sequence of float
        Distances of the planes from the SLM, meters.
    threads : Frames
    optics : Optics
        Optics whose stop the light passes.
    """

    def __init__(
        self,
        fields: Array,
        pitch: Pitch,
        wavelength: float,
        distances: Sequence[float],
        threads: Frames,
        optics: Optics = ON_AXIS,
    ) -> None:
        self._shape, self._threads = fields.shape[-2:], threads
        farthest = max(map(abs, distances))
        # its loss is the reported PSNR
        self._padded = padded_shape(self._shape, pitch, wavelength, farthest, JUDGING_GUARD)
        space = FreeSpace(self._padded, pitch, wavelength, optics.passes(self._padded, pitch), on=fields)
        self._transfers = [arrays.as_type(space(z), fields.dtype) for z in distances]
        rows, columns = self._shape
        xp = arrays.namespace(fields)

        def amplitudes(frame):
            spectrum = arrays.fft2(fields[frame, ...], self._padded)
            return [xp.abs(arrays.ifft2(spectrum * t)[:rows, :columns]) for t in self._transfers]

        self._amplitudes = threads.each(amplitudes, fields.shape[0])
        squares = (arrays.as_type(a, "float64") ** 2 for planes in self._amplitudes for a in planes)
        self.energy = sum(map(arrays.total, squares))
        self.gain = None

    def gradient(self, light: Array) -> tuple[float, Array, np.ndarray]:
        """Return the loss, and its gradient with respect to the light; see `ComplexTarget.gradient`."""
        if self.gain is None:
            self.gain, self._waves = 1.0, arrays.empty(light.shape, light.dtype, light)
            self.gradient(light)
        (gain, rows, columns), xp = (self.gain, *self._shape), arrays.namespace(light)
        errors, matches, energies = np.zeros((3, light.shape[0]))

        def compare(frame):
            spectrum, back = arrays.fft2(light[frame, ...], self._padded), 0
            for transfer, amplitude in zip(self._transfers, self._amplitudes[frame], strict=True):
                wave = arrays.ifft2(spectrum * transfer, overwrite=True)
                image = wave[:rows, :columns]
                size = xp.abs(image)
                error = gain * size - amplitude
                errors[frame] += _square(error)
                matches[frame] += arrays.product(size, amplitude).real
                energies[frame] += _square(size)
                image *= gain * error / xp.maximum(size, 1e-20)
                wave[rows:, :] = 0.0
                wave[:rows, columns:] = 0.0
                back = back + xp.conj(transfer) * arrays.fft2(wave, overwrite=True)
            self._waves[frame, ...] = arrays.ifft2(back, overwrite=True)[:rows, :columns]

        self._threads.each(compare, light.shape[0])
        self.gain = float(matches.sum() / energies.sum())
        return errors.sum() / self.energy, self._waves, np.full(light.shape[0], 1 / self.energy, complex)


def _square(wave):
    return arrays.product(wave, wave).real
