"""Interpretation of numbers as phases: their unit, or levels of a modulator. Nothing is guessed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..engine import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Callable

TURN = 2 * math.pi
LEVELS = "levels"
UNITS = {"radians": 1.0, "turns": TURN, "pi": math.pi, "degrees": math.pi / 180}  # radians per unit
CHOICES = (*UNITS, LEVELS)
MAX_BITS = 16  # of an SLM's levels
# Words for units in files.
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
# Numbers count as radians if they span at least this fraction of a turn, and exceed it by at most this rounding error,
# twice that of half precision near 2 pi.
MIN_TURN_FRACTION, ROUNDING = 0.98, 0.004
MIN_LEVEL_FRACTION = 15 / 16  # of a type's levels that levels without a number of bits must reach


def parse_units(text: object) -> str | None:
    """One of `CHOICES` for a file's words, such as "radians" or "rad; wrapped"; None if they are unknown."""
    return _WORDS.get(str(text).split(";")[0].strip().lower())


def radians_of(
    layers: np.ndarray, units: str | None = None, bits: int | None = None
) -> Callable[[np.ndarray], np.ndarray]:
    """Make the function from an array's numbers to radians, float64.

    Parameters
    ----------
    layers : numpy.ndarray of bool, int or float, shape (frame, wavelength, y, x)
        All numbers; their range shows which units are possible.
    units : str, optional
        One of `CHOICES`. Default: levels for integers; radians for floats that span one turn in each layer.
    bits : int, optional
        Bits of levels: 2^bits of them are a turn. Default: those of an unsigned type, if the levels fill it. Levels of
        fewer bits may be unchanged, shifted to the top of the type, or stretched to fill it; only one of these must be
        possible. With `units` of levels they are unchanged.

    Returns
    -------
    callable
        Takes parts of the array, of any shape.

    Raises
    ------
    InvalidInput
        If the numbers have two readings, or contradict the arguments.
    """
    if bits is not None and not 1 <= bits <= MAX_BITS:
        raise InvalidInput(f"Expected 1 to {MAX_BITS} bits, got {bits}. Give those of the levels by --bits.")
    if units not in (None, *CHOICES):
        raise InvalidInput(f"Expected units {', '.join(CHOICES)}, got '{units}'. Choose one by --units.")
    if units in UNITS:
        if bits:
            raise InvalidInput(f"Phases in {units} have no bits. Omit --bits, or give --units levels.")
        return _scaled(UNITS[units])
    if not layers.any():
        return _scaled(0.0)  # in any unit
    if layers.dtype.kind in "iub":
        return _of_integers(layers, bits, units == LEVELS)
    if units == LEVELS or bits:
        return _of_floats(layers, bits, units == LEVELS)
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
    """Refuse numbers that can be in another unit than radians."""
    low, high = float(layer.min()), float(layer.max())
    span, whole = high - low, _is_whole(layer)
    within = any(a - ROUNDING <= low and high <= a + TURN + ROUNDING for a in (0.0, -math.pi))
    if within and span >= MIN_TURN_FRACTION * TURN and not whole:
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
        f"Phases go from {low:.4g} to {high:.4g}, which can be {', '.join(ways[:-1])} or {ways[-1]}. Choose one."
    )


def _bits_for(level):
    return max(1, int(level).bit_length())


def _of_floats(layers, bits, explicit):
    """Conversion of levels of a floating-point type; `explicit`: the units are given as levels."""
    if not bits:
        raise InvalidInput("Levels of a floating-point type may have any number of bits. Give it by --bits.")
    if not explicit and not all(map(_is_whole, layers)):
        raise InvalidInput(
            "Levels of --bits are whole numbers, the phases are not. Omit --bits, or give --units levels."
        )
    low, high = float(layers.min()), float(layers.max())
    if low < 0 or high >= 2**bits:
        raise InvalidInput(
            f"The levels go from {low:g} to {high:g}, and --bits {bits} has 0 to {2**bits - 1}. Give other --bits, or "
            "--units."
        )
    return _scaled(TURN / 2**bits)


