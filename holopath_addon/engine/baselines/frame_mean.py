"""The mean intensity of all frames against pictures, one picture a step."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..waves import arrays
from ..waves.supervision import DARK, blocks

if TYPE_CHECKING:
    from ..waves.arrays import Array
    from ..waves.supervision import Frames
    from ..waves.target_images import TargetImages

DARKEST = 1e-3  # of a target's root mean square: amplitudes that the slope of the root is divided by


class FrameMean:
    """Light of all frames, compared with pictures.

    L = sum over pixels of w (g^2 I - t)^2, where I is the mean of the frames' intensities in a picture's plane, t what
    is wanted there, and w = `TargetImages.weight`, so that independent frames have the loss 1/m in any picture. Or of
    their amplitudes, L = sum over pixels of v (g sqrt(I) - sqrt(t))^2, with v = w t but for what is dark.

    Parameters
    ----------
    pictures : TargetImages
    gain : float
        Amplitude of the light sent in.
    threads : Frames
    amplitudes : bool
        Whether these are compared rather than intensities.
    """

    def __init__(
        self, pictures: TargetImages, gain: float, threads: Frames, amplitudes: bool = False
    ) -> None:
        self.pictures, self.gain, self.amplitudes = pictures, gain, amplitudes
        self._threads = threads
        self._waves = None

    def weight(self, number: int) -> Array:
        """Of the squared error of each pixel of a picture."""
        weight, target = self.pictures.weight(number), self.pictures.targets[number, ...]
        mean = arrays.namespace(target).mean(target)
        return weight * (target + DARK * mean) if self.amplitudes else weight

    def gradient(self, light: Array, number: int) -> tuple[float, Array]:
        """Loss of a picture, and its gradient with respect to the light.

        Returns
        -------
        loss : float
        back : array
            In memory that the next call overwrites: G with dL = 2 Re sum conj(G) du.
        """
        pictures, (rows, columns) = self.pictures, self.pictures.shape
        xp, frames = arrays.namespace(light), light.shape[0]
        transfer = arrays.as_type(pictures.transfer(number), light.dtype)
        waves = self._seen(light, transfer)
        target = pictures.targets[number, ...]
        scale = self.gain**2 / frames
        kind = "float32" if light.dtype == xp.complex64 else "float64"
        error, factor = (arrays.empty(target.shape, kind, light) for _ in range(2))
        parts, dark = blocks(target), DARKEST * math.sqrt(xp.mean(target))

        def compare(part):
            block = parts[part]
            image = scale * arrays.total_intensity(waves[:, block, :columns])
            if self.amplitudes:
                root = xp.sqrt(image)
                error[block, :] = root - xp.sqrt(target[block, :])
                factor[block, :] = scale / xp.maximum(root, dark or 1.0)
            else:
                error[block, :] = image - target[block, :]
                factor[block, :] = 2 * scale

        self._threads.each(compare, len(parts))
        weighted = error * self.weight(number)
        loss = arrays.total(error * weighted)
        slope = arrays.as_type(factor * weighted, light.dtype)  # a product of unlike numbers is slower
        adjoint = xp.conj(transfer)

        def back(frame):
            wave = waves[frame, ...]
            wave[:rows, :columns] *= slope
            wave[rows:, :] = 0.0
            wave[:rows, columns:] = 0.0
            waves[frame, ...] = carried(wave, adjoint)

        self._threads.each(back, frames)
        return loss, waves[:, :rows, :columns]

    def look(self, light: Array, number: int) -> Array:
        """The picture as it is, without the gain."""
        rows, columns = self.pictures.shape
        waves = self._seen(light, self.pictures.transfer(number))
        image = arrays.empty((rows, columns), "float32", light)
        parts = blocks(image)

        def add(part):
            image[parts[part], :] = arrays.total_intensity(waves[:, parts[part], :columns])

        self._threads.each(add, len(parts))
        return image / light.shape[0]

    def _seen(self, light, transfer):
        """Waves in a picture's plane, on the padded grid."""
        shape, (rows, columns) = (light.shape[0], *self.pictures.padded), self.pictures.shape
        if self._waves is None or self._waves.dtype != light.dtype or self._waves.shape != shape:
            self._waves = arrays.empty(shape, light.dtype, light)

        def see(frame):
            wave = self._waves[frame, ...]
            wave[:rows, :columns] = light[frame, ...]
            wave[rows:, :] = 0.0
            wave[:rows, columns:] = 0.0
            self._waves[frame, ...] = carried(wave, transfer)

        self._threads.each(see, shape[0])
        return self._waves


def carried(wave: Array, transfer: Array) -> Array:
    """A wave on another plane, in the memory of the first; with the conjugate transfer function, the adjoint."""
    spectrum = arrays.fft2(wave, overwrite=True)
    spectrum *= transfer
    return arrays.ifft2(spectrum, overwrite=True)
