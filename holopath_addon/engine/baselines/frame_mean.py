"""The mean intensity of all frames against pictures, one picture a step."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..waves.supervision import DARK, blocks

if TYPE_CHECKING:
    from ..waves.pictures import Pictures
    from ..waves.supervision import Frames

DARKEST = 1e-3  # of a target's root mean square: amplitudes that the slope of the root is divided by


class FrameMean:
    """Light of all frames, compared with pictures.

    L = sum over pixels of w (g^2 I - t)^2, where I is the mean of the frames' intensities in a picture's plane, t what
    is wanted there, and w = `Pictures.weight`, so that independent frames have the loss 1/m in any picture. Or of
    their amplitudes, L = sum over pixels of v (g sqrt(I) - sqrt(t))^2, with v = w t but for what is dark.

    Parameters
    ----------
    pictures : Pictures
    gain : float
        Amplitude of the light sent in.
    threads : Frames
    amplitudes : bool
        Whether these are compared rather than intensities.
    """

    def __init__(self, pictures: Pictures, gain: float, threads: Frames, amplitudes: bool = False) -> None:
        self.pictures, self.gain, self.amplitudes = pictures, gain, amplitudes
        self._threads = threads
        self._waves = None

    def weight(self, number: int) -> np.ndarray:
        """Of the squared error of each pixel of a picture."""
        weight, target = self.pictures.weight(number), self.pictures.wanted[number]
        return weight * (target + DARK * target.mean()) if self.amplitudes else weight

    def gradient(self, light: np.ndarray, number: int) -> tuple[float, np.ndarray]:
        """Loss of a picture, and its gradient with respect to the light.

        Returns
        -------
        loss : float
        back : numpy.ndarray
            In memory that the next call overwrites: G with dL = 2 Re sum conj(G) du.
        """
        pictures, (rows, columns) = self.pictures, self.pictures.shape
        transfer = pictures.transfer(number).astype(light.dtype, copy=False)
        waves = self._seen(light, transfer)
        target = pictures.wanted[number]
        scale = self.gain**2 / len(light)
        error, factor = np.empty((2, *target.shape), light.real.dtype)
        parts, dark = blocks(target), DARKEST * math.sqrt(target.mean())

        def compare(part):
            block = parts[part]
            image = scale * _intensity(waves[:, block, :columns])
            if self.amplitudes:
                root = np.sqrt(image)
                error[block] = root - np.sqrt(target[block])
                factor[block] = scale / np.maximum(root, dark or 1)
            else:
                error[block] = image - target[block]
                factor[block] = 2 * scale

        self._threads.each(compare, len(parts))
        weighted = error * self.weight(number)
        loss = float((error * weighted).sum(dtype=np.float64))
        slope = (factor * weighted).astype(light.dtype)  # a product of unlike numbers is slower
        adjoint = np.conj(transfer)

        def back(frame):
            wave = waves[frame]
            wave[:rows, :columns] *= slope
            wave[rows:], wave[:rows, columns:] = 0, 0
            waves[frame] = carried(wave, adjoint)

        self._threads.each(back, len(light))
        return loss, waves[:, :rows, :columns]

    def look(self, light: np.ndarray, number: int) -> np.ndarray:
        """The picture as it is, without the gain."""
        rows, columns = self.pictures.shape
        waves = self._seen(light, self.pictures.transfer(number))
        image = np.empty((rows, columns), np.float32)
        parts = blocks(image)

        def add(part):
            image[parts[part]] = _intensity(waves[:, parts[part], :columns])

        self._threads.each(add, len(parts))
        return image / np.float32(len(light))

    def _seen(self, light, transfer):
        """Waves in a picture's plane, on the padded grid."""
        padded = self.pictures.padded
        if self._waves is None or self._waves.dtype != light.dtype or len(self._waves) != len(light):
            self._waves = np.empty((len(light), *padded), light.dtype)
        rows, columns = self.pictures.shape

        def see(frame):
            wave = self._waves[frame]
            wave[:rows, :columns] = light[frame]
            wave[rows:], wave[:rows, columns:] = 0, 0
            self._waves[frame] = carried(wave, transfer)

        self._threads.each(see, len(light))
        return self._waves


def carried(wave: np.ndarray, transfer: np.ndarray) -> np.ndarray:
    """A wave on another plane, in the memory of the first; with the conjugate transfer function, the adjoint."""
    spectrum = scipy.fft.fft2(wave, overwrite_x=True)
    spectrum *= transfer
    return scipy.fft.ifft2(spectrum, overwrite_x=True)


def _intensity(waves):
    """Sum of the squared magnitudes over frames, shape (frame, y, x)."""
    total = np.zeros((waves.shape[1], 2 * waves.shape[2]), waves.real.dtype)
    square = np.empty_like(total)
    for wave in waves.view(total.dtype):  # real and imaginary parts side by side
        np.multiply(wave, wave, out=square)
        total += square
    return total[:, ::2] + total[:, 1::2]
