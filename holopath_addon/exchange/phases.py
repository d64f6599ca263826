"""What the numbers of an array mean as phases: their unit, or the levels of a modulator. Nothing is guessed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..engine import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Callable

TURN = 2 * math.pi
LEVELS = "levels"
UNITS = {"radians": 1.0, "turns": TURN, "pi": math.pi, "degrees": math.pi / 180}  # radians in one
CHOICES = (*UNITS, LEVELS)
MAX_BITS = 16  # of an SLM's levels
# What files say of units, in their own words.
_WORDS = {
    "rad": "radians",
    "radian": "radians",
    "turn": "turns",
    "wave": "turns",
    "waves": "turns",
    "deg": "degrees",
    "degree": "degrees",
    "level": LEVELS,
} | {name: name for name in CHOICES}
# Numbers are taken for radians where they fill one turn, this fraction of it or more, and go beyond it no more than
# this; that of half precision near 2 pi is 0.002.
FILLED, ROUNDING = 0.98, 0.004
FILLED_LEVELS = 15 / 16  # fraction of a type's levels that levels reach, if nobody says how many there are


def known_units(text: object) -> str | None:
    """One of `CHOICES` by a file's own words, as "radians" or "rad; wrapped"; None if it is none of them."""
    return _WORDS.get(str(text).split(";")[0].strip().lower())


def radians_of(
    layers: np.ndarray, units: str | None = None, bits: int | None = None
) -> Callable[[np.ndarray], np.ndarray]:
    """The function from an array's numbers to radians, float64.

    Parameters
    ----------
    layers : numpy.ndarray of bool, int or float, shape (frame, wavelength, y, x)
        All of the numbers: their range tells what they can be.
    units : str, optional
        Of `CHOICES`. Default: levels for whole numbers; radians for others if they fill one turn in each layer.
    bits : int, optional
        Of levels: 2^bits of them are a turn. Default: those of an unsigned type, if the levels fill it. Levels of fewer
        bits than the type's are as they are, or shifted to its top, or stretched to fill it, whichever it can be alone;
        if `units` say levels, they are as they are.

    Returns
    -------
    callable
        For parts of the array, of any shape.

    Raises
    ------
    InvalidInput
        If the numbers can be read in two ways, or not as said.
    """
    if bits is not None and not 1 <= bits <= MAX_BITS:
        raise InvalidInput(
            f"An SLM has 1 to {MAX_BITS} bits, not {bits}: give those of the levels by --bits."
        )
    if units not in (None, *CHOICES):
        raise InvalidInput(f"Phases are in {', '.join(CHOICES)}, not in '{units}': choose one by --units.")
    if units in UNITS:
        if bits:
            raise InvalidInput(f"Phases in {units} have no bits: leave out --bits, or say --units levels.")
        return _scaled(UNITS[units])
    if not layers.any():
        return _scaled(0.0)  # whatever they are
    if layers.dtype.kind in "iub":
        return _of_whole(layers, bits, units == LEVELS)
    if units == LEVELS or bits:
        return _of_fractional(layers, bits, units == LEVELS)
    for frame in layers:
        for layer in frame:
            if layer.any():
                _require_radians(layer)
    return _scaled(1.0)


def _scaled(factor):
    return lambda part: np.asarray(part, np.float64) * factor


def _is_whole(array):
    return all(bool((part == np.round(part)).all()) for part in array)


def _require_radians(layer):
    """Refuse numbers that may be something else than radians."""
    low, high = float(layer.min()), float(layer.max())
    span, whole = high - low, _is_whole(layer)
    within = any(a - ROUNDING <= low and high <= a + TURN + ROUNDING for a in (0.0, -math.pi))
    if within and span >= FILLED * TURN and not whole:
        return
    readings = {
        "radians (--units radians)": True,
        "turns (--units turns)": span <= 1 + ROUNDING or not (within or whole),
        "units of pi (--units pi)": span <= 2 + ROUNDING,
        "degrees (--units degrees)": 2 * TURN < span <= 360 + ROUNDING,
        f"levels (--bits {_bits_for(high)} or more)": whole and 0 <= low and high < 2**MAX_BITS,
    }
    ways = [text for text, possible in readings.items() if possible]
    ways = ways if len(ways) > 1 else [*ways, "turns (--units turns)"]
    raise InvalidInput(
        f"Phases go from {low:.4g} to {high:.4g}, which can be {', '.join(ways[:-1])} or {ways[-1]}: say which."
    )


def _bits_for(level):
    return max(1, int(level).bit_length())


