"""Sums over paths in the rows of a radiance map: of whole numbers, so that the order of threads changes no bit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..hologram import channel
from ..scene.buffers import mean, row_stride
from .filtering import TINY, Half, squared_error
from .grains import TILT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .filtering import Halves
    from .grain_grid import GrainGrid, RowIndex

STEPS = 2.0**26  # whole-number steps of 1
LIMIT = 2.0**30  # largest summand
ATOMIC = dr.ReduceMode.Local  # a copy for each thread would make the size of the sums part of the program
HALF = 8  # numbers of a `Half`
LIGHT = 2 * HALF + TILT  # numbers of a row of light: both halves, and slopes along x and y
TEXTURE = 4  # numbers of a row of textures: reflectances, and rays


@dataclass(frozen=True)
class RowSums:
    """Sums in rows, of light (`LIGHT` numbers a row) or of textures (`TEXTURE`).

    Attributes
    ----------
    values : mitsuba.UInt64
        Numbers of all rows, in steps of 1 / `STEPS`.
    columns : int
        Numbers of a row.
    """

    values: mi.UInt64
    columns: int

    @classmethod
    def zeros(cls, rows: int, columns: int) -> RowSums:
        """Empty sums of some rows and columns."""
        return cls(dr.zeros(mi.UInt64, columns * rows), columns)

    def add_light(
        self,
        row: mi.UInt32,
        number: mi.UInt32,
        half: Half,
        tilt: tuple[mi.Float, mi.Float],
        active: mi.Bool,
    ) -> None:
        """Add paths to one of the two halves of their rows.

        Parameters
        ----------
        row : mitsuba.UInt32
        number : mitsuba.UInt32
            Number of the path: even and odd ones make the halves.
        half : Half
            Sums of one path.
        tilt : tuple of mitsuba.Float
            `Rays.tilt`.
        active : mitsuba.Bool
        """
        first = LIGHT * row + HALF * (number & 1)
        for k, value in enumerate(half.values):
            self._add(_steps(value), first + k, active)
        for k, slope in enumerate(tilt):  # of either sign: the sums wrap round
            self._add(mi.UInt64(mi.Int64(slope * STEPS)), LIGHT * (row + 1) - TILT + k, active)

    def add_texture(self, row: mi.UInt32, reflectance: mi.Color3f, active: mi.Bool) -> None:
        """Add the reflectances that active rays met to their rows."""
        for k, value in enumerate((*reflectance, mi.Float(1))):
            self._add(_steps(value), TEXTURE * row + k, active)

    def _add(self, steps, place, active):
        dr.scatter_add(self.values, steps, place, active, mode=ATOMIC)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return dr.width(self.values) // self.columns

    def column(self, row: mi.UInt32, column: int) -> mi.UInt64:
        """Sum in a column of some rows, in steps."""
        return dr.gather(mi.UInt64, self.values, self.columns * row + column)

    @property
    def halves(self) -> Halves:
        """Both halves of light."""
        row = dr.arange(mi.UInt32, self.rows)
        first, second = (
            Half.of([mi.Float(self.column(row, start + k)) / STEPS for k in range(HALF)])
            for start in (0, HALF)
        )
        dr.eval(first, second)
        return first, second

    @property
    def textures(self) -> Half:
        """Reflectances and rays, as a `Half` without light."""
        row = dr.arange(mi.UInt32, self.rows)
        columns = [mi.Float(self.column(row, k)) / STEPS for k in range(TEXTURE)]
        dr.eval(columns)
        return Half(mi.Color3f(0), mi.Color3f(*columns[:3]), columns[3], mi.Float(0))

    def means(
        self,
        light: mi.Color3f,
        count: mi.Float,
        index: RowIndex,
        grid: GrainGrid,
        wavelengths: Sequence[float],
    ) -> mi.Float:
        """Rows of mean slopes and of radiances, for `RadianceMap`.

        A pupil bin without a path has the mean of its cell.

        Parameters
        ----------
        light : mitsuba.Color3f
            Radiance of each row.
        count : mitsuba.Float
            Paths of each row.
        index : RowIndex
        grid : GrainGrid
        wavelengths : sequence of float
            Meters; a radiance each.
        """
        stride = row_stride(TILT + len(wavelengths))
        means = dr.zeros(mi.Float, self.rows * stride)

        def sums(row):
            paths = dr.gather(mi.Float, count, row)
            colors = dr.gather(mi.Color3f, light, row) * paths
            tilt = [mi.Float(mi.Int64(self.column(row, LIGHT - TILT + k))) / STEPS for k in range(TILT)]
            return [*tilt, *colors, paths]

        def store(total, row, active=True):
            paths = total[-1]
            values = total[:TILT] + [total[TILT + channel(wavelength)] for wavelength in wavelengths]
            for k, value in enumerate(values):
                dr.scatter(means, dr.select(paths > 0, value / paths, 0), row * stride + k, active)

        row = dr.arange(mi.UInt32, self.rows)
        store(sums(row), row)
        if grid.bins > 1:
            first, _ = index.at(dr.compress(index.binned))
            bins = [first + k for k in range(grid.bins**2)]
            whole = [sum(values) for values in zip(*(sums(row) for row in bins), strict=True)]
            for row in bins:
                store(whole, row, sums(row)[-1] == 0)
        dr.eval(means)
        dr.sync_thread()
        return means


def _steps(value):
    """Value as a whole number of steps."""
    return mi.UInt64(dr.clip(value, 0, LIMIT) * STEPS)


def field_error(
    halves: Halves, filtered: Halves, shared: mi.Bool, texture_rays: mi.Float, white: float
) -> tuple[float, float]:
    """Estimate the relative error of the field from the noise of the radiances.

    An amplitude sqrt(L) errs by dL / (2 sqrt(L)), so the field by sqrt(sum L (dL / L)^2 / 4 / sum L), where the
    factors L count at most as `white`: lights in view must not hide the rest. dL is half the difference of the means of
    the two independent halves; where they are filtered, see `squared_error`.

    Parameters
    ----------
    halves, filtered : Halves
        Before and after `share_light`.
    shared : mitsuba.Bool
        Rows that share their light.
    texture_rays : mitsuba.Float
        Rays of each row that see textures alone.
    white : float
        Radiance above which brightness does not count.

    Returns
    -------
    error : float
    texture_error : float
        Error due to textures.
    """
    own, light = halves[0] + halves[1], filtered[0] + filtered[1]
    bright, both = mean(own.radiance), (halves[0].count > 0) & (halves[1].count > 0)
    # 12: channels, and 2^2
    weight = dr.select(both & (bright > 0), own.count * dr.minimum(bright, white), 0) / 12

    def part(where, squared, of):
        return dr.select(where, weight * squared / dr.maximum(dr.square(of), TINY), 0)

    def apart(a, b):
        return 0.25 * dr.squared_norm(a - b)

    # textures and edges: a few paths see a part of them, and the rays that see textures alone a larger one
    irradiance, fraction = mean(light.irradiance), own.count / dr.maximum(own.count + texture_rays, 1)
    parts = [
        weight,
        part(~shared, apart(*(half.radiance for half in halves)), bright),
        part(shared, apart(*(half.irradiance for half in filtered)), irradiance),
        part(shared, squared_error(halves, filtered), irradiance),
        part(shared, fraction * apart(*(half.reflectance for half in halves)), mean(own.reflectance)),
    ]
    dr.eval(parts)  # in one kernel
    whole, alone, noise, differences, texture = (float(dr.sum(values)[0]) for values in parts)
    error = alone + max(noise, differences) + texture
    return tuple(math.sqrt(each / (12 * whole)) if whole > 0 else 0.0 for each in (error, texture))
