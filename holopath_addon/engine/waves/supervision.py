"""Loss of the frames' mean intensity against target images, its gradient, and Adam."""

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

BRIGHTNESS = 10.0  # an image that is 10 % too bright has the loss of a speckle contrast of 0.3
DARK = 0.05  # fraction of the mean intensity, added to intensities by which errors are divided


@dataclass(frozen=True)
class TargetImage:
    """Target of the fields' mean intensity on one plane, through the pupil or a part of it.

    Attributes
    ----------
    transfer : array, complex64, shape (y, x)
        Transfer function from the fields' spectra to the image's, with the pupil; FFT order.
    target : array, float32, shape (y, x)
        Target intensity.
    weight : array, float32, shape (y, x)
        Weight of the squared error of each pixel; zero where the target is unknown.
    """

    transfer: Array
    target: Array
    weight: Array


class FramePool:
    """Thread pool for frames; a context manager."""

    def __enter__(self):
        self.pool = ThreadPoolExecutor(threads())
        return self

    def __exit__(self, *_):
        self.pool.shutdown()

    def each(self, work: Callable[[int], Any], count: int) -> list:
        """Return ``[work(0), ..., work(count - 1)]``, computed in parallel."""
        return list(self.pool.map(work, range(count)))


def blocks(wave: Array) -> list[slice]:
    """Slices of rows that fit into a processor's cache; on other devices one of all rows."""
    shape = wave.shape
    height = max(1, (1 << 15) // shape[1]) if isinstance(wave, np.ndarray) else shape[0]
    return [slice(first, min(first + height, shape[0])) for first in range(0, shape[0], height)]


def relative(target: Array) -> Array:
    """Weight of the squared error of each pixel, with which m independent frames have the loss 1/m in any image.

    It is the inverse of the intensity, as in the variance of its square root, by which images are compared.

    Parameters
    ----------
    target : array, float32
        Target intensity.

    Returns
    -------
    array, float32, same shape
        Zeros for a black image.
    """
    xp = arrays.namespace(target)
    if not xp.any(target != 0):
        return xp.zeros_like(target)
    return 1 / ((target + DARK * xp.mean(target)) * xp.sum(target))


def supervise(
    spectra: Sequence[Array],
    images: Sequence[TargetImage],
    energy: float,
    stages: dict[int, float],
    pool: FramePool,
) -> tuple[dict[int, float], Array]:
    """Compute the loss of the frames' mean intensity, and its gradient with respect to the spectra.

    L = sum over images and m of stages[m] (sum over pixels of weight (I / b - target)^2 + BRIGHTNESS (b / c - 1)^2),
    where I is the mean of |ifft(transfer U_n)|^2 over the first m frames, b = sum I / sum target over the pixels that
    have weight, and c the mean of the frames' energies over `energy`. Speckle and brightness have separate terms, since
    the squared error of an image with speckle is least if it is too dark.

    Parameters
    ----------
    spectra : sequence of array, complex64, shape (y, x)
        U_n = FFT of each frame's field, cut to the recordable band.
    images : sequence of TargetImage
    energy : float
        Sum over pixels of the intensity of a field that shows the targets.
    stages : dict of int to float
        Weight of the mean of the first m frames, by m.
    pool : FramePool

    Returns
    -------
    losses : dict of int to float
        Losses by m, without the term of brightness and the weight in `stages`.
    gradient : array, complex64, shape (frames, y, x)
        G_n with dL = 2 Re sum conj(G_n) dU_n.
    """
    frames, shape, xp = len(spectra), spectra[0].shape, arrays.namespace(spectra[0])
    pixels = math.prod(shape)
    energies = pool.each(lambda frame: arrays.product(spectra[frame], spectra[frame]).real / pixels, frames)
    scales = np.cumsum(energies) / energy  # m c
    losses = dict.fromkeys(stages, 0.0)
    drift = np.zeros(frames)
    waves, gradient = (arrays.empty((frames, *shape), "complex64", spectra[0]) for _ in range(2))
    for number, image in enumerate(images):
        _propagate(waves, spectra, image.transfer, pool)
        slopes: list = [None] * frames
        mask = arrays.as_type(image.weight > 0, "float32")
        target_energy = arrays.total(image.target * mask)
        for count, total in _sums(waves, stages, pool).items():
            last, stage = count - 1, stages[count]
            brightness = arrays.total(total * mask) / target_energy  # m b
            normalized = total / brightness
            error = normalized - image.target
            weighted = error * image.weight
            losses[count] += arrays.total(error * weighted)
            excess = float(brightness / scales[last] - 1)
            even = BRIGHTNESS * excess / float(scales[last])
            even -= arrays.total(normalized * weighted) / brightness
            slopes[last] = 2 * stage / brightness * weighted
            slopes[last] += 2 * stage * even / target_energy * mask
            drift[last] += 2 * stage * BRIGHTNESS * excess * brightness / scales[last] ** 2 / energy
        factors, adjoint = _slopes_of_frames(slopes), xp.conj(image.transfer)

        def back(frame, first=number == 0, factors=factors, adjoint=adjoint):
            wave, slope = waves[frame, ...], gradient[frame, ...]
            wave *= factors[frame]
            part = arrays.fft2(wave, overwrite=True)
            if first:
                arrays.put(slope, xp.multiply, part, adjoint)
            else:
                part *= adjoint
                slope += part

        pool.each(back, frames)
    drift = np.cumsum(drift[::-1])[::-1]

    def scale(frame):
        slope = gradient[frame, ...]
        slope -= float(drift[frame]) * spectra[frame]
        slope *= 1 / pixels

    pool.each(scale, frames)
    return losses, gradient


def _propagate(waves, spectra, transfer, pool):
    """Propagate each frame to an image's plane, into `waves`."""

    def propagate(frame):
        wave = waves[frame, ...]
        arrays.put(wave, arrays.namespace(wave).multiply, spectra[frame], transfer)
        waves[frame, ...] = arrays.ifft2(wave, overwrite=True)

    pool.each(propagate, len(spectra))


def _slopes_of_frames(slopes):
    """Slopes by frame, from slopes by the last frame of a mean: a frame contributes to every mean that includes it."""
    total, factor, factors = None, 0j, []
    for slope in reversed(slopes):
        if slope is not None:
            total = slope if total is None else total + slope
            factor = arrays.as_type(total, "complex64")  # products of different types are slower
        factors.append(factor)
    return factors[::-1]


def _sums(waves, stages, pool):
    """Sums of the intensities of the first frames, by the numbers of frames in `stages`."""
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

    pool.each(add, len(parts))
    return sums


class Adam:
    """Adam (Kingma and Ba, ICLR 2015) over a stack of frames.

    `encoding.phases.Phases` has an Adam of its own, in one pass over each block of pixels with its light.

    Parameters
    ----------
    shape : tuple of int
        Frames first.
    on : array, optional
        Array whose library and device compute. Default: NumPy.
    """

    WARM_UP = 50  # steps until the rate is at its highest
    DECAYS = 0.9, 0.99  # of the means of slopes and of their squares

    def __init__(self, shape: tuple[int, ...], on: Array = PROCESSOR) -> None:
        self.mean, self.square = (arrays.zeros(shape, "float32", on) for _ in range(2))
        self.count = 0

    @classmethod
    def rate(cls, step: int, steps: int, highest: float) -> float:
        """Length of step number `step` of `steps`: it rises at once, and falls as a cosine."""
        return highest * min(1, (step + 1) / cls.WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / steps))

    def step(self, values: Array, gradient: Sequence[Array], rate: float, pool: FramePool) -> None:
        """Take a step of length `rate` against the gradient, a sequence of frames; `values` change in place."""
        self.count += 1
        first, second = self.DECAYS
        length, spread = rate / (1 - first**self.count), 1 / (1 - second**self.count)
        xp = arrays.namespace(values)

        def move(frame):
            mean, square, slope = self.mean[frame, ...], self.square[frame, ...], gradient[frame]
            mean += (1 - first) * (slope - mean)
            square += (1 - second) * (slope * slope - square)
            values[frame, ...] -= length * mean / (xp.sqrt(square * spread) + 1e-12)

        pool.each(move, len(gradient))
