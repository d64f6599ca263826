"""Distances as text: 0.5m, 50cm, 2D, inf."""

import math
import re

from ..engine import InvalidInput

_UNITS = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3}
_DIOPTERS = ("d", "dpt", "dioptre", "dioptres", "diopters")  # words that users type
_LENGTH = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-z]*)", re.IGNORECASE)


def parse_distance(text):
    """Parse a distance in front of the camera.

    Parameters
    ----------
    text : str
        A number with m, cm, mm, km or D (diopters). A bare number is in meters; ``inf`` and 0D are infinity.

    Returns
    -------
    float
        Meters.

    Raises
    ------
    InvalidInput
        If the text is not a distance, or not in front of the camera.
    """
    word = text.strip().lower()
    if word in ("inf", "infinity", "infm"):
        return math.inf
    match = _LENGTH.fullmatch(word)
    if not match or (match[2] not in _UNITS and match[2] not in _DIOPTERS):
        raise InvalidInput(
            f"Expected a distance, got '{text}'. Write for example 0.5m, 50cm, 2D (diopters) or inf."
        )
    value = float(match[1])
    if match[2] in _DIOPTERS:
        if value < 0:
            raise InvalidInput(
                f"Expected a distance in front of the camera, got {text}. Give a positive one."
            )
        return 1 / value if value > 0 else math.inf
    value *= _UNITS[match[2]]
    if value <= 0:
        raise InvalidInput(f"Expected a distance in front of the camera, got {text}. Give a positive one.")
    return value


def parse_focus(text):
    """Parse distances with commas between them.

    Parameters
    ----------
    text : str
        See `parse_distance`.

    Returns
    -------
    list of float
        Meters.

    Raises
    ------
    InvalidInput
        See `parse_distance`.
    """
    return [parse_distance(part) for part in text.split(",")]


def format_distance(meters):
    """Short text of a distance in meters, without the unit, as in file names: ``0.5``, ``inf``."""
    return "inf" if math.isinf(meters) else f"{meters:.6g}"
