"""The ambient radiance cache: diffuse light, baked into a texture over all surfaces (the paper's fast variant, s5).

What a texel stores is the light that its surface scatters diffusely, over the surface's reflectance there,

    R = L_d / g,   g(x, w) = pi f_d(w, n),

with L_d radiance, f_d the diffuse lobes of the BSDF between the direction w that it is seen from and the normal n;
g is the reflectance of a Lambertian surface. So textures stay as sharp as they are, and what depends on w alone,
as the light that a coat leaves to what lies below, is right from everywhere.

Light is solved for bounce by bounce: L_k = L_e + T L_(k-1), with few samples for groups of texels (the source),
then once more with many samples for each texel in view, looking up the source where its rays end (final gathering,
Reichert 1992).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import binary_closing, minimum_filter

from ..mapping import DepthMapping
from ..scene.buffers import loaded
from ..scene.lobes import DIFFUSE
from ..scene.rays import Rays
from .atlas import BLOCK, NONE

if TYPE_CHECKING:
    from ..camera import Camera
    from ..hologram import Hologram
    from ..scene.specular_chains import FirstHits, SpecularChains
    from .atlas import Atlas, Triangles
    from .path_tracer import PathTracer

GROUPS = 1 << 18  # about how many groups of texels the source has: coarser ones leak light at edges
MOST_LANES = 1 << 17  # groups or texels between two looks at progress and cancel
LEAST_LANES = 1 << 12
PROBE_RAYS = 1 << 18
PROBE_DEPTH = 6  # surfaces on the way of a probe
UNSEEN_TEXELS = 1 << 18  # about how many show what is only seen by way of other surfaces
LEAST_TEXELS = 8  # across a part that no probe met
MARGIN = 1.15  # of the view's width: after small moves of the camera its texels are baked
GRAZING = 0.05  # least cosine that texels are stretched for
SEPARABLE = 0.05  # most relative error of the product form of a BSDF's diffuse lobes
LEAST_DISTANCE = 1e-20  # of a surface that another touches
ALL = int(mi.BSDFFlags.All)
# what is summed over samples: R by lamps and by what they light, samples, inverse distances, and of every other
# sample the mean channels
SUMS = "direct_r direct_g direct_b indirect_r indirect_g indirect_b count inverse direct_half indirect_half".split()


class RadianceCache:
    """Diffuse light on the surfaces of a scene.

    Parameters
    ----------
    atlas : Atlas
    complete : bool
        Whether all surfaces have texels.
    translucent : bool
        Whether some surfaces scatter diffusely what comes from behind.

    Attributes
    ----------
    slots : mitsuba.UInt32
        Two numbers a texel: where it is in `fine`, 0 for nowhere, and its group.
    fine : mitsuba.Float
        Four numbers each: R, and 1 where it is known.
    source : mitsuba.Float
        Four numbers each of the coarse groups: sums of R over samples, and how many there were.
    coarse : Groups
        Of all texels.
    lanes : int
        Groups that one kernel samples: always as many, since Mitsuba's sampler makes another size another kernel.
    groups : list of Groups
        Those in `fine`, in their order.
    others, own : mitsuba.BSDFContext
        Lobes that are not cached, and those that are.
    """

    def __init__(self, atlas: Atlas, complete: bool, translucent: bool) -> None:
        self.atlas, self.complete, self.translucent = atlas, complete, translucent
        self.others, self.own = mi.BSDFContext(), mi.BSDFContext()
        self.others.type_mask, self.own.type_mask = ALL & ~DIFFUSE, DIFFUSE
        texels = max(1, np.count_nonzero(atlas.rows != NONE))
        side = min(1 << max(0, math.ceil(0.5 * math.log2(texels / GROUPS))), BLOCK)
        self.coarse, self.groups = Groups.all_of(atlas, side), []
        slots = np.zeros((atlas.size, 2), np.uint32)
        slots[self.coarse.pool, 1] = self.coarse.numbers
        self.slots = loaded(mi.UInt32, slots.ravel())
        self.fine, self.source = zeros(4), zeros(4 * max(1, len(self.coarse)))
        lanes = 1 << max(0, len(self.coarse) // 4).bit_length()
        self.lanes = min(max(lanes, LEAST_LANES), MOST_LANES)

    def add(self, groups: Groups, values: np.ndarray) -> None:
        """Keep what was baked of groups of texels.

        Parameters
        ----------
        groups : Groups
        values : numpy.ndarray, float32, shape (len(groups), 4)
            R, and 1 where it is known.
        """
        before = dr.width(self.fine) // 4
        dr.scatter(self.slots, loaded(mi.UInt32, groups.numbers) + before, 2 * loaded(mi.UInt32, groups.pool))
        self.fine = dr.concat([self.fine, loaded(mi.Float, values.ravel())])
        dr.eval(self.fine, self.slots)
        self.groups.append(groups)

    def baked(self, texels: np.ndarray) -> np.ndarray:
        """Whether each of some texels is baked."""
        if not len(texels):
            return np.zeros(0, bool)
        return np.array(dr.gather(mi.UInt32, self.slots, 2 * loaded(mi.UInt32, texels))) > 0

    def picture(self, most: int) -> np.ndarray:
        """R as a picture of the texture: of the texels in view, else of their coarse groups, black elsewhere.

        Parameters
        ----------
        most : int
            Pixels along a side; larger textures are thinned out.

        Returns
        -------
        numpy.ndarray, float32, shape (y, x, 3)
            Row 0 is the top.
        """
        width, height = self.atlas.layout.size
        step = math.ceil(max(width, height) / most)
        rows = self.atlas.rows.reshape(height, width)[::step, ::step]
        fine, source = (np.array(values).reshape(-1, 4) for values in (self.fine, self.source))
        slots = np.array(self.slots).reshape(height, width, 2)[::step, ::step]
        light = fine[slots[..., 0]]
        light = np.where(light[..., 3:] > 0, light, source[slots[..., 1]])
        light = light[..., :3] / np.maximum(light[..., 3:], 1)
        return np.where((rows != NONE)[..., None], light, 0).astype(np.float32)

    def diffuse(
        self,
        surface: mi.PreliminaryIntersection3f,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDFPtr,
        sampler: mi.Sampler,
        first: mi.Bool,
        active: mi.Bool,
    ) -> tuple[mi.Color3f, mi.Bool]:
        """Radiance that a surface scatters diffusely to si.wi, and whether the cache knows it (Dr.Jit types).

        Parameters
        ----------
        surface : mitsuba.PreliminaryIntersection3f
        si : mitsuba.SurfaceInteraction3f
        bsdf : mitsuba.BSDFPtr
        sampler : mitsuba.Sampler
        first : mitsuba.Bool
            Whether it is seen directly: the source is too coarse for that, but for a few places.
        active : mitsuba.Bool
        """
        front = dr.dot(si.n, si.to_world(si.wi)) > 0
        texel, known = self.atlas.texel(surface, front, sampler.next_2d(), active)
        slot, group = dr.gather(mi.Vector2u, self.slots, texel, known)
        stored = dr.gather(mi.Vector4f, self.fine, slot, known)
        if not self.complete:
            known &= ~first | (stored.w > 0)
        coarse = known & (stored.w == 0)
        stored = dr.select(coarse, dr.gather(mi.Vector4f, self.source, group, coarse), stored)
        light = mi.Color3f(stored.x, stored.y, stored.z) / dr.maximum(stored.w, 1)
        return dr.select(known, light * self.reflectance(si, bsdf, front, known), 0), known

    def reflectance(
        self, si: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr, front: mi.Bool, active: mi.Bool | bool
    ) -> mi.Color3f:
        """g of the module's description: what R is multiplied by."""
        normal = mi.Vector3f(0, 0, dr.select(front, 1, -1))
        value = bsdf.eval(self.own, si, normal, active)
        if self.translucent:
            value += bsdf.eval(self.own, si, -normal, active)
        return math.pi * value

    def sample(
        self,
        scene: mi.Scene,
        tracer: PathTracer,
        pool: mi.UInt32,
        first: mi.UInt32,
        count: mi.UInt32,
        samples: int,
        done: mi.UInt32,
        seed: int,
    ) -> list[mi.Float]:
        """Sums over samples of groups of texels, each of any of the group's; one kernel.

        Parameters
        ----------
        scene : mitsuba.Scene
        tracer : PathTracer
        pool : mitsuba.UInt32
            Texels, those of a group side by side.
        first, count : mitsuba.UInt32
            Where each group begins in the pool, and how many texels it has.
        samples : int
            Of each group.
        done : mitsuba.UInt32
            How many it has had before.
        seed : int

        Returns
        -------
        list of mitsuba.Float
            As SUMS names them.
        """
        size = dr.width(first)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed % (1 << 32), size)
        # R4 sequences (Roberts 2018) from a start of each group's own
        leader, key = dr.gather(mi.UInt32, pool, first), dr.opaque(mi.UInt32, 2 * seed % (1 << 32))
        last = done + dr.opaque(mi.UInt32, samples)
        start = [mi.Float(word) * 2.0**-32 for k in (0, 1) for word in mi.sample_tea_32(leader, key + k)]
        steps = [dr.opaque(mi.Float, 1.1673039782614187 ** -(k + 1)) for k in range(4)]

        def body(number, sums, sampler):
            turn = [s + mi.Float(number) * step for s, step in zip(start, steps, strict=True)]
            turn = [t - dr.floor(t) for t in turn]
            member = dr.minimum(mi.UInt32(sampler.next_1d() * mi.Float(count)), count - 1)
            texel = dr.gather(mi.UInt32, pool, first + member)
            surface, front = self.atlas.place(texel, sampler.next_2d())
            si = surface.compute_surface_interaction(mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1)))
            normal = mi.Frame3f(dr.select(front, si.n, -si.n))
            towards = normal.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
            si.wi = si.to_local(towards)
            g = self.reflectance(si, si.bsdf(), front, True)
            turns = mi.Point2f(*turn[:2]), mi.Point2f(*turn[2:])
            *lights, distance = tracer.scattered(scene, sampler, si, self.own, turns)
            valid = dr.max(g) > 0
            for light in lights:
                valid &= dr.all(dr.isfinite(light))
            # in a channel that the surface does not reflect, its light is not known
            grey = [dr.mean(light) / dr.maximum(dr.mean(g), 1e-30) for light in lights]
            lights = [
                dr.select(valid, dr.select(g > 1e-4 * dr.max(g), light / g, mi.Color3f(rest)), 0)
                for light, rest in zip(lights, grey, strict=True)
            ]
            inverse = dr.rcp(dr.maximum(distance, LEAST_DISTANCE))
            more = [*lights[0], *lights[1], dr.select(valid, 1.0, 0.0), dr.select(valid, inverse, 0)]
            more += [dr.select(number % 2 == 0, dr.mean(light), 0) for light in lights]
            return number + 1, [total + m for total, m in zip(sums, more, strict=True)], sampler

        state = (mi.UInt32(done), [dr.zeros(mi.Float, size) for _ in SUMS], sampler)
        return dr.while_loop(state, lambda number, *_: number < last, body, label="bake")[1]


