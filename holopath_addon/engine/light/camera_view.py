"""What a camera sees of textures over surfaces: how fine its texels must be, which are in view, which are missing."""

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
PROBE_DEPTH = 6  # surfaces on the way of a probe
UNSEEN_TEXELS = 1 << 18  # about how many show what is only seen by way of other surfaces
LEAST_TEXELS = 8  # across a part that no probe met
MARGIN = 1.15  # of the view's width: after small moves of the camera its texels are baked
GRAZING = 0.05  # least cosine that texels are stretched for


@dataclass(frozen=True)
class BakeRequest:
    """Which light is wanted.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    near : float
        World depth of the volume's near end, metres.
    optics : FirstHits or SpecularChains
    settings : Settings
    noise : float
        Relative standard error of texels.
    most : int
        Samples of a texel at most.
    """

    scene: mi.Scene
    camera: Camera
    hologram: Hologram
    near: float
    optics: FirstHits | SpecularChains
    settings: Settings
    noise: float
    most: int

    def same(self, other: BakeRequest) -> bool:
        """Whether it is for the very same scene, camera and hologram, and equal numbers."""
        return (
            self.scene is other.scene
            and self.camera is other.camera
            and self.hologram is other.hologram
            and (self.near, self.settings, self.noise, self.most)
            == (other.near, other.settings, other.noise, other.most)
        )


class CameraView:
    """What a camera sees, or a little more, beyond the edges of its view.

    Parameters
    ----------
    request : BakeRequest
    margin : float
        Width to look at, of the view's.
    """

    def __init__(self, request: BakeRequest, margin: float = MARGIN) -> None:
        camera, self._scene, self._hologram = request.camera, request.scene, request.hologram
        fov = 2 * math.atan(margin * math.tan(camera.fov_x / 2))
        shift_x, shift_y = camera.shift_x / margin, camera.shift_y / margin
        self._camera = replace(camera, fov_x=fov, shift_x=shift_x, shift_y=shift_y)
        self._mapping = DepthMapping.of(request.hologram, self._camera, request.near)
        self._optics, self._seed = request.optics, request.settings.seed

    def _look(self, stride):
        """Rays through every so many pixels and the whole pupil, how many, and what they see."""
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
        branch = mi.UInt32(sampler.next_1d() * self._optics.branches)
        seen = self._optics.view(self._scene, ray, branch)
        seen.path = seen.path + rays.start
        return size, sampler, seen

    def reach(self, triangles: Triangles) -> tuple[np.ndarray, set[tuple[int, int]]]:
        """How fine the texels of each part must be, and which sides of which owners light leaves for the camera.

        What is seen directly, or by way of mirrors and clear glass, gets texels of a pixel of the hologram; what
        lights it, coarse ones.

        Returns
        -------
        texel : numpy.ndarray, shape (triangles.parts,)
            Metres of the part's own mesh.
        sides : set of (int, int)
            As `Atlas` takes them.
        """
        pixels = self._hologram.width * self._hologram.height
        size, sampler, seen = self._look(max(1, math.ceil(math.sqrt(pixels / PROBE_RAYS))))
        direct, path_to = (loaded(mi.Float, np.full(max(1, triangles.parts), np.inf)) for _ in "12")
        reached = dr.zeros(mi.UInt32, 2 * triangles.numbers)
        context = mi.BSDFContext()
        pixel = self._hologram.pitch / self._mapping.focal
        state = (mi.Ray3f(seen.ray), mi.PreliminaryIntersection3f(seen.surface), mi.Float(seen.path))
        state += (sampler, mi.UInt32(0), mi.Bool(seen.exists))

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
        turn = math.sqrt((area[met] / path_to[met] ** 2).sum() / UNSEEN_TEXELS)
        with np.errstate(invalid="ignore"):
            texel = np.where(met, np.minimum(direct, turn * path_to), np.sqrt(area) / LEAST_TEXELS)
        texel = np.clip(texel, 1e-9, 1e9)
        return texel, {(int(n) // 2, int(n) % 2) for n in np.flatnonzero(np.array(reached))}

    def seen(self, atlas: Atlas) -> tuple[np.ndarray, np.ndarray]:
        """Texels in view, and the side in texels of the squares of them that a pixel covers.

        Returns
        -------
        texels : numpy.ndarray of uint32
            All texels of each block in view.
        side : numpy.ndarray of int
        """
        _, sampler, seen = self._look(0.5)
        across, down = atlas.width // BLOCK, atlas.size // atlas.width // BLOCK
        finest = loaded(mi.Float, np.full(across * down, np.inf))
        si = seen.surface.compute_surface_interaction(seen.ray, mi.RayFlags.All, seen.exists)
        cosine = dr.dot(si.n, -seen.ray.d)
        texel, known = atlas.texel(seen.surface, cosine > 0, sampler.next_2d(), seen.exists)
        # as large as the pixel, which is longer than wide
        side = self._pixel(atlas, seen, known) * dr.rsqrt(dr.maximum(dr.abs(cosine), GRAZING))
        block = texel // atlas.width // BLOCK * across + texel % atlas.width // BLOCK
        dr.scatter_reduce(dr.ReduceOp.Min, finest, side, block, known)
        finest = np.array(finest).reshape(down, across)
        # where surfaces are seen at grazing angles, rays are far apart
        marked = binary_closing(np.pad(np.isfinite(finest), 1), np.ones((3, 3)))[1:-1, 1:-1]
        finest = np.where(np.isfinite(finest), finest, minimum_filter(finest, 3))
        side = 1 << np.clip(np.log2(np.clip(finest, 1, BLOCK)), 0, None).astype(int)
        each = np.repeat(np.repeat(np.where(marked, side, 0), BLOCK, 0), BLOCK, 1).ravel()
        texels = np.flatnonzero((each > 0) & (atlas.rows != NONE))
        return texels.astype(np.uint32), each[texels]

    def coverage(self, cache: RadianceCache) -> tuple[float, float, float]:
        """How much of the view a cache lacks.

        Returns
        -------
        missing, lost, coarse : float
            Shares of the view on cached surfaces: what is not baked, what has no texels at all, and what has texels
            of over two pixels.
        """
        atlas = cache.atlas
        _, _, seen = self._look(2)
        si = seen.surface.compute_surface_interaction(seen.ray, mi.RayFlags.All, seen.exists)
        front = dr.dot(si.n, seen.ray.d) < 0
        wanted = atlas.triangles.row(seen.surface, seen.exists)[2]
        texel, known = atlas.texel(seen.surface, front, mi.Point2f(0.5), seen.exists)
        slot = dr.gather(mi.UInt32, cache.slots, 2 * texel, known)
        coarse = known & (self._pixel(atlas, seen, known) < 0.5 / atlas.layout.coarser)
        missing, lost = known & (slot == 0), wanted & ~known
        count = max(1, _count(wanted))
        return _count(missing) / count, _count(lost) / count, _count(coarse) / count

    def _pixel(self, atlas, seen, known):
        """Side of a pixel, in texels of the surface that is seen."""
        owner, row, _ = atlas.triangles.row(seen.surface, known)
        scale = dr.gather(mi.Float, atlas.triangles.scale, owner, known)
        part = dr.gather(mi.UInt32, atlas.triangles.part_of, row, known)
        texel = dr.gather(mi.Float, atlas.texel_of, part, known)
        return self._hologram.pitch / self._mapping.focal * seen.path / (scale * texel)


def _count(lanes):
    return int(dr.count(lanes)[0])
