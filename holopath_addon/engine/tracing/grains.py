"""Grains of light in view and their radiance, path-traced once for all pixels that see them (stage s5)."""

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
from .grain_grid import GrainGrid, RowIndex
from .regions import Sightings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..scene.rays import ImagePoint, Rays
    from ..scene.specular_chains import FirstHits, SpecularChains

CHUNK_PATHS = 1 << 20  # paths that share a sequence of random numbers
UNIT_PATHS = 1 << 17  # paths of a unit of work: 0.12 s of two idle cores, several times that of busy ones
TILT = 2  # numbers of slopes that precede the radiances in a row of means
# Reflectances that are added for black surfaces, and for light that no diffuse lobe scatters.
BLACK, SPECULAR = 1e-3, 0.04


@dataclass(frozen=True)
class RadianceMap:
    """Mean radiances of the grains in view.

    Attributes
    ----------
    grid : GrainGrid
    index : RowIndex
        Rows of its cells.
    radiances : mitsuba.Float
        Rows of means: the surface's `Rays.tilt`, and the radiance of each color.
    colors : int
        Radiances of a row; 1 where all wavelengths share one.
    passes, textures : int
        Paths of a pixel, and rays of it that see textures alone.
    error : float
        Relative standard error of the wave field, see `row_sums.field_error`.
    sightings : tuple of Sightings
        Surfaces that the paths met as seen from the tiles of each recording plane.
    """

    grid: GrainGrid
    index: RowIndex
    radiances: mi.Float
    colors: int
    passes: int
    textures: int
    error: float
    sightings: tuple[Sightings, ...]

    def sampler(self, seed: int, size: int) -> None:
        """Return None: no random numbers are needed."""
        return None

    def amplitudes(
        self,
        scene: mi.Scene,
        rays: Rays,
        sampler: None,
        point: ImagePoint,
        grain: tuple[mi.Int, mi.Int, mi.Float],
        slope: tuple[mi.Float, mi.Float],
        channels: Sequence[int],
    ) -> tuple[list, tuple[mi.Float, mi.Float]]:
        """Look up amplitudes, the roots of radiances, and mean slopes of a grain's surface.

        Between pupil bins radiance is interpolated, so that a highlight moves as the view does.

        Parameters
        ----------
        scene, rays, sampler
            Not used: parameters of `PathsPerRay.amplitudes`.
        point : ImagePoint
        grain : tuple of mitsuba.Int, mitsuba.Int, mitsuba.Float
            Pixel column and row, and z in meters.
        slope : tuple of mitsuba.Float
            Slopes of the ray, (dx/dz, dy/dz).
        channels : sequence of int
            Color channel of each wavelength.

        Returns
        -------
        amplitudes : list of mitsuba.Float
        tilt : tuple of mitsuba.Float
            Mean `Rays.tilt`.
        """
        cell, inside = self.grid.cell(*grain, point.branch)
        first, binned = self.index.at(cell, inside)
        values = TILT + self.colors
        if self.grid.bins == 1:
            return self._roots(gather_row(self.radiances, first, values), channels)
        over, up = (self.grid.bin_place(s) for s in slope)
        i, j = mi.UInt32(over), mi.UInt32(up)
        i, j = dr.minimum(i, self.grid.bins - 2), dr.minimum(j, self.grid.bins - 2)
        over, up = over - i, up - j
        total = [mi.Float(0)] * values
        for i_step, j_step, weight in (
            (0, 0, (1 - over) * (1 - up)),
            (1, 0, over * (1 - up)),
            (0, 1, (1 - over) * up),
            (1, 1, over * up),
        ):
            at = first + dr.select(binned, (j + j_step) * self.grid.bins + i + i_step, 0)
            row = gather_row(self.radiances, at, values)
            total = [sum_ + weight * value for sum_, value in zip(total, row, strict=True)]
        return self._roots(total, channels)

    def _roots(self, row, channels):
        roots = [dr.sqrt(value) for value in row[TILT:]]
        return roots if self.colors > 1 else roots * len(channels), tuple(row[:TILT])


def reflectance_of(scene: mi.Scene, point: ImagePoint, active: mi.Bool) -> tuple[mi.Color3f, mi.Bool]:
    """Reflectance that a grain's light is divided by where grains share it, and whether light is emitted there.

    A rough value is enough, as light is multiplied by it again.

    Parameters
    ----------
    scene : mitsuba.Scene
    point : ImagePoint
    active : mitsuba.Bool

    Returns
    -------
    reflectance : mitsuba.Color3f
        1 where there is no diffuse lobe.
    emits : mitsuba.Bool
        Whether the surface, or the sky, is an emitter.
    """
    interaction = point.surface.compute_surface_interaction(point.ray, mi.RayFlags.All, active)
    emits = interaction.emitter(scene, active) != None  # noqa: E711 (of each lane)
    active = active & point.surface.is_valid()
    bsdf = interaction.bsdf(point.ray)
    value = dr.clip(bsdf.eval_diffuse_reflectance(interaction, active), 0, 1)
    value += dr.select((bsdf.flags() & (SMOOTH & ~DIFFUSE)) != 0, mi.Float(SPECULAR), BLACK)
    # without a diffuse lobe Mitsuba returns what is scattered along the normal, which bumps and the view change
    diffuse = active & ((bsdf.flags() & DIFFUSE) != 0) & dr.all(dr.isfinite(value))
    return dr.select(diffuse, value, 1), emits


