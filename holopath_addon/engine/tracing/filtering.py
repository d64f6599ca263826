"""Noise filter of the radiance map: neighboring grains of one surface share their light.

They share light over reflectance, so that textures stay sharp. Paths come in two independent halves. Where the means
of one half show that two grains differ by no more than noise, the other half's light is averaged over both, and vice
versa (Rousselle, Knaus and Zwicker, ACM Trans. Graph. 31(6), 2012; weights of non-local means). So a half's own noise
does not decide its weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..progress import paced
from ..scene.buffers import gather_row, row_stride

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..progress import PartProgress
    from .grain_grid import GrainGrid, RowIndex

WIDTH = 2.0  # standard deviation of the Gaussian, columns
# Tolerated difference of two grains beyond noise, in standard deviations: of means with the grains around them, and of
# the grains alone, for lines of a column's width.
STRICT, ALONE = 0.7, 1.5
ROUNDING = 1e-6  # relative rounding error between two compiled programs: light without noise counts as equal
TINY = 1e-30  # avoids divisions by zero


@dataclass(frozen=True)
class Half:
    """Sums over every second path for each row of the radiance map (Dr.Jit types).

    Attributes
    ----------
    light, reflected : mitsuba.Color3f
        Sums of radiances, and of the reflectances of the surfaces that they come from.
    count : mitsuba.Float
        Paths.
    square : mitsuba.Float
        Sum of squares of light over reflectance, over all channels.
    """

    light: mi.Color3f
    reflected: mi.Color3f
    count: mi.Float
    square: mi.Float

    def __add__(self, other: Half) -> Half:
        return Half.of([mine + its for mine, its in zip(self.values, other.values, strict=True)])

    @property
    def radiance(self) -> mi.Color3f:
        """Mean radiance."""
        return self.light / dr.maximum(self.count, TINY)

    @property
    def reflectance(self) -> mi.Color3f:
        """Mean reflectance."""
        return self.reflected / dr.maximum(self.count, TINY)

    @property
    def irradiance(self) -> mi.Color3f:
        """Light over reflectance, up to a factor the irradiance."""
        return self.light / dr.maximum(self.reflected, TINY)

    @property
    def variance(self) -> mi.Float:
        """Variance of `irradiance`, as a mean over these paths."""
        paths = dr.maximum(self.count, TINY)
        return dr.maximum(self.square / paths - dr.squared_norm(self.irradiance), 0) / paths

    @classmethod
    def path(cls, light: mi.Color3f, reflectance: mi.Color3f) -> Half:
        """Sums of one path."""
        return cls(light, reflectance, mi.Float(1), dr.squared_norm(light / dr.maximum(reflectance, TINY)))

    @classmethod
    def of(cls, values: Sequence[mi.Float]) -> Half:
        """Sums from numbers in the order of `values`."""
        return cls(mi.Color3f(*values[:3]), mi.Color3f(*values[3:6]), *values[6:])

    @property
    def values(self) -> tuple[mi.Float, ...]:
        """All sums, as numbers."""
        return (*self.light, *self.reflected, self.count, self.square)


Halves = tuple[Half, Half]


def share_light(
    halves: Halves,
    cells: mi.UInt32,
    index: RowIndex,
    grid: GrainGrid,
    reach: int,
    progress: PartProgress,
) -> tuple[Halves, mi.Bool]:
    """Add to the sums of each row those of similar rows nearby.

    Light and reflectance are summed separately: what rows share adds up to the light that their paths brought.

    Parameters
    ----------
    halves : Halves
    cells : mitsuba.UInt32
        Cells of the grid whose rows share their light, each pupil bin with the same bin of others.
    index : RowIndex
    grid : GrainGrid
    reach : int
        Columns to either side.
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    Halves
        Weighted sums, counts included.
    shared : mitsuba.Bool
        Whether a row shares its light; the others keep their own sums.
    """
    rows = _Neighbors(cells, index, grid, dr.width(halves[0].count))
    first_half, second_half = halves[0].values, halves[1].values
    size = len(first_half)
    table = _table([*first_half, *second_half])

    def at(row, valid):
        values = [dr.select(valid, value, 0) for value in gather_row(table, row, 2 * size)]
        return Half.of(values[:size]), Half.of(values[size:])

    def add_neighbor(step, first, second):
        """Add up 3 x 3 columns and 3 slabs."""
        neighbor = at(*rows.at(step % 3 - 1, step // 3 % 3 - 1, step // 9 - 1))
        first, second = (
            (Half.of(total) + half).values for total, half in zip((first, second), neighbor, strict=True)
        )
        return step + 1, first, second

    side = 2 * reach + 1
    steps = 27 + 3 * side**2

    def summed(body, count, before, label):
        """Run a loop of `count` steps, some of them at a time, for its sums."""
        sums = [tuple(dr.opaque(mi.Float, 0, rows.size) for _ in range(size)) for _ in range(2)]
        for some in paced(range(count), count, side):
            state, stop = (dr.opaque(mi.Int, some.start, rows.size), *sums), dr.opaque(mi.Int, some.stop)
            _, *sums = dr.while_loop(state, lambda step, *_, stop=stop: step < stop, body, label=label)
            dr.eval(sums)
            dr.sync_thread()
            progress((before + some.stop) / steps)
        return sums

    sums = summed(add_neighbor, 27, 0, "guides of the radiance map")
    around = [Half.of(values) for values in sums]
    guide, noise = [half.irradiance for half in around], [half.variance for half in around]
    comparable = (around[0].count > 1) & (around[1].count > 1)
    path_variance = [half.variance * half.count for half in around]
    guides = _table([*guide[0], noise[0], path_variance[0], *guide[1], noise[1], path_variance[1]])
    middle = reach + side * (reach + side)

    def add_weighted(step, first, second):
        """Add a neighbor, each half by the weight of the other."""
        over, up, slab = step % side - reach, step // side % side - reach, step // side**2 - 1
        row, valid = rows.at(over, up, slab)
        valid &= comparable | (step == middle)
        values, its = gather_row(guides, row, 10), at(row, valid)
        near = dr.exp(mi.Float(over * over + up * up) * (-0.5 / WIDTH**2))

        def weight(k):
            """Weight by half number k."""
            mine, other = halves[k], its[k]
            color, variance, its_path_variance = (
                mi.Color3f(*values[5 * k : 5 * k + 3]),
                values[5 * k + 3],
                values[5 * k + 4],
            )
            alike = _similarity(guide[k], noise[k], color, variance, STRICT)
            variances = path_variance[k] / mine.count, its_path_variance / other.count
            alone = _similarity(mine.irradiance, variances[0], other.irradiance, variances[1], ALONE)
            return near * dr.select((mine.count > 0) & (other.count > 0), alike * alone, alike)

        sums = (
            tuple(total + weight * value for total, value in zip(totals, half.values, strict=True))
            for totals, weight, half in zip((first, second), (weight(1), weight(0)), its, strict=True)
        )
        return step + 1, *sums

    sums = summed(add_weighted, 3 * side**2, 27, "filter of the radiance map")
    filtered = [
        Half.of([dr.select(rows.shared, value, alone) for value, alone in zip(values, alone_, strict=True)])
        for values, alone_ in zip(sums, (first_half, second_half), strict=True)
    ]
    dr.eval(filtered, rows.shared)
    return (filtered[0], filtered[1]), rows.shared


def squared_error(halves: Halves, filtered: Halves) -> mi.Float:
    """Squared error of the filter's `Half.irradiance` in each row; right on average, not row by row.

    A filtered half f_a errs by noise and by averaging over grains that differ. As it is independent of the other half
    b, (f_a - b)^2 is on average that difference squared and the variances of f_a and b; those are half of (f_a - f_b)^2
    and of (a - b)^2.

    Parameters
    ----------
    halves, filtered : Halves
        Before and after `share_light`.
    """
    (a, b), (f_a, f_b) = ([half.irradiance for half in pair] for pair in (halves, filtered))
    apart = 0.5 * (dr.squared_norm(f_a - b) + dr.squared_norm(f_b - a) - dr.squared_norm(a - b))
    both = (halves[0].count > 0) & (halves[1].count > 0)
    return dr.select(both, apart - 0.25 * dr.squared_norm(f_a - f_b), 0)


def _similarity(mine, noise, other, its_noise, strict):
    """Weight of a grain for another one, 0 to 1, by their values and variances."""
    beyond = dr.squared_norm(mine - other) - (noise + dr.minimum(noise, its_noise))
    scale = strict**2 * (noise + its_noise) + ROUNDING**2 * dr.squared_norm(mine) + TINY
    return dr.exp(-dr.maximum(beyond, 0) / scale)


def _table(columns):
    """Table of columns, in rows that `gather_row` reads."""
    size, stride = max(dr.width(value) for value in columns), row_stride(len(columns))
    table, row = dr.zeros(mi.Float, stride * size), dr.arange(mi.UInt32, size)
    for k, value in enumerate(columns):
        dr.scatter(table, value, stride * row + k)
    dr.eval(table)
    return table


class _Neighbors:
    """Positions of a radiance map's rows on its grid, and the rows beside them."""

    def __init__(self, cells, index, grid, size):
        self.size, self._index = size, index
        outside = dr.width(index.words)  # stands for a row that shares nothing
        self._cell = dr.full(mi.UInt32, outside, size)
        first, binned = index.at(cells)
        for k in range(grid.bins**2):
            dr.scatter(self._cell, cells, first + k, binned if k else True)
        dr.eval(self._cell)
        self._columns, self._lines, self._slabs = (
            dr.opaque(mi.Int, n) for n in (grid.columns, grid.rows, grid.slabs)
        )
        line = mi.Int(self._cell) // self._columns
        slab = line // self._lines
        self._column, self._line = mi.Int(self._cell) % self._columns, line % self._lines
        self._slab, self._first_slab = slab % self._slabs, slab - slab % self._slabs
        self.shared = self._cell < mi.UInt32(dr.opaque(mi.UInt32, outside))
        first, self._binned = index.at(self._cell, self.shared)
        self._bin = dr.arange(mi.UInt32, size) - first

    def at(self, over, down, slab):
        """Row some columns, rows and slabs away, and whether there is one."""
        column, line, slab = self._column + over, self._line + down, self._slab + slab
        valid = self.shared & (column >= 0) & (column < self._columns)
        valid &= (line >= 0) & (line < self._lines) & (slab >= 0) & (slab < self._slabs)
        cell = mi.UInt32(((self._first_slab + slab) * self._lines + line) * self._columns + column)
        first, binned = self._index.at(cell, valid)
        valid &= binned == self._binned
        row = first + self._bin
        # other cells may have borrowed a neighbor's row
        return row, valid & (dr.gather(mi.UInt32, self._cell, row, valid) == cell)
