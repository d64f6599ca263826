"""The wave path tracer: rays from the recording plane through the scene, and back as a wave field.

The paper's stages (section 4) by name: s1 a direction at a pixel, s2 hologram space to world, s3 first hit,
s4 its surface ends the coherent chain, s5 radiance, s6 the image point Q in hologram space, s7 the path's
phase, s8 one random phase a frame, s9 accumulation.
"""

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .hologram import channel
from .kernel_table import LEVELS

CHUNK_RAYS = 1 << 22  # between two looks at progress and cancel; well below a second on two cores


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
        Depth slabs between `z_low` and `z_high` (metres), and bins along each axis of the pupil.
    """

    width: int
    height: int
    margin: int
    slabs: int
    bins: int
    z_low: float
    z_high: float

    @property
    def columns(self):
        return self.width + 2 * self.margin

    @property
    def rows(self):
        return self.height + 2 * self.margin

    @property
    def cells(self):
        return self.columns * self.rows * self.slabs * self.bins**2

    def index(self, column, row, z, slope_x, slope_y, max_slope):
        """Cell of a grain seen along a slope, and whether it lies on the grid (Dr.Jit types)."""
        column, row = column + self.margin, row + self.margin
        inside = (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        scale = self.slabs / max(self.z_high - self.z_low, 1e-12)
        slab = dr.clip(mi.Int((z - self.z_low) * scale), 0, self.slabs - 1)
        cell = (slab * self.rows + row) * self.columns + column
        if self.bins > 1:
            half = self.bins / (2 * max_slope)
            bin_x = dr.clip(mi.Int((slope_x + max_slope) * half), 0, self.bins - 1)
            bin_y = dr.clip(mi.Int((slope_y + max_slope) * half), 0, self.bins - 1)
            cell = (cell * self.bins + bin_y) * self.bins + bin_x
        return mi.UInt32(cell), inside


class Rays:
    """Rays of hologram space as rays of the world, and depths back (s1, s2, s6).

    Parameters
    ----------
    hologram : Hologram
    camera : Camera
    mapping : DepthMapping
    plane : float
        z of the recording plane, metres.
    """

    def __init__(self, hologram, camera, mapping, plane):
        self.width, self.height, self.pitch = hologram.width, hologram.height, hologram.pitch
        self.mapping = mapping
        self.to_far = mapping.z_far - plane
        self.position = mi.Point3f(*map(float, camera.position))
        self.right, self.up, self.forward = (mi.Vector3f(*map(float, axis)) for axis in camera.axes)
        self.clip_start = camera.clip_start

    def place(self, column, row):
        """Hologram coordinates in metres of (fractional) pixel indices; row 0 is the top."""
        return ((column - 0.5 * (self.width - 1)) * self.pitch, (0.5 * (self.height - 1) - row) * self.pitch)

    def world(self, x, y, slope_x, slope_y):
        """The world ray through (x, y) of the recording plane with the given slopes, and depth per distance."""
        mapping = self.mapping
        spread = mapping.beta / mapping.focal
        tan_x = (x + slope_x * self.to_far) / mapping.focal + mapping.centre_x
        tan_y = (y + slope_y * self.to_far) / mapping.focal + mapping.centre_y
        direction = self.forward + tan_x * self.right + tan_y * self.up
        origin = self.position + (slope_x * spread) * self.right + (slope_y * spread) * self.up
        depth_rate = dr.rsqrt(dr.squared_norm(direction))
        return mi.Ray3f(origin + self.clip_start * direction, direction * depth_rate), depth_rate

    def height_over_plane(self, distance, depth_rate, hit):
        """dz = z_Q - z_p of a hit after `distance` along the ray; the far end where nothing was hit."""
        depth = self.clip_start + distance * depth_rate
        return self.to_far + dr.select(hit, self.mapping.beta / depth, 0)


def intersect(scene, ray):
    """Distance to the first surface and whether there is one (s3)."""
    hit = scene.ray_intersect_preliminary(ray, coherent=True)
    return hit.t, hit.is_valid()


def radiance_integrator(max_depth):
    """Mitsuba's path tracer with next-event estimation and multiple importance sampling."""
    return mi.load_dict({"type": "path", "max_depth": int(max_depth), "rr_depth": max(5, int(max_depth))})


