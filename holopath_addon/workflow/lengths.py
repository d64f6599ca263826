"""Distances as people write them: 0.5m, 50cm, 2D, inf."""

import math
import re

from ..engine import InvalidInput

_UNITS = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3}
_DIOPTRES = ("d", "dpt", "dioptre", "dioptres", "diopters")
_LENGTH = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-z]*)", re.IGNORECASE)


def parse_distance(text):
    """Distance in front of the camera.

    Parameters
    ----------
    text : str
        A number with m, cm, mm, km or D (dioptres); a bare number is in metres; ``inf`` is infinity, and
        so is 0D.

    Returns
    -------
    float
        Metres.

    Raises
    ------
    InvalidInput
        If it is no such distance or not in front of the camera.
    """
    word = text.strip().lower()
    if word in ("inf", "infinity", "infm"):
        return math.inf
    match = _LENGTH.fullmatch(word)
    if not match or (match[2] not in _UNITS and match[2] not in _DIOPTRES):
        raise InvalidInput(f"'{text}' is not a distance: write for example 0.5m, 50cm, 2D (diopters) or inf.")
    value = float(match[1])
    if match[2] in _DIOPTRES:
        if value < 0:
            raise InvalidInput(f"The focus {text} lies behind the camera: give a distance in front of it.")
        return 1 / value if value > 0 else math.inf
    value *= _UNITS[match[2]]
    if value <= 0:
        raise InvalidInput(f"The focus {text} lies behind the camera: give a distance in front of it.")
    return value


def parse_focus(text):
    """Comma-separated distances, see `parse_distance`; list of metres.

    Raises
    ------
    InvalidInput
    """
    return [parse_distance(part) for part in text.split(",")]


def format_distance(metres):
    """Short text of a distance in metres, without unit, as used in file names: ``0.5``, ``inf``."""
    return "inf" if math.isinf(metres) else f"{metres:.6g}"