def _of_fractional(layers, bits, said):
    """Levels in a type that has fractions."""
    if not bits:
        raise InvalidInput("Levels of a type with a fraction may have any number of bits: give it by --bits.")
    if not said and not all(map(_is_whole, layers)):
        raise InvalidInput(
            "The phases are no whole numbers, which levels of --bits are: leave out --bits, or say --units levels."
        )
    low, high = float(layers.min()), float(layers.max())
    if low < 0 or high >= 2**bits:
        raise InvalidInput(
            f"The levels go from {low:g} to {high:g}, and --bits {bits} has 0 to {2**bits - 1}: give other --bits, or "
            "--units."
        )
    return _scaled(TURN / 2**bits)


def _of_whole(layers, bits, said):
    """Levels in a type of whole numbers."""
    if layers.dtype.kind == "b":
        if bits not in (None, 1):
            raise InvalidInput(f"Levels that are true or false have one bit, not {bits}: leave out --bits.")
        return _scaled(math.pi)
    low, high = int(layers.min()), int(layers.max())
    if low < 0:
        raise InvalidInput(
            f"The whole numbers go down to {low}, and levels begin at 0: say --units radians, turns, pi or degrees, or "
            "write the levels from 0."
        )
    unsigned = 8 * layers.dtype.itemsize if layers.dtype.kind == "u" and layers.dtype.itemsize <= 2 else None
    if bits is None:
        return _of_all_levels(layers, high, unsigned)
    ways = {}
    if high < 2**bits:
        ways[f"{bits} bits as they are (--units levels --bits {bits})"] = _scaled(TURN / 2**bits)
    if unsigned and unsigned > bits and not said:
        levels = _distinct(layers)
        if _is_shifted(levels, unsigned - bits):
            ways[f"the top {bits} bits of {unsigned} (--bits {unsigned})"] = _scaled(TURN / 2**unsigned)
        elif _is_stretched(levels, _step(bits, unsigned)):
            ways[f"{bits} bits stretched to {unsigned} (write them again)"] = _of_stretched(bits, unsigned)
    if len(ways) > 1:
        raise InvalidInput(f"The levels up to {high} can be {' or '.join(ways)}: say which.")
    for function in ways.values():
        return function
    raise InvalidInput(
        f"The levels go up to {high}, and --bits {bits} has 0 to {2**bits - 1}: give --bits {_bits_for(high)} or more, "
        "or write the levels again."
        if high < 2**MAX_BITS
        else f"The levels go up to {high}, and an SLM has {2**MAX_BITS} at most: write the levels again."
    )


def _of_all_levels(layers, high, unsigned):
    """Nobody says how many levels are a turn: those of the type, if they fill it."""
    if unsigned is None:
        raise InvalidInput(
            f"Whole numbers of {layers.dtype} up to {high} can be levels of any number of bits (--bits N), or degrees "
            "(--units degrees): say which."
        )
    if high < FILLED_LEVELS * 2**unsigned:
        fewer = _bits_for(high)
        ways = [f"--bits {bits} for {2**bits} levels" for bits in sorted({fewer, unsigned})]
        raise InvalidInput(
            f"The levels go up to {high}, and how many make a turn is not said: give {' or '.join(ways)}."
        )
    levels = _distinct(layers)
    for bits in range(1, unsigned):
        if not _is_shifted(levels, unsigned - bits) and _is_stretched(levels, _step(bits, unsigned)):
            raise InvalidInput(
                f"The levels can be {bits} bits that were stretched to 0 to {2**unsigned - 1} (--bits {bits}) or "
                f"{unsigned} bits as they are (--bits {unsigned}): say which."
            )
    return _scaled(TURN / 2**unsigned)  # also of fewer bits that lie at the top: the same phases


def _distinct(array):
    """The different levels of an array of 8 or 16 bits, rising."""
    seen = np.zeros(1 << 8 * array.dtype.itemsize, bool)
    for part in array:
        seen[part] = True
    return np.flatnonzero(seen)


def _is_shifted(levels, shift):
    return not (levels & (1 << shift) - 1).any()


def _step(bits, of_bits):
    """Between levels that are stretched from 0 to the largest number of another number of bits."""
    return (2**of_bits - 1) / (2**bits - 1)


def _is_stretched(levels, step):
    """Whether all levels are multiples of a step, rounded or cut to whole numbers."""
    multiples = np.round(levels / step) * step
    return bool((np.round(multiples) == levels).all() or (np.floor(multiples + 1e-6) == levels).all())


def _of_stretched(bits, of_bits):
    step = _step(bits, of_bits)
    return lambda part: np.round(np.asarray(part, np.float64) / step) * (TURN / 2**bits)
