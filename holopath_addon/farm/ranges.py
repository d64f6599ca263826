"""Lists of frames in words."""

from __future__ import annotations

import re
from itertools import chain

from ..engine import InvalidInput

FIRST, LAST = -1048574, 1048574  # frames that Blender knows
MOST = 100_000
_PART = re.compile(r"\s*(-?[0-9]{1,7})(?:-(-?[0-9]{1,7})(?::([0-9]{1,7}))?)?\s*")


def frames(text: str) -> tuple[int, ...]:
    """Frames that a text lists.

    Parameters
    ----------
    text : str
        As ``1-5,9,20-40:2``: numbers and ranges, of which both ends belong to it, with a step or without.

    Returns
    -------
    tuple of int
        Sorted, each once.

    Raises
    ------
    InvalidInput
    """
    parts = [_range(part) for part in text.split(",")]
    if sum(map(len, parts)) > MOST:
        raise InvalidInput(f"'{text}' lists more than {MOST} frames: give fewer at once.")
    return tuple(sorted(set(chain(*parts))))


def _range(part):
    match = _PART.fullmatch(part)
    if match is None:
        raise InvalidInput(f"'{part}' is no frame and no range of frames: give for example 1-5,9,20-40:2.")
    first = int(match[1])
    last, step = int(match[2] or first), int(match[3] or 1)
    if step == 0:
        raise InvalidInput(f"The range '{part}' has a step of 0: give 1 or more.")
    if last < first:
        raise InvalidInput(f"The range '{part}' is empty: give its first frame first.")
    if first < FIRST or last > LAST:
        raise InvalidInput(f"The range '{part}' leaves Blender's frames, {FIRST} to {LAST}.")
    return range(first, last + 1, step)
