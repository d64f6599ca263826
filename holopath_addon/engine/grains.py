"""The radiance of grains: path-traced once, shared by all pixels that see them (stage s5)."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .buffers import gather_row, row_stride
from .hologram import channel

CHUNK_PATHS = 1 << 20  # between two looks at progress and cancel
# Sums are whole numbers: their order, which threads decide, then does not change the last bit.
RADIANCE_STEPS = 2.0**26
RADIANCE_LIMIT = 2.0**30


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
        Depth slabs between `z_low` and `z_high` (metres from the recording plane), and bins along each axis
        of the pupil, which is `max_slope` in radius.
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

    @property
    def columns(self):
        """Pixels along x, margins included."""
        return self.width + 2 * self.margin

    @property
    def rows(self):
        """Pixels along y, margins included."""
        return self.height + 2 * self.margin

    def cell(self, column, row, dz, branch):
        """Number of the column, slab and branch of a grain, and whether it lies on the grid (Dr.Jit types)."""
        column, row = column + self.margin, row + self.margin
        inside = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        scale = self.slabs / max(self.z_high - self.z_low, 1e-12)
        slab = dr.clip(mi.Int((dz - self.z_low) * scale), 0, self.slabs - 1) + mi.Int(branch) * self.slabs
        return mi.UInt32((slab * self.rows + row) * self.columns + column), inside

    def bin(self, slope_x, slope_y):
        """Number of the pupil bin of a direction."""
        if self.bins == 1:
            return mi.UInt32(0)
        half = self.bins / (2 * self.max_slope)
        over = dr.clip(mi.Int((slope_x + self.max_slope) * half), 0, self.bins - 1)
        up = dr.clip(mi.Int((slope_y + self.max_slope) * half), 0, self.bins - 1)
        return mi.UInt32(up * self.bins + over)


@dataclass(frozen=True)
class RadianceMap:
    """Amplitudes (roots of mean radiances) of the grains in view.

    Only cells that hold a surface have values: `numbers` gives each cell of the grid its row, 0 for none.
    """

    grid: GrainGrid
    numbers: "mi.UInt32"
    amplitudes: "mi.Float"
    colours: int

    def amplitude(self, column, row, dz, slope_x, slope_y, branch):
        """Amplitude of each wavelength of the grain at a pixel column and depth, seen along a slope."""
        cell, inside = self.grid.cell(column, row, dz, branch)
        number = dr.gather(mi.UInt32, self.numbers, cell, inside)
        return gather_row(
            self.amplitudes, number * self.grid.bins**2 + self.grid.bin(slope_x, slope_y), self.colours
        )


def radiance_integrator(max_depth):
    """Mitsuba's path tracer with next-event estimation and multiple importance sampling."""
    return mi.load_dict({"type": "path", "max_depth": int(max_depth), "rr_depth": max(5, int(max_depth))})


