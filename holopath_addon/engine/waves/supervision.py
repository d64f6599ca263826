"""How far the frame mean of the intensity is from what it should be, and the way down: loss, adjoint, Adam."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..scene.variants import threads
from . import arrays
from .arrays import PROCESSOR, Array

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any

BRIGHTNESS = 10.0  # a picture 10 % too bright counts as much as a speckle contrast of 0.3
DARK = 0.05  # of the mean intensity, added where errors are divided by the intensity


@dataclass(frozen=True)
class TargetImage:
    """One picture that the fields are judged by.

    Attributes
    ----------
    transfer : array, complex64, shape (y, x)
        From the fields' spectra to the spectrum in the picture's plane, pupil included; FFT order.
    target : array, float32, shape (y, x)
        Wanted intensity.
    weight : array, float32, shape (y, x)
        Of the squared error of each pixel; zero where nothing is known.
    """

    transfer: Array
    target: Array
    weight: Array


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


def relative(target: Array) -> Array:
    """Weight of a squared error so that independent frames have the loss 1/m in any picture.

    One over the intensity, as in the variance of its root, which is how pictures are looked at.

    Parameters
    ----------
    target : array, float32

    Returns
    -------
    array, float32, same shape
        Zeros for a black picture.
    """
    xp = arrays.namespace(target)
    if not xp.any(target != 0):
        return xp.zeros_like(target)
    return 1 / ((target + DARK * xp.mean(target)) * xp.sum(target))


def supervise(
    spectra: Sequence[Array],
    pictures: Sequence[TargetImage],
    energy: float,
    stages: dict[int, float],
    threads: Frames,
) -> tuple[dict[int, float], Array]:
    """Loss of the frame mean over pictures, and its gradient with respect to the spectra.

    L = sum over pictures and m of stages[m] (sum over pixels of weight (I / b - target)^2 + BRIGHTNESS (b / c - 1)^2),
    where I is the mean of |ifft(transfer U_n)|^2 over the first m frames, b = sum I / sum target over the pixels that
    have weight, and c the mean of the frames' energies over `energy`. Speckle and brightness are judged apart, since
    the squared error of a picture with speckle is least when it is too dark.

    Parameters
    ----------
    spectra : sequence of array, complex64, shape (y, x)
        U_n = FFT of each frame's field, cut to the recordable band.
    pictures : sequence of TargetImage
    energy : float
        Sum over pixels of the intensity of a field whose pictures are the targets.
    stages : dict of int to float
        How much the mean of the first m frames counts, by m.
    threads : Frames

    Returns
    -------
    losses : dict of int to float
        By m, without brightness and the factor in `stages`.
    gradient : array, complex64, shape (frames, y, x)
        G_n with dL = 2 Re sum conj(G_n) dU_n.
    """
    frames, shape, xp = len(spectra), spectra[0].shape, arrays.namespace(spectra[0])
    pixels = math.prod(shape)
    energies = threads.each(
        lambda frame: arrays.product(spectra[frame], spectra[frame]).real / pixels, frames
    )
    scales = np.cumsum(energies) / energy  # m c
    losses = dict.fromkeys(stages, 0.0)
    drift = np.zeros(frames)
    waves, gradient = (arrays.empty((frames, *shape), "complex64", spectra[0]) for _ in range(2))
    for number, picture in enumerate(pictures):
        _look(waves, spectra, picture.transfer, threads)
        slopes: list = [None] * frames
        seen = arrays.as_type(picture.weight > 0, "float32")
        wanted = arrays.total(picture.target * seen)
        for count, total in _sums(waves, stages, threads).items():
            last, stage = count - 1, stages[count]
            brightness = arrays.total(total * seen) / wanted  # m b
            image = total / brightness
            error = image - picture.target
            weighted = error * picture.weight
            losses[count] += arrays.total(error * weighted)
            excess = float(brightness / scales[last] - 1)
            even = BRIGHTNESS * excess / float(scales[last])
            even -= arrays.total(image * weighted) / brightness
            slopes[last] = 2 * stage / brightness * weighted
            slopes[last] += 2 * stage * even / wanted * seen
            drift[last] += 2 * stage * BRIGHTNESS * excess * brightness / scales[last] ** 2 / energy
        factors, adjoint = _of_frames(slopes), xp.conj(picture.transfer)

        def back(frame, first=number == 0, factors=factors, adjoint=adjoint):
            wave, slope = waves[frame, ...], gradient[frame, ...]
            wave *= factors[frame]
            part = arrays.fft2(wave, overwrite=True)
            if first:
                arrays.put(slope, xp.multiply, part, adjoint)
            else:
                part *= adjoint
                slope += part

        threads.each(back, frames)
    drift = np.cumsum(drift[::-1])[::-1]

    def scale(frame):
        slope = gradient[frame, ...]
        slope -= float(drift[frame]) * spectra[frame]
        slope *= 1 / pixels

    threads.each(scale, frames)
    return losses, gradient


def _look(waves, spectra, transfer, threads):
    """Each frame's wave in a picture's plane, into `waves`."""

    def look(frame):
        wave = waves[frame, ...]
        arrays.put(wave, arrays.namespace(wave).multiply, spectra[frame], transfer)
        waves[frame, ...] = arrays.ifft2(wave, overwrite=True)

    threads.each(look, len(spectra))


def _of_frames(slopes):
    """Slopes by frame, of slopes by the last frame of a mean: a frame shows in every mean that includes it."""
    total, factor, factors = None, 0j, []
    for slope in reversed(slopes):
        if slope is not None:
            total = slope if total is None else total + slope
            factor = arrays.as_type(total, "complex64")  # a product of unlike numbers is slower
        factors.append(factor)
    return factors[::-1]


def _sums(waves, stages, threads):
    """Intensities of the first frames, summed, by how many: the numbers in `stages`."""
    sums = {count: arrays.empty(waves.shape[1:], "float32", waves) for count in sorted(stages)}
    xp = arrays.namespace(waves)
    parts = blocks(waves[0, ...])

    def add(part):
        rows = parts[part]
        total = arrays.zeros((rows.stop - rows.start, waves.shape[2]), "float32", waves)
        for count in range(1, waves.shape[0] + 1):
            wave = waves[count - 1, rows, :]
            total += xp.real(wave) ** 2
            total += xp.imag(wave) ** 2
            if count in sums:
                sums[count][rows, :] = total

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

    def __init__(
        self, shape: tuple[int, ...], first: float = 0.9, second: float = 0.99, on: Array = PROCESSOR
    ) -> None:
        self.decays = first, second
        self.mean, self.square = (arrays.zeros(shape, "float32", on) for _ in range(2))
        self.count = 0

    @classmethod
    def rate(cls, step: int, steps: int, highest: float) -> float:
        """Length of step number `step` of `steps`."""
        return highest * min(1, (step + 1) / cls.WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / steps))

    def step(self, values: Array, gradient: Sequence[Array], rate: float, threads: Frames) -> None:
        """Move `values`, an array of the shape given, against the gradient, a sequence of frames, in place."""
        self.count += 1
        first, second = self.decays
        length, spread = rate / (1 - first**self.count), 1 / (1 - second**self.count)
        xp = arrays.namespace(values)

        def move(frame):
            mean, square, slope = self.mean[frame, ...], self.square[frame, ...], gradient[frame]
            mean += (1 - first) * (slope - mean)
            square += (1 - second) * (slope * slope - square)
            values[frame, ...] -= length * mean / (xp.sqrt(square * spread) + 1e-12)

        threads.each(move, len(gradient))
