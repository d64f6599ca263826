"""Loss of the mean intensity of all frames against target images, one image in each step."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..waves import arrays
from ..waves.supervision import DARK, blocks

if TYPE_CHECKING:
    from ..waves.arrays import Array
    from ..waves.supervision import FramePool
    from ..waves.target_images import TargetImages

MIN_AMPLITUDE = 1e-3  # divisor in the derivative of the root, fraction of a target's root mean square


class FrameMean:
    """Loss of the light of all frames against target images.

    L = sum over pixels of w (g^2 I - t)^2, where I is the mean of the frames' intensities in an image's plane, t the
    target there, and w = `TargetImages.weight`, so that m independent frames have the loss 1/m for any image. For
    amplitudes L = sum over pixels of v (g sqrt(I) - sqrt(t))^2, with v = w t except in dark pixels.

    Parameters
    ----------
    pictures : TargetImages
    gain : float
        Amplitude g of the incident light.
    pool : FramePool
    amplitudes : bool
        Whether to compare amplitudes instead of intensities.
    """

    def __init__(
        self, pictures: TargetImages, gain: float, pool: FramePool, amplitudes: bool = False
    ) -> None:
        self.pictures, self.gain, self.amplitudes = pictures, gain, amplitudes
        self._pool = pool
        self._waves = None

    def weight(self, number: int) -> Array:
        """Weight of the squared error of each pixel of an image."""
        weight, intensity = self.pictures.weight(number), self.pictures.intensity(number)
        mean = arrays.namespace(intensity).mean(intensity)
        return weight * (intensity + DARK * mean) if self.amplitudes else weight

    def gradient(self, light: Array, number: int) -> tuple[float, Array]:
        """Loss of an image, and its gradient with respect to the light.

        Parameters
        ----------
        light : array, complex, shape (frame, y, x)
        number : int
            Index of the image.

        Returns
        -------
        loss : float
        back : array, complex, shape (frame, y, x)
            G with dL = 2 Re sum conj(G) du, in memory that the next call overwrites.
        """
        pictures, (rows, columns) = self.pictures, self.pictures.shape
        xp, frames = arrays.namespace(light), light.shape[0]
        transfer = arrays.as_type(pictures.transfer(number), light.dtype)
        waves = self._propagate(light, transfer)
        target = pictures.targets[number, ...]
        scale = self.gain**2 / frames
        kind = "float32" if light.dtype == xp.complex64 else "float64"
        error, factor = (arrays.empty(target.shape, kind, light) for _ in range(2))
        parts, dark = blocks(target), MIN_AMPLITUDE * math.sqrt(xp.mean(target))

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

        self._pool.each(compare, len(parts))
        weighted = error * self.weight(number)
        loss = arrays.total(error * weighted)
        slope = arrays.as_type(factor * weighted, light.dtype)  # a product of different types is slower
        adjoint = xp.conj(transfer)

        def back(frame):
            wave = waves[frame, ...]
            wave[:rows, :columns] *= slope
            wave[rows:, :] = 0.0
            wave[:rows, columns:] = 0.0
            waves[frame, ...] = carried(wave, adjoint)

        self._pool.each(back, frames)
        return loss, waves[:, :rows, :columns]

    def image(self, light: Array, number: int) -> Array:
        """Mean intensity of the frames in an image's plane, float32, shape (y, x); parameters as of `gradient`.

        The gain does not count.
        """
        rows, columns = self.pictures.shape
        waves = self._propagate(light, self.pictures.transfer(number))
        image = arrays.empty((rows, columns), "float32", light)
        parts = blocks(image)

        def add(part):
            image[parts[part], :] = arrays.total_intensity(waves[:, parts[part], :columns])

        self._pool.each(add, len(parts))
        return image / light.shape[0]

    def _propagate(self, light, transfer):
        """Waves in an image's plane, on the padded grid."""
        shape, (rows, columns) = (light.shape[0], *self.pictures.padded), self.pictures.shape
        if self._waves is None or self._waves.dtype != light.dtype or self._waves.shape != shape:
            self._waves = arrays.empty(shape, light.dtype, light)

        def propagate(frame):
            wave = self._waves[frame, ...]
            wave[:rows, :columns] = light[frame, ...]
            wave[rows:, :] = 0.0
            wave[:rows, columns:] = 0.0
            self._waves[frame, ...] = carried(wave, transfer)

        self._pool.each(propagate, shape[0])
        return self._waves


def carried(wave: Array, transfer: Array) -> Array:
    """Propagate a wave in its own memory; with the conjugate transfer function this is the adjoint."""
    spectrum = arrays.fft2(wave, overwrite=True)
    spectrum *= transfer
    return arrays.ifft2(spectrum, overwrite=True)
