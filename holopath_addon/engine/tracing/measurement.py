"""Measurement of the radiance map by adaptive sampling: each pass follows from the statistics of the passes before.

Integer sums and maxima make the results independent of the order of threads.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from ..progress import paced
from ..scene.variants import units_at_once
from .filtering import Half, share_light
from .grain_grid import RowIndex
from .grains import (
    CHUNK_PATHS,
    UNIT_PATHS,
    RadianceMap,
    SamplingPass,
    grains_of,
    reflectance_of,
    row_of,
    unit_count,
)
from .row_sums import ATOMIC, HALF, LIGHT, TEXTURE, RowSums, field_error
from .tiles import Tiles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..light.path_tracer import PathTracer
    from ..plan import Plan
    from ..progress import PartProgress
    from ..scene.rays import Rays
    from ..scene.specular_chains import FirstHits, SpecularChains
    from .grain_grid import GrainGrid

FIRST_TEXTURE_RAY = 1 << 13  # number of the first of the rays that see textures alone; paths stay below
TEXTURE_ERROR = 0.35  # maximum error due to textures, as a fraction of the target
MAX_TEXTURE_RAYS = 256  # rays of a pixel that see textures alone
TOLERANCE = 1.1  # an error up to this multiple of the target is good enough
CELLS_WEIGHT = 0.1  # fraction of the time that finding the occupied cells takes
MAX_ROUNDS = 3  # rounds of paths
TRACING_WEIGHT = 0.9  # fraction of a pass's time for its rays; its evaluation takes the rest

Totals = dict[str, Any]  # sums and maxima by name


class Measurement:
    """Path tracing of the radiance of the grains in view, with each path for all pixels that see its grain.

    A pixel's amplitude is the square root of the mean radiance over paths. The mean of roots would be biased dark.

    Parameters
    ----------
    scene : mitsuba.Scene
    rays : Rays
    image_finder : FirstHits or SpecularChains
    tracer : PathTracer
    grid : GrainGrid
    plan : Plan
        Paths and texture rays of a pixel, how far grains share their light, see `filtering`, and the target of
        `row_sums.field_error`.
    wavelengths : sequence of float
        Meters; a radiance each.
    """

    def __init__(
        self,
        scene: mi.Scene,
        rays: Rays,
        image_finder: FirstHits | SpecularChains,
        tracer: PathTracer,
        grid: GrainGrid,
        plan: Plan,
        wavelengths: Sequence[float],
    ) -> None:
        self._scene, self._rays, self._image_finder, self._tracer = scene, rays, image_finder, tracer
        self._grid, self._plan, self._wavelengths = grid, plan, wavelengths
        # unit of radiance, so that squares are whole numbers of steps, too
        self._unit = plan.white if 0 < plan.white < math.inf else 1.0
        self._scale = dr.opaque(mi.Float, 1 / self._unit)
        self._tiles = Tiles(grid, rays, plan.planes if plan.regions else ())
        self._light: Totals = {}
        self._paths = self._rounds = self._texture_rays = 0
        self._error = math.inf
        self._textures = Half.of([mi.Float(0)] * HALF)

    def measure(self, progress: PartProgress) -> RadianceMap:
        """Trace all passes for the radiance map.

        Parameters
        ----------
        progress : callable
            ``progress(done)``, may raise.
        """
        done, sampling = 0.0, SamplingPass("cells", self._plan.passes, 0, CELLS_WEIGHT)
        while sampling is not None:
            weight = (1 - done) * sampling.weight
            whole = _part(progress, done, weight)
            totals = self._trace(sampling, _part(whole, 0.0, TRACING_WEIGHT))
            rest = _part(whole, TRACING_WEIGHT, 1 - TRACING_WEIGHT)
            sampling = self._evaluate(sampling, totals, rest)
            done += weight
        return self._radiance_map()

    def _trace(self, sampling, progress):
        """Trace a pass; return its totals, those of light with the rounds before."""
        add = {"cells": self._add_cells, "light": self._add_light, "textures": self._add_textures}
        totals = self._light if sampling.kind == "light" and self._light else self._zeros(sampling.kind)
        count, seed = unit_count(self._grid, sampling.rays), self._plan.settings.seed
        for some in paced(range(count), CHUNK_PATHS // UNIT_PATHS * units_at_once()):
            grains = grains_of(self._scene, self._rays, self._image_finder, self._grid, some, sampling, seed)
            add[sampling.kind](grains, totals)
            dr.eval(totals)
            dr.sync_thread()
            progress(some.stop / count)
        return totals

    def _zeros(self, kind):
        """Totals of a kind of pass without any ray."""
        if kind == "cells":
            grid = self._grid
            return {"occupied": dr.zeros(mi.UInt32, grid.columns * grid.rows * grid.slabs * grid.branches)}
        if kind == "textures":
            return {"sums": RowSums.zeros(self._index.rows, TEXTURE)}
        rows = self._index.rows
        return {
            "sums": RowSums.zeros(rows, LIGHT),
            "emitting": dr.zeros(mi.UInt32, rows),
            **self._tiles.zeros(),
        }

    def _add_cells(self, grains, totals):
        rows = dr.select(grains.binned, mi.UInt32(self._grid.bins**2), 1)
        dr.scatter_reduce(dr.ReduceOp.Max, totals["occupied"], rows, grains.cell, grains.inside, mode=ATOMIC)

    def _add_light(self, grains, totals):
        scene, point = self._scene, grains.point
        light = self._tracer.radiance(scene, grains.sampler, point)
        light *= self._scale / point.color
        row, inside = row_of(grains, self._grid, self._index, self._occupied)
        inside &= dr.all(dr.isfinite(light))
        reflectance, emits = reflectance_of(scene, point, inside)
        first, _ = self._index.at(grains.cell, inside)
        dr.scatter_reduce(
            dr.ReduceOp.Max, totals["emitting"], mi.UInt32(1), first, inside & emits, mode=ATOMIC
        )
        half = Half.path(light, reflectance)
        totals["sums"].add_light(row, grains.number, half, self._rays.tilt(point), inside)
        self._tiles.add(grains, inside & dr.any(light > 0), totals)

    def _add_textures(self, grains, totals):
        row, inside = row_of(grains, self._grid, self._index, self._occupied)
        reflectance, _ = reflectance_of(self._scene, grains.point, inside)
        totals["sums"].add_texture(row, reflectance, inside)

    def _evaluate(self, sampling, totals, progress):
        """Evaluate the totals of a pass; return the next pass, or None at the target error or a maximum."""
        plan = self._plan
        if sampling.kind == "cells":
            self._occupied = totals["occupied"]
            self._index = RowIndex.of(self._occupied, self._grid)
            if not dr.any(self._index.binned):
                self._grid = replace(self._grid, bins=1)
            return self._next_paths(plan.passes)
        if sampling.kind == "light":
            self._light, self._paths, self._rounds = totals, self._paths + sampling.rays, self._rounds + 1
            self._share(progress)
        else:
            self._textures, self._texture_rays = totals["sums"].textures, sampling.rays
        target, max_paths = plan.target_error, plan.max_passes
        self._error, texture_error = field_error(
            self._halves,
            self._filtered,
            self._shared,
            self._textures.count,
            (plan.white or math.inf) / self._unit,
        )
        if self._rounds == 1 and sampling.kind == "light" and texture_error > 0:
            rays = plan.textures
            if rays is None:
                rays = rays_for_textures(texture_error, target, self._paths)
            if rays:
                return SamplingPass("textures", rays, FIRST_TEXTURE_RAY, 0.0)
        if self._error <= TOLERANCE * target or self._paths >= max_paths or self._rounds == MAX_ROUNDS:
            return None
        more = math.ceil(self._paths * ((self._error / target) ** 2 - 1))
        return self._next_paths(min(max_paths - self._paths, more))

    def _next_paths(self, passes):
        """Pass for light; another one may follow."""
        another = self._rounds < MAX_ROUNDS - 1 and self._paths + passes < self._plan.max_passes
        return SamplingPass("light", passes, self._paths, 0.5 if another else 1.0)

    def _share(self, progress):
        """Filter the light of neighboring grains, except for emitters."""
        self._halves = self._filtered = self._light["sums"].halves
        self._shared = dr.zeros(mi.Bool, self._index.rows)
        emitting = dr.gather(mi.UInt32, self._light["emitting"], self._index.first)
        cells = dr.compress((self._occupied > 0) & (emitting == 0))
        if self._plan.reach and self._paths > 1 and dr.width(cells):
            self._filtered, self._shared = share_light(
                self._halves, cells, self._index, self._grid, self._plan.reach, progress
            )

    def _radiance_map(self):
        own = self._halves[0] + self._halves[1]
        shared = (self._filtered[0] + self._filtered[1]).irradiance * (own + self._textures).reflectance
        light = self._unit * dr.select(self._shared, shared, own.radiance)
        dr.eval(light, own.count)
        return RadianceMap(
            self._grid,
            self._index,
            self._light["sums"].means(light, own.count, self._index, self._grid, self._wavelengths),
            len(self._wavelengths),
            self._paths,
            self._texture_rays,
            self._error,
            self._tiles.sightings(self._light),
        )


def _part(progress, start, weight):
    """Progress callback of a part of the work, of a weight from `start` on."""
    return lambda done: progress(start + weight * done)


def rays_for_textures(error: float, target: float, passes: int) -> int:
    """Rays through each pixel, beside its paths, that reduce the error due to textures to `TEXTURE_ERROR`.

    Parameters
    ----------
    error : float
        Error due to textures that the paths leave.
    target : float
        Target of the whole error.
    passes : int
        Paths of a pixel.
    """
    return min(MAX_TEXTURE_RAYS, max(0, math.ceil(passes * (error / (TEXTURE_ERROR * target)) ** 2) - passes))
