"""How far the frame mean of the intensity is from what it should be, and the way down: loss, adjoint, Adam."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..scene.variants import threads

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any

    from .arrays import Array

BRIGHTNESS = 10.0  # a picture 10 % too bright counts as much as a speckle contrast of 0.3
DARK = 0.05  # of the mean intensity, added where errors are divided by the intensity


@dataclass(frozen=True)
class TargetPicture:
    """One picture that the fields are judged by.

    Attributes
    ----------
    transfer : numpy.ndarray, complex64, shape (y, x)
        From the fields' spectra to the spectrum in the picture's plane, pupil included; FFT order.
    target : numpy.ndarray, float32, shape (y, x)
        Wanted intensity.
    weight : numpy.ndarray, float32, shape (y, x)
        Of the squared error of each pixel; zero where nothing is known.
    """

    transfer: np.ndarray
    target: np.ndarray
    weight: np.ndarray


class Frames:
    """Threads that work on frames side by side; a context manager."""

    def __enter__(self):
        self.pool = ThreadPoolExecutor(threads())
        return self

    def __exit__(self, *_):
        self.pool.shutdown()

    def each(self, work: Callable[[int], Any], count: int) -> list:
        """``[work(0), ..., work(count - 1)]``."""
        return list(self.pool.map(work, range(count)))


def blocks(wave: Array) -> list[slice]:
    """Slices of rows that stay in a processor's cache from one operation to the next; elsewhere all of them."""
    shape = wave.shape
    height = max(1, (1 << 15) // shape[1]) if isinstance(wave, np.ndarray) else shape[0]
    return [slice(first, min(first + height, shape[0])) for first in range(0, shape[0], height)]


def relative(target: np.ndarray) -> np.ndarray:
    """Weight of a squared error so that independent frames have the loss 1/m in any picture.

    One over the intensity, as in the variance of its root, which is how pictures are looked at.

    Parameters
    ----------
    target : numpy.ndarray, float32

    Returns
    -------
    numpy.ndarray, float32, same shape
        Zeros for a black picture.
    """
    if not target.any():
        return np.zeros_like(target)
    return 1 / ((target + DARK * target.mean()) * target.sum())


def supervise(
    spectra: Sequence[np.ndarray],
    pictures: Sequence[TargetPicture],
    energy: float,
    stages: dict[int, float],
    threads: Frames,
) -> tuple[dict[int, float], np.ndarray]:
    """Loss of the frame mean over pictures, and its gradient with respect to the spectra.

    L = sum over pictures and m of stages[m] (sum over pixels of weight (I / b - target)^2 + BRIGHTNESS (b / c - 1)^2),
    where I is the mean of |ifft(transfer U_n)|^2 over the first m frames, b = sum I / sum target over the pixels that
    have weight, and c the mean of the frames' energies over `energy`. Speckle and brightness are judged apart, since
    the squared error of a picture with speckle is least when it is too dark.

    Parameters
    ----------
    spectra : sequence of numpy.ndarray, complex64, shape (y, x)
        U_n = FFT of each frame's field, cut to the recordable band.
    pictures : sequence of TargetPicture
    energy : float
        Sum over pixels of the intensity of a field whose pictures are the targets.
    stages : dict of int to float
        How much the mean of the first m frames counts, by m.
    threads : Frames

    Returns
    -------
    losses : dict of int to float
        By m, without brightness and the factor in `stages`.
    gradient : numpy.ndarray, complex64, shape (frames, y, x)
        G_n with dL = 2 Re sum conj(G_n) dU_n.
    """
    frames, shape, pixels = len(spectra), spectra[0].shape, spectra[0].size
    energies = threads.each(
        lambda frame: float(np.vdot(spectra[frame], spectra[frame]).real) / pixels, frames
    )
    scales = np.cumsum(energies) / energy  # m c
    losses = dict.fromkeys(stages, 0.0)
    drift = np.zeros(frames)
    waves, gradient = np.empty((2, frames, *shape), np.complex64)
    for number, picture in enumerate(pictures):
        _look(waves, spectra, picture.transfer, threads)
        slopes: list = [None] * frames
        seen = (picture.weight > 0).astype(np.float32)
        wanted = float((picture.target * seen).sum(dtype=np.float64))
        for count, total in _sums(waves, stages, threads).items():
            last, stage = count - 1, stages[count]
            brightness = float((total * seen).sum(dtype=np.float64)) / wanted  # m b
            image = total / np.float32(brightness)
            error = image - picture.target
            weighted = error * picture.weight
            losses[count] += float((error * weighted).sum(dtype=np.float64))
            excess = brightness / scales[last] - 1
            even = BRIGHTNESS * excess / scales[last]
            even -= float((image * weighted).sum(dtype=np.float64)) / brightness
            slopes[last] = np.float32(2 * stage / brightness) * weighted
            slopes[last] += np.float32(2 * stage * even / wanted) * seen
            drift[last] += 2 * stage * BRIGHTNESS * excess * brightness / scales[last] ** 2 / energy
        factors, adjoint = _of_frames(slopes), np.conj(picture.transfer)

        def back(frame, first=number == 0, factors=factors, adjoint=adjoint):
            waves[frame] *= factors[frame]
            part = scipy.fft.fft2(waves[frame], overwrite_x=True)
            if first:
                np.multiply(part, adjoint, out=gradient[frame])
            else:
                part *= adjoint
                gradient[frame] += part

        threads.each(back, frames)
    drift = np.cumsum(drift[::-1])[::-1]

    def scale(frame):
        gradient[frame] -= np.float32(drift[frame]) * spectra[frame]
        gradient[frame] *= np.float32(1 / pixels)

    threads.each(scale, frames)
    return losses, gradient


def _look(waves, spectra, transfer, threads):
    """Each frame's wave in a picture's plane, into `waves`."""

    def look(frame):
        np.multiply(spectra[frame], transfer, out=waves[frame])
        waves[frame] = scipy.fft.ifft2(waves[frame], overwrite_x=True)

    threads.each(look, len(waves))


def _of_frames(slopes):
    """Slopes by frame, of slopes by the last frame of a mean: a frame shows in every mean that includes it."""
    total, factor, factors = None, np.complex64(0), []
    for slope in reversed(slopes):
        if slope is not None:
            total = slope if total is None else total + slope
            factor = total.astype(np.complex64)  # a product of unlike numbers is slower
        factors.append(factor)
    return factors[::-1]


def _sums(waves, stages, threads):
    """Intensities of the first frames, summed, by how many: the numbers in `stages`."""
    sums = {count: np.empty(waves.shape[1:], np.float32) for count in sorted(stages)}
    parts = blocks(waves[0, ...])

    def add(part):
        rows = parts[part]
        total = np.zeros((rows.stop - rows.start, waves.shape[2]), np.float32)
        for count, wave in enumerate(waves[:, rows], 1):
            total += wave.real**2
            total += wave.imag**2
            if count in sums:
                sums[count][rows] = total

    threads.each(add, len(parts))
    return sums


class Adam:
    """Kingma and Ba, ICLR 2015, over a stack of frames, with a rate that rises at once and falls as a cosine.

    Parameters
    ----------
    shape : tuple of int
        Frames first.
    """

    WARM_UP = 50  # steps

    def __init__(self, shape: tuple[int, ...], first: float = 0.9, second: float = 0.99) -> None:
        self.decays = first, second
        self.mean = np.zeros(shape, np.float32)
        self.square = np.zeros(shape, np.float32)
        self.count = 0

    @classmethod
    def rate(cls, step: int, steps: int, highest: float) -> float:
        """Length of step number `step` of `steps`."""
        return highest * min(1, (step + 1) / cls.WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / steps))

    def step(self, values: np.ndarray, gradient: Sequence[np.ndarray], rate: float, threads: Frames) -> None:
        """Move `values`, an array of the shape given, against the gradient, a sequence of frames, in place."""
        self.count += 1
        first, second = self.decays
        length = np.float32(rate / (1 - first**self.count))
        spread = np.float32(1 / (1 - second**self.count))

        def move(frame):
            mean, square, slope = self.mean[frame], self.square[frame], gradient[frame]
            mean += np.float32(1 - first) * (slope - mean)
            square += np.float32(1 - second) * (slope * slope - square)
            values[frame] -= length * mean / (np.sqrt(square * spread) + np.float32(1e-12))

        threads.each(move, len(values))
