"""A first look at a scene: a few rays and paths tell how much there is to model, and how fast this machine is."""

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from .errors import InvalidInput
from .mapping import DepthMapping

PILOT_GRAINS, PILOT_PATHS = 4096, 32
DIRECTIONS = 16  # a pixel
# From this share of neighbouring rays on that meet the same triangle packets are faster: 1.6 times at 0.07, 0.6 at
# 0.006. Measured speeds would decide otherwise now and then, and hits differ in their last bits.
COHERENT = 0.02
LEAST_SHARE = (
    1e-4  # of the view: less sky may be cracks between triangles, fewer mirrors are not worth their cost
)
BENT = 1e-3  # of the vergence, and dioptres


@dataclass(frozen=True)
class Probe:
    """What a few rays saw.

    Attributes
    ----------
    vergence : numpy.ndarray
        Inverse world depths of what was hit, 1/m; through mirrors and lenses of the image, which may be negative.
    bent : bool
        Whether images lie elsewhere than at the optical path length, as in curved mirrors and through glass.
    sky : bool
        Whether rays that hit nothing meet an environment.
    specular : float
        Share of rays that meet surfaces with a δ lobe.
    turn : float
        Turn of the view across the pupil in widths of the sharpest glossy lobes in view; 0 without gloss.
    gloss : numpy.ndarray
        Inverse depths of the glossy surfaces in view, 1/m.
    coherent : bool
        Whether rays are faster in packets, as they are where triangles are large.
    rays_per_second : float
        Speed of this machine on this scene.
    splits : int
        Hits at which chains divide.
    diffuse : float
        Share of rays that meet surfaces, no mirrors, that scatter diffusely.
    """

    vergence: np.ndarray
    bent: bool
    sky: bool
    specular: float
    turn: float
    gloss: np.ndarray
    coherent: bool
    rays_per_second: float
    splits: int
    diffuse: float


@dataclass(frozen=True)
class Light:
    """What a few radiance paths found.

    Attributes
    ----------
    noise : float
        Variance of one path relative to its grain's squared mean, weighted by brightness.
    bright : float
        Radiance of the bright parts of the view, the 95th percentile of what is lit.
    paths_per_second : float
        Speed of this machine on this scene.
    """

    noise: float
    bright: float
    paths_per_second: float


