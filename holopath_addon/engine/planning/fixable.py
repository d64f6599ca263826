"""Decisions of the plan that `Settings.fixed` may override."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import InvalidInput
from ..settings import DECLARED
from ..settings.former_names import warn, with_current_names

MAX_SLABS = 48  # depth slabs of the radiance map
GLOSSY_BINS = (2, 6)  # minimum and maximum of the radiance map's bins along each axis of the pupil

# Minimum, maximum and meaning of each value.
FIXABLE = {
    "chain": (*DECLARED["max_specular_depth"].bounds, "longest chain of mirrors and clear surfaces"),
    "splits": (0, 2, "hits of a chain at which more than one way on is followed"),
    "max_depth": (*DECLARED["max_depth"].bounds, "vertices of a radiance path"),
    "passes": (1, 1 << 16, "radiance paths a pixel, without a look at their noise"),
    "slabs": (1, MAX_SLABS, "depth slabs of the radiance map"),
    "bins": (1, GLOSSY_BINS[1], "pupil bins along each axis of the radiance map"),
    "textures": (0, 1 << 16, "rays a pixel that see textures alone"),
    "filter": (0, 1, "whether grains of one surface share their light"),
    "gray": (0, 1, "whether all wavelengths share one radiance"),
    "dispersion": (0, 1, "whether each wavelength has rays of its own where glass disperses"),
    "regions": (0, 1, "whether each tile has as many rays as it needs"),
    "beside": (0, 1 << 12, "pixels beyond each edge of the picture that are traced, too"),
    "chunk": (1, 1 << 40, "bytes of the sums of pixels that are traced at once"),
    "steps": (1, 1 << 20, "steps of baselines that find phases by descent"),
}


def parse_fixed(text: str, tell: Callable[[str], object] = warn) -> dict:
    """Parse decisions to fix, such as ``chain=4 passes=64``.

    Parameters
    ----------
    text : str
        Words NAME=NUMBER, with or without commas between; names are those of `FIXABLE`.
    tell : callable
        ``tell(text)`` receives a sentence about a former name. Default: a DeprecationWarning.

    Returns
    -------
    dict of str to int

    Raises
    ------
    InvalidInput
        If a word has another form, or its name or number is not in `FIXABLE`.
    """
    fixed = {}
    for word in text.replace(",", " ").split():
        name, _, value = word.partition("=")
        try:
            fixed[name] = int(value)
        except ValueError:
            raise InvalidInput(
                f"Expected NAME=NUMBER to fix a decision, got '{word}'. Write for example chain=4."
            ) from None
    fixed = with_current_names("decision", fixed, tell)
    check_fixed(fixed)
    return fixed


def check_fixed(fixed: dict) -> None:
    """Check names and values of fixed decisions.

    Parameters
    ----------
    fixed : dict of str to int
        `Settings.fixed`.

    Raises
    ------
    InvalidInput
        If a name or its value is not in `FIXABLE`.
    """
    for name, value in fixed.items():
        if name not in FIXABLE:
            raise InvalidInput(f"There is no decision '{name}' to fix. Choose one of {', '.join(FIXABLE)}.")
        low, high, meaning = FIXABLE[name]
        if not (isinstance(value, int) and low <= value <= high):
            raise InvalidInput(
                f"The fixed {name} ({meaning}) must be a whole number from {low} to {high}, got {value}."
            )
