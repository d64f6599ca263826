"""Cells that the radiance of grains is averaged over, and their rows in the radiance map (stage s5)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

# Half width of the bins together, as a fraction of the pupil's radius: the outer bins' centroids then are where
# interpolation puts them.
BINNED = 8 / (3 * math.pi)


@dataclass(frozen=True)
class GrainGrid:
    """Grid of cells that a grain's radiance is averaged over: pixel columns, depth slabs and pupil bins.

    Attributes
    ----------
    width, height : int
        The hologram's pixels.
    margin : int
        Pixels beyond the hologram's edge on every side that steep rays reach.
    slabs, bins : int
        Depth slabs between `z_low` and `z_high` (meters from the SLM), and bins along each axis of the pupil,
        which is `max_slope` in radius; cells of diffuse surfaces have one bin.
    branches : int
        Specular branches, each with cells of its own.
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
        # opaque: one compiled program for all grids; made here, as opaque numbers cannot be made within a loop
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
        """Cell of a grain at a column, row, z (meters) and branch, and whether it lies on the grid (Dr.Jit types)."""
        (margin, columns, rows, slabs), (z_low, scale) = self._kept
        column, row = column + margin, row + margin
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        slab = dr.clip(mi.Int((z - z_low) * scale), 0, slabs - 1) + mi.Int(branch) * slabs
        return mi.UInt32((slab * rows + row) * columns + column), inside

    def bin_place(self, slope: mi.Float) -> mi.Float:
        """Position of a slope along one axis of the pupil, in bins from the center of the first."""
        return dr.clip((slope / (BINNED * self.max_slope) + 1) * (0.5 * self.bins) - 0.5, 0, self.bins - 1)


@dataclass(frozen=True)
class RowIndex:
    """Rows of the radiance map that belong to each cell of a grid: none, one, or one per pupil bin.

    Attributes
    ----------
    words : mitsuba.UInt32
        First row and number of rows of each cell in one word, so that a ray fetches both at once. Read it by `at`,
        `first` and `binned` only.
    rows : int
        Rows in all, with row 0 for rays that meet no surface.
    """

    words: mi.UInt32
    rows: int

    @classmethod
    def of(cls, occupied: mi.UInt32, grid: GrainGrid) -> RowIndex:
        """Number the rows of the occupied cells; each other cell borrows those of a neighbor, or has row 0.

        Parameters
        ----------
        occupied : mitsuba.UInt32
            Rows that each cell of the grid needs: 0, 1 or the number of pupil bins.
        grid : GrainGrid
        """
        ends = dr.cumsum(occupied)
        rows = int(ends[dr.width(ends) - 1]) + 1
        words = 2 * (ends - occupied + 1) + dr.select(occupied > 1, mi.UInt32(1), 0)
        words = dr.select(occupied != 0, words, 0)
        dr.eval(words)
        cell = dr.arange(mi.Int, dr.width(words))
        columns, lines, slabs = (dr.opaque(mi.Int, size) for size in (grid.columns, grid.rows, grid.slabs))
        column, line, slab = cell % columns, cell // columns % lines, cell // (columns * lines) % slabs
        filled = mi.UInt32(words)
        axes = (slab, slabs, columns * lines), (column, columns, 1), (line, lines, columns)
        for position, size, step in axes:
            for side in (-1, 1):
                empty = (position + side >= 0) & (position + side < size) & (filled == 0)
                borrowed = dr.gather(mi.UInt32, words, mi.UInt32(cell + side * step), empty)
                filled = dr.select(empty, borrowed, filled)
        dr.eval(filled)
        return cls(filled, rows)

    def at(self, cell: mi.UInt32, active: mi.Bool | bool = True) -> tuple[mi.UInt32, mi.Bool]:
        """First row of each cell, where active, and whether it has a row for each pupil bin."""
        word = dr.gather(mi.UInt32, self.words, cell, active)
        return word >> 1, (word & 1) == 1

    @property
    def first(self) -> mi.UInt32:
        """First row of every cell."""
        return self.words >> 1

    @property
    def binned(self) -> mi.Bool:
        """Whether each cell has a row for each pupil bin."""
        return (self.words & 1) == 1