class Pilot:
    """Up to about a million rays over the hologram and the pupil.

    Parameters
    ----------
    scene : mitsuba.Scene
    hologram : Hologram
    camera : Camera
    mapping : DepthMapping
        With beta = 0 the rays start at the pupil's centre.
    seed : int
    """

    def __init__(self, scene, hologram, camera, mapping, seed=0):
        import drjit as dr
        import mitsuba as mi

        from .rays import Rays

        self.scene, self.camera, self.seed = scene, camera, seed
        rays = Rays(hologram, camera, mapping, mapping.z_far)
        stride = max(1, math.ceil(math.sqrt(hologram.width * hologram.height / (1 << 16))))
        columns, rows = -(-hologram.width // stride), -(-hologram.height // stride)
        self.size = columns * rows * DIRECTIONS
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, self.size)
        index = dr.arange(mi.UInt32, self.size)
        pixel, number = index // DIRECTIONS, index % DIRECTIONS
        jitter = sampler.next_2d()
        column = dr.minimum((pixel % columns + jitter.x) * stride, hologram.width) - 0.5
        row = dr.minimum((pixel // columns + jitter.y) * stride, hologram.height) - 0.5
        turn = sampler.next_2d()
        u = mi.Point2f(number * 0.7548776662466927 + turn.x, number * 0.5698402909980532 + turn.y)
        limit = max(hologram.max_slope(w) for w in hologram.wavelengths)
        self.pupil = mapping.pupil_radius(limit)
        slope = limit * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
        self.ray, self.depth_rate = rays.world(*rays.place(column, row), slope.x, slope.y)
        self.sampler = sampler

    def nearest(self):
        """Depth of the nearest surface in metres, None if there is none."""
        hit = self.scene.ray_intersect_preliminary(self.ray, coherent=True)
        depth = np.asarray(self.camera.clip_start + hit.t * self.depth_rate)
        nearest = depth.min(where=np.asarray(hit.is_valid()), initial=math.inf)
        return float(nearest) if math.isfinite(nearest) else None

    def first_hits(self):
        """The `Probe` of first surfaces."""
        import drjit as dr
        import mitsuba as mi

        from .lobes import is_specular

        si = self.scene.ray_intersect(self.ray)
        coherent = _same_surface(si) >= COHERENT
        speed = self.size / _timed(
            lambda: dr.eval(self.scene.ray_intersect_preliminary(self.ray, coherent=coherent).t)
        )
        bsdf, hit = si.bsdf(), si.is_valid()
        depth = self.camera.clip_start + si.t * self.depth_rate
        sample, _ = bsdf.sample(mi.BSDFContext(), si, self.sampler.next_1d(), self.sampler.next_2d(), hit)
        glossy = hit & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Glossy) & (sample.pdf > 0)
        # a lobe of constant density over a cap of half-angle a has a = 1 / sqrt(pi pdf)
        turns = 2 * self.pupil / depth * dr.sqrt(math.pi * sample.pdf)
        turns, gloss = (np.asarray(values)[np.asarray(glossy)] for values in (turns, 1 / depth))
        turn = float(np.quantile(turns, 0.9)) if len(turns) > LEAST_SHARE * self.size else 0.0
        specular = float(np.asarray(hit & is_specular(bsdf.flags())).mean())
        exists = hit | self.camera.sees_sky
        vergence, sky = self._seen(depth, np.asarray(hit), np.broadcast_to(exists, self.size))
        diffuse = float(np.asarray(hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)).mean())
        return Probe(vergence, False, sky, specular, turn, gloss, coherent, speed, 0, diffuse)

    def images(self, probe, optics):
        """The `Probe` with the images that chains of mirrors and clear surfaces show."""
        import drjit as dr
        import mitsuba as mi

        branch = mi.UInt32(self.sampler.next_1d() * optics.branches)
        view = optics.view(self.scene, self.ray, branch)
        depth = self.camera.clip_start + view.distance * self.depth_rate
        exists = np.broadcast_to(view.exists, self.size)
        vergence, sky = self._seen(depth, np.asarray(view.hit), exists)
        branches = np.asarray(view.branch)[exists]
        splits = int(branches.max(initial=0)).bit_length()
        path = dr.rcp(view.path)
        bent = dr.abs(dr.rcp(view.distance) - path) > BENT * (path + 1)
        bent = bool((np.asarray(bent) & exists).mean() > LEAST_SHARE)
        return replace(probe, vergence=vergence, sky=sky, splits=splits, bent=bent)

    def light(self, tracer, optics):
        """What radiance paths along some of the rays find."""
        import drjit as dr
        import mitsuba as mi

        grains = min(self.size, PILOT_GRAINS)
        index = dr.arange(mi.UInt32, grains * PILOT_PATHS) // PILOT_PATHS
        chosen = dr.gather(mi.Ray3f, self.ray, mi.UInt32(mi.Float(index) * (self.size / grains)))
        dr.eval(chosen)
        light = None

        def trace():
            nonlocal light
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(self.seed, grains * PILOT_PATHS)
            seen = optics.view(self.scene, chosen, mi.UInt32(0))
            colour = tracer.radiance(self.scene, sampler, seen.ray, seen.surface, seen.whole)
            light = dr.select(seen.exists, colour.x + colour.y + colour.z, 0)
            dr.eval(light)

        seconds = _timed(trace)
        light = np.nan_to_num(np.asarray(light, np.float64)).reshape(grains, PILOT_PATHS)
        mean, variance = light.mean(1), light.var(1, ddof=1)
        lit = mean > 0
        speed = grains * PILOT_PATHS / seconds
        if not lit.any():
            return Light(0.0, 0.0, speed)
        # weighted by brightness, in which lamps in view must not hide the rest
        weight = np.minimum(mean[lit], np.percentile(mean[lit], 75))
        noise = (weight * variance[lit] / mean[lit] ** 2).sum() / weight.sum()
        return Light(float(noise), float(np.percentile(mean[lit], 95)) / 3, speed)

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


def _timed(work):
    """Seconds of the second of two calls, which compiles nothing."""
    import drjit as dr

    for _ in range(2):
        dr.sync_thread()
        start = time.perf_counter()
        work()
        dr.sync_thread()
    return time.perf_counter() - start


def vergence_range(seen, chain):
    """Smallest and largest inverse depth in view, 1/m.

    Caustics spread a few images over all depths, behind the viewer too: with chains a hundredth at either
    end is left to the nearest depth inside.
    """
    if not len(seen.vergence):
        return 0.0, 0.0
    low, high = np.quantile(seen.vergence, (0.01, 0.99) if chain else (0, 1))
    return float(min(low, 0.0) if seen.sky else low), float(high)


def near_end(scene, camera, hologram, seed=0):
    """World depth of the volume's near end: as given, or the nearest surface that the pupil sees."""
    pinhole = DepthMapping.of(replace(hologram, depth_mapping="fit"), camera, 1e-9)
    nearest = Pilot(scene, hologram, camera, pinhole, seed).nearest()
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
    return min(nearest, Pilot(scene, hologram, camera, mapping, seed).nearest() or nearest)
