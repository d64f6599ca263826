"""Pictures that fields are judged by: at depths of the volume, through the whole pupil and parts of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..pixels import Pitch, coarsest, frequencies
from . import arrays
from .arrays import PROCESSOR, Array
from .propagation import FreeSpace, padded_shape
from .supervision import Frames, TargetPicture, relative

PARTS = 2  # of the pupil looked through at each depth, besides the whole
PART = 0.5  # radius of a part, of the pupil's
MOST_DEPTHS = 20
MOST_BYTES = 1 << 30  # of transfer functions that are kept


@dataclass(frozen=True)
class Vantage:
    """Where a picture is focused, and through which part of the pupil.

    Attributes
    ----------
    distance : float
        From the fields' plane, metres.
    part : tuple of float or None
        Centre x and y and radius in cycles a pixel, of the larger pitch, y downwards; the whole pupil's radius is 0.5.
        None: all of it.
    """

    distance: float
    part: tuple | None = None

    def passes(self, shape: tuple[int, int], pitch: Pitch = 1.0) -> np.ndarray | None:
        """FFT bins that the part lets through; None for the whole."""
        if self.part is None:
            return None
        fy, fx = frequencies(shape, pitch)
        x, y, radius = self.part
        return np.hypot(fx[None, :] - x, fy[:, None] - y) <= radius


def spread_vantages(pitch: Pitch, wavelength: float, low: float, high: float, seed: int) -> list[Vantage]:
    """Vantages all over a volume: depths a depth of focus apart, at each the whole pupil and random halves of it.

    Parameters
    ----------
    pitch : float or (float, float)
    wavelength : float
        Metres.
    low, high : float
        Ends of the volume, from the fields' plane, metres.
    seed : int

    Returns
    -------
    list of Vantage
    """
    slope = math.tan(math.asin(wavelength / (2 * coarsest(pitch))))
    rng = np.random.default_rng(seed)
    vantages = []
    depths = min(MOST_DEPTHS, 2 + math.ceil((high - low) * slope**2 / wavelength))
    for distance in np.linspace(low, high, depths):
        vantages.append(Vantage(float(distance)))
        for _ in range(PARTS):
            aside = 0.5 * (1 - PART) * math.sqrt(rng.random())
            angle = 2 * math.pi * rng.random()
            vantages.append(
                Vantage(float(distance), (aside * math.cos(angle), aside * math.sin(angle), 0.5 * PART))
            )
    return vantages


class Pictures:
    """What is wanted at several vantages, in one wavelength.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the fields.
    pitch : float or (float, float)
    wavelength : float
        Metres.
    vantages : list of Vantage
    guard : int
        Pixels more around the fields, `TEACHING_GUARD` for phases that are to show the pictures.
    on : array, optional
        In whose namespace they are computed, where that one lies. Default: NumPy's.

    Attributes
    ----------
    wanted : array, float32, shape (vantage, y, x)
        Frame-mean intensities.
    energy : float
        Sum over pixels of the intensity of a frame whose pictures these are.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        pitch: Pitch,
        wavelength: float,
        vantages: list[Vantage],
        guard: int = 0,
        on: Array = PROCESSOR,
    ) -> None:
        self.shape, self.vantages = shape, list(vantages)
        farthest = max(abs(vantage.distance) for vantage in vantages)
        self.padded = padded_shape(shape, pitch, wavelength, farthest, guard)
        self.space = FreeSpace(self.padded, pitch, wavelength, on=on)
        self.wanted = arrays.zeros((len(self.vantages), *shape), "float32", on)
        self.energy, self._frames = 0.0, 0
        self._transfers = {}

    def __len__(self) -> int:
        return len(self.vantages)

    def transfer(self, number: int) -> Array:
        """From the fields' spectra to the spectrum of a picture, complex64; not to be changed."""
        kept = self._transfers.get(number)
        if kept is not None:
            return kept
        vantage = self.vantages[number]
        transfer, passes = self.space(vantage.distance), vantage.passes(self.padded, self.space.pitch)
        if passes is not None:
            transfer *= arrays.mask(passes, transfer)
        if (len(self._transfers) + 1) * 8 * math.prod(self.padded) <= MOST_BYTES:
            self._transfers[number] = transfer
        return transfer

    def spectra(self, fields: Array, threads: Frames) -> list[Array]:
        """Spectra of fields of shape (frames, y, x), cut to the band."""
        band = arrays.mask(self.space.band, fields)
        return threads.each(lambda n: arrays.fft2(fields[n, ...], self.padded) * band, fields.shape[0])

    def add(self, fields: Array) -> None:
        """Count frames towards the wanted pictures; fields of shape (frames, y, x)."""
        rows, columns = self.shape
        before, self._frames = self._frames, self._frames + fields.shape[0]
        with Frames() as threads:
            spectra = self.spectra(fields, threads)

            def picture(number):
                transfer, total = self.transfer(number), float(before) * self.wanted[number, ...]
                for spectrum in spectra:
                    wave = arrays.ifft2(spectrum * transfer, overwrite=True)[:rows, :columns]
                    total += arrays.intensity(wave)
                self.wanted[number, ...] = total / float(self._frames)

            threads.each(picture, len(self))
        energy = sum(arrays.product(s, s).real for s in spectra) / self.space.band.size
        self.energy = (self.energy * before + energy) / self._frames

    def weight(self, number: int) -> Array:
        """Of the squared error of each pixel of a picture."""
        return relative(self.wanted[number, ...])

    def target(self, number: int) -> TargetPicture:
        """A picture as `supervise` takes it; what lies outside the fields does not count."""
        rows, columns = self.shape
        target, weight = (arrays.zeros(self.padded, "float32", self.wanted) for _ in range(2))
        target[:rows, :columns] = self.wanted[number, ...]
        weight[:rows, :columns] = self.weight(number)
        return TargetPicture(self.transfer(number), target, weight)