def row_stride(count):
    """Row length of a buffer whose rows of `count` values `gather_row` reads in packets of 4, 2 or 1."""
    return count if count <= 2 else 4 * math.ceil(count / 4)


def gather_row(buffer, index, count):
    """The `count` values of row `index` of a buffer made by `packed`."""
    stride = row_stride(count)
    if stride == 1:
        return [dr.gather(type(buffer), buffer, index)]
    size = min(stride, 4)
    whole = {
        (2, mi.Float): mi.Vector2f,
        (4, mi.Float): mi.Vector4f,
        (2, mi.UInt32): mi.Vector2u,
        (4, mi.UInt32): mi.Vector4u,
    }
    packet = whole[size, type(buffer)]
    values = []
    for k in range(stride // size):
        values += list(dr.gather(packet, buffer, index * (stride // size) + k))
    return values[:count]


def packed(values):
    """A 2-D array, float32 or uint32, as a flat Dr.Jit buffer with rows of `row_stride`."""
    rows, count = values.shape
    if count != row_stride(count):
        values = np.pad(values, ((0, 0), (0, row_stride(count) - count)))
    return (mi.UInt32 if values.dtype == np.uint32 else mi.Float)(np.ascontiguousarray(values).ravel())


PHASOR_SCALE = 127


def packed_phasors(phasors):
    """Unit phasors as pairs of signed bytes, two frames a word, the frames of a grain side by side.

    Rounding to 1/127 is noise at -50 dB, far under any speckle, and a quarter of the memory traffic, which
    limits the kernel when there are many frames.
    """
    frames = len(phasors)
    pairs = np.zeros((phasors[0].size, 2 * math.ceil(frames / 2), 2), np.int8)
    for m, phasor in enumerate(phasors):
        pairs[:, m] = np.round(PHASOR_SCALE * phasor.ravel().view(np.float32).reshape(-1, 2))
    return packed(pairs.reshape(len(pairs), -1).view(np.uint32))


def gather_phasors(buffer, index, frames):
    """Real and imaginary parts, times `PHASOR_SCALE`, of each frame's phasor at a grain."""
    parts = []
    for word in gather_row(buffer, index, math.ceil(frames / 2)):
        word = mi.Int(word)
        parts += [mi.Float((word << shift) >> 24) for shift in (24, 16, 8, 0)]
    return parts[: 2 * frames]


def measure_grains(scene, rays, grid, max_slope, wavelengths, passes, max_depth, seed, progress):
    """Radiance map (s5): mean radiance of each grain, path-traced once for all pixels that see it.

    One path gives the grain it meets a sample; amplitudes are roots of means, since a root of a noisy
    sample is biased dark. Empty cells take the mean of their neighbours.

    Parameters
    ----------
    scene : mitsuba.Scene
    rays : Rays
    grid : GrainGrid
    max_slope : float
        Half-width of the pupil in slopes.
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
    together = max(1, min(passes, CHUNK_RAYS // 4 // pixels))
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
        slope = max_slope * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
        x, y = rays.place(column, row)
        ray, depth_rate = rays.world(x, y, slope.x, slope.y)
        dz = rays.height_over_plane(*_order(intersect(scene, ray), depth_rate))
        light, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(ray), None, True)
        cell, inside = grid.index(
            mi.Int(dr.round(column + slope.x * dz / rays.pitch)),
            mi.Int(dr.round(row - slope.y * dz / rays.pitch)),
            dz,
            slope.x,
            slope.y,
            max_slope,
        )
        inside &= dr.all(dr.isfinite(light))
        for k, value in enumerate((*light, mi.Float(1))):
            steps = mi.UInt64(dr.clip(value, 0, RADIANCE_LIMIT) * RADIANCE_STEPS)
            dr.scatter_add(sums, steps, 4 * cell + k, inside)
        dr.eval(sums)
        dr.sync_thread()
        progress((first + count) / passes)
    return _amplitudes(sums, grid, wavelengths)


def _order(hit, depth_rate):
    distance, valid = hit
    return distance, depth_rate, valid


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


def trace_field(scene, rays, hologram, settings, count, lattice, tables, grid, amplitudes, phasors, progress):
    """The wave field on the recording plane, all frames and wavelengths from one traversal.

    Parameters
    ----------
    scene : mitsuba.Scene
    rays : Rays
    hologram : Hologram
    settings : Settings
        ``estimator``, ``radiance``, ``spp`` (of the paper's estimator), ``max_depth`` and ``seed``.
    count : int
        Rays a pixel.
    lattice : Lattice
    tables : list of numpy.ndarray
        `kernel_table` of each wavelength. Both unused by the paper's estimator.
    grid : GrainGrid
    amplitudes : mitsuba.Float or None
        From `measure_grains`; None takes one path a ray.
    phasors : numpy.ndarray, complex64, shape (frames, height, width)
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, wavelengths, height, width)
        Unfiltered: energy outside the circular band is junk, which `propagation` cuts.
    """
    width, height, pitch = hologram.width, hologram.height, hologram.pitch
    wavelengths = hologram.wavelengths
    frames = len(phasors)
    max_slope = max(hologram.max_slope(w) for w in wavelengths)
    paper = settings.estimator == "paper"
    phasor_buffer = packed_phasors(phasors)
    if not paper:
        i, j = lattice.indices.T
        directions = packed(np.stack([i, j], axis=1).astype(np.float32))
        offsets = lattice.offsets(pitch)
        offset_stride = offsets.shape[1]
        offset_buffer = mi.Int(offsets.ravel())
        reach = int(offsets.max())
        table_buffer = packed(np.stack(tables, axis=-1).reshape(-1, len(wavelengths)).view(np.float32))
        level_scale = LEVELS / lattice.depth_limit
    channels = [channel(w) for w in wavelengths]
    integrator = None if amplitudes is not None else radiance_integrator(settings.max_depth)
    disk_area = math.pi * max_slope**2
    slopes_squared = [hologram.max_slope(w) ** 2 for w in wavelengths]
    rows_together = max(1, min(height, CHUNK_RAYS // (width * count)))
    out = np.empty((frames, len(wavelengths), height, width), np.complex64)
    lattice_spacing = None if paper else lattice.spacing

    for first in range(0, height, rows_together):
        rows = min(rows_together, height - first)
        size = rows * width
        index = dr.arange(mi.UInt32, size)
        column = mi.Int(index % width)
        row = mi.Int(index // width + dr.opaque(mi.UInt32, first))
        x, y = rays.place(mi.Float(column), mi.Float(row))
        random = (
            mi.PCG32(size, initstate=settings.seed + 1, initseq=dr.opaque(mi.UInt64, first * width))
            if paper
            else None
        )
        sampler = None
        if integrator is not None:
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(settings.seed * 9973 + first, size)
        field = [dr.zeros(mi.Float, size) for _ in range(2 * frames * len(wavelengths))]

        def body(step, field, random, sampler):
            # s1: a direction of the cone
            if paper:
                u = mi.Point2f(random.next_float32(), random.next_float32())
                slope = max_slope * mi.warp.square_to_uniform_disk_concentric(u)
                slope_x, slope_y = slope.x, slope.y
            else:
                index_i, index_j = gather_row(directions, step, 2)
                slope_x, slope_y = index_i * lattice_spacing, index_j * lattice_spacing
            # s2, s3
            ray, depth_rate = rays.world(x, y, slope_x, slope_y)
            distance, hit = intersect(scene, ray)
            # s6: Q relative to the plane
            dz = rays.height_over_plane(distance, depth_rate, hit)
            # s7: kernel between Q's grain and this pixel
            if paper:
                shift_x = mi.Int(dr.round(slope_x * dz / pitch))
                shift_y = mi.Int(dr.round(slope_y * dz / pitch))
                squared = slope_x * slope_x + slope_y * slope_y
                detour = dz * squared / (1 + dr.sqrt(1 + squared))
                kernel = []
                for wavelength, limit in zip(wavelengths, slopes_squared):
                    sine, cosine = dr.sincos((-2 * math.pi / wavelength) * detour)
                    weight = dr.select(squared <= limit, dz * (disk_area / (wavelength * count)), 0)
                    kernel += [weight * cosine, weight * sine]
            else:
                level = mi.UInt32(dr.minimum(dr.abs(dz) * level_scale, LEVELS - 1))
                reach_x = dr.gather(mi.Int, offset_buffer, level * offset_stride + mi.UInt32(dr.abs(index_i)))
                reach_y = dr.gather(mi.Int, offset_buffer, level * offset_stride + mi.UInt32(dr.abs(index_j)))
                entry = (level * (reach + 1) + mi.UInt32(reach_y)) * (reach + 1) + mi.UInt32(reach_x)
                kernel = gather_row(table_buffer, entry, 2 * len(wavelengths))
                behind = dz < 0
                for k in range(1, len(kernel), 2):
                    kernel[k] = dr.select(behind, -kernel[k], kernel[k])
                shift_x = dr.select((index_i < 0) != behind, -reach_x, reach_x)
                shift_y = dr.select((index_j < 0) != behind, -reach_y, reach_y)
            grain_column, grain_row = column + shift_x, row - shift_y
            # s4, s5: amplitude of the grain
            if integrator is None:
                cell, inside = grid.index(grain_column, grain_row, dz, slope_x, slope_y, max_slope)
                amplitude = gather_row(amplitudes, dr.select(inside, cell, 0), len(wavelengths))
                amplitude = [dr.select(inside, a, 0) for a in amplitude]
            else:
                light, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(ray), None, True)
                amplitude = [dr.sqrt(dr.maximum(light[c], 0)) for c in channels]
            # s8: the frames' phases at the grain, periodic with the hologram
            wrapped_x = grain_column - width * mi.Int(dr.floor(mi.Float(grain_column) / width))
            wrapped_y = grain_row - height * mi.Int(dr.floor(mi.Float(grain_row) / height))
            wrapped_x = dr.clip(wrapped_x, 0, width - 1)
            wrapped_y = dr.clip(wrapped_y, 0, height - 1)
            phasor = gather_phasors(phasor_buffer, mi.UInt32(wrapped_y * width + wrapped_x), frames)
            # s9
            field = list(field)
            for k, a in enumerate(amplitude):
                real, imag = a * kernel[2 * k], a * kernel[2 * k + 1]
                for m in range(frames):
                    at = 2 * (k * frames + m)
                    field[at] = dr.fma(real, phasor[2 * m], dr.fma(-imag, phasor[2 * m + 1], field[at]))
                    field[at + 1] = dr.fma(
                        real, phasor[2 * m + 1], dr.fma(imag, phasor[2 * m], field[at + 1])
                    )
            return step + 1, field, random, sampler

        limit = dr.opaque(mi.UInt32, count)
        _, field, _, _ = dr.while_loop(
            (mi.UInt32(0), field, random, sampler),
            lambda step, *_: step < limit,
            body,
            label="wave path tracer",
        )
        dr.eval(field)
        for k, m in np.ndindex(len(wavelengths), frames):
            at = 2 * (k * frames + m)
            target = out[m, k, first : first + rows]
            target.real = np.asarray(field[at]).reshape(rows, width)
            target.imag = np.asarray(field[at + 1]).reshape(rows, width)
        progress((first + rows) / height)
    out /= PHASOR_SCALE
    return out
