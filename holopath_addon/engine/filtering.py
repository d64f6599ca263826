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

from .buffers import gather_row

if TYPE_CHECKING:
    from .grains import GrainGrid

WIDTH, REACH = 2.0, 4  # columns: standard deviation of the Gaussian, and where it ends
STRICT = 0.7  # standard deviations that two grains may differ by beyond what noise makes them
SAME = 1e-2  # relative difference that always may be
ROW = (
    8  # numbers of each row in tables: light of both halves, three channels each, and one more number of each
)


@dataclass(frozen=True)
class Halves:
    """Light over reflectance of each row of the radiance map, by every second path (Dr.Jit types).

    Attributes
    ----------
    light : (mitsuba.Color3f, mitsuba.Color3f)
    count : (mitsuba.Float, mitsuba.Float)
        Paths.
    """

    light: tuple[mi.Color3f, mi.Color3f]
    count: tuple[mi.Float, mi.Float]

    @property
    def mean(self) -> mi.Color3f:
        """Light of all paths."""
        (a, b), (m, n) = self.light, self.count
        return (a * m + b * n) / dr.maximum(m + n, 1e-30)

    @property
    def both(self) -> mi.Bool:
        """Which rows both halves tell of."""
        return (self.count[0] > 0) & (self.count[1] > 0)


