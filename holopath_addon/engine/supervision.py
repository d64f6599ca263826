"""How far the frame mean of the intensity is from what it should be, and the way down: loss, adjoint, Adam."""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.fft

BRIGHTNESS = 10.0  # a view 10 % too bright counts as much as a speckle contrast of 0.3
DARK = 0.05  # of the mean intensity, added where errors are divided by the intensity


@dataclass(frozen=True)
class View:
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
        self.pool = ThreadPoolExecutor(os.cpu_count())
        return self

    def __exit__(self, *_):
        self.pool.shutdown()

    def each(self, work, count):
        """``[work(0), ..., work(count - 1)]``."""
        return list(self.pool.map(work, range(count)))


def relative(target):
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


def supervise(spectra, views, energy, stages, threads):
    """Loss of the frame mean over views, and its gradient with respect to the spectra.

    L = sum over views and m of stages[m] (sum over pixels of weight (I / b - target)^2 + BRIGHTNESS (b / c - 1)^2),
    where I is the mean of |ifft(transfer U_n)|^2 over the first m frames, b = sum I / sum target over the pixels that
    have weight, and c the mean of the frames' energies over `energy`. Speckle and brightness are judged apart, since
    the squared error of a picture with speckle is least when it is too dark.

    Parameters
    ----------
    spectra : sequence of numpy.ndarray, complex64, shape (y, x)
        U_n = FFT of each frame's field, cut to the recordable band.
    views : sequence of View
    energy : float
        Sum over pixels of the intensity of a field whose pictures are the targets.
    stages : dict of int to float
        How much the mean of the first m frames counts, by m.
    threads : Frames

    Returns
    -------
    losses : dict of int to float
        By m, without brightness and the factor in `stages`.
    gradient : list of numpy.ndarray, complex64
        G_n with dL = 2 Re sum conj(G_n) dU_n.
    """
    frames, pixels = len(spectra), spectra[0].size
    energies = threads.each(lambda n: float(np.vdot(spectra[n], spectra[n]).real) / pixels, frames)
    scales = np.cumsum(energies) / energy  # m c
    losses = dict.fromkeys(stages, 0.0)
    drift = np.zeros(frames)
    gradient = [0] * frames
    for view in views:
        waves = threads.each(lambda n, view=view: scipy.fft.ifft2(spectra[n] * view.transfer), frames)
        slopes = [None] * frames
        seen = (view.weight > 0).astype(np.float32)
        wanted = float((view.target * seen).sum(dtype=np.float64))
        total = np.zeros(view.target.shape, np.float32)
        for n, wave in enumerate(waves):
            total += wave.real**2 + wave.imag**2
            if n + 1 in stages:
                bright = float((total * seen).sum(dtype=np.float64)) / wanted  # m b
                image = total / np.float32(bright)
                error = image - view.target
                weighted = error * view.weight
                losses[n + 1] += float((error * weighted).sum(dtype=np.float64))
                excess = bright / scales[n] - 1
                even = BRIGHTNESS * excess / scales[n]
                even -= float((image * weighted).sum(dtype=np.float64)) / bright
                slopes[n] = np.float32(2 * stages[n + 1] / bright) * weighted
                slopes[n] += np.float32(2 * stages[n + 1] * even / wanted) * seen
                drift[n] += 2 * stages[n + 1] * BRIGHTNESS * excess * bright / scales[n] ** 2 / energy
        # a frame shows in every mean that includes it
        for n in range(frames - 2, -1, -1):
            if slopes[n] is None:
                slopes[n] = slopes[n + 1]
            elif slopes[n + 1] is not None:
                slopes[n] = slopes[n] + slopes[n + 1]

        def back(n, view=view, waves=waves, slopes=slopes):
            part = scipy.fft.fft2(waves[n] * slopes[n], overwrite_x=True)
            part *= np.conj(view.transfer)
            gradient[n] = gradient[n] + part

        threads.each(back, frames)
    drift = np.cumsum(drift[::-1])[::-1]
    for n in range(frames):
        gradient[n] = (gradient[n] - np.float32(drift[n]) * spectra[n]) / np.float32(pixels)
    return losses, gradient


class Adam:
    """Kingma and Ba, ICLR 2015, over a stack of frames, with a rate that rises at once and falls as a cosine.

    Parameters
    ----------
    shape : tuple of int
        Frames first.
    """

    WARM_UP = 50  # steps

    def __init__(self, shape, first=0.9, second=0.99):
        self.decays = first, second
        self.mean = np.zeros(shape, np.float32)
        self.square = np.zeros(shape, np.float32)
        self.count = 0

    @classmethod
    def rate(cls, step, steps, highest):
        """Length of step number `step` of `steps`."""
        return highest * min(1, (step + 1) / cls.WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / steps))

    def step(self, values, gradient, rate, threads):
        """Move `values`, an array of the shape given, against the gradient, a sequence of frames, in place."""
        self.count += 1
        first, second = self.decays
        length = np.float32(rate / (1 - first**self.count))
        spread = np.float32(1 / (1 - second**self.count))

        def move(n):
            mean, square, slope = self.mean[n], self.square[n], gradient[n]
            mean += np.float32(1 - first) * (slope - mean)
            square += np.float32(1 - second) * (slope * slope - square)
            values[n] -= length * mean / (np.sqrt(square * spread) + np.float32(1e-12))

        threads.each(move, len(values))
