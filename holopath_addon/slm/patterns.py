"""What a display is shown to be known: flat fields, gratings, dots and random levels, at each focus of the camera."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..engine.waves.modulator import grey_levels
from ..engine.waves.propagation import propagate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..engine.pixels import Pitch

DOTS, APART = 9, 0.18  # dots of a picture, and their least distance in shares of the shorter side
REFERENCE = 16  # captures after which the first picture is looked at again


def patterns(
    shape: tuple[int, int],
    bits: int,
    pitch: Pitch,
    wavelength: float,
    distances: Sequence[float],
    count: int = 64,
    seed: int = 0,
) -> list[tuple[np.ndarray, float]]:
    """Levels and the distance at which they are looked at.

    Of each focus in turn: a picture of dots, which are sharp there, says where the camera looks and what aberrates;
    gratings and flat fields say the response and what is unmodulated; random levels, of single pixels and of blocks,
    say all the rest and the same once more. The first picture comes again at once, which says what noise there is, at
    the end and after every `REFERENCE` captures, so that drift is seen.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    bits : int
        Of a level.
    pitch : float or (float, float)
    wavelength : float
        Metres.
    distances : sequence of float
        Of the foci from the SLM, metres.
    count : int
        Of all captures.
    seed : int

    Returns
    -------
    list of (numpy.ndarray, float)
    """
    rng = np.random.default_rng(seed)
    top = 2**bits - 1
    shown = []
    repeats = set(references(count)[1:])
    number = 0
    while len(shown) < count:
        if len(shown) in repeats:
            shown.append(shown[0])
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
        shown.append((np.asarray(levels).astype(np.uint8 if bits <= 8 else np.uint16), distance))
        number += 1
    return shown


def references(count: int) -> list[int]:
    """Numbers of the captures of the first picture, among so many."""
    return sorted({0, 1, *range(1 + REFERENCE, count, REFERENCE), count - 1})


def _dots(shape, bits, pitch, wavelength, distance, rng):
    """Phases, as levels of an ideal display, of light from dots at a distance, each of a random phase."""
    sources = np.zeros(shape, np.complex64)
    at: list[np.ndarray] = []
    for _ in range(100 * DOTS):
        new = rng.integers(0.15 * np.array(shape), 0.85 * np.array(shape))
        if len(at) < DOTS and all(math.dist(new, each) > APART * min(shape) for each in at):
            at.append(new)
            sources[tuple(new)] = np.exp(2j * math.pi * rng.random())
    light = propagate(sources, -distance, pitch, wavelength)
    return grey_levels(np.mod(np.angle(light), 2 * math.pi), bits)


def _grating(shape, levels, number, rng):
    """Bars, across or down, of 2 to 4 pixels."""
    bar = rng.integers(2, 5)
    y, x = np.indices(shape)
    return np.where((x if number % 2 else y) // bar % 2, *levels)
