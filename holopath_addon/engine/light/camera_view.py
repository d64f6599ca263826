"""A camera's view of the texture over surfaces: the size that texels need, texels in view, and missing ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import binary_closing, minimum_filter

from ..mapping import DepthMapping
from ..scene.buffers import loaded
from ..scene.random_numbers import Sampler
from ..scene.rays import Rays
from .atlas import BLOCK, NONE

if TYPE_CHECKING:
    from ..camera import Camera
    from ..hologram import Hologram
    from ..scene.specular_chains import FirstHits, SpecularChains
    from ..settings import Settings
    from .atlas import Atlas, Triangles
    from .radiance_cache import RadianceCache

PROBE_RAYS = 1 << 18
PROBE_DEPTH = 6  # surfaces that a probe ray meets
INDIRECT_TEXELS = 1 << 18  # approximate number of texels of surfaces that are seen only by way of others
MIN_TEXELS = 8  # across a part that no probe ray met
MARGIN = 1.15  # width that is baked over that of the view: small moves of the camera then need no baking
MIN_COSINE = 0.05  # minimum cosine for which texels are stretched


@dataclass(frozen=True)
class BakeRequest:
    """Light to bake: a view of a scene, and its accuracy.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    near : float
        World depth of the volume's near end, meters.
    image_finder : FirstHits or SpecularChains
    settings : Settings
    noise : float
        Target of the relative standard error of texels.
    max_samples : int
        Maximum samples of a texel.
    """

    scene: mi.Scene
    camera: Camera
    hologram: Hologram
    near: float
    image_finder: FirstHits | SpecularChains
    settings: Settings
    noise: float
    max_samples: int

    def same(self, other: BakeRequest) -> bool:
        """Whether both are for the same scene, and equal in all else."""
        return (
            self.scene is other.scene
            and self.camera.to_dict() == other.camera.to_dict()
            and self.hologram == other.hologram
            and (self.near, self.settings, self.noise, self.max_samples)
            == (other.near, other.settings, other.noise, other.max_samples)
        )


class CameraView:
    """View of a camera, or a slightly wider one.

    Parameters
    ----------
    request : BakeRequest
    margin : float
        Width over that of the camera's view.
    """

    def __init__(self, request: BakeRequest, margin: float = MARGIN) -> None:
        camera, self._scene, self._hologram = request.camera, request.scene, request.hologram
        fov = 2 * math.atan(margin * math.tan(camera.fov_x / 2))
        shift_x, shift_y = camera.shift_x / margin, camera.shift_y / margin
        self._camera = replace(camera, fov_x=fov, shift_x=shift_x, shift_y=shift_y)
        self._mapping = DepthMapping.of(request.hologram, self._camera, request.near)
        self._image_finder, self._seed = request.image_finder, request.settings.seed

    def _probe(self, stride):
        """Number of rays through the pupil and every `stride`-th pixel, their sampler and their image points."""
        hologram = self._hologram
        columns, rows = math.ceil(hologram.width / stride), math.ceil(hologram.height / stride)
        size = columns * rows
        index = dr.arange(mi.UInt32, size)
        sampler = Sampler.seeded(self._seed, index)
        jitter = sampler.next_2d()
        across, step = dr.opaque(mi.UInt32, columns), dr.opaque(mi.Float, float(stride))
        column = (mi.Float(index % across) + jitter.x) * step - 0.5
        row = (mi.Float(index // across) + jitter.y) * step - 0.5
        limit = hologram.widest_slope
        slope = limit * mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
        rays = Rays(hologram, self._camera, self._mapping, self._mapping.z_far)
        ray, _ = rays.world(*rays.place(column, row), slope.x, slope.y)
        branch = mi.UInt32(sampler.next_1d() * self._image_finder.branches)
        point = self._image_finder.view(self._scene, ray, branch)
        point.path = point.path + rays.start
        return size, sampler, point

    def reach(self, triangles: Triangles) -> tuple[np.ndarray, set[tuple[int, int]]]:
        """Size that the texels of each part need, and sides that send light to the camera.

        Surfaces that are seen directly, or by way of mirrors and clear glass, get texels of a hologram's pixel; those
        that light them, coarse ones.

        Returns
        -------
        texel : numpy.ndarray, shape (triangles.parts,)
            Side of a texel, meters of the part's own mesh.
        sides : set of (int, int)
            Parameter of `atlas.lay_out`.
        """
        pixels = self._hologram.width * self._hologram.height
        size, sampler, point = self._probe(max(1, math.ceil(math.sqrt(pixels / PROBE_RAYS))))
        direct, path_to = (loaded(mi.Float, np.full(max(1, triangles.parts), np.inf)) for _ in "12")
        reached = dr.zeros(mi.UInt32, 2 * triangles.numbers)
        context = mi.BSDFContext()
        pixel = self._hologram.pitch / self._mapping.focal
        state = (mi.Ray3f(point.ray), mi.PreliminaryIntersection3f(point.surface), mi.Float(point.path))
        state += (sampler, mi.UInt32(0), mi.Bool(point.exists))

        def body(ray, surface, path, sampler, number, active):
            owner, row, known = triangles.row(surface, active)
            part = dr.gather(mi.UInt32, triangles.part_of, row, known)
            scale = dr.gather(mi.Float, triangles.scale, owner, known)
            dr.scatter_reduce(dr.ReduceOp.Min, direct, pixel * path / scale, part, known & (number == 0))
            dr.scatter_reduce(dr.ReduceOp.Min, path_to, path / scale, part, known)
            si = surface.compute_surface_interaction(ray, mi.RayFlags.All, active)
            active &= si.is_valid()
            side = dr.select(dr.dot(si.n, ray.d) < 0, mi.UInt32(0), 1)
            dr.scatter(reached, mi.UInt32(1), 2 * owner + side, known & active)
            sample, value = si.bsdf().sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
            active &= (dr.max(value) > 0) & (number + 1 < PROBE_DEPTH)
            ray = si.spawn_ray(si.to_world(sample.wo))
            surface = self._scene.ray_intersect_preliminary(ray, coherent=False, active=active)
            return ray, surface, path + surface.t, sampler, number + 1, active

        dr.while_loop(state, lambda *s: s[-1], body, label="reach")
        dr.eval(direct, path_to, reached)
        direct, path_to = np.array(direct, np.float64), np.array(path_to, np.float64)
        area = triangles.areas()
        met = np.isfinite(path_to) & (area > 0)
        angle = math.sqrt((area[met] / path_to[met] ** 2).sum() / INDIRECT_TEXELS)
        with np.errstate(invalid="ignore"):
            texel = np.where(met, np.minimum(direct, angle * path_to), np.sqrt(area) / MIN_TEXELS)
        texel = np.clip(texel, 1e-9, 1e9)
        return texel, {(int(n) // 2, int(n) % 2) for n in np.flatnonzero(np.array(reached))}

    def texels(self, atlas: Atlas) -> tuple[np.ndarray, np.ndarray]:
        """Texels in view, and the squares of texels that a pixel covers.

        Returns
        -------
        texels : numpy.ndarray of uint32
            All texels of each block in view.
        side : numpy.ndarray of int
            Side of each texel's square, texels.
        """
        _, sampler, point = self._probe(0.5)
        across, down = atlas.width // BLOCK, atlas.size // atlas.width // BLOCK
        finest = loaded(mi.Float, np.full(across * down, np.inf))
        si = point.surface.compute_surface_interaction(point.ray, mi.RayFlags.All, point.exists)
        cosine = dr.dot(si.n, -point.ray.d)
        texel, known = atlas.texel(point.surface, cosine > 0, sampler.next_2d(), point.exists)
        # of the same area as the pixel, which is longer than wide on the surface
        side = self._pixel(atlas, point, known) * dr.rsqrt(dr.maximum(dr.abs(cosine), MIN_COSINE))
        block = texel // atlas.width // BLOCK * across + texel % atlas.width // BLOCK
        dr.scatter_reduce(dr.ReduceOp.Min, finest, side, block, known)
        finest = np.array(finest).reshape(down, across)
        # rays are far apart on surfaces at grazing angles
        marked = binary_closing(np.pad(np.isfinite(finest), 1), np.ones((3, 3)))[1:-1, 1:-1]
        finest = np.where(np.isfinite(finest), finest, minimum_filter(finest, 3))
        side = 1 << np.clip(np.log2(np.clip(finest, 1, BLOCK)), 0, None).astype(int)
        each = np.repeat(np.repeat(np.where(marked, side, 0), BLOCK, 0), BLOCK, 1).ravel()
        texels = np.flatnonzero((each > 0) & (atlas.rows != NONE))
        return texels.astype(np.uint32), each[texels]

    def coverage(self, cache: RadianceCache) -> tuple[float, float, float]:
        """Fractions of the view, on surfaces that can be cached, that a cache lacks.

        Returns
        -------
        missing, lost, coarse : float
            Fractions that are not baked, have no texels, and have texels of over two pixels.
        """
        atlas = cache.atlas
        _, _, point = self._probe(2)
        si = point.surface.compute_surface_interaction(point.ray, mi.RayFlags.All, point.exists)
        front = dr.dot(si.n, point.ray.d) < 0
        cached = atlas.triangles.row(point.surface, point.exists)[2]
        texel, known = atlas.texel(point.surface, front, mi.Point2f(0.5), point.exists)
        slot = dr.gather(mi.UInt32, cache.slots, 2 * texel, known)
        coarse = known & (self._pixel(atlas, point, known) < 0.5 / atlas.layout.coarser)
        missing, lost = known & (slot == 0), cached & ~known
        count = max(1, _count(cached))
        return _count(missing) / count, _count(lost) / count, _count(coarse) / count

    def _pixel(self, atlas, point, known):
        """Side of a pixel, in texels of the surface at an image point."""
        owner, row, _ = atlas.triangles.row(point.surface, known)
        scale = dr.gather(mi.Float, atlas.triangles.scale, owner, known)
        part = dr.gather(mi.UInt32, atlas.triangles.part_of, row, known)
        texel = dr.gather(mi.Float, atlas.texel_of, part, known)
        return self._hologram.pitch / self._mapping.focal * point.path / (scale * texel)


def _count(lanes):
    return int(dr.count(lanes)[0])
