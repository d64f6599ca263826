"""Takes noise out of the radiance map: neighbouring grains of one surface share their light.

What is shared is light over reflectance, so that textures stay sharp. Paths come in two halves that know nothing of
each other. Where the means of one half say that two grains differ by no more than noise, the other half's light is
averaged over both, and the other way round (Rousselle, Knaus and Zwicker, ACM Trans. Graph. 31(6), 2012; weights as of
non-local means). So noise does not choose what it is averaged with.
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
    from .grain_grid import GrainGrid

WIDTH = 2.0  # columns: standard deviation of the Gaussian
# Standard deviations that two grains may differ by beyond what noise makes them: with those around them, and alone,
# for lines of a column's width
STRICT, ALONE = 0.7, 1.5
# What two programs may make of the same numbers, relatively: light without noise is the same then, too.
ROUNDING = 1e-6
LEAST = 1e-30


@dataclass(frozen=True)
class Half:
    """What every second path tells of each row of the radiance map: sums (Dr.Jit types).

    Attributes
    ----------
    light, shown : mitsuba.Color3f
        Radiances, and reflectances where they come from.
    count : mitsuba.Float
        Paths.
    square : mitsuba.Float
        Squares of light over reflectance, of all channels.
    """

    light: mi.Color3f
    shown: mi.Color3f
    count: mi.Float
    square: mi.Float

    def __add__(self, other: Half) -> Half:
        return Half.of([mine + its for mine, its in zip(self.numbers, other.numbers, strict=True)])

    @property
    def radiance(self) -> mi.Color3f:
        """Mean."""
        return self.light / dr.maximum(self.count, LEAST)

    @property
    def reflectance(self) -> mi.Color3f:
        """Mean."""
        return self.shown / dr.maximum(self.count, LEAST)

    @property
    def over(self) -> mi.Color3f:
        """Light over reflectance."""
        return self.light / dr.maximum(self.shown, LEAST)

    @property
    def variance(self) -> mi.Float:
        """Of light over reflectance, of the mean of these paths."""
        paths = dr.maximum(self.count, LEAST)
        return dr.maximum(self.square / paths - dr.squared_norm(self.over), 0) / paths

    @classmethod
    def path(cls, light: mi.Color3f, reflectance: mi.Color3f) -> Half:
        """Of one path."""
        return cls(light, reflectance, mi.Float(1), dr.squared_norm(light / dr.maximum(reflectance, LEAST)))

    @classmethod
    def of(cls, values: Sequence[mi.Float]) -> Half:
        """From the numbers of `numbers`."""
        return cls(mi.Color3f(*values[:3]), mi.Color3f(*values[3:6]), *values[6:])

    @property
    def numbers(self) -> tuple[mi.Float, ...]:
        """All of them."""
        return (*self.light, *self.shown, self.count, self.square)


Halves = tuple[Half, Half]


def filtered(
    halves: Halves,
    cells: mi.UInt32,
    numbers: mi.UInt32,
    grid: GrainGrid,
    reach: int,
    progress: PartProgress,
) -> tuple[Halves, mi.Bool]:
    """Sums of each row and of rows near it that are like it.

    Light and reflectance are summed each for itself: what rows share adds up to the light that their paths brought.

    Parameters
    ----------
    halves : Halves
    cells : mitsuba.UInt32
        Those of the grid whose rows share their light, each pupil bin with the same bin of others.
    numbers : mitsuba.UInt32
        As of `RadianceMap`.
    grid : GrainGrid
    reach : int
        Columns to either side.
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    Halves
        Counts are weighted ones.
    shared : mitsuba.Bool
        Which rows these are; the others have their own sums.
    """
    rows = _Rows(cells, numbers, grid, dr.width(halves[0].count))
    own = halves[0].numbers, halves[1].numbers
    size = len(own[0])
    table = _table([*own[0], *own[1]])

    def at(row, there):
        values = [dr.select(there, value, 0) for value in gather_row(table, row, 2 * size)]
        return Half.of(values[:size]), Half.of(values[size:])

    def gathered(step, first, second):
        """Sums of 3 x 3 columns and 3 slabs."""
        beside = at(*rows.beside(step % 3 - 1, step // 3 % 3 - 1, step // 9 - 1))
        first, second = (
            (Half.of(total) + half).numbers for total, half in zip((first, second), beside, strict=True)
        )
        return step + 1, first, second

    side = 2 * reach + 1
    steps = 27 + 3 * side**2

    def summed(body, count, before, label):
        """Sums of all steps, some of them at a time."""
        sums = [tuple(dr.opaque(mi.Float, 0, rows.size) for _ in range(size)) for _ in range(2)]
        for some in paced(range(count), count, side):
            state, stop = (dr.opaque(mi.Int, some.start, rows.size), *sums), dr.opaque(mi.Int, some.stop)
            _, *sums = dr.while_loop(state, lambda step, *_, stop=stop: step < stop, body, label=label)
            dr.eval(sums)
            dr.sync_thread()
            progress((before + some.stop) / steps)
        return sums

    sums = summed(gathered, 27, 0, "guides of the radiance map")
    around = [Half.of(values) for values in sums]
    guide, noise = [half.over for half in around], [half.variance for half in around]
    told = (around[0].count > 1) & (around[1].count > 1)
    of_path = [half.variance * half.count for half in around]
    guides = _table([*guide[0], noise[0], of_path[0], *guide[1], noise[1], of_path[1]])
    middle = reach + side * (reach + side)

    def averaged(step, first, second):
        over, up, slab = step % side - reach, step // side % side - reach, step // side**2 - 1
        row, there = rows.beside(over, up, slab)
        there &= told | (step == middle)
        values, its = gather_row(guides, row, 10), at(row, there)
        near = dr.exp(mi.Float(over * over + up * up) * (-0.5 / WIDTH**2))

        def weight(k):
            """By what half number k says."""
            mine, other = halves[k], its[k]
            color, variance, each = (
                mi.Color3f(*values[5 * k : 5 * k + 3]),
                values[5 * k + 3],
                values[5 * k + 4],
            )
            alike = _alike(guide[k], noise[k], color, variance, STRICT)
            variances = of_path[k] / mine.count, each / other.count
            alone = _alike(mine.over, variances[0], other.over, variances[1], ALONE)
            return near * dr.select((mine.count > 0) & (other.count > 0), alike * alone, alike)

        sums = (
            tuple(total + weight * value for total, value in zip(totals, half.numbers, strict=True))
            for totals, weight, half in zip((first, second), (weight(1), weight(0)), its, strict=True)
        )
        return step + 1, *sums

    sums = summed(averaged, 3 * side**2, 27, "filter of the radiance map")
    kept = [
        Half.of([dr.select(rows.shared, value, alone) for value, alone in zip(values, alone_, strict=True)])
        for values, alone_ in zip(sums, own, strict=True)
    ]
    dr.eval(kept, rows.shared)
    return (kept[0], kept[1]), rows.shared


def squared_error(halves: Halves, kept: Halves) -> mi.Float:
    """Squared error of `Half.over` of the sum of `kept`, the filter's result, of each row; right on average, not row by
    row.

    A filtered half f_a errs by noise and by what was averaged that differs. As it does not know the other half b,
    (f_a - b)^2 is on average that difference squared and the variances of f_a and b; those are half of (f_a - f_b)^2
    and of (a - b)^2.
    """
    (a, b), (f_a, f_b) = ([half.over for half in pair] for pair in (halves, kept))
    apart = 0.5 * (dr.squared_norm(f_a - b) + dr.squared_norm(f_b - a) - dr.squared_norm(a - b))
    both = (halves[0].count > 0) & (halves[1].count > 0)
    return dr.select(both, apart - 0.25 * dr.squared_norm(f_a - f_b), 0)


def _alike(mine, noise, other, its_noise, strict):
    """Weight of a grain that another was found for, from 0 to 1."""
    beyond = dr.squared_norm(mine - other) - (noise + dr.minimum(noise, its_noise))
    scale = strict**2 * (noise + its_noise) + ROUNDING**2 * dr.squared_norm(mine) + LEAST
    return dr.exp(-dr.maximum(beyond, 0) / scale)


def _table(columns):
    """Numbers of each row, as `gather_row` reads them."""
    size, stride = max(dr.width(value) for value in columns), row_stride(len(columns))
    table, row = dr.zeros(mi.Float, stride * size), dr.arange(mi.UInt32, size)
    for k, value in enumerate(columns):
        dr.scatter(table, value, stride * row + k)
    dr.eval(table)
    return table


class _Rows:
    """Where the rows of a radiance map lie on its grid, and which lie beside them."""

    def __init__(self, cells, numbers, grid, size):
        self.size, self._numbers = size, numbers
        # of rows of no such cell: not on the grid
        self._cell = dr.full(mi.UInt32, dr.width(numbers), size)
        number = dr.gather(mi.UInt32, numbers, cells)
        for k in range(grid.bins**2):
            dr.scatter(self._cell, cells, (number >> 1) + k, (number & 1) == 1 if k else True)
        dr.eval(self._cell)
        self._columns, self._lines, self._slabs = (
            dr.opaque(mi.Int, n) for n in (grid.columns, grid.rows, grid.slabs)
        )
        line = mi.Int(self._cell) // self._columns
        slab = line // self._lines
        self._column, self._line = mi.Int(self._cell) % self._columns, line % self._lines
        self._slab, self._first = slab % self._slabs, slab - slab % self._slabs
        self.shared = self._cell < mi.UInt32(dr.opaque(mi.UInt32, dr.width(numbers)))
        own = dr.gather(mi.UInt32, numbers, self._cell, self.shared)
        self._bin, self._binned = dr.arange(mi.UInt32, size) - (own >> 1), own & 1

    def beside(self, over, down, slab):
        """Row so many columns, rows and slabs away, and whether there is one."""
        column, line, slab = self._column + over, self._line + down, self._slab + slab
        there = self.shared & (column >= 0) & (column < self._columns)
        there &= (line >= 0) & (line < self._lines) & (slab >= 0) & (slab < self._slabs)
        cell = mi.UInt32(((self._first + slab) * self._lines + line) * self._columns + column)
        number = dr.gather(mi.UInt32, self._numbers, cell, there)
        there &= (number & 1) == self._binned
        row = (number >> 1) + self._bin
        # other cells may have borrowed a neighbour's row
        return row, there & (dr.gather(mi.UInt32, self._cell, row, there) == cell)
