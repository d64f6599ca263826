"""Which pixels of a recording plane need rays, how many, and how followed: tile by tile, from what rays saw there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .kernel_table import LEAST_DIRECTIONS

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike

TILE = 16  # pixels
STEPS = 8  # of the depth limit at most; each has half the rays of the one before
DEPTHS = 255  # that a depth within the limit is rounded up to

# Pixels that a lattice reaches where images are in view. One in a curved mirror or lens lies at other depths for other
# directions: were they few, many would leave a grain at once, and what is near the plane be dark here and bright there.
IMAGE_REACH = 6.0


@dataclass(frozen=True)
class Region:
    """Pixels that are traced alike.

    Attributes
    ----------
    pixels : numpy.ndarray of uint32
        Numbers, row by row.
    depth_limit : float
        Largest distance of a surface from the plane, metres.
    chains : bool
        Whether mirrors or clear surfaces are in view from there.
    """

    pixels: np.ndarray
    depth_limit: float
    chains: bool


@dataclass(frozen=True)
class Sightings:
    """What rays saw from each tile of a recording plane.

    Attributes
    ----------
    depth : numpy.ndarray of uint32, shape (rows, columns)
        Distance from the plane of the farthest surface, in `DEPTHS` parts of the limit; 0 where there is nothing.
    chains : numpy.ndarray of bool
        Whether a ray met a mirror or a clear surface.
    images : bool
        Whether what is seen over these is recorded.
    """

    depth: np.ndarray
    chains: np.ndarray
    images: bool = True

    def steps(self, reach: float) -> np.ndarray:
        """Step of the depth limit for each tile, from 0, the whole limit, at which a lattice reaches so many pixels; -1
        where no rays are needed.
        """
        most = np.where(
            self.chains & self.images,
            *(max(0, 2 * math.log2(reach / least)) for least in (IMAGE_REACH, LEAST_DIRECTIONS[0])),
        )
        # a surface between the rays may lie a little farther
        part = np.minimum((self.depth + 2) / DEPTHS, 1.0)
        step = np.minimum(np.minimum(-2 * np.log2(part), most), STEPS).astype(int)
        return np.where(self.depth == 0, -1, step)


def limit_of(step: ArrayLike, depth_limit: float) -> Any:
    """Depth limit of a step."""
    return depth_limit * 2.0 ** (-0.5 * step)


def tiles_of(width: int, height: int) -> tuple[int, int]:
    """Rows and columns of tiles."""
    return -(-height // TILE), -(-width // TILE)


def regions_of(
    sightings: Sightings, width: int, height: int, depth_limit: float, reach: float
) -> list[Region]:
    """The regions of a plane, those with most rays first.

    Parameters
    ----------
    sightings : Sightings
    width, height : int
        Pixels of the plane.
    depth_limit : float
        Metres.
    reach : float
        Of its lattice, pixels.

    Returns
    -------
    list of Region
    """
    steps = sightings.steps(reach)
    kinds = np.where(steps < 0, -1, 2 * steps + ~sightings.chains)
    # pixels in the order of their tiles, whose rays stay near each other
    rows, columns = steps.shape
    number = np.arange(width * height, dtype=np.uint32).reshape(height, width)
    padded = np.pad(
        number, ((0, rows * TILE - height), (0, columns * TILE - width)), constant_values=2**32 - 1
    )
    blocks = padded.reshape(rows, TILE, columns, TILE).swapaxes(1, 2).reshape(rows, columns, -1)
    found = []
    for kind in np.unique(kinds[kinds >= 0]):
        pixels = blocks[kinds == kind].ravel()
        pixels = pixels[pixels != 2**32 - 1]
        found.append(Region(pixels, limit_of(kind // 2, depth_limit), kind % 2 == 0))
    return found
