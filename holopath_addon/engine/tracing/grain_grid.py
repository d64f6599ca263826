"""Cells that the radiance of grains is averaged over (stage s5)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

BINNED = 8 / (
    3 * math.pi
)  # of the pupil's radius: the outer bins' centroids then are where interpolation puts them


@dataclass(frozen=True)
class GrainGrid:
    """Cells that a grain's radiance is averaged over: pixel columns, depth slabs and pupil bins.

    Attributes
    ----------
    width, height : int
        The hologram's pixels.
    margin : int
        Pixels beyond the hologram's edge on every side that steep rays reach.
    slabs, bins : int
        Depth slabs between `z_low` and `z_high` (metres from the SLM), and bins along each axis of the pupil,
        which is `max_slope` in radius; cells of diffuse surfaces have one bin.
    branches : int
        Specular branches that are kept apart.
    """

    width: int
    height: int
    margin: int
    slabs: int
    bins: int
    z_low: float
    z_high: float
    max_slope: float
    branches: int = 1
    _kept: tuple = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # no literals: one program for all grids; made here, for within a loop nothing can be
        whole = (self.margin, self.columns, self.rows, self.slabs)
        scale = self.slabs / max(self.z_high - self.z_low, 1e-12)
        kept = [dr.opaque(mi.Int, n) for n in whole], [dr.opaque(mi.Float, x) for x in (self.z_low, scale)]
        object.__setattr__(self, "_kept", kept)

    @property
    def columns(self) -> int:
        """Pixels along x, margins included."""
        return self.width + 2 * self.margin

    @property
    def rows(self) -> int:
        """Pixels along y, margins included."""
        return self.height + 2 * self.margin

    def cell(self, column: mi.Int, row: mi.Int, z: mi.Float, branch: mi.UInt32) -> tuple[mi.UInt32, mi.Bool]:
        """Number of the column, slab and branch of a grain, and whether it lies on the grid (Dr.Jit types)."""
        (margin, columns, rows, slabs), (z_low, scale) = self._kept
        column, row = column + margin, row + margin
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        slab = dr.clip(mi.Int((z - z_low) * scale), 0, slabs - 1) + mi.Int(branch) * slabs
        return mi.UInt32((slab * rows + row) * columns + column), inside

    def bin_place(self, slope: mi.Float) -> mi.Float:
        """Where a slope lies along one axis of the pupil, in bins from the centre of the first."""
        return dr.clip((slope / (BINNED * self.max_slope) + 1) * (0.5 * self.bins) - 0.5, 0, self.bins - 1)
