"""Pixels of a grid, which may be longer in one direction than in the other.

A pitch is one number for both directions, or the pair (x, y). What a grid records is a round cone: the circle that both
directions hold, whose edge, 1 / (2 p), follows from the larger pitch p. With a third number that is p, for grids whose
cone is narrower than their pixels allow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.fft

Pitch = float | tuple[float, ...]


class EvenSteps(NamedTuple):
    """Evenly spaced places along an axis of a grid, in its pixels from the first one's middle."""

    first: float
    step: float
    count: int


class Raster(NamedTuple):
    """Where the pixels of a grid lie.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns.
    pitch : float or (float, float)
        Meters.
    middle : (float, float)
        Of the grid, meters down and across.
    """

    shape: tuple[int, int]
    pitch: Pitch
    middle: tuple[float, float] = (0.0, 0.0)

    def lines_on(self, other: Raster) -> list[EvenSteps]:
        """Its rows and its columns on another grid."""
        lines = []
        each = zip(self.shape, axes(self.pitch), self.middle, strict=True)
        theirs = zip(other.shape, axes(other.pitch), other.middle, strict=True)
        for (count, own, middle), (n, pitch, aside) in zip(each, theirs, strict=True):
            step = own / pitch
            first = (n - 1) / 2 - step * (count - 1) / 2 + (middle - aside) / pitch
            lines.append(EvenSteps(first, step, count))
        return lines


def beyond(lines: Sequence[EvenSteps], shape: Sequence[int]) -> int:
    """Pixels that a grid has to be wider, both sides together, for lines to be on it."""
    out = [
        max(-line.first, line.first + line.step * (line.count - 1) - n + 1)
        for line, n in zip(lines, shape, strict=True)
    ]
    return 2 * math.ceil(max(0.0, *out))


def axes(pitch: Pitch) -> tuple[float, float]:
    """Pitch of rows and of columns, (y, x), meters."""
    return (pitch[1], pitch[0]) if isinstance(pitch, tuple) else (pitch, pitch)


def in_words(pitch: Pitch) -> str:
    """A pitch in micrometers, as labels and reports have it."""
    return " × ".join(f"{d * 1e6:.4g}" for d in (pitch[:2] if isinstance(pitch, tuple) else (pitch,))) + " µm"


def coarsest(pitch: Pitch) -> float:
    """The pitch p of the recorded cone, meters."""
    return pitch if not isinstance(pitch, tuple) else pitch[2] if len(pitch) == 3 else max(pitch)


def frequencies(shape: Sequence[int], pitch: Pitch) -> list[np.ndarray]:
    """FFT frequencies of rows and of columns, cycles in a length p: the band's edge is 1/2."""
    if not isinstance(pitch, tuple):
        return [scipy.fft.fftfreq(n) for n in shape]
    return [scipy.fft.fftfreq(n) * (coarsest(pitch) / d) for n, d in zip(shape, axes(pitch), strict=True)]


def scaled(pitch: Pitch, factor: float) -> Pitch:
    """A pitch times a factor."""
    return tuple(d * factor for d in pitch) if isinstance(pitch, tuple) else pitch * factor


def half_sides(shape: Sequence[int], pitch: Pitch, half: float = 0.0) -> list[float]:
    """Pixels down and across of a length in meters, of half the shorter side of a panel if it is 0."""
    if half:
        return [half / d for d in axes(pitch)]
    if not isinstance(pitch, tuple):
        return [min(shape) / 2] * 2
    half = min(n * d for n, d in zip(shape, axes(pitch), strict=True)) / 2
    return [half / d for d in axes(pitch)]