def filtered(halves: Halves, cells: mi.UInt32, numbers: mi.UInt32, grid: GrainGrid) -> Halves:
    """Each row's light averaged with that of rows near it.

    Parameters
    ----------
    halves : Halves
    cells : mitsuba.UInt32
        Those of the grid whose rows share their light, one row each. Where highlights are seen light is not in
        proportion to reflectance.
    numbers : mitsuba.UInt32
        As of `RadianceMap`.
    grid : GrainGrid

    Returns
    -------
    Halves
        Counts are weighted ones.
    """
    rows = _Rows(cells, numbers, grid, dr.width(halves.count[0]))
    table = _table(halves.light, halves.count)

    def gathered(step, light, count, variance, known):
        """Means of 3 x 3 columns and 3 slabs, and the mean variance of one path there."""
        row, there = rows.beside(step % 3 - 1, step // 3 % 3 - 1, step // 9 - 1)
        a, m, b, n = _row(table, row, there)
        two = there & (m > 0) & (n > 0)
        one = dr.squared_norm(a - b) / (dr.rcp(dr.maximum(m, 1)) + dr.rcp(dr.maximum(n, 1)))
        variance, known = variance + dr.select(two, one, 0), known + dr.select(two, mi.Float(1), 0)
        light, count = (light[0] + a * m, light[1] + b * n), (count[0] + m, count[1] + n)
        return step + 1, light, count, variance, known

    state = (
        dr.zeros(mi.Int, rows.size),
        (mi.Color3f(0), mi.Color3f(0)),
        (mi.Float(0), mi.Float(0)),
        mi.Float(0),
        mi.Float(0),
    )
    _, light, count, variance, known = dr.while_loop(
        state, lambda step, *_: step < 27, gathered, label="guides of the radiance map"
    )
    variance /= dr.maximum(known, 1)
    guide = [total / dr.maximum(number, 1) for total, number in zip(light, count, strict=True)]
    noise = [variance / dr.maximum(number, 1) for number in count]
    told, guides, side = (count[0] > 0) & (count[1] > 0), _table(guide, noise), 2 * REACH + 1
    middle = REACH + side * (REACH + side)

    def averaged(step, light, count):
        over, up, slab = step % side - REACH, step // side % side - REACH, step // side**2 - 1
        row, there = rows.beside(over, up, slab)
        there &= told | (step == middle)
        a, m, b, n = _row(table, row, there)
        guide_a, noise_a, guide_b, noise_b = _row(guides, row, there)
        near = dr.exp(mi.Float(over * over + up * up) * (-0.5 / WIDTH**2))
        m *= near * _alike(guide[1], noise[1], guide_b, noise_b)
        n *= near * _alike(guide[0], noise[0], guide_a, noise_a)
        return step + 1, (light[0] + a * m, light[1] + b * n), (count[0] + m, count[1] + n)

    _, light, count = dr.while_loop(
        state[:3], lambda step, *_: step < 3 * side**2, averaged, label="filter of the radiance map"
    )
    light = tuple(
        dr.select(rows.shared, total / dr.maximum(number, 1e-30), own)
        for total, number, own in zip(light, count, halves.light, strict=True)
    )
    count = tuple(
        dr.select(rows.shared, number, own) for number, own in zip(count, halves.count, strict=True)
    )
    dr.eval(light, count)
    return Halves(light, count)


def squared_error(halves: Halves, kept: Halves) -> mi.Float:
    """Squared error of the mean of `kept`, the filter's result, of each row; right on average, not row by row.

    A filtered half f_a errs by noise and by what was averaged that differs. As it does not know the other half b,
    (f_a - b)^2 is on average that difference squared and the variances of f_a and b; those are half of (f_a - f_b)^2
    and of (a - b)^2.
    """
    (a, b), (f_a, f_b) = halves.light, kept.light
    apart = 0.5 * (dr.squared_norm(f_a - b) + dr.squared_norm(f_b - a) - dr.squared_norm(a - b))
    return dr.select(halves.both, apart - 0.25 * dr.squared_norm(f_a - f_b), 0)


def _alike(mine, noise, other, its_noise):
    """Weight of a grain whose guide is another, from 0 to 1."""
    beyond = dr.squared_norm(mine - other) - (noise + dr.minimum(noise, its_noise))
    scale = STRICT**2 * (noise + its_noise) + SAME**2 * dr.squared_norm(mine) + 1e-20
    return dr.exp(-dr.maximum(beyond, 0) / scale)


def _table(light, more):
    size = max(dr.width(value) for value in (*light, *more))
    table, row = dr.zeros(mi.Float, ROW * size), dr.arange(mi.UInt32, size)
    for k, value in enumerate((*light[0], more[0], *light[1], more[1])):
        dr.scatter(table, value, ROW * row + k)
    dr.eval(table)
    return table


def _row(table, row, there):
    values = [dr.select(there, value, 0) for value in gather_row(table, row, ROW)]
    return mi.Color3f(*values[:3]), values[3], mi.Color3f(*values[4:7]), values[7]


class _Rows:
    """Where the rows of a radiance map lie on its grid, and which lie beside them."""

    def __init__(self, cells, numbers, grid, size):
        self.size, self._numbers = size, numbers
        # of rows of no such cell: not on the grid
        self._cell = dr.full(mi.UInt32, dr.width(numbers), size)
        dr.scatter(self._cell, cells, dr.gather(mi.UInt32, numbers, cells) >> 1)
        dr.eval(self._cell)
        self._columns, self._lines, self._slabs = (
            dr.opaque(mi.Int, n) for n in (grid.columns, grid.rows, grid.slabs)
        )
        line = mi.Int(self._cell) // self._columns
        slab = line // self._lines
        self._column, self._line = mi.Int(self._cell) % self._columns, line % self._lines
        self._slab, self._first = slab % self._slabs, slab - slab % self._slabs
        self.shared = self._cell < mi.UInt32(dr.opaque(mi.UInt32, dr.width(numbers)))

    def beside(self, over, down, slab):
        """Row so many columns, rows and slabs away, and whether there is one."""
        column, line, slab = self._column + over, self._line + down, self._slab + slab
        there = self.shared & (column >= 0) & (column < self._columns)
        there &= (line >= 0) & (line < self._lines) & (slab >= 0) & (slab < self._slabs)
        cell = mi.UInt32(((self._first + slab) * self._lines + line) * self._columns + column)
        row = dr.gather(mi.UInt32, self._numbers, cell, there) >> 1
        # other cells may have borrowed a neighbour's row
        return row, there & (dr.gather(mi.UInt32, self._cell, row, there) == cell)
