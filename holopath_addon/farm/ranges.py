"""Parser of lists of frames."""

from __future__ import annotations

import re
from itertools import chain

from ..engine import InvalidInput

FIRST, LAST = -1048574, 1048574  # Blender's frames
MAX_FRAMES = 100_000
_PART = re.compile(r"\s*(-?[0-9]{1,7})(?:-(-?[0-9]{1,7})(?::([0-9]{1,7}))?)?\s*")


def frames(text: str) -> tuple[int, ...]:
    """Parse a list of frames.

    Parameters
    ----------
    text : str
        Such as ``1-5,9,20-40:2``: numbers and ranges, which include both ends, optionally with a step.

    Returns
    -------
    tuple of int
        Sorted, each once.

    Raises
    ------
    InvalidInput
    """
    parts = [_range(part) for part in text.split(",")]
    if sum(map(len, parts)) > MAX_FRAMES:
        raise InvalidInput(f"Expected at most {MAX_FRAMES} frames, got more in '{text}'. Give fewer at once.")
    return tuple(sorted(set(chain(*parts))))


def _range(part):
    match = _PART.fullmatch(part)
    if match is None:
        raise InvalidInput(f"Expected frames such as 1-5,9,20-40:2, got '{part}'.")
    first = int(match[1])
    last, step = int(match[2] or first), int(match[3] or 1)
    if step == 0:
        raise InvalidInput(f"The step of the range '{part}' must be at least 1, got 0.")
    if last < first:
        raise InvalidInput(f"The range '{part}' is empty. Give its first frame first.")
    if first < FIRST or last > LAST:
        raise InvalidInput(f"Expected frames from {FIRST} to {LAST}, as Blender has them, got '{part}'.")
    return range(first, last + 1, step)
