"""A first look at a scene: a few rays and paths tell how much there is to model, and how fast this machine is."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..errors import InvalidInput
from ..mapping import DepthMapping
from ..tracing.regions import DEPTHS, Look

if TYPE_CHECKING:
    from collections.abc import Callable

    import mitsuba as mi
    from numpy.typing import ArrayLike

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.path_tracer import PathTracer
    from ..scene.specular_chains import FirstHits, SpecularChains
    from ..settings import Settings

_Result = TypeVar("_Result")

PILOT_PIXELS, PILOT_GRAINS = 1 << 14, 4096
FEWER = {"draft": 8, "preview": 4}  # times fewer of them for these qualities
PILOT_PATHS = 32  # of a grain
NEAREST_PIXELS, NEAREST_RAYS = (
    1 << 16,
    4,
)  # to find the nearest surface, which may be thin; of a pixel at most
DIRECTIONS = 16  # a pixel that rays go through
# From this share of neighbouring rays on that meet the same triangle packets are faster: 1.6 times at 0.07, 0.6 at
# 0.006. Measured speeds would decide otherwise now and then, and hits differ in their last bits.
COHERENT = 0.02
LEAST_SHARE = (
    1e-4  # of the view: less sky may be cracks between triangles, fewer mirrors are not worth their cost
)
BENT = 1e-3  # of the vergence, and dioptres
LEAST_LIGHT = 0.005  # of the light: bounces that add less are left out
OUTLIERS = 0.01  # of the grains: a few at the edges of lamps' images would else decide
DEPTHS_TRIED = (1, 2, 3, 4, 6)  # vertices of a path
ALIKE = 1.3  # times as long: calls that nothing held up
TIMED = 0.06  # seconds after which a call is not timed again; none that compiles takes less


@dataclass(frozen=True)
class Probe:
    """What a few rays saw.

    Attributes
    ----------
    vergence : numpy.ndarray
        Inverse world depths of what was hit, 1/m; through mirrors and lenses of the image, which may be negative.
    bent : bool
        Whether images lie elsewhere than at the optical path length, as in curved mirrors and through glass.
    images : numpy.ndarray
        Inverse depths of such images, 1/m.
    sky : bool
        Whether rays that hit nothing meet an environment.
    specular : float
        Share of rays that meet surfaces with a δ lobe.
    nearly : float
        Share of rays that meet rough surfaces with a narrow lobe.
    turn, sharpest : float
        Turn of the view across the pupil in widths of the sharp glossy lobes in view, and of the sharpest; 0 without
        gloss.
    gloss : numpy.ndarray
        Inverse depths of the glossy surfaces in view, 1/m.
    coherent : bool
        Whether rays are faster in packets, as they are where triangles are large.
    rays_per_second : float
        Speed of this machine on this scene.
    chains_per_second : float
        The same of rays that are followed over mirrors and through clear surfaces.
    compiling : float
        Seconds that the first of the rays and chains took longer than later ones.
    splits : int
        Hits at which chains divide.
    cut : float
        Share of the light from white surroundings that chains would show beyond the hits that are followed.
    diffuse : float
        Share of rays that meet surfaces, no mirrors, that scatter diffusely.
    places : Places
        What each ray saw.
    """

    vergence: np.ndarray
    bent: bool
    images: np.ndarray
    sky: bool
    specular: float
    nearly: float
    turn: float
    sharpest: float
    gloss: np.ndarray
    coherent: bool
    rays_per_second: float
    chains_per_second: float
    compiling: float
    splits: int
    cut: float
    diffuse: float
    places: Places


@dataclass(frozen=True)
class Places:
    """What rays saw, from anywhere.

    Attributes
    ----------
    column, row : numpy.ndarray
        Where rays cross the far end of the volume, pixels.
    slope_x, slope_y : numpy.ndarray
        To the right and up.
    z : numpy.ndarray
        Depth of what is seen, metres from the SLM; NaN where there is nothing.
    first : numpy.ndarray
        Depth of the first surface.
    chains : numpy.ndarray of bool
        Whether it is seen through mirrors or clear surfaces.
    z_far, pitch : float
        Metres.
    """

    column: np.ndarray
    row: np.ndarray
    slope_x: np.ndarray
    slope_y: np.ndarray
    z: np.ndarray
    first: np.ndarray
    chains: np.ndarray
    z_far: float
    pitch: float

    def look(
        self, plane: float, limit: float, width: int, height: int, cell: int, where: np.ndarray, images: bool
    ) -> Look:
        """The `Look` from the tiles, `cell` pixels wide, of a plane of so many pixels, at a distance from the SLM, at
        the places `where`, with `images` in mirrors or without.
        """
        walk = (plane - self.z_far) / self.pitch
        column = np.floor((self.column + self.slope_x * walk + 0.5) / cell).astype(int)
        row = np.floor((self.row - self.slope_y * walk + 0.5) / cell).astype(int)
        shape = -(-height // cell), -(-width // cell)
        on_plane = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
        inside, tiles = on_plane & where, row * shape[1] + column
        tile = tiles[inside]
        part = np.minimum(np.abs(self.z[inside] - plane) / limit, 1.0)
        depth, chains = np.zeros(shape[0] * shape[1], np.uint32), np.zeros(shape[0] * shape[1], bool)
        np.maximum.at(depth, tile, 1 + (part * (DEPTHS - 1)).astype(np.uint32))
        chains[tiles[on_plane & self.chains]] = True
        return Look(depth.reshape(shape), chains.reshape(shape), images)


@dataclass(frozen=True)
class Edges:
    """Edges of near things, as seen along the axis.

    Attributes
    ----------
    front, behind : numpy.ndarray
        Depths of what is in front and of the surface behind, metres from the SLM.
    seen : numpy.ndarray
        Depth of what is seen there: of the surface behind, or of the image that it shows.
    images : numpy.ndarray of bool
        Whether it shows one.
    length : float
        Of each piece, pixels.
    """

    front: np.ndarray
    behind: np.ndarray
    seen: np.ndarray
    images: np.ndarray
    length: float


@dataclass(frozen=True)
class Light:
    """What a few radiance paths found.

    Attributes
    ----------
    noise, direct, texture : float
        Variance of one path relative to its grain's squared mean, weighted by brightness; of paths that end at the
        first surface that lamps light; and of the reflectance where a path begins.
    shining : float
        Share of the paths that begin at what shines itself.
    chroma : float
        Largest difference of the colour channels relative to their mean, weighted by brightness.
    max_depth, lost : int, float
        Vertices of a path that are enough, and the share of the light that is lost with longer ones.
    bright : float
        Radiance of the bright parts of the view, the 95th percentile of what is lit.
    paths_per_second : float
        Speed of this machine on this scene.
    compiling : float
        Seconds that the first paths took longer than later ones.
    short_per_second : float
        Speed of paths that end at the first surface that lamps light, see `Pilot.with_short_paths`; infinite before.
    """

    noise: float
    direct: float
    texture: float
    shining: float
    bright: float
    paths_per_second: float
    compiling: float
    chroma: float
    max_depth: int
    lost: float
    short_per_second: float = math.inf


class Pilot:
    """A few rays over the hologram and the pupil.

    Parameters
    ----------
    scene : mitsuba.Scene
    hologram : Hologram
    camera : Camera
    mapping : DepthMapping
        With beta = 0 the rays start at the pupil's centre.
    seed : int
    pixels : int
        That rays go through, about, `DIRECTIONS` each.
    grains : int
        Whose light is looked at.
    hurried : bool
        Whether speeds may be rough.
    """

    def __init__(
        self,
        scene: mi.Scene,
        hologram: Hologram,
        camera: Camera,
        mapping: DepthMapping,
        seed: int = 0,
        pixels: int = PILOT_PIXELS,
        grains: int = PILOT_GRAINS,
        hurried: bool = False,
    ) -> None:
        import drjit as dr
        import mitsuba as mi

        from ..scene.rays import Rays

        self.scene, self.camera, self.seed, self._mapping = scene, camera, seed, mapping
        rays = Rays(hologram, camera, mapping, mapping.z_far)
        stride = max(1, math.ceil(math.sqrt(hologram.width * hologram.height / pixels)))
        columns, rows = -(-hologram.width // stride), -(-hologram.height // stride)
        self.size = columns * rows * DIRECTIONS
        self._grains, self._hurried = min(self.size, grains), hurried
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, self.size)
        index = dr.arange(mi.UInt32, self.size)
        pixel, number = index // DIRECTIONS, index % DIRECTIONS
        jitter = sampler.next_2d()
        # no literals: one program for all displays
        across, step, width, height = (
            dr.opaque(kind, number)
            for kind, number in (
                (mi.UInt32, columns),
                (mi.Float, stride),
                (mi.Float, hologram.width),
                (mi.Float, hologram.height),
            )
        )
        column = dr.minimum((pixel % across + jitter.x) * step, width) - 0.5
        row = dr.minimum((pixel // across + jitter.y) * step, height) - 0.5
        turn = sampler.next_2d()
        u = mi.Point2f(number * 0.7548776662466927 + turn.x, number * 0.5698402909980532 + turn.y)
        limit = hologram.widest_slope
        self.pupil = mapping.pupil_radius(limit)
        slope = limit * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
        self.ray, self.depth_rate = rays.world(*rays.place(column, row), slope.x, slope.y)
        self.sampler = sampler
        self._from = column, row, slope
        self._rays, self._pitch = rays, hologram.pitch
        self._size = hologram.width, hologram.height

    @classmethod
    def of(
        cls, scene: mi.Scene, hologram: Hologram, camera: Camera, mapping: DepthMapping, settings: Settings
    ) -> Pilot:
        """One for a hologram of such a quality."""
        fewer = FEWER.get(settings.quality, 1)
        counts = PILOT_PIXELS // fewer, PILOT_GRAINS // fewer
        return cls(scene, hologram, camera, mapping, settings.seed, *counts, settings.quality == "draft")

    def nearest(self) -> float | None:
        """Depth of the nearest surface in metres, None if there is none."""
        hit = self.scene.ray_intersect_preliminary(self.ray, coherent=True)
        depth = np.asarray(self.camera.clip_start + hit.t * self.depth_rate)
        nearest = depth.min(where=np.asarray(hit.is_valid()), initial=math.inf)
        return float(nearest) if math.isfinite(nearest) else None

    def edges(self, optics: FirstHits | SpecularChains, least: float) -> Edges:
        """The `Edges` where depths differ by more than `least` metres, and more than the surfaces beside them go on."""
        import drjit as dr
        import mitsuba as mi

        width, height = self._size
        side = max(1, math.ceil(math.sqrt(width * height / NEAREST_PIXELS)))
        columns, rows = width // side, height // side
        across, step = dr.opaque(mi.UInt32, columns), dr.opaque(mi.Float, side)
        index = dr.arange(mi.UInt32, columns * rows)
        place = self._rays.place(mi.Float(index % across) * step, mi.Float(index // across) * step)
        ray, depth_rate = self._rays.world(*place, mi.Float(0), mi.Float(0))
        branch = mi.UInt32(self._chance(columns * rows) * optics.branches)
        view = optics.view(self.scene, ray, branch, drawn=True)
        first, seen = (
            np.array(self._rays.height_over_plane(distance, depth_rate, dr.isfinite(distance)))
            + self._mapping.z_far
            for distance in (view.first, view.distance)
        )
        kinds = first, seen, np.broadcast_to(np.asarray(view.hits) > 0, first.shape)
        kinds = [values.reshape(rows, columns) for values in kinds]
        found = []
        for first, *what in (kinds, [values.T for values in kinds]):
            steps = np.diff(first, axis=1)
            goes_on = 2 * np.maximum(abs(np.roll(steps, 1, 1)), abs(np.roll(steps, -1, 1)))
            row, column = np.nonzero(abs(steps) > least + goes_on)
            nearer = column + (steps[row, column] > 0)
            behind = row, 2 * column + 1 - nearer
            found.append([first[row, nearer], first[behind], *(values[behind] for values in what)])
        front, behind, seen, images = (np.concatenate(values) for values in zip(*found, strict=True))
        return Edges(front, behind, seen, images, float(side))

    def first_hits(self) -> Probe:
        """The `Probe` of first surfaces."""
        import drjit as dr
        import mitsuba as mi

        from ..scene.lobes import is_specular
        from ..scene.specular_chains import nearly_smooth

        si = self.scene.ray_intersect(self.ray)
        coherent = _same_surface(si) >= COHERENT
        seconds, compiling, _ = _timed(
            lambda: dr.eval(self.scene.ray_intersect_preliminary(self.ray, coherent=coherent).t),
            self._hurried,
        )
        speed = self.size / seconds
        bsdf, hit = si.bsdf(), si.is_valid()
        depth = self.camera.clip_start + si.t * self.depth_rate
        sample, _ = bsdf.sample(mi.BSDFContext(), si, self.sampler.next_1d(), self.sampler.next_2d(), hit)
        glossy = hit & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Glossy) & (sample.pdf > 0)
        # a lobe of constant density over a cap of half-angle a has a = 1 / sqrt(pi pdf)
        turns = 2 * self.pupil / depth * dr.sqrt(math.pi * sample.pdf)
        nearly = nearly_smooth(self.scene, si, depth, self.pupil) > 0
        specular = hit & is_specular(bsdf.flags())
        diffuse = hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
        dr.eval(hit, depth, glossy, turns, nearly, specular, diffuse)
        nearly, specular, diffuse = (float(np.asarray(kind).mean()) for kind in (nearly, specular, diffuse))
        depth, hit, glossy = (np.asarray(values) for values in (depth, hit, glossy))
        turns, gloss = np.asarray(turns)[glossy], 1 / depth[glossy]
        few = len(turns) <= LEAST_SHARE * self.size
        turn, sharpest = (0.0, 0.0) if few else map(float, np.quantile(turns, (0.9, 0.99)))
        exists = np.broadcast_to(hit | self.camera.sees_sky, self.size)
        vergence, sky = self._seen(depth, hit, exists)
        places = self.places(depth, hit, exists & (hit | sky), False)
        return Probe(
            vergence,
            False,
            np.empty(0),
            sky,
            specular,
            nearly,
            turn,
            sharpest,
            gloss,
            coherent,
            speed,
            speed,
            compiling,
            0,
            0.0,
            diffuse,
            places,
        )

    def images(self, probe: Probe, optics: SpecularChains) -> Probe:
        """The `Probe` with the images that chains of mirrors and clear surfaces show."""
        import drjit as dr
        import mitsuba as mi

        branch = mi.UInt32(self.sampler.next_1d() * optics.branches)

        def follow():
            view = optics.view(self.scene, self.ray, branch, drawn=True)
            dr.eval(view)
            return view

        seconds, compiling, view = _timed(follow, self._hurried)
        speed = self.size / seconds
        depth, path = self.camera.clip_start + view.distance * self.depth_rate, dr.rcp(view.path)
        bent = dr.abs(dr.rcp(view.distance) - path) > BENT * (path + 1)
        # light that is seen at its image hardly differs across the pupil
        flags = view.surface.shape.bsdf().flags()
        glossy = view.surface.is_valid() & mi.has_flag(flags, mi.BSDFFlags.Glossy) & (view.image < 1)
        beyond = dr.select(view.cut & ~view.exists, dr.mean(view.weight), 0)
        dr.eval(depth, bent, glossy, beyond)
        depth, hit, hits = (np.asarray(values) for values in (depth, view.hit, view.hits))
        exists = np.broadcast_to(view.exists, self.size)
        vergence, sky = self._seen(depth, hit, exists)
        splits = int(np.asarray(view.branch)[exists].max(initial=0)).bit_length()
        bent = np.asarray(bent) & exists
        images, gloss = 1 / depth[bent], 1 / depth[exists & np.asarray(glossy)]
        places = self.places(depth, hit, exists & (hit | sky), hits > 0, probe.places.first)
        return replace(
            probe,
            vergence=vergence,
            sky=sky,
            gloss=gloss,
            splits=splits,
            cut=float(np.asarray(beyond).mean()),
            bent=bool(bent.mean() > LEAST_SHARE),
            images=images[np.isfinite(images)],
            places=places,
            chains_per_second=speed,
            compiling=probe.compiling + compiling,
        )

    def longest_chain(self, optics_of: Callable[[int], SpecularChains], most: int) -> tuple[int, float]:
        """Hits of a chain that are enough, and the share of what is seen that is lost with them.

        Parameters
        ----------
        optics_of : callable
            ``optics_of(most_hits)`` gives `SpecularChains`.
        most : int
            Hits that are followed at most.
        """
        import drjit as dr
        import mitsuba as mi

        branch = mi.UInt32(self.sampler.next_1d() * optics_of(most).branches)
        dr.eval(branch)

        def seen(hits):
            view = optics_of(hits).view(self.scene, self.ray, branch, drawn=True)
            return float(
                np.asarray(dr.select(view.exists & ~view.cut, dr.mean(view.weight), 0), np.float64).sum()
            )

        whole = seen(most)
        for hits in (1, 2, 3, 4, 6):
            if hits >= most:
                break
            lost = 1 - seen(hits) / max(whole, 1e-30)
            if lost < LEAST_SHARE:
                return hits, max(lost, 0.0)
        return most, 0.0

    def places(
        self,
        depth: ArrayLike,
        hit: np.ndarray,
        exists: np.ndarray,
        chains: ArrayLike,
        first: np.ndarray | None = None,
    ) -> Places:
        """The `Places` that rays saw, of world depths in metres; `first` as of `Places`, where it is not the same."""
        column, row, slope = self._from
        vergence = np.where(hit, 1 / np.asarray(depth), 0)
        z = np.where(exists, self._mapping.z_far + self._mapping.beta * vergence, np.nan)
        return Places(
            np.asarray(column),
            np.asarray(row),
            np.asarray(slope.x),
            np.asarray(slope.y),
            z,
            z if first is None else first,
            np.broadcast_to(chains, z.shape),
            self._mapping.z_far,
            self._pitch,
        )

    def light(
        self,
        tracer_of: Callable[[int], PathTracer],
        optics: FirstHits | SpecularChains,
        max_depth: int,
        least: int,
        slab: float,
        firefly: float,
    ) -> Light:
        """What radiance paths find in the grains that some of the rays see.

        Parameters
        ----------
        tracer_of : callable
            ``tracer_of(max_depth)`` gives a `PathTracer`.
        optics : FirstHits or SpecularChains
        max_depth : int
            Vertices of a path.
        least : int
            So many at least.
        slab : float
            Thickness of a grain, metres.
        firefly : float
            Most that a path counts, in radiances of the bright parts of the view.

        Returns
        -------
        Light
        """
        grains, trace = self._grains, self._paths(optics, slab)

        def found(light):
            return np.nan_to_num(np.asarray(light, np.float64)).reshape(3, grains, PILOT_PATHS)

        def of_one_cell(cell):
            parts = [np.broadcast_to(np.asarray(part, np.int64), grains * PILOT_PATHS) for part in cell]
            parts = np.stack(parts).reshape(4, grains, PILOT_PATHS)
            return (parts == parts[..., :1]).all(0)

        seconds, compiling, traced = _timed(lambda: trace(tracer_of(max_depth)), self._hurried)
        all_light, direct_light, bands, cell, reflectance, shines = traced
        all_light, same = found(all_light), of_one_cell(cell)
        count = same.sum(1)

        def mean_of(light):
            return (light * same).sum(-1) / count

        shining = float(np.asarray(shines, np.float32).mean())
        mean, speed = mean_of(all_light.sum(0)), grains * PILOT_PATHS / seconds
        if not (mean > 0).any():
            return Light(0.0, 0.0, 0.0, shining, 0.0, speed, compiling, 0.0, least, 0.0)
        whole = mean
        # as the rendering's paths are limited
        most = firefly * np.percentile(mean[mean > 0], 95) / 3
        limited = np.minimum(all_light, most)
        means, mean = mean_of(limited), mean_of(limited.sum(0))
        lit = (mean > 0) & (count > 1)
        if not lit.any():
            return Light(0.0, 0.0, 0.0, shining, 0.0, speed, compiling, 0.0, least, 0.0)
        # weighted by brightness, in which lamps in view must not hide the rest
        weight = np.minimum(mean[lit], np.percentile(mean[lit], 95))
        weight /= weight.sum()

        def share(values):
            return float((weight * values[lit] / mean[lit]).sum())

        def noise_of(light, means=means):
            # of each channel by itself
            own = mean_of(light)
            variance = ((light - own[..., None]) ** 2 * same).sum(-1) / np.maximum(count - 1, 1)
            relative = variance[:, lit] / np.maximum(means[:, lit], 1e-30) ** 2
            relative = np.minimum(relative, np.quantile(relative, 1 - OUTLIERS))
            return float((weights * relative).sum() / max(weights.sum(), 1e-30))

        weights = np.minimum(means[:, lit], np.percentile(mean[lit], 95) / 3)
        noise, direct = noise_of(limited), noise_of(np.minimum(found(direct_light), most))
        shown_light = found(reflectance)
        texture = noise_of(shown_light, mean_of(shown_light))
        chroma = share(3 * np.ptp(means, axis=0))
        depth, lost, less = max_depth, 0.0, share(whole)
        for fewer, light in zip(DEPTHS_TRIED, bands, strict=False):
            light = np.nan_to_num(np.asarray(light, np.float64)).reshape(grains, PILOT_PATHS)
            less -= share(mean_of(light))
            if least <= fewer < max_depth and less < LEAST_LIGHT:
                depth, lost = fewer, max(less, 0.0)
                break
        bright = float(np.percentile(mean[lit], 95)) / 3
        return Light(noise, direct, texture, shining, bright, speed, compiling, chroma, depth, lost)

    def with_short_paths(
        self,
        light: Light,
        tracer_of: Callable[[int], PathTracer],
        optics: FirstHits | SpecularChains,
        slab: float,
    ) -> Light:
        """What `light` found, of the same parameters, and the speed of paths that end at the first surface that lamps
        light.
        """
        from ..light.path_tracer import DIRECT

        trace = self._paths(optics, slab)
        seconds, *_ = _timed(lambda: trace(tracer_of(*DIRECT)), hurried=True)
        speed = self._grains * PILOT_PATHS / seconds
        return replace(light, short_per_second=max(light.paths_per_second, speed))

    def _paths(self, optics, slab):
        """A function of a tracer, which takes a few paths of each grain."""
        import drjit as dr
        import mitsuba as mi

        from ..light.path_tracer import DIRECT
        from ..tracing.grains import shown

        grains = self._grains
        index = dr.arange(mi.UInt32, grains * PILOT_PATHS) // PILOT_PATHS
        chosen = mi.UInt32(mi.Float(index) * dr.opaque(mi.Float, self.size / grains))
        column, row, slope = (dr.gather(type(values), values, chosen) for values in self._from)
        branches, pitch = optics.branches, self._pitch
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(self.seed, grains * PILOT_PATHS)
        turn = sampler.next_2d()  # the surface of a grain differs from place to place, too
        place = self._rays.place(column + turn.x - 0.5, row + turn.y - 0.5)
        ray, depth_rate = self._rays.world(*place, slope.x, slope.y)
        branch = mi.UInt32(0)
        if branches > 1:
            branch = mi.UInt32(dr.gather(mi.Float, self._chance(grains), index) * branches)
        dr.eval(ray, depth_rate, branch)

        def trace(tracer):
            paths = mi.load_dict({"type": "independent"})
            paths.seed(self.seed + 1, grains * PILOT_PATHS)
            seen = optics.view(self.scene, ray, branch, drawn=True)
            found = tracer.by_vertices(
                self.scene, paths, seen.ray, seen.surface, seen.whole, DEPTHS_TRIED, parts=seen.parts
            )
            through = dr.select(seen.exists, 1, 0) / seen.colour
            if seen.weight is not None:
                through *= seen.weight
            found = [light * through for light in found]
            whole, direct = sum(found), sum(found[: DEPTHS_TRIED.index(*DIRECT) + 1])
            dz = self._rays.height_over_plane(seen.distance, depth_rate, seen.hit)
            # a whole grain: cells of the grid begin where the first path's does
            walk = (dz - dr.gather(mi.Float, dz, index * PILOT_PATHS)) / pitch
            over, down = turn.x + slope.x * walk, turn.y - slope.y * walk
            cell = [mi.Int(dr.floor(over)), mi.Int(dr.floor(down)), mi.Int(dr.floor(dz / slab)), seen.branch]
            reflectance, shines = shown(self.scene, seen, seen.exists)
            result = whole, direct, [dr.sum(light) for light in found], cell, reflectance, shines
            dr.eval(result)
            return result

        return trace

    def _chance(self, size):
        """A random number for each grain."""
        import mitsuba as mi

        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(self.seed + 2, size)
        return sampler.next_1d()

    def _seen(self, depth, hit, exists):
        """Vergences of what is seen, and whether sky is."""
        vergence = 1 / np.asarray(depth)[exists & hit].astype(np.float64)
        sky = self.scene.environment() is not None and (exists & ~hit).mean() > LEAST_SHARE
        return vergence[np.isfinite(vergence)], bool(sky)


def _same_surface(si):
    """Share of neighbouring rays, of the same pixel, that meet the same triangle, or nothing."""
    import drjit as dr
    import mitsuba as mi

    shapes = (np.asarray(dr.reinterpret_array(mi.UInt32, shape)) for shape in (si.shape, si.instance))
    met = np.stack([np.asarray(si.prim_index), *shapes]).reshape(3, -1, DIRECTIONS)
    return float((met[..., 1:] == met[..., :-1]).all(0).mean())


def _timed(work: Callable[[], _Result], hurried: bool = False) -> tuple[float, float, _Result]:
    """Seconds of the fastest of a few calls; how much longer the first took, which may compile; and what the last of
    them returned.

    One call in ten or so is held up by the system, and the second may compile, too: two are enough where both are as
    fast as none that compiles, and one if `hurried`. Calls that take long are three, others up to four.
    """
    import drjit as dr

    def call():
        dr.sync_thread()
        start = time.perf_counter()
        result = work()
        dr.sync_thread()
        return time.perf_counter() - start, result

    first, result = call()
    if hurried and first < TIMED:
        return first, 0.0, result
    second, result = call()
    if max(first, second) < min(TIMED, ALIKE * min(first, second)):
        return min(first, second), 0.0, result
    found = [second]
    while len(found) < 2 or (len(found) < 3 and sum(found) < TIMED):
        seconds, result = call()
        found.append(seconds)
    return min(found), first - min(found), result


def vergence_range(seen: Probe, chain: int) -> tuple[float, float]:
    """Smallest and largest inverse depth in view, 1/m.

    Caustics spread a few images over all depths, behind the viewer too: with chains a hundredth at either
    end is left to the nearest depth inside.
    """
    if not len(seen.vergence):
        return 0.0, 0.0
    low, high = np.quantile(seen.vergence, (0.01, 0.99) if chain else (0, 1))
    return float(min(low, 0.0) if seen.sky else low), float(high)


def near_end(scene: mi.Scene, camera: Camera, hologram: Hologram, seed: int = 0) -> float:
    """World depth of the volume's near end: as given, or the nearest surface that the pupil sees."""
    pinhole = DepthMapping.of(replace(hologram, depth_mapping="fit"), camera, 1e-9)
    pixels = min(NEAREST_PIXELS, -(-NEAREST_RAYS * hologram.width * hologram.height // DIRECTIONS))
    nearest = Pilot(scene, hologram, camera, pinhole, seed, pixels).nearest()
    if nearest is None:
        if scene.environment() is None or not camera.sees_sky:
            raise InvalidInput(
                "Nothing is in the camera's view: point it at an object within its clipping range, or show a lit world."
            )
        return hologram.near or 1.0
    if hologram.near:
        return hologram.near
    if hologram.depth_mapping == "eyepiece":
        return nearest
    mapping = DepthMapping.of(hologram, camera, nearest)
    return min(nearest, Pilot(scene, hologram, camera, mapping, seed, pixels).nearest() or nearest)
