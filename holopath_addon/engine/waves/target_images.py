"""Target images of fields: at depths of the volume, through the whole pupil and parts of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..pixels import Pitch, coarsest, frequencies
from . import arrays
from .arrays import PROCESSOR, Array
from .propagation import FreeSpace, padded_shape
from .supervision import FramePool, TargetImage, relative

PARTS = 2  # parts of the pupil at each depth, besides the whole
PART = 0.5  # radius of a part in terms of the pupil's
MAX_DEPTHS = 20
MAX_TRANSFER_BYTES = 1 << 30  # of cached transfer functions


@dataclass(frozen=True)
class Viewpoint:
    """Focus of an image, and the part of the pupil through which it is seen.

    Attributes
    ----------
    distance : float
        Distance of the focal plane from the fields' plane, meters.
    part : tuple of float or None
        Center x and y and radius of the part in cycles per pixel of the larger pitch, y down; the whole pupil has a
        radius of 0.5. None: the whole pupil.
    """

    distance: float
    part: tuple | None = None

    def part_mask(self, shape: tuple[int, int], pitch: Pitch = 1.0) -> np.ndarray | None:
        """FFT bins that pass the part of the pupil; None for the whole pupil."""
        if self.part is None:
            return None
        fy, fx = frequencies(shape, pitch)
        x, y, radius = self.part
        return np.hypot(fx[None, :] - x, fy[:, None] - y) <= radius


def spread_viewpoints(pitch: Pitch, wavelength: float, low: float, high: float, seed: int) -> list[Viewpoint]:
    """Viewpoints all over a volume: depths a depth of focus apart, each with the whole pupil and random halves of it.

    Parameters
    ----------
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    low, high : float
        Distances of the volume's ends from the fields' plane, meters.
    seed : int
        Seed of the halves.

    Returns
    -------
    list of Viewpoint
    """
    slope = math.tan(math.asin(wavelength / (2 * coarsest(pitch))))
    rng = np.random.default_rng(seed)
    viewpoints = []
    depths = min(MAX_DEPTHS, 2 + math.ceil((high - low) * slope**2 / wavelength))
    for distance in np.linspace(low, high, depths):
        viewpoints.append(Viewpoint(float(distance)))
        for _ in range(PARTS):
            aside = 0.5 * (1 - PART) * math.sqrt(rng.random())
            angle = 2 * math.pi * rng.random()
            viewpoints.append(
                Viewpoint(float(distance), (aside * math.cos(angle), aside * math.sin(angle), 0.5 * PART))
            )
    return viewpoints


class TransferCache:
    """Transfer functions from the spectra of fields to those at viewpoints, cached up to `MAX_TRANSFER_BYTES`.

    Parameters
    ----------
    space : FreeSpace
    """

    def __init__(self, space: FreeSpace) -> None:
        self._space, self._transfers = space, {}

    def __call__(self, viewpoint: Viewpoint) -> Array:
        """Return the transfer function of a viewpoint, complex64, in FFT order; do not change it."""
        transfer, space = self._transfers.get(viewpoint), self._space
        if transfer is None:
            transfer, mask = space(viewpoint.distance), viewpoint.part_mask(space.shape, space.pitch)
            if mask is not None:
                transfer *= arrays.mask(mask, transfer)
            if (len(self._transfers) + 1) * 8 * math.prod(space.shape) <= MAX_TRANSFER_BYTES:
                self._transfers[viewpoint] = transfer
        return transfer


class TargetImages:
    """Target images at several viewpoints, in one wavelength.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the fields.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    viewpoints : list of Viewpoint
    guard : int
        Pixels of guard band around the fields, `OPTIMIZATION_GUARD` for phases that are optimized to show the images.
    on : array, optional
        Array whose library and device compute. Default: NumPy.

    Attributes
    ----------
    targets : array, float32, shape (viewpoint, y, x)
        Frame-mean intensities.
    energy : float
        Sum over pixels of the intensity of a frame that shows these images.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        pitch: Pitch,
        wavelength: float,
        viewpoints: list[Viewpoint],
        guard: int = 0,
        on: Array = PROCESSOR,
    ) -> None:
        self.shape, self.viewpoints = shape, list(viewpoints)
        farthest = max(abs(viewpoint.distance) for viewpoint in viewpoints)
        self.padded = padded_shape(shape, pitch, wavelength, farthest, guard)
        self.space = FreeSpace(self.padded, pitch, wavelength, on=on)
        self.targets = arrays.zeros((len(self.viewpoints), *shape), "float32", on)
        self.energy, self._frames = 0.0, 0
        self._transfers = TransferCache(self.space)

    def __len__(self) -> int:
        return len(self.viewpoints)

    def transfer(self, number: int) -> Array:
        """Return the transfer function from the fields' spectra to that of an image; see `TransferCache`."""
        return self._transfers(self.viewpoints[number])

    def spectra(self, fields: Array, pool: FramePool) -> list[Array]:
        """Return the spectra of fields of shape (frames, y, x), cut to the band."""
        band = arrays.mask(self.space.band, fields)
        return pool.each(lambda n: arrays.fft2(fields[n, ...], self.padded) * band, fields.shape[0])

    def add(self, fields: Array) -> None:
        """Add frames to the mean of the target images; fields of shape (frames, y, x)."""
        rows, columns = self.shape
        before, self._frames = self._frames, self._frames + fields.shape[0]
        with FramePool() as pool:
            spectra = self.spectra(fields, pool)

            def add_to_image(number):
                transfer, total = self.transfer(number), float(before) * self.targets[number, ...]
                for spectrum in spectra:
                    wave = arrays.ifft2(spectrum * transfer, overwrite=True)[:rows, :columns]
                    total += arrays.intensity(wave)
                self.targets[number, ...] = total / float(self._frames)

            pool.each(add_to_image, len(self))
        energy = sum(arrays.product(s, s).real for s in spectra) / self.space.band.size
        self.energy = (self.energy * before + energy) / self._frames

    def intensity(self, number: int) -> Array:
        """Return the intensity to which the weights of an image's pixels are relative."""
        return self.targets[number, ...]

    def weight(self, number: int) -> Array:
        """Return the weight of the squared error of each pixel of an image."""
        return relative(self.intensity(number))

    def target(self, number: int) -> TargetImage:
        """Return an image for `supervise`; pixels outside the fields have no weight."""
        rows, columns = self.shape
        target, weight = (arrays.zeros(self.padded, "float32", self.targets) for _ in range(2))
        target[:rows, :columns] = self.targets[number, ...]
        weight[:rows, :columns] = self.weight(number)
        return TargetImage(self.transfer(number), target, weight)