class View:
    """What a camera sees, a little beyond the edges of its view.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    near : float
        World depth of the volume's near end, metres.
    optics : FirstHits or SpecularChains
    seed : int
    margin : float
        Width to look at, of the view's.
    """

    def __init__(
        self,
        scene: mi.Scene,
        camera: Camera,
        hologram: Hologram,
        near: float,
        optics: FirstHits | SpecularChains,
        seed: int,
        margin: float = MARGIN,
    ) -> None:
        fov = 2 * math.atan(margin * math.tan(camera.fov_x / 2))
        shift_x, shift_y = camera.shift_x / margin, camera.shift_y / margin
        self._camera = replace(camera, fov_x=fov, shift_x=shift_x, shift_y=shift_y)
        self._mapping = DepthMapping.of(hologram, self._camera, near)
        self._scene, self._hologram, self._optics, self._seed = scene, hologram, optics, seed

    def _look(self, stride):
        """Rays through every so many pixels and the whole pupil, how many, and what they see."""
        hologram = self._hologram
        columns, rows = math.ceil(hologram.width / stride), math.ceil(hologram.height / stride)
        size = columns * rows
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(self._seed, size)
        index = dr.arange(mi.UInt32, size)
        jitter = sampler.next_2d()
        column = (mi.Float(index % columns) + jitter.x) * stride - 0.5
        row = (mi.Float(index // columns) + jitter.y) * stride - 0.5
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
        count = max(1, _count(wanted))
        return (
            _count(known & (slot == 0)) / count,
            _count(wanted & ~known) / count,
            _count(coarse) / count,
        )

    def _pixel(self, atlas, seen, known):
        """Side of a pixel, in texels of the surface that is seen."""
        owner, row, _ = atlas.triangles.row(seen.surface, known)
        scale = dr.gather(mi.Float, atlas.triangles.scale, owner, known)
        part = dr.gather(mi.UInt32, atlas.triangles.part_of, row, known)
        texel = dr.gather(mi.Float, atlas.texel_of, part, known)
        return self._hologram.pitch / self._mapping.focal * seen.path / (scale * texel)


def inseparable(triangles: Triangles, samples: int = 64) -> set[int]:
    """Numbers of the shapes whose diffuse light is not a product of what the viewer's and the lamp's directions give.

    So it is, too, where a BSDF does not keep its lobes apart.
    """
    if not triangles.meshes:
        return set()
    meshes = [mesh for mesh in triangles.meshes for _ in range(samples)]
    size = len(meshes)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, size)
    surface = dr.zeros(mi.PreliminaryIntersection3f, size)
    surface.valid, surface.t = mi.Bool(True), mi.Float(1)
    surface.shape = dr.reinterpret_array(mi.ShapePtr, mi.UInt32([mesh.shape for mesh in meshes]))
    count = mi.Float([len(mesh.faces) for mesh in meshes])
    surface.prim_index = mi.UInt32(sampler.next_1d() * count)
    u = sampler.next_2d()
    surface.prim_uv = dr.select(u.x + u.y > 1, 1 - u, u)
    si = surface.compute_surface_interaction(mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1)))
    si.sh_frame = mi.Frame3f(si.n)
    bsdf = si.bsdf()
    views, lamps = ([mi.warp.square_to_cosine_hemisphere(sampler.next_2d()) for _ in "12"] for _ in "vl")
    everything, own, others = mi.BSDFContext(), mi.BSDFContext(), mi.BSDFContext()
    own.type_mask, others.type_mask = DIFFUSE, ALL & ~DIFFUSE

    def value(context, view, lamp):
        si.wi = view
        return bsdf.eval(context, si, lamp)

    product = value(own, views[0], lamps[0]) * value(own, views[1], lamps[1])
    crossed = value(own, views[0], lamps[1]) * value(own, views[1], lamps[0])
    apart = value(own, views[0], lamps[0]) + value(others, views[0], lamps[0])
    whole = value(everything, views[0], lamps[0])
    wrong = np.zeros(size // samples, bool)
    for one, other in ((product, crossed), (apart, whole)):
        one, other = (np.array(v, np.float64).reshape(3, -1, samples) for v in (one, other))
        error = np.abs(one - other).sum((0, 2)) / np.maximum(np.maximum(one, other).sum((0, 2)), 1e-12)
        wrong |= error > SEPARABLE
    return {mesh.shape for mesh, bad in zip(triangles.meshes, wrong, strict=True) if bad}


@dataclass(frozen=True)
class Groups:
    """Texels in groups that share their samples: those in a square, and of one triangle or of small ones.

    Attributes
    ----------
    pool : numpy.ndarray of uint32
        Texels, those of a group side by side.
    starts, counts : numpy.ndarray of uint32
        Where each group begins in the pool, and how many texels it has.
    sides : numpy.ndarray of uint32 or int
        Side of each group's square in texels.
    """

    pool: np.ndarray
    starts: np.ndarray
    counts: np.ndarray
    sides: np.ndarray | int = 1

    @classmethod
    def of(cls, atlas: Atlas, texels: np.ndarray, side: np.ndarray | int) -> Groups:
        """Groups of texels in squares of `side` texels, a number or one for each."""
        line, column = texels // atlas.width, texels % atlas.width
        square = (line // side * side).astype(np.int64) * atlas.width + column // side * side
        row = atlas.rows[texels].astype(np.int64)
        row[atlas.points[row]] = 0
        key = square * (atlas.triangles.count + 1) + row
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.diff(key[order], prepend=-1))
        counts = np.diff(starts, append=len(order))
        sides = np.broadcast_to(side, texels.shape)[order][starts]
        return cls(*(values.astype(np.uint32) for values in (texels[order], starts, counts, sides)))

    @classmethod
    def all_of(cls, atlas: Atlas, side: int) -> Groups:
        """Groups of all texels of an atlas: as `of`, which need not sort the squares that lie in one triangle."""
        width, height = atlas.layout.size
        numbers = np.arange(atlas.size, dtype=np.uint32).reshape(height, width)
        rows = atlas.rows.reshape(height, width)
        margin = (0, -height % side), (0, -width % side)
        numbers, rows = (np.pad(v, margin, constant_values=NONE) for v in (numbers, rows))
        shape = rows.shape[0] // side, side, rows.shape[1] // side, side
        numbers, rows = (v.reshape(shape).swapaxes(1, 2).reshape(-1, side * side) for v in (numbers, rows))
        first = rows.min(1)
        whole = first == rows.max(1)
        mixed = numbers[~whole][rows[~whole] != NONE]
        rest = cls.of(atlas, mixed.astype(np.int64), side)
        pool = numbers[whole & (first != NONE)]
        starts = side * side * np.arange(len(pool) + 1)
        return cls(
            np.concatenate([pool.ravel(), rest.pool]),
            np.concatenate([starts[:-1], starts[-1] + rest.starts]).astype(np.uint32),
            np.concatenate([np.full(len(pool), side * side), rest.counts]).astype(np.uint32),
        )

    def __len__(self) -> int:
        return len(self.starts)

    def digest(self) -> str:
        """Of which texels are in which group."""
        return blake2b(self.pool.tobytes() + self.counts.tobytes(), digest_size=16).hexdigest()

    @property
    def leaders(self) -> np.ndarray:
        """The first texel of each group."""
        return self.pool[self.starts]

    @property
    def numbers(self) -> np.ndarray:
        """Number of the group of each texel in the pool."""
        return np.repeat(np.arange(len(self), dtype=np.uint32), self.counts)


def _count(lanes):
    return int(dr.count(lanes)[0])


def zeros(count: int) -> mi.Float:
    """Zeros in memory: a literal would be compiled into the kernel, and compiled anew once it is none."""
    return loaded(mi.Float, np.zeros(count))
