"""What light is compared with, frame by frame: a complex field on one plane, or amplitudes on some."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..optics import ON_AXIS, Optics
from ..pixels import Pitch
from ..waves.propagation import JUDGING_GUARD, FreeSpace, padded_shape
from ..waves.supervision import blocks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..waves.supervision import Frames


class ComplexTarget:
    """Complex amplitudes on one plane; which one is all the same, as propagation keeps scalar products.

    L = sum over frames and frequencies of |c U - T|^2 / sum |T|^2, with U and T the spectra of the light and of the
    target within the circular aperture that a pixel grid records (paper section 4.3), and c the least-squares factor:
    a phase of each frame's own and a gain that all share, so that neither is penalised.

    Parameters
    ----------
    fields : numpy.ndarray, complex, shape (frame, y, x)
        At the SLM.
    aperture : bool
        Whether light beyond the circle is free, as a stop in the Fourier plane takes it away.
    threads : Frames
    optics : Optics
        Whose stop, within the circle, counts instead of it.
    pitch : float or (float, float)
        Where pixels are not square, meters.

    Attributes
    ----------
    energy : float
        Of what is compared; 0 where there is nothing to be shown.
    """

    def __init__(
        self,
        fields: np.ndarray,
        aperture: bool,
        threads: Frames,
        optics: Optics = ON_AXIS,
        pitch: Pitch = 1.0,
    ) -> None:
        shape = fields.shape[-2:]
        self._band = optics.passes(shape, pitch) if aperture else np.ones(shape, bool)
        self._band = self._band.astype(fields.dtype)
        self._threads = threads
        self._targets = threads.each(lambda frame: scipy.fft.fft2(fields[frame]) * self._band, len(fields))
        self._energies = np.array(threads.each(lambda frame: _square(self._targets[frame]), len(fields)))
        self.energy = float(sum(self._energies))
        self.factors = None

    def gradient(self, light: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Loss, and its gradient with respect to the light.

        c is that of the step before, and is then made the best one for this light.

        Returns
        -------
        loss : float
        back : numpy.ndarray
            In memory that the next call overwrites; times `factors` it is G with dL = 2 Re sum conj(G) du.
        factors : numpy.ndarray, complex
        """
        if self.factors is None:
            self.factors, self._waves = np.ones(len(light), light.dtype), np.empty_like(light)
            self.gradient(light)
        used = self.factors
        sums = self._threads.each(lambda frame: self._compare(light, frame, used[frame]), len(light))
        errors, overlaps = np.array(sums).T
        # of the spectra, from those of the errors: U = (E + T) / c
        energies = (errors.real + 2 * overlaps.real + self._energies) / np.abs(used) ** 2
        overlaps = (overlaps + self._energies) / used
        gain = np.abs(overlaps).sum() / energies.sum()
        self.factors = gain * np.exp(-1j * np.angle(overlaps))
        loss = float(errors.real.sum()) / self.energy
        return loss, self._waves, np.conj(used) * (light[0].size / self.energy)

    def _compare(self, light, frame, factor):
        """c U - T, back on the plane, into `_waves`; its square and its product with T."""
        wave = self._waves[frame]
        wave[:] = light[frame]
        wave = scipy.fft.fft2(wave, overwrite_x=True)
        square = overlap = 0.0
        for rows in blocks(wave.shape):
            error, target = wave[rows], self._targets[frame][rows]
            error *= self._band[rows]
            error *= wave.dtype.type(factor)
            error -= target
            square += np.vdot(error, error).real
            overlap += np.vdot(target, error)
        self._waves[frame] = scipy.fft.ifft2(wave, overwrite_x=True)
        return square, overlap


class AmplitudeTarget:
    """Amplitudes on some planes, phases free: how prior work supervises (Choi et al., ACM TOG 40(6), 240 (2021)).

    L = sum over frames, planes and pixels of (g |u_z| - a_z)^2 / sum a_z^2, with the gain g of the step before.

    Parameters
    ----------
    fields : numpy.ndarray, complex, shape (frame, y, x)
        At the SLM.
    pitch : float or (float, float)
    wavelength : float
        Metres.
    distances : sequence of float
        Of the planes from the SLM, metres.
    threads : Frames
    optics : Optics
        Through whose stop they are seen.
    """

    def __init__(
        self,
        fields: np.ndarray,
        pitch: Pitch,
        wavelength: float,
        distances: Sequence[float],
        threads: Frames,
        optics: Optics = ON_AXIS,
    ) -> None:
        self._shape, self._threads = fields.shape[-2:], threads
        farthest = max(map(abs, distances))
        # its own loss is the PSNR that is told
        self._padded = padded_shape(self._shape, pitch, wavelength, farthest, JUDGING_GUARD)
        space = FreeSpace(self._padded, pitch, wavelength, optics.passes(self._padded, pitch))
        self._transfers = [space(z).astype(fields.dtype) for z in distances]
        rows, columns = self._shape

        def amplitudes(frame):
            spectrum = scipy.fft.fft2(fields[frame], self._padded)
            return [np.abs(scipy.fft.ifft2(spectrum * t)[:rows, :columns]) for t in self._transfers]

        self._amplitudes = threads.each(amplitudes, len(fields))
        self.energy = float(sum((a.astype(float) ** 2).sum() for planes in self._amplitudes for a in planes))
        self.gain = None

    def gradient(self, light: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """As `ComplexTarget.gradient`."""
        if self.gain is None:
            self.gain, self._waves = 1.0, np.empty_like(light)
            self.gradient(light)
        gain, rows, columns = self.gain, *self._shape
        errors, matches, energies = np.zeros((3, len(light)))

        def compare(frame):
            spectrum, back = scipy.fft.fft2(light[frame], self._padded), 0
            for transfer, amplitude in zip(self._transfers, self._amplitudes[frame], strict=True):
                wave = scipy.fft.ifft2(spectrum * transfer, overwrite_x=True)
                seen = wave[:rows, :columns]
                size = np.abs(seen)
                error = gain * size - amplitude
                errors[frame] += float(np.vdot(error, error))
                matches[frame] += float(np.vdot(size, amplitude))
                energies[frame] += float(np.vdot(size, size))
                seen *= gain * error / np.maximum(size, 1e-20)
                wave[rows:], wave[:rows, columns:] = 0, 0
                back = back + np.conj(transfer) * scipy.fft.fft2(wave, overwrite_x=True)
            self._waves[frame] = scipy.fft.ifft2(back, overwrite_x=True)[:rows, :columns]

        self._threads.each(compare, len(light))
        self.gain = matches.sum() / energies.sum()
        return errors.sum() / self.energy, self._waves, np.full(len(light), 1 / self.energy, light.dtype)


def _square(wave):
    return float(np.vdot(wave, wave).real)