def row_of(
    grains: Grains, grid: GrainGrid, index: RowIndex, occupied: mi.UInt32
) -> tuple[mi.UInt32, mi.Bool]:
    """Row of each grain in the radiance map, and whether it has one.

    Parameters
    ----------
    grains : Grains
    grid : GrainGrid
    index : RowIndex
    occupied : mitsuba.UInt32
        Parameter of `RowIndex.of`: cells without a surface of their own are left out, as they borrow rows.
    """
    inside = grains.inside & (dr.gather(mi.UInt32, occupied, grains.cell, grains.inside) != 0)
    first, binned = index.at(grains.cell, inside)
    over, up = (mi.UInt32(dr.round(grid.bin_place(s))) for s in (grains.slope.x, grains.slope.y))
    return first + dr.select(binned, up * grid.bins + over, 0), inside


@dataclass
class Grains:
    """Grains that some rays met, in Dr.Jit types.

    Attributes
    ----------
    sampler : Sampler
        Random numbers for the paths from there.
    first : mitsuba.Float
        Height of the ray's first surface over the plane, meters.
    number : mitsuba.UInt32
        Number of the ray among those of its pixel.
    column, row : mitsuba.Float
        Start of the ray on the plane, pixels.
    slope : mitsuba.Point2f
        Slopes of the ray.
    point : ImagePoint
    dz : mitsuba.Float
        Height of the image point over the plane, meters.
    cell : mitsuba.UInt32
        Cell of the grid.
    inside : mitsuba.Bool
        Whether the grain lies on the grid and holds a surface or the sky.
    binned : mitsuba.Bool
        Whether its surface looks different across the pupil.
    """

    sampler: Sampler
    first: mi.Float
    number: mi.UInt32
    column: mi.Float
    row: mi.Float
    slope: mi.Point2f
    point: ImagePoint
    dz: mi.Float
    cell: mi.UInt32
    inside: mi.Bool
    binned: mi.Bool


@dataclass(frozen=True)
class SamplingPass:
    """Rays through all pixels, for one purpose.

    Attributes
    ----------
    kind : {'cells', 'light', 'textures'}
        Finds cells that hold a surface, the light that it sends, or only what it reflects.
    rays : int
        Rays of a pixel.
    first : int
        Index of the first of them.
    weight : float
        Approximate fraction of the remaining work.
    """

    kind: str
    rays: int
    first: int
    weight: float


def unit_count(grid: GrainGrid, passes: int) -> int:
    """Number of units of work for `passes` rays through each pixel of a grid."""
    return math.ceil(grid.columns * grid.rows / _pixels(UNIT_PATHS, passes))


def _pixels(paths, passes):
    """Pixels for some paths, in whole packets, so that rays meet the same surfaces whatever units go together."""
    return max(1, paths // (passes * PACKET)) * PACKET


def grains_of(
    scene: mi.Scene,
    rays: Rays,
    image_finder: FirstHits | SpecularChains,
    grid: GrainGrid,
    units: range,
    sampling: SamplingPass,
    seed: int,
) -> Grains:
    """Trace a pass's rays of some units to their grains; the same ones at every call, whatever units go together.

    Parameters
    ----------
    scene, rays, image_finder, grid
        Parameters of `measurement.Measurement`.
    units : range
        Numbers below `unit_count`.
    sampling : SamplingPass
    seed : int
    """
    passes, size = sampling.rays, _pixels(UNIT_PATHS, sampling.rays)
    first = units.start * size
    count = min(len(units) * size, grid.columns * grid.rows - first)
    # the passes of a pixel side by side: rays that stay near each other are faster in fine meshes
    index, each = dr.arange(mi.UInt32, count * passes), dr.opaque(mi.UInt32, passes)
    number = index % each + dr.opaque(mi.UInt32, sampling.first)
    pixel = index // each + dr.opaque(mi.UInt32, first)
    chunk = dr.opaque(mi.UInt32, _pixels(CHUNK_PATHS, passes))
    own = dr.opaque(mi.UInt32, (seed * 9973 + 0x9E3779B1 * sampling.first) & 0xFFFFFFFF)
    sampler = Sampler.seeded(own + pixel // chunk * chunk, pixel % chunk * each + index % each)
    jitter = sampler.next_2d()
    columns, margin = dr.opaque(mi.UInt32, grid.columns), dr.opaque(mi.Float, grid.margin)
    column = mi.Float(pixel % columns) - margin + jitter.x - 0.5
    row = mi.Float(pixel // columns) - margin + jitter.y - 0.5
    # the R2 sequence spreads a pixel's passes over the pupil, from a random start
    key = dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)
    turn = mi.Point2f(*(mi.Float(word) * 2.0**-32 for word in mi.sample_tea_32(pixel, key)))
    u = mi.Point2f(number * 0.7548776662466927 + turn.x, number * 0.5698402909980532 + turn.y)
    slope = grid.max_slope * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
    ray, depth_rate = rays.world(*rays.place(column, row), slope.x, slope.y)
    branches = image_finder.branches
    branch = mi.UInt32(sampler.next_1d() * branches) if branches > 1 else mi.UInt32(0)
    point = image_finder.view(scene, ray, branch, drawn=True)
    first = rays.height_over_plane(point.first, depth_rate, dr.isfinite(point.first))
    dz = rays.within(rays.height_over_plane(point.distance, depth_rate, point.hit))
    over = mi.Int(dr.round(column + slope.x * dz / rays.pitch))
    down = mi.Int(dr.round(row - slope.y * dz / rays.pitch))
    cell, inside = grid.cell(over, down, rays.plane + dz, point.branch)
    binned = mi.Bool(False)
    if grid.bins > 1:
        flags = point.surface.shape.bsdf().flags()
        binned = mi.has_flag(flags, mi.BSDFFlags.Glossy) | (point.whole & ((flags & SHARP) != 0))
    return Grains(sampler, first, number, column, row, slope, point, dz, cell, inside & point.exists, binned)
