"""Decisions that `Settings.fixed` may take in the plan's place."""

from __future__ import annotations

from ..errors import InvalidInput
from ..settings import DECLARED

MOST_SLABS = 48  # of the radiance map
GLOSSY_BINS = (2, 6)  # fewest and most along each axis of the pupil

# Lowest and highest value, and what it is.
FIXABLE = {
    "chain": (*DECLARED["most_hits"].bounds, "longest chain of mirrors and clear surfaces"),
    "splits": (0, 2, "hits of a chain at which more than one way on is followed"),
    "max_depth": (*DECLARED["max_depth"].bounds, "vertices of a radiance path"),
    "passes": (1, 1 << 16, "radiance paths a pixel, without a look at their noise"),
    "slabs": (1, MOST_SLABS, "depth slabs of the radiance map"),
    "bins": (1, GLOSSY_BINS[1], "pupil bins along each axis of the radiance map"),
    "textures": (0, 1 << 16, "rays a pixel that see textures alone"),
    "filter": (0, 1, "whether grains of one surface share their light"),
    "grey": (0, 1, "whether all wavelengths share one radiance"),
    "dispersion": (0, 1, "whether each wavelength has rays of its own where glass disperses"),
    "regions": (0, 1, "whether each tile has as many rays as it needs"),
    "beside": (0, 1 << 12, "pixels beyond each edge of the picture that are traced, too"),
    "chunk": (1, 1 << 40, "bytes of the sums of pixels that are traced at once"),
    "steps": (1, 1 << 20, "steps of baselines that find phases by descent"),
}


def parse_fixed(text: str) -> dict:
    """Decisions to fix, from words as ``chain=4 passes=64``, with or without commas between; see `FIXABLE`.

    Parameters
    ----------
    text : str

    Returns
    -------
    dict

    Raises
    ------
    InvalidInput
    """
    fixed = {}
    for word in text.replace(",", " ").split():
        name, _, value = word.partition("=")
        try:
            fixed[name] = int(value)
        except ValueError:
            raise InvalidInput(
                f"'{word}' fixes no decision: write NAME=NUMBER, for example chain=4."
            ) from None
    check_fixed(fixed)
    return fixed


def check_fixed(fixed: dict) -> None:
    """Refuse names and values that no decision has."""
    for name, value in fixed.items():
        if name not in FIXABLE:
            raise InvalidInput(f"There is no decision '{name}' to fix: choose one of {', '.join(FIXABLE)}.")
        low, high, what = FIXABLE[name]
        if not (isinstance(value, int) and low <= value <= high):
            raise InvalidInput(
                f"The fixed {name} ({what}) must be a whole number from {low} to {high}, not {value}."
            )
