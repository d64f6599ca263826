"""Pixels of a grid, which may be longer in one direction than in the other.

A pitch is one number for both directions, or the pair (x, y). What a grid records is a round cone: the circle that both
directions hold, whose edge, 1 / (2 p), follows from the larger pitch p.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.fft

Pitch = float | tuple[float, float]


class Line(NamedTuple):
    """Evenly spaced places along an axis of a grid, in its pixels from the first one's middle."""

    first: float
    step: float
    count: int


def axes(pitch: Pitch) -> tuple[float, float]:
    """Pitch of rows and of columns, (y, x), meters."""
    return (pitch[1], pitch[0]) if isinstance(pitch, tuple) else (pitch, pitch)


def in_words(pitch: Pitch) -> str:
    """A pitch in micrometers, as labels and reports have it."""
    return " × ".join(f"{d * 1e6:.4g}" for d in (pitch if isinstance(pitch, tuple) else (pitch,))) + " µm"


def coarsest(pitch: Pitch) -> float:
    """The larger pitch p, meters."""
    return max(pitch) if isinstance(pitch, tuple) else pitch


def frequencies(shape: Sequence[int], pitch: Pitch) -> list[np.ndarray]:
    """FFT frequencies of rows and of columns, cycles in a length of the larger pitch: the band's edge is 1/2."""
    if not isinstance(pitch, tuple):
        return [scipy.fft.fftfreq(n) for n in shape]
    return [scipy.fft.fftfreq(n) * (max(pitch) / d) for n, d in zip(shape, axes(pitch), strict=True)]


def scaled(pitch: Pitch, factor: float) -> Pitch:
    """A pitch times a factor."""
    return (pitch[0] * factor, pitch[1] * factor) if isinstance(pitch, tuple) else pitch * factor


def half_sides(shape: Sequence[int], pitch: Pitch, half: float = 0.0) -> list[float]:
    """Pixels down and across of a length in meters, of half the shorter side of a panel if it is 0."""
    if half:
        return [half / d for d in axes(pitch)]
    if not isinstance(pitch, tuple):
        return [min(shape) / 2] * 2
    half = min(n * d for n, d in zip(shape, axes(pitch), strict=True)) / 2
    return [half / d for d in axes(pitch)]
