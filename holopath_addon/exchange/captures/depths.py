"""Depths of a picture's pixels, in any unit that is named."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ...engine import InvalidInput
from .pixels import stored_pixels

if TYPE_CHECKING:
    from pathlib import Path

DEPTHS = (".exr", ".png", ".npy")
UNITS = ("m", "mm", "diopters", "inverse")  # of the numbers of a depth file
UNIT_WORDS = (
    "m, mm, diopters (1/m), or inverse (from 0 at the far one of --depth-ends FAR,NEAR to 1 at the near one)"
)
DEPTH_CHANNELS = ("z", "depth", "v", "y")  # last words of the names that renderers give it, in small letters


def read_depth(path: Path, unit: str, ends: tuple | None = None) -> np.ndarray:
    """Read the depth of each pixel of a picture.

    Parameters
    ----------
    path : Path
        An EXR file of any floating-point numbers, a PNG file of 8 or 16 bits, or a NumPy array of either. Levels of
        whole numbers are taken as they are; of inverse depth the highest level is 1.
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
        If it cannot be read, has several channels that differ, or a number that is not a positive, finite depth.
    """
    if unit not in UNITS:
        raise InvalidInput(f"There is no unit of depth '{unit}': choose {UNIT_WORDS}.")
    pixels, names = stored_pixels(path)
    numbers = pixels[..., _depth_channel(path, pixels, names)].astype(np.float64)
    if unit == "inverse":
        return _between(path, numbers / (np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1), ends)
    good = np.isfinite(numbers) & (numbers > 0)
    if not good.all():
        row, column = np.argwhere(~good)[0]
        raise InvalidInput(
            f"{path} has {np.count_nonzero(~good)} pixels without a positive, finite depth, the first of them "
            f"{numbers[row, column]:g} in column {column}, row {row}: fill them in, and give what is far away a depth "
            "such as 1000 m."
        )
    return 1 / numbers if unit == "diopters" else numbers * (1e-3 if unit == "mm" else 1.0)


def _between(path, share, ends):
    """Depths of shares of the way from the inverse depth of one end to that of the other."""
    if ends is None or not (math.isfinite(ends[0]) and ends[0] > ends[1] > 0):
        raise InvalidInput(
            "The ends of inverse depths (--depth-ends FAR,NEAR) must be positive and finite, and the far one larger."
        )
    if not ((share >= 0) & (share <= 1)).all():
        raise InvalidInput(
            f"{path} has numbers from {np.nanmin(share):g} to {np.nanmax(share):g}: inverse depths must lie between 0 "
            "at the far end and 1 at the near one."
        )
    return 1 / (1 / ends[0] + share * (1 / ends[1] - 1 / ends[0]))


def _depth_channel(path, pixels, names):
    """Number of the channel that holds the depth."""
    colors = [k for k, name in enumerate(names) if name != "A"]
    if len(colors) == 1:
        return colors[0]
    named = [k for k in colors if names[k].lower().rpartition(".")[2] in DEPTH_CHANNELS]
    if len(named) == 1:
        return named[0]
    if all(np.array_equal(pixels[..., k], pixels[..., colors[0]], equal_nan=True) for k in colors[1:]):
        return colors[0]
    raise InvalidInput(
        f"{path} has several channels that differ ({', '.join(names)}): give a depth file of one channel."
    )
