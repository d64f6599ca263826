"""Grains that rays see, and their radiance: path-traced once, shared by all pixels that see them (stage s5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..scene.buffers import gather_row
from ..scene.lobes import DIFFUSE, SHARP, SMOOTH
from ..scene.random_numbers import Sampler
from ..scene.rays import PACKET
from .grain_grid import GrainGrid
from .regions import Sightings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..scene.rays import ImagePoint, Rays
    from ..scene.specular_chains import FirstHits, SpecularChains

CHUNK_PATHS = 1 << 20  # that draw random numbers together
UNIT_PATHS = 1 << 17  # of a unit of work: an eighth of a second of two cores, several times that of busy ones
TILT = 2  # slopes before the radiances in a row of means
# added to reflectances: of black surfaces, and for light that no diffuse lobe scatters
BLACK, SPECULAR = 1e-3, 0.04


@dataclass(frozen=True)
class RadianceMap:
    """Mean radiances of the grains in view.

    Only cells that hold a surface have values. `numbers` gives each cell of the grid twice its first row, 0 for
    none, and 1 more where it has all pupil bins. A row of `radiances` holds the surface's mean `Rays.tilt`, and the
    radiance of each wavelength; `colours` is 1 where all share one. `passes` paths a pixel, and `textures` rays
    that see textures alone, left the relative standard error `error` of the wave field, see `_field_error`; `sightings`
    are what their rays saw from the tiles of each recording plane.
    """

    grid: GrainGrid
    numbers: mi.UInt32
    radiances: mi.Float
    colours: int
    passes: int
    textures: int
    error: float
    sightings: tuple[Sightings, ...]

    def sampler(self, seed: int, size: int) -> None:
        """No random numbers are needed."""
        return None

    def amplitudes(
        self,
        scene: mi.Scene,
        rays: Rays,
        sampler: None,
        seen: ImagePoint,
        grain: tuple[mi.Int, mi.Int, mi.Float],
        slope: tuple[mi.Float, mi.Float],
        channels: Sequence[int],
    ) -> tuple[list, tuple[mi.Float, mi.Float]]:
        """Roots of each wavelength's radiance of the grain at a pixel column, row and depth, seen along a slope, and
        the mean `Rays.tilt` of the surface there.

        Between pupil bins radiance is interpolated, so that a highlight moves as the view does.
        """
        cell, inside = self.grid.cell(*grain, seen.branch)
        number = dr.gather(mi.UInt32, self.numbers, cell, inside)
        first, values = number >> 1, TILT + self.colours
        if self.grid.bins == 1:
            return self._roots(gather_row(self.radiances, first, values), channels)
        binned = (number & 1) == 1
        over, up = (self.grid.bin_place(s) for s in slope)
        i, j = mi.UInt32(over), mi.UInt32(up)
        i, j = dr.minimum(i, self.grid.bins - 2), dr.minimum(j, self.grid.bins - 2)
        over, up = over - i, up - j
        total = [mi.Float(0)] * values
        for i_step, j_step, share in (
            (0, 0, (1 - over) * (1 - up)),
            (1, 0, over * (1 - up)),
            (0, 1, (1 - over) * up),
            (1, 1, over * up),
        ):
            at = first + dr.select(binned, (j + j_step) * self.grid.bins + i + i_step, 0)
            row = gather_row(self.radiances, at, values)
            total = [sum_ + share * value for sum_, value in zip(total, row, strict=True)]
        return self._roots(total, channels)

    def _roots(self, row, channels):
        roots = [dr.sqrt(value) for value in row[TILT:]]
        return roots if self.colours > 1 else roots * len(channels), tuple(row[:TILT])


def shown(scene: mi.Scene, seen: ImagePoint, active: mi.Bool) -> tuple[mi.Color3f, mi.Bool]:
    """What light is divided by where grains share it, and whether the surface, or the sky, shines itself.

    It is the reflectance, roughly; any value is right, as light is multiplied by it again.
    """
    point = seen.surface.compute_surface_interaction(seen.ray, mi.RayFlags.All, active)
    shines = point.emitter(scene, active) != None  # noqa: E711 (of each lane)
    active = active & seen.surface.is_valid()
    bsdf = point.bsdf(seen.ray)
    value = dr.clip(bsdf.eval_diffuse_reflectance(point, active), 0, 1)
    value += dr.select((bsdf.flags() & (SMOOTH & ~DIFFUSE)) != 0, mi.Float(SPECULAR), BLACK)
    # what has no diffuse lobe tells how much it scatters straight up, which bumps and the view change
    matt = active & ((bsdf.flags() & DIFFUSE) != 0) & dr.all(dr.isfinite(value))
    return dr.select(matt, value, 1), shines


def row_of(
    grains: Grains, grid: GrainGrid, numbers: mi.UInt32, occupied: mi.UInt32
) -> tuple[mi.UInt32, mi.Bool]:
    """Row of each grain of the radiance map, and whether it has one."""
    # cells that the first round did not meet may have borrowed a neighbour's row
    inside = grains.inside & (dr.gather(mi.UInt32, occupied, grains.cell, grains.inside) != 0)
    number = dr.gather(mi.UInt32, numbers, grains.cell, inside)
    over, up = (mi.UInt32(dr.round(grid.bin_place(s))) for s in (grains.slope.x, grains.slope.y))
    return (number >> 1) + dr.select((number & 1) == 1, up * grid.bins + over, 0), inside


@dataclass
class Grains:
    """Grains that rays saw (Dr.Jit types): the sampler after them, the first surface's distance from the plane, number
    of the path and of the pixel's place on the plane, slope, the `ImagePoint`, distance from the plane, cell, whether
    it is on the grid and shows anything, and whether its surface looks different across the pupil.
    """

    sampler: Sampler
    first: mi.Float
    number: mi.UInt32
    column: mi.Float
    row: mi.Float
    slope: mi.Point2f
    seen: ImagePoint
    dz: mi.Float
    cell: mi.UInt32
    inside: mi.Bool
    binned: mi.Bool


def unit_count(grid: GrainGrid, passes: int) -> int:
    """Units of work that the pixels of a grid are asked in, so many rays each."""
    return math.ceil(grid.columns * grid.rows / _pixels(UNIT_PATHS, passes))


def _pixels(paths, passes):
    """Pixels of so many paths, of whole packets: rays meet the same surfaces whatever units go together."""
    return max(1, paths // (passes * PACKET)) * PACKET


def grains_of(
    scene: mi.Scene,
    rays: Rays,
    optics: FirstHits | SpecularChains,
    grid: GrainGrid,
    units: range,
    passes: int,
    seed: int,
    before: int,
) -> Grains:
    """The `Grains` of the pixels of some units, all passes; the same at every call, whatever units go together.

    Parameters
    ----------
    scene, rays, optics, grid :
        As of `measurement.Measurement`.
    units : range
        Below `unit_count`.
    passes : int
        Rays of a pixel.
    seed : int
    before : int
        Number of the first of them.
    """
    size = _pixels(UNIT_PATHS, passes)
    first = units.start * size
    count = min(len(units) * size, grid.columns * grid.rows - first)
    # the passes of a pixel side by side: their rays stay near each other, which fine meshes repay
    index, each = dr.arange(mi.UInt32, count * passes), dr.opaque(mi.UInt32, passes)
    number = index % each + dr.opaque(mi.UInt32, before)
    pixel = index // each + dr.opaque(mi.UInt32, first)
    chunk = dr.opaque(mi.UInt32, _pixels(CHUNK_PATHS, passes))
    own = dr.opaque(mi.UInt32, (seed * 9973 + 0x9E3779B1 * before) & 0xFFFFFFFF)
    sampler = Sampler.seeded(own + pixel // chunk * chunk, pixel % chunk * each + index % each)
    jitter = sampler.next_2d()
    columns, margin = dr.opaque(mi.UInt32, grid.columns), dr.opaque(mi.Float, grid.margin)
    column = mi.Float(pixel % columns) - margin + jitter.x - 0.5
    row = mi.Float(pixel // columns) - margin + jitter.y - 0.5
    # the R2 sequence spreads a pixel's passes over the pupil, from a start of its own
    key = dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)
    turn = mi.Point2f(*(mi.Float(word) * 2.0**-32 for word in mi.sample_tea_32(pixel, key)))
    u = mi.Point2f(number * 0.7548776662466927 + turn.x, number * 0.5698402909980532 + turn.y)
    slope = grid.max_slope * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
    ray, depth_rate = rays.world(*rays.place(column, row), slope.x, slope.y)
    branch = mi.UInt32(sampler.next_1d() * optics.branches) if optics.branches > 1 else mi.UInt32(0)
    seen = optics.view(scene, ray, branch, drawn=True)
    first = rays.height_over_plane(seen.first, depth_rate, dr.isfinite(seen.first))
    dz = rays.within(rays.height_over_plane(seen.distance, depth_rate, seen.hit))
    over = mi.Int(dr.round(column + slope.x * dz / rays.pitch))
    down = mi.Int(dr.round(row - slope.y * dz / rays.pitch))
    cell, inside = grid.cell(over, down, rays.plane + dz, seen.branch)
    binned = mi.Bool(False)
    if grid.bins > 1:
        flags = seen.surface.shape.bsdf().flags()
        binned = mi.has_flag(flags, mi.BSDFFlags.Glossy) | (seen.whole & ((flags & SHARP) != 0))
    return Grains(sampler, first, number, column, row, slope, seen, dz, cell, inside & seen.exists, binned)


def numbered(occupied: mi.UInt32, grid: GrainGrid) -> tuple[mi.UInt32, int]:
    """First rows (doubled, one more with pupil bins) of the occupied cells, and rows in all; the others borrow
    a neighbour's, or have 0.
    """
    ends = dr.cumsum(occupied)
    rows = int(ends[dr.width(ends) - 1]) + 1
    numbers = 2 * (ends - occupied + 1) + dr.select(occupied > 1, mi.UInt32(1), 0)
    numbers = dr.select(occupied != 0, numbers, 0)
    dr.eval(numbers)
    cell = dr.arange(mi.Int, dr.width(numbers))
    columns, rows_, slabs = (dr.opaque(mi.Int, size) for size in (grid.columns, grid.rows, grid.slabs))
    column, row, slab = cell % columns, cell // columns % rows_, cell // (columns * rows_) % slabs
    filled = mi.UInt32(numbers)
    axes = (slab, slabs, columns * rows_), (column, columns, 1), (row, rows_, columns)
    for position, size, step in axes:
        for side in (-1, 1):
            there = (position + side >= 0) & (position + side < size) & (filled == 0)
            filled = dr.select(
                there, dr.gather(mi.UInt32, numbers, mi.UInt32(cell + side * step), there), filled
            )
    dr.eval(filled)
    return filled, rows