def _of_integers(layers, bits, explicit):
    """Conversion of levels of an integer type; `explicit`: the units are given as levels."""
    if layers.dtype.kind == "b":
        if bits not in (None, 1):
            raise InvalidInput(f"Levels that are true or false have one bit, not {bits}. Omit --bits.")
        return _scaled(math.pi)
    low, high = int(layers.min()), int(layers.max())
    if low < 0:
        raise InvalidInput(
            f"The whole numbers go down to {low}, and levels start at 0. Give --units radians, turns, pi or degrees, "
            "or write the levels from 0."
        )
    unsigned = 8 * layers.dtype.itemsize if layers.dtype.kind == "u" and layers.dtype.itemsize <= 2 else None
    if bits is None:
        return _of_all_levels(layers, high, unsigned)
    ways = {}
    if high < 2**bits:
        ways[f"{bits} bits as they are (--units levels --bits {bits})"] = _scaled(TURN / 2**bits)
    if unsigned and unsigned > bits and not explicit:
        levels = _distinct(layers)
        if _is_shifted(levels, unsigned - bits):
            ways[f"the top {bits} bits of {unsigned} (--bits {unsigned})"] = _scaled(TURN / 2**unsigned)
        elif _is_stretched(levels, _step(bits, unsigned)):
            ways[f"{bits} bits stretched to {unsigned} (write them again)"] = _of_stretched(bits, unsigned)
    if len(ways) > 1:
        raise InvalidInput(f"The levels up to {high} can be {' or '.join(ways)}. Choose one.")
    for function in ways.values():
        return function
    raise InvalidInput(
        f"The levels go up to {high}, and --bits {bits} has 0 to {2**bits - 1}. Give --bits {_bits_for(high)} or more, "
        "or write the levels again."
        if high < 2**MAX_BITS
        else f"The levels go up to {high}, and an SLM has at most {2**MAX_BITS}. Write the levels again."
    )


def _of_all_levels(layers, high, unsigned):
    """Conversion of levels without a number of bits: those of the type, if the levels fill it."""
    if unsigned is None:
        raise InvalidInput(
            f"Whole numbers of {layers.dtype} up to {high} can be levels of any number of bits (--bits N), or degrees "
            "(--units degrees). Choose one."
        )
    if high < MIN_LEVEL_FRACTION * 2**unsigned:
        fewer = _bits_for(high)
        ways = [f"--bits {bits} for {2**bits} levels" for bits in sorted({fewer, unsigned})]
        raise InvalidInput(
            f"The levels go up to {high}, and the number of levels in a turn is unknown. Give {' or '.join(ways)}."
        )
    levels = _distinct(layers)
    for bits in range(1, unsigned):
        if not _is_shifted(levels, unsigned - bits) and _is_stretched(levels, _step(bits, unsigned)):
            raise InvalidInput(
                f"The levels can be {bits} bits stretched to 0 to {2**unsigned - 1} (--bits {bits}) or {unsigned} bits "
                f"unchanged (--bits {unsigned}). Choose one."
            )
    return _scaled(TURN / 2**unsigned)  # also right for fewer bits at the top


def _distinct(array):
    """Distinct levels of an array of 8 or 16 bits, ascending."""
    occurs = np.zeros(1 << 8 * array.dtype.itemsize, bool)
    for part in array:
        occurs[part] = True
    return np.flatnonzero(occurs)


def _is_shifted(levels, shift):
    return not (levels & (1 << shift) - 1).any()


def _step(bits, of_bits):
    """Step between levels of `bits` bits that are stretched to `of_bits` bits."""
    return (2**of_bits - 1) / (2**bits - 1)


def _is_stretched(levels, step):
    """Whether all levels are multiples of a step, rounded or truncated to integers."""
    multiples = np.round(levels / step) * step
    return bool((np.round(multiples) == levels).all() or (np.floor(multiples + 1e-6) == levels).all())


def _of_stretched(bits, of_bits):
    step = _step(bits, of_bits)
    return lambda part: np.round(np.asarray(part, np.float64) / step) * (TURN / 2**bits)
