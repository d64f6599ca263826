"""Depth files of pictures, in a named unit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ...engine import InvalidInput
from .options import note
from .pixels import stored_pixels

if TYPE_CHECKING:
    from pathlib import Path

DEPTHS = (".exr", ".png", ".npy")
UNITS = ("m", "mm", "diopters", "inverse")  # of the numbers of a depth file
UNIT_WORDS = (
    "m, mm, diopters (1/m), or inverse (from 0 at the far one of --depth-ends FAR,NEAR to 1 at the near one)"
)
DEPTH_CHANNELS = ("z", "depth", "v", "y")  # last parts of renderers' names for the channel, in lower case
FAR_DEPTH = 100.0  # meters: a scene that begins beyond it is rare, and one read in a wrong unit likely


def read_depth(path: Path, unit: str, ends: tuple | None = None) -> np.ndarray:
    """Read the depth of each pixel of a picture.

    Parameters
    ----------
    path : Path
        An EXR file of any floating-point numbers, a PNG file of 8 or 16 bits, or a NumPy array of either. Integers are
        in the unit; for inverse depth the highest level is 1.
    unit : str
        One of `UNITS`.
    ends : (float, float), optional
        Depths in meters of the inverse depths 0 and 1.

    Returns
    -------
    numpy.ndarray, float64, shape (y, x)
        Meters.

    Raises
    ------
    InvalidInput
        If the file cannot be read, has several different channels, or a depth is not positive and finite.
    """
    if unit not in UNITS:
        raise InvalidInput(f"Expected a unit of depth {UNIT_WORDS}, got '{unit}'.")
    pixels, names = stored_pixels(path)
    numbers = pixels[..., _depth_channel(path, pixels, names)].astype(np.float64)
    if unit == "inverse":
        return _between(path, numbers / (np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1), ends)
    valid = np.isfinite(numbers) & (numbers > 0)
    if not valid.all():
        row, column = np.argwhere(~valid)[0]
        raise InvalidInput(
            f"{path} has {np.count_nonzero(~valid)} pixels without a positive, finite depth, the first of them "
            f"{numbers[row, column]:g} in column {column}, row {row}. Fill them in, with a depth such as 1000 m for "
            "distant background."
        )
    return 1 / numbers if unit == "diopters" else numbers * (1e-3 if unit == "mm" else 1.0)


def depth_notes(path: Path, depth: np.ndarray, unit: str) -> list[dict[str, str]]:
    """A note, if all depths lie so far that their unit is probably another one.

    Parameters
    ----------
    path : Path
        The depth file.
    depth : numpy.ndarray
        Depths in meters.
    unit : str
        One of `UNITS`.

    Returns
    -------
    list of dict
    """
    if unit == "inverse" or depth.min() <= FAR_DEPTH:  # the ends of inverse depths are given in meters
        return []
    advice = "if they are millimeters, give --depth-unit mm" if unit == "m" else "check --depth-unit"
    return [note(path, f"depths from {depth.min():.4g} to {depth.max():.4g} m", advice)]


def _between(path, fraction, ends):
    """Depths at fractions of the way from the inverse depth of the far end to that of the near one."""
    if ends is None or not (math.isfinite(ends[0]) and ends[0] > ends[1] > 0):
        raise InvalidInput(
            "The ends of inverse depths (--depth-ends FAR,NEAR) must be positive and finite, with FAR larger than NEAR."
        )
    if not ((fraction >= 0) & (fraction <= 1)).all():
        raise InvalidInput(
            "Inverse depths must lie between 0 at the far end and 1 at the near one, got "
            f"{np.nanmin(fraction):g} to {np.nanmax(fraction):g} in {path}."
        )
    return 1 / (1 / ends[0] + fraction * (1 / ends[1] - 1 / ends[0]))


def _depth_channel(path, pixels, names):
    """Index of the depth channel."""
    colors = [k for k, name in enumerate(names) if name != "A"]
    if len(colors) == 1:
        return colors[0]
    matches = [k for k in colors if names[k].lower().rpartition(".")[2] in DEPTH_CHANNELS]
    if len(matches) == 1:
        return matches[0]
    if all(np.array_equal(pixels[..., k], pixels[..., colors[0]], equal_nan=True) for k in colors[1:]):
        return colors[0]
    raise InvalidInput(
        f"{path} has several different channels ({', '.join(names)}). Give a depth file of one channel."
    )
