"""Calibration patterns: flat fields, gratings, dots and random levels, at each focus of the camera."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..engine.waves.modulator import gray_levels
from ..engine.waves.propagation import propagate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..engine.pixels import Pitch

DOTS, MIN_SPACING = 9, 0.18  # dots of a picture, and their minimum distance as a fraction of the shorter side
REFERENCE = 16  # captures after which the first picture is repeated


def patterns(
    shape: tuple[int, int],
    bits: int,
    pitch: Pitch,
    wavelength: float,
    distances: Sequence[float],
    count: int = 64,
    seed: int = 0,
) -> list[tuple[np.ndarray, float]]:
    """Patterns and the distance at which each is captured.

    The foci take turns. Dots, which are sharp at the focus, locate the camera's view and show aberrations. Gratings and
    flat fields show the response and the unmodulated light. Random levels, of single pixels and of blocks, constrain
    everything else. The first picture is repeated at once, which shows the noise, and at the end and every `REFERENCE`
    captures, which shows drift.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the patterns.
    bits : int
        Bits of a level.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    distances : sequence of float
        Distances of the foci from the SLM, meters.
    count : int
        Number of captures, repetitions included.
    seed : int
        Seed of dots and random levels.

    Returns
    -------
    list of (numpy.ndarray, float)
        Levels, uint8 or uint16, shape (y, x), and the distance in meters.
    """
    rng = np.random.default_rng(seed)
    top = 2**bits - 1
    result = []
    repeats = set(references(count)[1:])
    number = 0
    while len(result) < count:
        if len(result) in repeats:
            result.append(result[0])
            continue
        distance = distances[number % len(distances)]
        turn = number // len(distances)
        if turn < 2:
            levels = _dots(shape, bits, pitch, wavelength, distance, rng)
        elif turn < 4:
            levels = np.full(shape, round(top * (number - 2 * len(distances)) / (2 * len(distances) - 1)))
        elif turn < 9:
            levels = _grating(shape, rng.permutation([0, rng.integers(top // 4, top + 1)]), number, rng)
        else:
            side = (1, 1, 2, 4)[turn % 4]
            blocks = rng.integers(0, top + 1, [-(-n // side) for n in shape])
            levels = np.repeat(np.repeat(blocks, side, 0), side, 1)[: shape[0], : shape[1]]
        result.append((np.asarray(levels).astype(np.uint8 if bits <= 8 else np.uint16), distance))
        number += 1
    return result


def references(count: int) -> list[int]:
    """Numbers of the captures of the first picture among `count` captures."""
    return sorted({0, 1, *range(1 + REFERENCE, count, REFERENCE), count - 1})


def _dots(shape, bits, pitch, wavelength, distance, rng):
    """Levels of an ideal display that shows dots of random phases at a distance."""
    sources = np.zeros(shape, np.complex64)
    dots: list[np.ndarray] = []
    for _ in range(100 * DOTS):
        new = rng.integers(0.15 * np.array(shape), 0.85 * np.array(shape))
        if len(dots) < DOTS and all(math.dist(new, each) > MIN_SPACING * min(shape) for each in dots):
            dots.append(new)
            sources[tuple(new)] = np.exp(2j * math.pi * rng.random())
    light = propagate(sources, pitch, wavelength, -distance)
    return gray_levels(np.mod(np.angle(light), 2 * math.pi), bits)


def _grating(shape, levels, number, rng):
    """Bars of 2 to 4 pixels, horizontal or vertical."""
    bar = rng.integers(2, 5)
    y, x = np.indices(shape)
    return np.where((x if number % 2 else y) // bar % 2, *levels)
