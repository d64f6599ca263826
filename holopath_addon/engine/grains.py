"""The radiance of grains: path-traced once, shared by all pixels that see them (stage s5)."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .buffers import row_stride
from .hologram import channel
from .rays import intersect

CHUNK_PATHS = 1 << 20  # between two looks at progress and cancel

# The radiance map sums whole numbers: their order, which threads decide, then does not change the last bit.
RADIANCE_STEPS = 2.0**26
RADIANCE_LIMIT = 2.0**30


@dataclass(frozen=True)
class GrainGrid:
    """Cells of the radiance map: pixel columns, depth slabs and pupil bins.

    Attributes
    ----------
    margin : int
        Pixels beyond the hologram's edge on every side that steep rays reach.
    slabs, bins : int
        Depth slabs between `z_low` and `z_high` (metres from the recording plane), and bins along each axis
        of the pupil, which is `max_slope` in radius.
    """

    width: int
    height: int
    margin: int
    slabs: int
    bins: int
    z_low: float
    z_high: float
    max_slope: float

    @property
    def columns(self):
        return self.width + 2 * self.margin

    @property
    def rows(self):
        return self.height + 2 * self.margin

    @property
    def cells(self):
        return self.columns * self.rows * self.slabs * self.bins**2

    def index(self, column, row, z, slope_x, slope_y):
        """Cell of a grain seen along a slope, and whether it lies on the grid (Dr.Jit types)."""
        column, row = column + self.margin, row + self.margin
        inside = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        scale = self.slabs / max(self.z_high - self.z_low, 1e-12)
        slab = dr.clip(mi.Int((z - self.z_low) * scale), 0, self.slabs - 1)
        cell = (slab * self.rows + row) * self.columns + column
        if self.bins > 1:
            half = self.bins / (2 * self.max_slope)
            bin_x = dr.clip(mi.Int((slope_x + self.max_slope) * half), 0, self.bins - 1)
            bin_y = dr.clip(mi.Int((slope_y + self.max_slope) * half), 0, self.bins - 1)
            cell = (cell * self.bins + bin_y) * self.bins + bin_x
        return mi.UInt32(cell), inside


def radiance_integrator(max_depth):
    """Mitsuba's path tracer with next-event estimation and multiple importance sampling."""
    return mi.load_dict({"type": "path", "max_depth": int(max_depth), "rr_depth": max(5, int(max_depth))})


def measure_grains(scene, rays, grid, wavelengths, passes, max_depth, seed, progress):
    """Radiance map (s5): mean radiance of each grain, path-traced once for all pixels that see it.

    One path gives the grain it meets a sample; amplitudes are roots of means, since a root of a noisy
    sample is biased dark. Empty cells take the mean of their neighbours.

    Parameters
    ----------
    scene : mitsuba.Scene
    rays : Rays
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
    mitsuba.Float
        Amplitudes, rows of `row_stride(len(wavelengths))`, one a cell.
    """
    integrator = radiance_integrator(max_depth)
    sums = dr.zeros(mi.UInt64, 4 * grid.cells)
    pixels = grid.columns * grid.rows
    together = max(1, min(passes, CHUNK_PATHS // pixels))
    for first in range(0, passes, together):
        count = min(together, passes - first)
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
        x, y = rays.place(column, row)
        ray, depth_rate = rays.world(x, y, slope.x, slope.y)
        distance, hit = intersect(scene, ray)
        dz = rays.height_over_plane(distance, depth_rate, hit)
        light, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(ray), None, True)
        cell, inside = grid.index(
            mi.Int(dr.round(column + slope.x * dz / rays.pitch)),
            mi.Int(dr.round(row - slope.y * dz / rays.pitch)),
            dz,
            slope.x,
            slope.y,
        )
        inside &= dr.all(dr.isfinite(light))
        for k, value in enumerate((*light, mi.Float(1))):
            steps = mi.UInt64(dr.clip(value, 0, RADIANCE_LIMIT) * RADIANCE_STEPS)
            dr.scatter_add(sums, steps, 4 * cell + k, inside)
        dr.eval(sums)
        dr.sync_thread()
        progress((first + count) / passes)
    return _amplitudes(sums, grid, wavelengths)


def _amplitudes(sums, grid, wavelengths):
    """Roots of the cells' mean radiance; empty cells filled from the 26 neighbours."""

    def stored(cell, active):
        values = [dr.gather(mi.UInt64, sums, 4 * cell + k, active) for k in range(4)]
        return mi.Vector4f(*(mi.Float(value) / RADIANCE_STEPS for value in values))

    cell = dr.arange(mi.UInt32, grid.cells)
    total = stored(cell, True)
    bins = grid.bins**2
    place = mi.Int(cell // bins)
    column, row = place % grid.columns, (place // grid.columns) % grid.rows
    slab = place // (grid.columns * grid.rows)
    empty = total.w == 0
    around = dr.zeros(mi.Vector4f, grid.cells)
    step = mi.Int(0)
    while_state = (step, around)

    def body(step, around):
        dx, dy, dz = step % 3 - 1, (step // 3) % 3 - 1, step // 9 - 1
        near = (
            (column + dx >= 0)
            & (column + dx < grid.columns)
            & (row + dy >= 0)
            & (row + dy < grid.rows)
            & (slab + dz >= 0)
            & (slab + dz < grid.slabs)
            & empty
        )
        other = mi.Int(cell) + ((dz * grid.rows + dy) * grid.columns + dx) * bins
        return step + 1, around + stored(mi.UInt32(other), near)

    _, around = dr.while_loop(while_state, lambda step, around: (step < 27) & empty, body)
    total = dr.select(empty, around, total)
    mean = dr.select(total.w > 0, total / total.w, 0)
    stride = row_stride(len(wavelengths))
    amplitudes = dr.zeros(mi.Float, grid.cells * stride)
    for k, wavelength in enumerate(wavelengths):
        dr.scatter(amplitudes, dr.sqrt(dr.maximum(mean[channel(wavelength)], 0)), cell * stride + k)
    dr.eval(amplitudes)
    dr.sync_thread()
    return amplitudes
