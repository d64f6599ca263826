"""Measures the radiance map: what is asked next follows from what the rays before told.

All that rays tell are sums of whole numbers, and largest ones: the order in which threads add them then does not change
the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..hologram import channel
from ..progress import paced
from ..scene.buffers import mean, row_stride
from ..scene.rays import OUTSIDE
from ..scene.variants import units_at_once
from .filtering import Half, filtered, squared_error
from .grains import CHUNK_PATHS, TILT, UNIT_PATHS, RadianceMap, grains_of, numbered, row_of, shown, unit_count
from .regions import DEPTHS, TILE, Sightings, tiles_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..light.path_tracer import PathTracer
    from ..plan import Plan
    from ..progress import PartProgress
    from ..scene.rays import Rays
    from ..scene.specular_chains import FirstHits, SpecularChains
    from .grain_grid import GrainGrid

RADIANCE_STEPS = 2.0**26
RADIANCE_LIMIT = 2.0**30
ATOMIC = dr.ReduceMode.Local  # a copy for each thread would make the size of the sums part of the program
HALF = 8  # numbers of a `Half`
SUMS = 2 * HALF + 2  # of a row: those of both halves, and slopes along x and y
LOOKED = 4  # numbers of a row that rays for textures add: reflectances, and how many they were
OTHERS = 1 << 13  # number of the first of the rays that see textures alone, which no path has
TEXTURES = 0.35  # of the wanted error: what textures may have of it
MOST_LOOKS = 256  # rays of a pixel that see textures alone
NOISIER = 1.1  # than wished is good enough
CELLS = 0.1  # of the time goes to find them
ROUNDS = 3  # of paths at most
ASKED = 0.9  # of a question's time goes to ask it, the rest to what follows from the answers

Totals = dict[str, Any]  # flat arrays of whole numbers by name, Dr.Jit's


@dataclass(frozen=True)
class _Question:
    """What rays through all pixels are asked, round by round.

    Attributes
    ----------
    kind : {'cells', 'light', 'textures'}
        Which cells hold a surface, what light it sends, or only what it reflects.
    passes : int
        Rays of a pixel.
    before : int
        Number of the first of them.
    share : float
        Of what is left to be done, roughly.
    """

    kind: str
    passes: int
    before: int
    share: float


class Measurement:
    """Path-traces the radiance of the grains in view, every path for all pixels that see its grain.

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
    """

    def __init__(
        self,
        scene: mi.Scene,
        rays: Rays,
        optics: FirstHits | SpecularChains,
        tracer: PathTracer,
        grid: GrainGrid,
        plan: Plan,
        *,
        wavelengths: Sequence[float],
        seed: int,
    ) -> None:
        self._scene, self._rays, self._optics, self._tracer = scene, rays, optics, tracer
        self._grid, self._plan, self._wavelengths, self._seed = grid, plan, wavelengths, seed
        # of the radiances that are added up, for their squares to be whole numbers of steps
        self._unit = plan.white if 0 < plan.white < math.inf else 1.0
        self._scale = dr.opaque(mi.Float, 1 / self._unit)
        self._tiles = _Tiles(grid, rays, plan.planes if plan.regions else ())
        self._question: _Question | None = _Question("cells", plan.passes, 0, CELLS)
        self._light: Totals = {}
        self._taken = self._rounds = self._looks = 0
        self._error = math.inf
        self._looked = Half.of([mi.Float(0)] * HALF)

    def _nothing(self, question):
        """What is known of a question before any pixel is asked."""
        if question.kind == "cells":
            grid = self._grid
            return {"occupied": dr.zeros(mi.UInt32, grid.columns * grid.rows * grid.slabs * grid.branches)}
        if question.kind == "textures":
            return {"reflectances": dr.zeros(mi.UInt64, LOOKED * self._rows)}
        sums, shining = dr.zeros(mi.UInt64, SUMS * self._rows), dr.zeros(mi.UInt32, self._rows)
        return {"sums": sums, "shining": shining, **self._tiles.nothing()}

    def _ask(self, question, totals, progress):
        """Ask all pixels, and add what they tell to the totals."""
        add = {"cells": self._cells_of, "light": self._light_of, "textures": self._textures_of}[question.kind]
        what = self._scene, self._rays, self._optics, self._grid
        count = unit_count(self._grid, question.passes)
        for some in paced(range(count), CHUNK_PATHS // UNIT_PATHS * units_at_once()):
            add(grains_of(*what, some, question.passes, self._seed, question.before), totals)
            dr.eval(totals)
            dr.sync_thread()
            progress(some.stop / count)

    def _cells_of(self, grains, totals):
        kind = dr.select(grains.binned, mi.UInt32(self._grid.bins**2), 1)
        dr.scatter_reduce(dr.ReduceOp.Max, totals["occupied"], kind, grains.cell, grains.inside, mode=ATOMIC)

    def _light_of(self, grains, totals):
        scene, seen, sums = self._scene, grains.seen, totals["sums"]
        light = self._tracer.radiance(
            scene, grains.sampler, seen.ray, seen.surface, seen.whole, parts=seen.parts
        )
        light *= self._scale / seen.colour
        row, inside = row_of(grains, self._grid, self._numbers, self._occupied)
        inside &= dr.all(dr.isfinite(light))
        reflectance, shines = shown(scene, seen, inside)
        first = dr.gather(mi.UInt32, self._numbers, grains.cell, inside) >> 1
        dr.scatter_reduce(
            dr.ReduceOp.Max, totals["shining"], mi.UInt32(1), first, inside & shines, mode=ATOMIC
        )
        half = SUMS * row + HALF * (grains.number & 1)
        for k, value in enumerate(Half.path(light, reflectance).numbers):
            dr.scatter_add(sums, _steps(value), half + k, inside, mode=ATOMIC)
        for k, slope in enumerate(self._rays.tilt(seen)):  # of either sign: the sums wrap round
            steps = mi.UInt64(mi.Int64(slope * RADIANCE_STEPS))
            dr.scatter_add(sums, steps, SUMS * (row + 1) - TILT + k, inside, mode=ATOMIC)
        self._tiles.add(grains, inside & dr.any(light > 0), totals)

    def _textures_of(self, grains, totals):
        row, inside = row_of(grains, self._grid, self._numbers, self._occupied)
        reflectance, _ = shown(self._scene, grains.seen, inside)
        for k, value in enumerate((*reflectance, mi.Float(1))):
            dr.scatter_add(totals["reflectances"], _steps(value), LOOKED * row + k, inside, mode=ATOMIC)

    def _include(self, question, totals):
        """Take in what all pixels told; of light, together with the rounds before."""
        if question.kind == "cells":
            self._occupied = totals["occupied"]
            self._numbers, self._rows = numbered(self._occupied, self._grid)
            if not dr.any((self._numbers & 1) == 1):
                self._grid = replace(self._grid, bins=1)
        elif question.kind == "light":
            self._light, self._taken, self._rounds = totals, self._taken + question.passes, self._rounds + 1
        else:
            self._looked, self._looks = _looked(totals["reflectances"]), question.passes

    def _next(self, asked, progress):
        """The question after one that was asked; None where all is known."""
        plan = self._plan
        if asked.kind == "cells":
            return self._paths(plan.passes)
        if asked.kind == "light":
            self._share(progress)
        wanted, most = plan.wanted_error, plan.most_passes
        self._error, of_textures = _field_error(
            self._halves, self._kept, self._shared, self._looked.count, plan.white / self._unit
        )
        if self._rounds == 1 and asked.kind == "light" and of_textures > 0:
            looks = plan.textures
            if looks is None:
                looks = rays_for_textures(of_textures, wanted, self._taken)
            if looks:
                return _Question("textures", looks, OTHERS, 0.0)
        if self._error <= NOISIER * wanted or self._taken >= most or self._rounds == ROUNDS:
            return None
        return self._paths(
            min(most - self._taken, math.ceil(self._taken * ((self._error / wanted) ** 2 - 1)))
        )

    def _paths(self, passes):
        """Question for light; another one may follow."""
        another = self._rounds < ROUNDS - 1 and self._taken + passes < self._plan.most_passes
        return _Question("light", passes, self._taken, 0.5 if another else 1.0)

    def _share(self, progress):
        """Have grains share their light."""
        self._halves = self._kept = _halves(self._light["sums"])
        self._shared = dr.zeros(mi.Bool, self._rows)
        plan, numbers = self._plan, self._numbers
        shining = dr.gather(mi.UInt32, self._light["shining"], numbers >> 1)
        cells = dr.compress((self._occupied > 0) & (shining == 0))
        if plan.reach and self._taken > 1 and dr.width(cells):
            what = self._halves, cells, numbers, self._grid, plan.reach
            self._kept, self._shared = filtered(*what, progress)

    def _radiance_map(self):
        own = self._halves[0] + self._halves[1]
        shared = (self._kept[0] + self._kept[1]).over * (own + self._looked).reflectance
        light = self._unit * dr.select(self._shared, shared, own.radiance)
        dr.eval(light, own.count)
        what = self._light["sums"], light, own.count, self._numbers, self._grid, self._wavelengths
        told = len(self._wavelengths), self._taken, self._looks, self._error
        return RadianceMap(
            self._grid, self._numbers, _means(*what), *told, self._tiles.sightings(self._light)
        )

    def measured(self, progress: PartProgress) -> RadianceMap:
        """The radiance map.

        Parameters
        ----------
        progress : callable
            ``progress(done)``, may raise.

        Returns
        -------
        RadianceMap
        """
        done = 0.0
        while (question := self._question) is not None:
            share = (1 - done) * question.share
            # paths of a later round add to those before
            again = question.kind == "light" and self._light
            totals = self._light if again else self._nothing(question)

            def told(part, done=done, share=share):
                progress(done + share * part)

            self._ask(question, totals, lambda part, told=told: told(ASKED * part))
            self._include(question, totals)
            self._question = self._next(question, lambda part, told=told: told(ASKED + (1 - ASKED) * part))
            done += share
        return self._radiance_map()


def _steps(value):
    """As whole numbers, to be added up."""
    return mi.UInt64(dr.clip(value, 0, RADIANCE_LIMIT) * RADIANCE_STEPS)


def rays_for_textures(error, wanted, passes):
    """Rays through each pixel that, with so many paths, leave little of the error that textures make."""
    return min(MOST_LOOKS, max(0, math.ceil(passes * (error / (TEXTURES * wanted)) ** 2) - passes))


def _looked(reflectances):
    """Reflectances that rays saw in each row, as a `Half` without light."""
    row = dr.arange(mi.UInt32, dr.width(reflectances) // LOOKED)
    columns = [
        mi.Float(dr.gather(mi.UInt64, reflectances, LOOKED * row + k)) / RADIANCE_STEPS for k in range(LOOKED)
    ]
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
    bright, both = mean(own.radiance), (halves[0].count > 0) & (halves[1].count > 0)
    weight = (
        dr.select(both & (bright > 0), own.count * dr.minimum(bright, white), 0) / 12
    )  # channels, and 2^2

    def part(where, squared, of):
        return dr.select(where, weight * squared / dr.maximum(dr.square(of), 1e-30), 0)

    def apart(a, b):
        return 0.25 * dr.squared_norm(a - b)

    # textures and edges, of which a few paths show a part, and the rays that look at them a larger one
    over, seen = mean(light.over), own.count / dr.maximum(own.count + looks, 1)
    parts = [
        weight,
        part(~shared, apart(*(half.radiance for half in halves)), bright),
        part(shared, apart(*(half.over for half in kept)), over),
        part(shared, squared_error(halves, kept), over),
        part(shared, seen * apart(*(half.reflectance for half in halves)), mean(own.reflectance)),
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
        tiles = self._shape[0] * self._shape[1]
        self._firsts = [dr.opaque(mi.UInt32, number * tiles) for number in range(len(planes))]
        self._numbers = [
            [
                dr.opaque(mi.Float, float(number))
                for number in (plane.z, plane.depth_limit, *_ends(plane.slab), *_ends(plane.images))
            ]
            for plane in planes
        ]

    def nothing(self):
        """Totals that nothing was added to."""
        count = len(self._planes) * self._shape[0] * self._shape[1]
        return {name: dr.zeros(mi.UInt32, max(1, count)) for name in ("depth", "chains")}

    def add(self, grains, lit, totals):
        """Add grains to the totals; `lit` says which of them shine."""
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
            tile = mi.UInt32(row // TILE * self._across + column // TILE) + self._firsts[number]
            part = 1 + mi.UInt32(dr.minimum(dr.abs(z - plane) / limit, 1) * (DEPTHS - 1))
            dr.scatter_reduce(dr.ReduceOp.Max, totals["depth"], part, tile, recorded, mode=ATOMIC)
            chained = inside & (grains.seen.hits > 0)
            dr.scatter_reduce(dr.ReduceOp.Max, totals["chains"], mi.UInt32(1), tile, chained, mode=ATOMIC)

    def sightings(self, totals):
        """The `Sightings` of each plane."""
        shape = (len(self._planes), *self._shape)
        depth, chains = (
            np.array(totals[name])[: math.prod(shape)].reshape(shape) for name in ("depth", "chains")
        )
        images = [plane.sees != "surfaces" for plane in self._planes]
        return tuple(map(Sightings, depth, chains > 0, images))


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
