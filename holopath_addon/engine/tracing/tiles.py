"""Surfaces that rays meet as seen from the tiles of recording planes, for `regions`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.rays import OUTSIDE
from .regions import DEPTHS, TILE, Sightings, tiles_of
from .row_sums import ATOMIC

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..plan import RecordingPlane
    from ..scene.rays import Rays
    from .grain_grid import GrainGrid
    from .grains import Grains


class Tiles:
    """Tiles of recording planes, which take in the grains that rays met.

    Parameters
    ----------
    grid : GrainGrid
    rays : Rays
        Rays that meet the grains.
    planes : sequence of RecordingPlane
    """

    def __init__(self, grid: GrainGrid, rays: Rays, planes: Sequence[RecordingPlane]) -> None:
        self._shape, self._planes = tiles_of(grid.width, grid.height), planes
        self._width, self._height, self._across = (
            dr.opaque(mi.Int, number) for number in (grid.width, grid.height, self._shape[1])
        )
        self._pitch, self._from = rays.pitch, rays.plane
        tiles = self._shape[0] * self._shape[1]
        self._firsts = [dr.opaque(mi.UInt32, number * tiles) for number in range(len(planes))]
        self._bounds = [
            [
                dr.opaque(mi.Float, float(number))
                for number in (plane.z, plane.depth_limit, *_ends(plane.slab), *_ends(plane.images))
            ]
            for plane in planes
        ]

    def zeros(self) -> dict[str, mi.UInt32]:
        """Maxima without any grain: ``depth`` and ``chains`` of all tiles."""
        count = len(self._planes) * self._shape[0] * self._shape[1]
        return {name: dr.zeros(mi.UInt32, max(1, count)) for name in ("depth", "chains")}

    def add(self, grains: Grains, lit: mi.Bool, maxima: dict[str, mi.UInt32]) -> None:
        """Take grains into the maxima; `lit` is true where they send light."""
        z, first = self._from + grains.dz, self._from + grains.first
        for number, (plane, limit, far, near, images_far, images_near) in enumerate(self._bounds):
            walk = (plane - self._from) / self._pitch
            column = mi.Int(dr.round(grains.column + grains.slope.x * walk))
            row = mi.Int(dr.round(grains.row - grains.slope.y * walk))
            inside = (column >= 0) & (column < self._width) & (row >= 0) & (row < self._height)
            inside &= (first > far) & (first < near)
            recorded = inside & lit & (z > images_far) & (z < images_near)
            if self._planes[number].sees != "all":
                recorded &= (grains.point.hits > 0) == (self._planes[number].sees == "images")
            tile = mi.UInt32(row // TILE * self._across + column // TILE) + self._firsts[number]
            part = 1 + mi.UInt32(dr.minimum(dr.abs(z - plane) / limit, 1) * (DEPTHS - 1))
            dr.scatter_reduce(dr.ReduceOp.Max, maxima["depth"], part, tile, recorded, mode=ATOMIC)
            chained = inside & (grains.point.hits > 0)
            dr.scatter_reduce(dr.ReduceOp.Max, maxima["chains"], mi.UInt32(1), tile, chained, mode=ATOMIC)

    def sightings(self, maxima: dict[str, mi.UInt32]) -> tuple[Sightings, ...]:
        """Sightings from each plane by the maxima of `add`."""
        shape = (len(self._planes), *self._shape)
        depth, chains = (
            np.array(maxima[name])[: math.prod(shape)].reshape(shape) for name in ("depth", "chains")
        )
        images = [plane.sees != "surfaces" for plane in self._planes]
        return tuple(map(Sightings, depth, chains > 0, images))


def _ends(slab):
    """Outer ends of a slab, finite."""
    return np.clip((slab.far[0], slab.near[1]), -OUTSIDE, OUTSIDE)