def measure_grains(scene, rays, optics, grid, wavelengths, passes, max_depth, seed, progress):
    """Path-trace the radiance of the grains in view, every path for all pixels that see its grain.

    A pixel takes the root of a mean over paths, since the root of a noisy sample is biased dark.

    Parameters
    ----------
    scene : mitsuba.Scene
    rays : Rays
    optics : FirstHits or SpecularChains
    grid : GrainGrid
    wavelengths : sequence of float
        Metres.
    passes : int
        Paths through each pixel of the recording plane.
    max_depth, seed : int
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    RadianceMap
    """
    pixels = grid.columns * grid.rows
    together = max(1, min(passes, CHUNK_PATHS // pixels))
    chunks = [(first, min(together, passes - first)) for first in range(0, passes, together)]
    occupied = dr.zeros(mi.UInt32, pixels * grid.slabs * grid.branches)
    for first, count in chunks:
        sampler, ray, depth_rate, place, slope = _primary_rays(rays, grid, first, count, seed)
        cell, inside, _, _ = _grain(scene, rays, optics, grid, sampler, ray, depth_rate, place, slope)
        dr.scatter(occupied, mi.UInt32(1), cell, inside)
        dr.eval(occupied)
        dr.sync_thread()
        progress(0.1 * (first + count) / passes)
    numbers, cells = _numbered(occupied, grid)

    integrator = radiance_integrator(max_depth)
    sums = dr.zeros(mi.UInt64, 4 * (cells + 1) * grid.bins**2)
    for first, count in chunks:
        sampler, ray, depth_rate, place, slope = _primary_rays(rays, grid, first, count, seed)
        cell, inside, bin_, last = _grain(scene, rays, optics, grid, sampler, ray, depth_rate, place, slope)
        light, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(last), None, True)
        inside &= dr.all(dr.isfinite(light))
        at = 4 * (dr.gather(mi.UInt32, numbers, cell, inside) * grid.bins**2 + bin_)
        for k, value in enumerate((*light, mi.Float(1))):
            steps = mi.UInt64(dr.clip(value, 0, RADIANCE_LIMIT) * RADIANCE_STEPS)
            dr.scatter_add(sums, steps, at + k, inside)
        dr.eval(sums)
        dr.sync_thread()
        progress(0.1 + 0.9 * (first + count) / passes)
    return RadianceMap(grid, numbers, _amplitudes(sums, grid.bins**2, wavelengths), len(wavelengths))


def _primary_rays(rays, grid, first, count, seed):
    """Rays of `count` passes from number `first` on, spread over pixels and pupil; the same at every call."""
    pixels = grid.columns * grid.rows
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed * 9973 + first, pixels * count)
    index = dr.arange(mi.UInt32, pixels * count)
    number, pixel = mi.Float(index // pixels + dr.opaque(mi.UInt32, first)), index % pixels
    jitter, turn = sampler.next_2d(), sampler.next_2d()
    column = mi.Float(pixel % grid.columns) - grid.margin + jitter.x - 0.5
    row = mi.Float(pixel // grid.columns) - grid.margin + jitter.y - 0.5
    # the R2 sequence spreads a pixel's passes over the pupil, the random turn decorrelates pixels
    u = mi.Point2f(number * 0.7548776662466927 + turn.x, number * 0.5698402909980532 + turn.y)
    slope = grid.max_slope * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
    ray, depth_rate = rays.world(*rays.place(column, row), slope.x, slope.y)
    return sampler, ray, depth_rate, (column, row), slope


def _grain(scene, rays, optics, grid, sampler, ray, depth_rate, place, slope):
    """Cell, whether it is on the grid, and pupil bin of what a ray sees in a branch at random; the last piece."""
    branch = mi.UInt32(sampler.next_1d() * optics.branches) if optics.branches > 1 else mi.UInt32(0)
    seen = optics.view(scene, ray, branch)
    dz = rays.height_over_plane(seen.distance, depth_rate, seen.hit)
    column = mi.Int(dr.round(place[0] + slope.x * dz / rays.pitch))
    row = mi.Int(dr.round(place[1] - slope.y * dz / rays.pitch))
    cell, inside = grid.cell(column, row, dz, seen.branch)
    return cell, inside & seen.exists, grid.bin(slope.x, slope.y), seen.ray


def _numbered(occupied, grid):
    """Numbers 1, 2, ... of the occupied cells; the others borrow a neighbour's, or have 0."""
    numbers = dr.cumsum(occupied)
    cells = int(numbers[dr.width(numbers) - 1])
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
    return filled, cells


def _amplitudes(sums, bins, wavelengths):
    """Roots of the mean radiances; a pupil bin that no path came through takes the mean of its cell."""
    rows = dr.width(sums) // 4

    def stored(row, active=True):
        values = [dr.gather(mi.UInt64, sums, 4 * row + k, active) for k in range(4)]
        return mi.Vector4f(*(mi.Float(value) / RADIANCE_STEPS for value in values))

    row = dr.arange(mi.UInt32, rows)
    total = stored(row)
    empty = total.w == 0
    first = row // bins * bins
    for other in range(bins if bins > 1 else 0):
        total += dr.select(empty, stored(first + other, empty), 0)
    mean = dr.select(total.w > 0, total / total.w, 0)
    stride = row_stride(len(wavelengths))
    amplitudes = dr.zeros(mi.Float, rows * stride)
    for k, wavelength in enumerate(wavelengths):
        dr.scatter(amplitudes, dr.sqrt(mean[channel(wavelength)]), row * stride + k)
    dr.eval(amplitudes)
    dr.sync_thread()
    return amplitudes
