"""The radiance of grains: path-traced once, shared by all pixels that see them (stage s5)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..hologram import channel
from ..scene.buffers import gather_row, row_stride
from ..scene.lobes import DIFFUSE, SHARP, SMOOTH
from ..scene.rays import OUTSIDE
from .filtering import Half, filtered, squared_error
from .grain_grid import GrainGrid
from .regions import DEPTHS, TILE, Sightings, tiles_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..light.path_tracer import PathTracer
    from ..plan import Plan
    from ..progress import PartProgress
    from ..scene.rays import ImagePoint, Rays
    from ..scene.specular_chains import FirstHits, SpecularChains

CHUNK_PATHS = 1 << 20  # between two looks at progress and cancel
# Sums are whole numbers: their order, which threads decide, then does not change the last bit.
RADIANCE_STEPS = 2.0**26
RADIANCE_LIMIT = 2.0**30
ATOMIC = dr.ReduceMode.Local  # a copy for each thread would make the size of the sums part of the program
HALF = 8  # numbers of a `Half`
SUMS = 2 * HALF + 2  # of a row: those of both halves, and slopes along x and y
LOOKED = 4  # numbers of a row that rays for textures add: reflectances, and how many they were
OTHERS = 1 << 13  # number of the first of these rays, which no path has
TILT = 2  # slopes before the radiances in a row of means
# added to reflectances: of black surfaces, and for light that no diffuse lobe scatters
BLACK, SPECULAR = 1e-3, 0.04
TEXTURES = 0.35  # of the wanted error: what textures may have of it
MOST_LOOKS = 256  # rays of a pixel that see textures alone
NOISIER = 1.1  # than wished is good enough
ROUNDS = 3  # of paths at most


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


def measure_grains(
    scene: mi.Scene,
    rays: Rays,
    optics: FirstHits | SpecularChains,
    tracer: PathTracer,
    grid: GrainGrid,
    plan: Plan,
    *,
    wavelengths: Sequence[float],
    seed: int,
    progress: PartProgress,
) -> RadianceMap:
    """Path-trace the radiance of the grains in view, every path for all pixels that see its grain.

    A pixel takes the root of a mean over paths, since the root of a noisy sample is biased dark.

    Parameters
    ----------
    scene : mitsuba.Scene
    rays : Rays
    optics : FirstHits or SpecularChains
    tracer : PathTracer
    grid : GrainGrid
    plan : Plan
        How many paths and rays for textures each pixel has, and how far grains share their light, see `filtering`; the
        error that is wanted is that of `_field_error`.
    wavelengths : sequence of float
        That have a radiance each, metres.
    seed : int
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    RadianceMap
    """
    passes, wanted, most, white = plan.passes, plan.wanted_error, plan.most_passes, plan.white
    pixels = grid.columns * grid.rows
    occupied = dr.zeros(mi.UInt32, pixels * grid.slabs * grid.branches)
    for grains, part in _chunks(scene, rays, optics, grid, passes, seed):
        kind = dr.select(grains.binned, mi.UInt32(grid.bins**2), 1)
        dr.scatter_reduce(dr.ReduceOp.Max, occupied, kind, grains.cell, grains.inside, mode=ATOMIC)
        dr.eval(occupied)
        dr.sync_thread()
        progress(0.1 * part)
    numbers, rows = _numbered(occupied, grid)
    if not dr.any((numbers & 1) == 1):
        grid = replace(grid, bins=1)

    sums, shining, tiles = (
        dr.zeros(mi.UInt64, SUMS * rows),
        dr.zeros(mi.UInt32, rows),
        _Tiles(grid, rays, plan.planes if plan.regions else ()),
    )
    # of the radiances that are added up, for their squares to be whole numbers of steps
    unit = white if 0 < white < math.inf else 1.0
    scale = dr.opaque(mi.Float, 1 / unit)
    taken, error, done, looks = 0, math.inf, 0.1, 0
    looked = Half.of([mi.Float(0)] * HALF)
    for number in range(ROUNDS):
        # half of what is left, where another round may follow
        share = (1 - done) * (0.5 if number < ROUNDS - 1 and taken + passes < most else 1)
        for grains, part in _chunks(scene, rays, optics, grid, passes, seed, taken):
            seen = grains.seen
            light = tracer.radiance(
                scene, grains.sampler, seen.ray, seen.surface, seen.whole, parts=seen.parts
            )
            light *= scale / seen.colour
            row, inside = _row(grains, grid, numbers, occupied)
            inside &= dr.all(dr.isfinite(light))
            reflectance, shines = shown(scene, seen, inside)
            first = dr.gather(mi.UInt32, numbers, grains.cell, inside) >> 1
            dr.scatter_reduce(dr.ReduceOp.Max, shining, mi.UInt32(1), first, inside & shines, mode=ATOMIC)
            half = SUMS * row + HALF * (grains.number & 1)
            for k, value in enumerate(Half.path(light, reflectance).numbers):
                dr.scatter_add(sums, _steps(value), half + k, inside, mode=ATOMIC)
            for k, slope in enumerate(rays.tilt(seen)):  # of either sign: the sums wrap round
                steps = mi.UInt64(mi.Int64(slope * RADIANCE_STEPS))
                dr.scatter_add(sums, steps, SUMS * (row + 1) - TILT + k, inside, mode=ATOMIC)
            tiles.add(grains, inside & dr.any(light > 0))
            dr.eval(sums, shining)
            dr.sync_thread()
            progress(done + share * part)
        done += share
        taken += passes
        halves, shared = _halves(sums), dr.zeros(mi.Bool, rows)
        kept, cells = halves, dr.compress((occupied > 0) & (dr.gather(mi.UInt32, shining, numbers >> 1) == 0))
        if plan.reach and taken > 1 and dr.width(cells):
            kept, shared = filtered(halves, cells, numbers, grid, plan.reach)
        error, of_textures = _field_error(halves, kept, shared, looked.count, white / unit)
        if number == 0 and of_textures > 0:
            looks = rays_for_textures(of_textures, wanted, taken) if plan.textures is None else plan.textures
            if looks:
                chunks = _chunks(scene, rays, optics, grid, looks, seed, OTHERS)
                looked = _reflectances(
                    scene, chunks, grid, numbers, occupied, rows, lambda done=done: progress(done)
                )
                error, _ = _field_error(halves, kept, shared, looked.count, white / unit)
        if error <= NOISIER * wanted or taken >= most:
            break
        passes = min(most - taken, math.ceil(taken * ((error / wanted) ** 2 - 1)))
    own = halves[0] + halves[1]
    light = unit * dr.select(shared, (kept[0] + kept[1]).over * (own + looked).reflectance, own.radiance)
    dr.eval(light, own.count)
    means = _means(sums, light, own.count, numbers, grid, wavelengths)
    return RadianceMap(grid, numbers, means, len(wavelengths), taken, looks, error, tiles.sightings())


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


def _row(grains, grid, numbers, occupied):
    """Row of each grain of the radiance map, and whether it has one."""
    # cells that the first round did not meet may have borrowed a neighbour's row
    inside = grains.inside & (dr.gather(mi.UInt32, occupied, grains.cell, grains.inside) != 0)
    number = dr.gather(mi.UInt32, numbers, grains.cell, inside)
    over, up = (mi.UInt32(dr.round(grid.bin_place(s))) for s in (grains.slope.x, grains.slope.y))
    return (number >> 1) + dr.select((number & 1) == 1, up * grid.bins + over, 0), inside


def _steps(value):
    """As whole numbers, to be added up."""
    return mi.UInt64(dr.clip(value, 0, RADIANCE_LIMIT) * RADIANCE_STEPS)


def rays_for_textures(error, wanted, passes):
    """Rays through each pixel that, with so many paths, leave little of the error that textures make."""
    return min(MOST_LOOKS, max(0, math.ceil(passes * (error / (TEXTURES * wanted)) ** 2) - passes))


def _reflectances(scene, chunks, grid, numbers, occupied, rows, tick):
    """Reflectances that rays see in each row, as a `Half` without light."""
    sums = dr.zeros(mi.UInt64, LOOKED * rows)
    for grains, _ in chunks:
        row, inside = _row(grains, grid, numbers, occupied)
        reflectance, _ = shown(scene, grains.seen, inside)
        for k, value in enumerate((*reflectance, mi.Float(1))):
            dr.scatter_add(sums, _steps(value), LOOKED * row + k, inside, mode=ATOMIC)
        dr.eval(sums)
        dr.sync_thread()
        tick()
    row = dr.arange(mi.UInt32, rows)
    columns = [mi.Float(dr.gather(mi.UInt64, sums, LOOKED * row + k)) / RADIANCE_STEPS for k in range(LOOKED)]
    dr.eval(columns)
    return Half(mi.Color3f(0), mi.Color3f(*columns[:3]), columns[3], mi.Float(0))


def _halves(sums):
    """The `Half`s of all rows."""
    row = dr.arange(mi.UInt32, dr.width(sums) // SUMS)
    halves = tuple(
        Half.of([_sum_of(sums, row, first + k) / RADIANCE_STEPS for k in range(HALF)]) for first in (0, HALF)
    )
    dr.eval(halves)
    return halves


def _sum_of(sums, row, column):
    return mi.Float(dr.gather(mi.UInt64, sums, SUMS * row + column))


def _field_error(halves, kept, shared, looks, white):
    """Relative error of the field that is left of the radiances' noise, and what textures have of it.

    An amplitude sqrt(L) errs by dL / (2 sqrt(L)), so the field by sqrt(sum L (dL / L)^2 / 4 / sum L), where the
    factors L count at most as `white`: lamps in view must not hide the rest. dL is half the difference of the means of
    every second path, two halves that know nothing of each other; where they are filtered, see `squared_error`.
    """
    own, light = halves[0] + halves[1], kept[0] + kept[1]
    bright, both = dr.mean(own.radiance), (halves[0].count > 0) & (halves[1].count > 0)
    weight = (
        dr.select(both & (bright > 0), own.count * dr.minimum(bright, white), 0) / 12
    )  # channels, and 2^2

    def part(where, squared, of):
        return dr.select(where, weight * squared / dr.maximum(dr.square(of), 1e-30), 0)

    def apart(a, b):
        return 0.25 * dr.squared_norm(a - b)

    # textures and edges, of which a few paths show a part, and the rays that look at them a larger one
    over, seen = dr.mean(light.over), own.count / dr.maximum(own.count + looks, 1)
    parts = [
        weight,
        part(~shared, apart(*(half.radiance for half in halves)), bright),
        part(shared, apart(*(half.over for half in kept)), over),
        part(shared, squared_error(halves, kept), over),
        part(shared, seen * apart(*(half.reflectance for half in halves)), dr.mean(own.reflectance)),
    ]
    dr.eval(parts)  # in one kernel
    whole, alone, least, differing, texture = (float(dr.sum(values)[0]) for values in parts)
    wrong = alone + max(least, differing) + texture
    return tuple(math.sqrt(error / (12 * whole)) if whole > 0 else 0.0 for error in (wrong, texture))


def _ends(slab):
    """The outer ends of a slab, finite."""
    return np.clip((slab.far[0], slab.near[1]), -OUTSIDE, OUTSIDE)


class _Tiles:
    """Takes in what rays saw from the tiles of recording planes."""

    def __init__(self, grid, rays, planes):
        self._shape, self._planes = tiles_of(grid.width, grid.height), planes
        self._width, self._height, self._across = (
            dr.opaque(mi.Int, number) for number in (grid.width, grid.height, self._shape[1])
        )
        self._pitch, self._from = rays.pitch, rays.plane
        self._numbers = [
            [
                dr.opaque(mi.Float, float(number))
                for number in (plane.z, plane.depth_limit, *_ends(plane.slab), *_ends(plane.images))
            ]
            for plane in planes
        ]
        count = len(planes) * self._shape[0] * self._shape[1]
        self._depth, self._chains = (dr.zeros(mi.UInt32, max(1, count)) for _ in range(2))

    def add(self, grains, lit):
        """Grains, and which of them shine."""
        z, first = self._from + grains.dz, self._from + grains.first
        for number, (plane, limit, far, near, images_far, images_near) in enumerate(self._numbers):
            walk = (plane - self._from) / self._pitch
            column = mi.Int(dr.round(grains.column + grains.slope.x * walk))
            row = mi.Int(dr.round(grains.row - grains.slope.y * walk))
            inside = (column >= 0) & (column < self._width) & (row >= 0) & (row < self._height)
            inside &= (first > far) & (first < near)
            recorded = inside & lit & (z > images_far) & (z < images_near)
            if self._planes[number].sees != "all":
                recorded &= (grains.seen.hits > 0) == (self._planes[number].sees == "images")
            tile = (
                mi.UInt32(row // TILE * self._across + column // TILE)
                + number * self._shape[0] * self._shape[1]
            )
            part = 1 + mi.UInt32(dr.minimum(dr.abs(z - plane) / limit, 1) * (DEPTHS - 1))
            dr.scatter_reduce(dr.ReduceOp.Max, self._depth, part, tile, recorded, mode=ATOMIC)
            chained = inside & (grains.seen.hits > 0)
            dr.scatter_reduce(dr.ReduceOp.Max, self._chains, mi.UInt32(1), tile, chained, mode=ATOMIC)
        dr.eval(self._depth, self._chains)

    def sightings(self):
        """The `Sightings` of each plane."""
        shape = (len(self._planes), *self._shape)
        depth, chains = (
            np.array(values)[: math.prod(shape)].reshape(shape) for values in (self._depth, self._chains)
        )
        images = [plane.sees != "surfaces" for plane in self._planes]
        return tuple(map(Sightings, depth, chains > 0, images))


@dataclass
class _Grains:
    """Grains that rays saw (Dr.Jit types): the sampler after them, the first surface's distance from the plane, number
    of the path and of the pixel's place on the plane, slope, the `ImagePoint`, distance from the plane, cell, whether
    it is on the grid and shows anything, and whether its surface looks different across the pupil.
    """

    sampler: mi.Sampler
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


def _chunks(scene, rays, optics, grid, passes, seed, before=0):
    """The `_Grains` of all pixels, some at a time, and the part that is done; `before` is how many passes were."""
    pixels = grid.columns * grid.rows
    together = max(1, CHUNK_PATHS // passes)
    for first in range(0, pixels, together):
        count = min(together, pixels - first)
        yield _grains(scene, rays, optics, grid, first, count, passes, seed, before), (first + count) / pixels


def _grains(scene, rays, optics, grid, first, count, passes, seed, before):
    """The `_Grains` of `count` pixels from number `first` on, all passes; the same at every call."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed((seed * 9973 + first + 0x9E3779B1 * before) & 0xFFFFFFFF, count * passes)
    # the passes of a pixel side by side: their rays stay near each other, which fine meshes repay
    index, each = dr.arange(mi.UInt32, count * passes), dr.opaque(mi.UInt32, passes)
    number = index % each + dr.opaque(mi.UInt32, before)
    pixel = index // each + dr.opaque(mi.UInt32, first)
    jitter = sampler.next_2d()
    columns, margin = dr.opaque(mi.UInt32, grid.columns), dr.opaque(mi.Float, grid.margin)
    column = mi.Float(pixel % columns) - margin + jitter.x - 0.5
    row = mi.Float(pixel // columns) - margin + jitter.y - 0.5
    # the R2 sequence spreads a pixel's passes over the pupil, from a start of its own
    turn = mi.Point2f(*(mi.Float(word) * 2.0**-32 for word in mi.sample_tea_32(pixel, seed)))
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
    return _Grains(sampler, first, number, column, row, slope, seen, dz, cell, inside & seen.exists, binned)


def _numbered(occupied, grid):
    """First rows (doubled, one more with pupil bins) of the occupied cells, and rows in all; the others borrow
    a neighbour's, or have 0.
    """
    ends = dr.cumsum(occupied)
    rows = int(ends[dr.width(ends) - 1]) + 1
    numbers = 2 * (ends - occupied + 1) + dr.select(occupied > 1, mi.UInt32(1), 0)
    numbers = dr.select(occupied != 0, numbers, 0)
    dr.eval(numbers)
    cell = dr.arange(mi.Int, dr.width(numbers))
    column, row = cell % grid.columns, (cell // grid.columns) % grid.rows
    slab = cell // (grid.columns * grid.rows) % grid.slabs
    filled = mi.UInt32(numbers)
    axes = (
        (slab, grid.slabs, grid.columns * grid.rows),
        (column, grid.columns, 1),
        (row, grid.rows, grid.columns),
    )
    for position, size, step in axes:
        for side in (-1, 1):
            there = (position + side >= 0) & (position + side < size) & (filled == 0)
            filled = dr.select(
                there, dr.gather(mi.UInt32, numbers, mi.UInt32(cell + side * step), there), filled
            )
    dr.eval(filled)
    return filled, rows


def _means(sums, light, count, numbers, grid, wavelengths):
    """Mean slopes, and the radiances `light`; a pupil bin that no path came through takes the mean of its cell."""
    rows, stride = dr.width(sums) // SUMS, row_stride(TILT + len(wavelengths))
    means = dr.zeros(mi.Float, rows * stride)

    def stored(row):
        paths = dr.gather(mi.Float, count, row)
        shown = dr.gather(mi.Color3f, light, row) * paths
        tilt = [
            mi.Float(mi.Int64(dr.gather(mi.UInt64, sums, SUMS * row + SUMS - TILT + k))) / RADIANCE_STEPS
            for k in range(TILT)
        ]
        return [*tilt, *shown, paths]

    def store(total, row, active=True):
        paths = total[-1]
        values = total[:TILT] + [total[TILT + channel(wavelength)] for wavelength in wavelengths]
        for k, value in enumerate(values):
            dr.scatter(means, dr.select(paths > 0, value / paths, 0), row * stride + k, active)

    row = dr.arange(mi.UInt32, rows)
    store(stored(row), row)
    if grid.bins > 1:
        first = dr.gather(mi.UInt32, numbers, dr.compress((numbers & 1) == 1)) >> 1
        bins = [first + k for k in range(grid.bins**2)]
        whole = [sum(values) for values in zip(*(stored(row) for row in bins), strict=True)]
        for row in bins:
            store(whole, row, stored(row)[-1] == 0)
    dr.eval(means)
    dr.sync_thread()
    return means
