"""The pilot: a few rays and paths that measure what a scene holds, and how fast this machine traces it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import InvalidInput
from ..light.path_tracer import DIRECT, PathTracer
from ..mapping import DepthMapping
from ..optics import ON_AXIS
from ..scene.buffers import mean
from ..scene.lobes import is_specular
from ..scene.random_numbers import Sampler
from ..scene.rays import Rays
from ..scene.specular_chains import nearly_smooth
from ..tracing.grains import reflectance_of
from .machine import timed
from .pilot_light import VERTEX_COUNTS, Light, Paths, light_of
from .probe import MIN_VIEW_FRACTION, Edges, Places, Probe

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..camera import Camera
    from ..hologram import Hologram
    from ..scene.specular_chains import FirstHits, SpecularChains
    from ..settings import Settings

_Result = TypeVar("_Result")

PILOT_PIXELS, PILOT_GRAINS = 1 << 14, 4096
DIVISORS = {"draft": 8, "preview": 4}  # of both, for these qualities
PILOT_PATHS = 32  # paths of a grain
# To find the nearest surface, which may be thin: pixels, and maximum rays of each.
NEAREST_PIXELS, NEAREST_RAYS = 1 << 16, 4
DIRECTIONS = 16  # rays of a pixel
SLAB_THICKNESS = 0.15  # thickness of a grain, fraction of the depth of focus
# Fraction of neighboring rays that meet the same triangle, from which packets are faster: 1.6 times at 0.07, 0.6 at
# 0.006. Measured speeds would decide differently now and then, and hits differ in their last bits.
MIN_COHERENT_FRACTION = 0.02
MIN_BEND = 1e-3  # difference of vergences, fraction of the vergence plus 1 diopter
# Fraction of the light of visible lamps that shorter chains may lose, beside that of the weights, which do not know how
# bright lamps are.
MAX_LAMP_LOSS = 0.01
CHAIN_LENGTHS = (1, 2, 3, 4, 6)  # hits of a chain, in the order tried


class Pilot:
    """A few rays, spread over the hologram and the pupil.

    Parameters
    ----------
    scene : mitsuba.Scene
    hologram : Hologram
    camera : Camera
    mapping : DepthMapping
        With beta = 0 the rays start at the pupil's center.
    seed : int
        Seed of the random numbers.
    pixels : int
        Approximate number of pixels, with `DIRECTIONS` rays each.
    grains : int
        Maximum number of grains whose light is sampled.
    timed_calls : int
        Times that programs run, of which the fastest counts.

    Attributes
    ----------
    size : int
        Number of rays.
    pupil, slab : float
        Radius of the pupil, in the scene, and thickness of a grain, meters.
    """

    def __init__(
        self,
        scene: mi.Scene,
        hologram: Hologram,
        camera: Camera,
        mapping: DepthMapping,
        *,
        seed: int = 0,
        pixels: int = PILOT_PIXELS,
        grains: int = PILOT_GRAINS,
        timed_calls: int = 2,
    ) -> None:
        self.scene, self.camera, self.seed = scene, camera, seed
        self._hologram, self._mapping = hologram, mapping
        self._rays = Rays(hologram, camera, mapping, mapping.z_far)
        stride = max(1, math.ceil(math.sqrt(hologram.width * hologram.height / pixels)))
        columns, rows = -(-hologram.width // stride), -(-hologram.height // stride)
        self.size = columns * rows * DIRECTIONS
        self._grains, self._timed_calls = min(self.size, grains), timed_calls
        self.sampler = _sampler(seed, self.size)
        index = dr.arange(mi.UInt32, self.size)
        pixel, number = index // DIRECTIONS, index % DIRECTIONS
        jitter = self.sampler.next_2d()
        # no literals: one program for all displays
        across = dr.opaque(mi.UInt32, columns)
        step, width, height = (dr.opaque(mi.Float, n) for n in (stride, hologram.width, hologram.height))
        column = dr.minimum((pixel % across + jitter.x) * step, width) - 0.5
        row = dr.minimum((pixel // across + jitter.y) * step, height) - 0.5
        turn = self.sampler.next_2d()
        u = mi.Point2f(number * 0.7548776662466927 + turn.x, number * 0.5698402909980532 + turn.y)
        limit = hologram.widest_slope
        self.pupil, self.slab = mapping.pupil_radius(limit), SLAB_THICKNESS * hologram.depth_of_focus
        slope = limit * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
        self.ray, self.depth_rate = self._rays.world(*self._rays.place(column, row), slope.x, slope.y)
        self._from = column, row, slope
        dr.make_opaque(self.ray, self.depth_rate, self._from)  # one program for all uses

    @classmethod
    def of(
        cls, scene: mi.Scene, hologram: Hologram, camera: Camera, mapping: DepthMapping, settings: Settings
    ) -> Pilot:
        """Pilot with as many rays as the quality needs."""
        divisor = DIVISORS.get(settings.quality, 1)
        return cls(
            scene,
            hologram,
            camera,
            mapping,
            seed=settings.seed,
            pixels=PILOT_PIXELS // divisor,
            grains=PILOT_GRAINS // divisor,
            timed_calls=1 if settings.quality == "draft" else 2,
        )

    def nearest(self) -> float | None:
        """World depth of the nearest surface, meters; None if there is none."""
        hit = self.scene.ray_intersect_preliminary(self.ray, coherent=True)
        depth = np.asarray(self.camera.clip_start + hit.t * self.depth_rate)
        nearest = depth.min(where=np.asarray(hit.is_valid()), initial=math.inf)
        return float(nearest) if math.isfinite(nearest) else None

    def edges(self, image_finder: FirstHits | SpecularChains) -> Edges:
        """`Edges` in the view along the axis, where depths differ by more than a grain's thickness."""
        width, height = self._hologram.width, self._hologram.height
        side = max(1, math.ceil(math.sqrt(width * height / NEAREST_PIXELS)))
        columns, rows = width // side, height // side
        across, step = dr.opaque(mi.UInt32, columns), dr.opaque(mi.Float, side)
        index = dr.arange(mi.UInt32, columns * rows)
        place = self._rays.place(mi.Float(index % across) * step, mi.Float(index // across) * step)
        ray, depth_rate = self._rays.world(*place, mi.Float(0), mi.Float(0))
        branch = mi.UInt32(self._random(columns * rows) * image_finder.branches)
        view = image_finder.view(self.scene, ray, branch, drawn=True)
        first, visible = (
            np.array(self._rays.height_over_plane(distance, depth_rate, dr.isfinite(distance)))
            + self._mapping.z_far
            for distance in (view.first, view.distance)
        )
        images = np.broadcast_to(np.asarray(view.hits) > 0, first.shape)
        first, visible, images = (values.reshape(rows, columns) for values in (first, visible, images))
        return Edges.between(first, visible, images, self.slab, float(side))

    def first_hits(self) -> Probe:
        """Probe of first surfaces."""
        si = self.scene.ray_intersect(self.ray)
        coherent = _same_surface(si) >= MIN_COHERENT_FRACTION
        seconds, compiling, _ = _timed(
            lambda: self.scene.ray_intersect_preliminary(self.ray, coherent=coherent).t, self._timed_calls
        )
        bsdf, hit = si.bsdf(), si.is_valid()
        depth = self.camera.clip_start + si.t * self.depth_rate
        sample, _ = bsdf.sample(mi.BSDFContext(), si, self.sampler.next_1d(), self.sampler.next_2d(), hit)
        glossy = hit & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Glossy) & (sample.pdf > 0)
        # a lobe of constant density over a cap of half-angle a has a = 1 / sqrt(pi pdf)
        turns = 2 * self.pupil / depth * dr.sqrt(math.pi * sample.pdf)
        nearly_specular = nearly_smooth(self.scene, si, depth, self.pupil) > 0
        specular = hit & is_specular(bsdf.flags())
        diffuse = hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
        dr.eval(hit, depth, glossy, turns, nearly_specular, specular, diffuse)
        nearly_specular, specular, diffuse = (
            float(np.asarray(kind).mean()) for kind in (nearly_specular, specular, diffuse)
        )
        depth, hit, glossy = (np.asarray(values) for values in (depth, hit, glossy))
        turns = np.asarray(turns)[glossy]
        few = len(turns) <= MIN_VIEW_FRACTION * self.size
        turn, sharpest = (0.0, 0.0) if few else map(float, np.quantile(turns, (0.9, 0.99)))
        exists = np.broadcast_to(hit | self.camera.sees_sky, self.size)
        vergence, is_image, sky = self._vergences(depth, hit, exists, np.zeros(self.size, bool))
        return Probe(
            vergence=vergence,
            is_image=is_image,
            sky=sky,
            specular=specular,
            nearly_specular=nearly_specular,
            diffuse=diffuse,
            turn=turn,
            sharpest=sharpest,
            gloss=1 / depth[glossy],
            places=self._places(depth, hit, exists & (hit | sky), False),
            coherent=coherent,
            rays_per_second=self.size / seconds,
            chains_per_second=self.size / seconds,
            compiling=compiling,
        )

    def images(self, probe: Probe, image_finder: SpecularChains) -> Probe:
        """Probe with the images that chains of mirrors and clear surfaces show."""
        branch = mi.UInt32(self.sampler.next_1d() * image_finder.branches)
        dr.make_opaque(branch)
        seconds, compiling, view = _timed(
            lambda: image_finder.view(self.scene, self.ray, branch, drawn=True), self._timed_calls
        )
        depth, path = self.camera.clip_start + view.distance * self.depth_rate, dr.rcp(view.path)
        # of a scene whose near end is far, all vergences are small
        shallow = min(1.0, (self._hologram.depth_near - self._mapping.z_far) / self._mapping.beta)
        shallow = dr.opaque(mi.Float, shallow)
        bent = dr.abs(dr.rcp(view.distance) - path) > MIN_BEND * (path + shallow)
        # light that comes from its image hardly differs across the pupil
        flags = view.surface.shape.bsdf().flags()
        glossy = view.surface.is_valid() & mi.has_flag(flags, mi.BSDFFlags.Glossy) & (view.image < 1)
        beyond = dr.select(view.cut & ~view.exists, mean(view.weight), 0)
        dr.eval(depth, bent, glossy, beyond)
        depth, hit, hits = (np.asarray(values) for values in (depth, view.hit, view.hits))
        exists = np.broadcast_to(view.exists, self.size)
        vergence, is_image, sky = self._vergences(depth, hit, exists, hits > 0)
        bent = np.asarray(bent) & exists
        images = 1 / depth[bent]
        return replace(
            probe,
            vergence=vergence,
            is_image=is_image,
            sky=sky,
            gloss=1 / depth[exists & np.asarray(glossy)],
            places=self._places(depth, hit, exists & (hit | sky), hits > 0, probe.places.first),
            chains_per_second=self.size / seconds,
            compiling=probe.compiling + compiling,
            bent=bool(bent.mean() > MIN_VIEW_FRACTION),
            images=images[np.isfinite(images)],
            splits=int(np.asarray(view.branch)[exists].max(initial=0)).bit_length(),
            cut=float(np.asarray(beyond).mean()),
        )

    def longest_chain(
        self, chains_up_to: Callable[[int], SpecularChains], max_hits: int
    ) -> tuple[int, float]:
        """Hits of a chain that suffice, and the fraction of the view that is lost with them.

        Parameters
        ----------
        chains_up_to : callable
            ``chains_up_to(hits)`` returns `SpecularChains` of at most that many hits.
        max_hits : int
            Hits that may be followed.
        """
        branch = mi.UInt32(self.sampler.next_1d() * chains_up_to(max_hits).branches)
        dr.eval(branch)
        whole = self._light_through(chains_up_to(max_hits), branch)
        for hits in (fewer for fewer in CHAIN_LENGTHS if fewer < max_hits):
            lost = (whole - self._light_through(chains_up_to(hits), branch)) / np.maximum(whole, 1e-30)
            if (lost < (MIN_VIEW_FRACTION, MAX_LAMP_LOSS)).all():
                return hits, max(lost[0], 0.0)
        return max_hits, 0.0

    def light(
        self,
        tracer: PathTracer,
        image_finder: FirstHits | SpecularChains,
        min_vertices: int,
        max_vertices: int,
        firefly_limit: float,
    ) -> Light:
        """Light that radiance paths find in the grains that some of the rays meet.

        Parameters
        ----------
        tracer : PathTracer
        image_finder : FirstHits or SpecularChains
        min_vertices, max_vertices : int
            Vertices that a path has at least, and that the tracer's have at most.
        firefly_limit : float
            Maximum that a path counts, in radiances of the bright parts of the view.

        Returns
        -------
        Light
        """
        starts = self._starts(image_finder)
        seconds, compiling, found = _timed(
            lambda: self._traced(starts, image_finder, tracer), self._timed_calls
        )
        light = light_of(self._paths(*found), min_vertices, max_vertices, firefly_limit)
        return replace(light, paths_per_second=self._grains * PILOT_PATHS / seconds, compiling=compiling)

    def with_short_paths(self, light: Light, image_finder: FirstHits | SpecularChains) -> Light:
        """Add to `light` the speed of paths that end at the first surface that lamps light."""
        starts, tracer = self._starts(image_finder), PathTracer(*DIRECT)
        seconds, *_ = _timed(lambda: self._traced(starts, image_finder, tracer), 1)
        speed = self._grains * PILOT_PATHS / seconds
        return replace(light, short_per_second=max(light.paths_per_second, speed))

    def _light_through(self, image_finder, branch):
        """Sums over whole chains: of the fractions of light that reach the viewer, and of the light of lamps."""
        view = image_finder.view(self.scene, self.ray, branch, drawn=True)
        whole = view.exists & ~view.cut
        si = view.surface.compute_surface_interaction(view.ray, mi.RayFlags.All, whole)
        lamps = si.emitter(self.scene, whole).eval(si, whole)
        lamps = mean(view.weight * lamps)
        # all rays that leave the scene meet the sky
        lamps = dr.select(si.is_valid() & dr.isfinite(lamps), lamps, 0)
        found = [dr.select(whole, value, 0) for value in (mean(view.weight), lamps)]
        dr.eval(found)
        return np.array([np.asarray(values, np.float64).sum() for values in found])

    def _places(self, depth, hit, exists, chains, first=None):
        """`Places` from world depths in meters; `first` is that of `Places`, where it differs from z."""
        column, row, slope = self._from
        z = np.where(exists, self._mapping.z_far + self._mapping.beta * np.where(hit, 1 / depth, 0), np.nan)
        return Places(
            column=np.asarray(column),
            row=np.asarray(row),
            slope_x=np.asarray(slope.x),
            slope_y=np.asarray(slope.y),
            z=z,
            first=z if first is None else first,
            chains=np.broadcast_to(chains, z.shape),
            z_far=self._mapping.z_far,
            pitch=self._hologram.pitch,
        )

    def _starts(self, image_finder):
        """`_Starts` of a few paths of each grain."""
        grains = self._grains
        index = dr.arange(mi.UInt32, grains * PILOT_PATHS) // PILOT_PATHS
        chosen = mi.UInt32(mi.Float(index) * dr.opaque(mi.Float, self.size / grains))
        column, row, slope = (dr.gather(type(values), values, chosen) for values in self._from)
        # the surface of a grain differs from place to place, too
        turn = _sampler(self.seed, grains * PILOT_PATHS).next_2d()
        place = self._rays.place(column + turn.x - 0.5, row + turn.y - 0.5)
        ray, depth_rate = self._rays.world(*place, slope.x, slope.y)
        branch = mi.UInt32(0)
        if image_finder.branches > 1:
            branch = mi.UInt32(dr.gather(mi.Float, self._random(grains), index) * image_finder.branches)
        dr.make_opaque(index, turn, slope, ray, depth_rate, branch)
        return _Starts(index, turn, slope, ray, depth_rate, branch)

    def _traced(self, starts, image_finder, tracer):
        """Trace the paths of some starts.

        Returns all light of each path, its light up to the first surface that lamps light, its light by vertices, the
        cell that it meets, the reflectance there, and whether that is an emitter.
        """
        paths = _sampler(self.seed + 1, self._grains * PILOT_PATHS)
        view = image_finder.view(self.scene, starts.ray, starts.branch, drawn=True)
        found = tracer.by_vertices(self.scene, paths, view, VERTEX_COUNTS)
        through = dr.select(view.exists, 1, 0) / view.color
        if view.weight is not None:
            through *= view.weight
        found = [light * through for light in found]
        whole, direct = sum(found), sum(found[: VERTEX_COUNTS.index(*DIRECT) + 1])
        dz = self._rays.height_over_plane(view.distance, starts.depth_rate, view.hit)
        # a whole grain: cells of the grid begin where the first path's does
        walk = (dz - dr.gather(mi.Float, dz, starts.index * PILOT_PATHS)) / self._hologram.pitch
        over, down = starts.turn.x + starts.slope.x * walk, starts.turn.y - starts.slope.y * walk
        cell = [mi.Int(dr.floor(at)) for at in (over, down, dz / self.slab)] + [view.branch]
        return (
            whole,
            direct,
            [dr.sum(light) for light in found],
            cell,
            *reflectance_of(self.scene, view, view.exists),
        )

    def _paths(self, whole, direct, by_vertices, cell, reflectance, shines):
        """Results of `_traced` as `Paths`."""
        shape = self._grains, PILOT_PATHS
        whole, direct, reflectance = (
            _finite(of_channels, (3, *shape)) for of_channels in (whole, direct, reflectance)
        )
        parts = [np.broadcast_to(np.asarray(part, np.int64), math.prod(shape)) for part in cell]
        cells = np.stack(parts).reshape(4, *shape)
        return Paths(
            whole,
            direct,
            [_finite(light, shape) for light in by_vertices],
            reflectance,
            (cells == cells[..., :1]).all(0),
            float(np.asarray(shines, np.float32).mean()),
        )

    def _random(self, size):
        """Random numbers in [0, 1)."""
        return _sampler(self.seed + 2, size).next_1d()

    def _vergences(self, depth, hit, exists, image):
        """Vergences of what is visible, which of them are of images, and whether the sky is visible."""
        vergence = 1 / depth[exists & hit].astype(np.float64)
        finite = np.isfinite(vergence)
        sky = self.scene.environment() is not None and (exists & ~hit).mean() > MIN_VIEW_FRACTION
        return vergence[finite], np.broadcast_to(image, self.size)[exists & hit][finite], bool(sky)


@dataclass(frozen=True)
class _Starts:
    """Starts of paths, in Dr.Jit types.

    Number of the grain, place in a pixel of the recording plane, slope, world ray and its depth per distance, and the
    branch that the image finder follows.
    """

    index: mi.UInt32
    turn: mi.Point2f
    slope: mi.Point2f
    ray: mi.Ray3f
    depth_rate: mi.Float
    branch: mi.UInt32


def _sampler(seed, size):
    """Sampler of independent random numbers for `size` lanes."""
    return Sampler.seeded(seed, dr.arange(mi.UInt32, size))


def _finite(values, shape):
    """Array of a shape, with 0 for NaN."""
    return np.nan_to_num(np.asarray(values, np.float64)).reshape(shape)


def _same_surface(si):
    """Fraction of neighboring rays of a pixel that meet the same triangle, or nothing."""
    shapes = (np.asarray(dr.reinterpret_array(mi.UInt32, shape)) for shape in (si.shape, si.instance))
    met = np.stack([np.asarray(si.prim_index), *shapes]).reshape(3, -1, DIRECTIONS)
    return float((met[..., 1:] == met[..., :-1]).all(0).mean())


def _timed(work: Callable[[], _Result], calls: int = 2) -> tuple[float, float, _Result]:
    """`machine.timed` with the seconds of the fastest of some calls, as the system delays one now and then.

    Everything that `work` uses must be opaque: with a literal the second call would compile another program.
    """
    seconds, compiling, results = zip(*(timed(work) for _ in range(calls)), strict=True)
    return min(seconds), sum(compiling), results[-1]


def near_end(scene: mi.Scene, camera: Camera, hologram: Hologram, seed: int = 0) -> float:
    """World depth of the volume's near end, meters: the hologram's own, or the nearest surface in view of the pupil.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    seed : int

    Raises
    ------
    InvalidInput
        If nothing is in view.
    """
    hologram = hologram.in_air
    pinhole = DepthMapping.of(replace(hologram, depth_mapping="fit", optics=ON_AXIS), camera, 1e-9)
    pixels = min(NEAREST_PIXELS, -(-NEAREST_RAYS * hologram.width * hologram.height // DIRECTIONS))
    nearest = Pilot(scene, hologram, camera, pinhole, seed=seed, pixels=pixels).nearest()
    if nearest is None:
        if scene.environment() is None or not camera.sees_sky:
            raise InvalidInput(
                "Nothing is in the camera's view. Point it at an object within its clipping range, or show a lit world."
            )
        return hologram.near or 1.0
    if hologram.near:
        return hologram.near
    if hologram.depth_mapping == "eyepiece":
        return nearest
    mapping = DepthMapping.of(hologram, camera, nearest)
    return min(
        nearest, Pilot(scene, hologram, camera, mapping, seed=seed, pixels=pixels).nearest() or nearest
    )
