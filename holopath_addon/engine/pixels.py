"""Grids of pixels, square or not.

A pitch is one number for both directions, or the pair (x, y). A grid records a round cone: the circle that fits both
directions, whose edge, 1 / (2 p), follows from the larger pitch p. A third number replaces p for grids whose cone is
narrower than their pixels allow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.fft

Pitch = float | tuple[float, ...]


class EvenSteps(NamedTuple):
    """Evenly spaced places along an axis of a grid, in pixels from the center of the first one."""

    first: float
    step: float
    count: int


class Raster(NamedTuple):
    """Position of a grid's pixels.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns.
    pitch : float or (float, float)
        Meters, see the module.
    middle : (float, float)
        Center of the grid, meters down and to the right.
    """

    shape: tuple[int, int]
    pitch: Pitch
    middle: tuple[float, float] = (0.0, 0.0)

    def lines_on(self, other: Raster) -> list[EvenSteps]:
        """Places of its rows and its columns on another grid."""
        lines = []
        each = zip(self.shape, axes(self.pitch), self.middle, strict=True)
        others = zip(other.shape, axes(other.pitch), other.middle, strict=True)
        for (count, own, middle), (n, pitch, other_middle) in zip(each, others, strict=True):
            step = own / pitch
            first = (n - 1) / 2 - step * (count - 1) / 2 + (middle - other_middle) / pitch
            lines.append(EvenSteps(first, step, count))
        return lines


def beyond(lines: Sequence[EvenSteps], shape: Sequence[int]) -> int:
    """Number of pixels, on both sides together, by which a grid must grow to contain rows and columns.

    Parameters
    ----------
    lines : (EvenSteps, EvenSteps)
        Rows and columns.
    shape : (int, int)
        Size of the grid.
    """
    excess = [
        max(-line.first, line.first + line.step * (line.count - 1) - n + 1)
        for line, n in zip(lines, shape, strict=True)
    ]
    return 2 * math.ceil(max(0.0, *excess))


def axes(pitch: Pitch) -> tuple[float, float]:
    """Pitch of rows and of columns, (y, x), meters."""
    return (pitch[1], pitch[0]) if isinstance(pitch, tuple) else (pitch, pitch)


def in_words(pitch: Pitch) -> str:
    """A pitch in micrometers, for labels and reports."""
    return " × ".join(f"{d * 1e6:.4g}" for d in (pitch[:2] if isinstance(pitch, tuple) else (pitch,))) + " µm"


def coarsest(pitch: Pitch) -> float:
    """Pitch p of the recorded cone, meters."""
    return pitch if not isinstance(pitch, tuple) else pitch[2] if len(pitch) == 3 else max(pitch)


def frequencies(shape: Sequence[int], pitch: Pitch) -> list[np.ndarray]:
    """FFT frequencies of rows and of columns, in cycles per length p, so that the band's edge is 1/2.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the FFT.
    pitch : float or (float, float)
        Pixel pitch, meters, see the module.
    """
    if not isinstance(pitch, tuple):
        return [scipy.fft.fftfreq(n) for n in shape]
    return [scipy.fft.fftfreq(n) * (coarsest(pitch) / d) for n, d in zip(shape, axes(pitch), strict=True)]


def scaled(pitch: Pitch, factor: float) -> Pitch:
    """A pitch times a factor."""
    return tuple(d * factor for d in pitch) if isinstance(pitch, tuple) else pitch * factor


def half_sides(shape: Sequence[int], pitch: Pitch, half: float = 0.0) -> list[float]:
    """Length in pixels down and across.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the panel.
    pitch : float or (float, float)
        Meters.
    half : float
        Length in meters. Default: half the shorter side of the panel.
    """
    if half:
        return [half / d for d in axes(pitch)]
    if not isinstance(pitch, tuple):
        return [min(shape) / 2] * 2
    half = min(n * d for n, d in zip(shape, axes(pitch), strict=True)) / 2
    return [half / d for d in axes(pitch)]
