"""Regions of a recording plane whose pixels need the same rays, found tile by tile from earlier rays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .kernel_table import MIN_DIRECTIONS

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike

TILE = 16  # pixels
STEPS = 8  # maximum steps of the depth limit, each with half the rays of the one before
DEPTHS = 255  # levels that a depth within the limit is rounded up to

# Minimum reach of a lattice, pixels, where images are in view. An image in a curved mirror or lens has another depth
# for each direction: with few directions many would leave a grain at once, and images near the plane look patchy.
IMAGE_REACH = 6.0


@dataclass(frozen=True)
class Region:
    """Pixels that need the same rays.

    Attributes
    ----------
    pixels : numpy.ndarray of uint32
        Numbers, row by row.
    depth_limit : float
        Maximum distance of a surface from the plane, meters.
    chains : bool
        Whether mirrors or clear surfaces are in view.
    """

    pixels: np.ndarray
    depth_limit: float
    chains: bool


@dataclass(frozen=True)
class Sightings:
    """Surfaces in view from each tile of a recording plane, as sampled by rays.

    Attributes
    ----------
    depth : numpy.ndarray of uint32, shape (rows, columns)
        Distance of the farthest surface from the plane, in `DEPTHS` parts of the limit; 0: no surface.
    chains : numpy.ndarray of bool
        Whether a ray met a mirror or a clear surface.
    images : bool
        Whether the plane records images in these.
    """

    depth: np.ndarray
    chains: np.ndarray
    images: bool = True

    def steps(self, reach: float) -> np.ndarray:
        """Step of the depth limit for each tile, see `limit_of`; -1 where no rays are needed.

        Parameters
        ----------
        reach : float
            Reach of the lattice at the whole limit, pixels.
        """
        max_step = np.where(
            self.chains & self.images,
            *(max(0, 2 * math.log2(reach / minimum)) for minimum in (IMAGE_REACH, MIN_DIRECTIONS[0])),
        )
        # a surface between the rays may lie a little farther
        part = np.minimum((self.depth + 2) / DEPTHS, 1.0)
        step = np.minimum(np.minimum(-2 * np.log2(part), max_step), STEPS).astype(int)
        return np.where(self.depth == 0, -1, step)


def limit_of(step: ArrayLike, depth_limit: float) -> Any:
    """Depth limit of a step, where step 0 has the whole `depth_limit`, meters."""
    return depth_limit * 2.0 ** (-0.5 * step)


def tiles_of(width: int, height: int) -> tuple[int, int]:
    """Rows and columns of tiles of a plane, whose width and height are pixels."""
    return -(-height // TILE), -(-width // TILE)


def regions_of(
    sightings: Sightings, width: int, height: int, depth_limit: float, reach: float
) -> list[Region]:
    """Find the regions of a plane, those with most rays first.

    Parameters
    ----------
    sightings : Sightings
    width, height : int
        Pixels of the plane.
    depth_limit : float
        Maximum distance of a surface from the plane, meters.
    reach : float
        Reach of the plane's lattice, pixels.

    Returns
    -------
    list of Region
    """
    steps = sightings.steps(reach)
    kinds = np.where(steps < 0, -1, 2 * steps + ~sightings.chains)
    # pixels tile by tile, so that their rays stay near each other
    rows, columns = steps.shape
    number = np.arange(width * height, dtype=np.uint32).reshape(height, width)
    padded = np.pad(
        number, ((0, rows * TILE - height), (0, columns * TILE - width)), constant_values=2**32 - 1
    )
    blocks = padded.reshape(rows, TILE, columns, TILE).swapaxes(1, 2).reshape(rows, columns, -1)
    regions = []
    for kind in np.unique(kinds[kinds >= 0]):
        pixels = blocks[kinds == kind].ravel()
        pixels = pixels[pixels != 2**32 - 1]
        regions.append(Region(pixels, limit_of(kind // 2, depth_limit), kind % 2 == 0))
    return regions
