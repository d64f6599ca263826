"""The ambient radiance cache: diffuse light, baked into a texture over all surfaces (the paper's fast variant, s5).

A texel stores the light that its surface scatters diffusely, over the surface's reflectance,

    R = L_d / g,   g(x, w) = pi f_d(w, n),

with L_d radiance, f_d the diffuse lobes of the BSDF between the viewing direction w and the normal n; g is the
reflectance of a Lambertian surface. So textures stay sharp, and factors that depend on w alone, such as the
transmittance of a coat, are right from everywhere.

Light is solved for bounce by bounce: L_k = L_e + T L_(k-1), with few samples for groups of texels (the source),
then once more with many samples for each texel in view, looking up the source where its rays end (final gathering,
Reichert 1992).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.buffers import loaded, mean
from ..scene.lobes import DIFFUSE
from ..scene.random_numbers import Sampler
from .atlas import BLOCK, NONE
from .groups import Groups

if TYPE_CHECKING:
    from .atlas import Atlas, Triangles
    from .path_tracer import PathTracer

GROUPS = 1 << 18  # approximate number of groups of texels of the source: coarser ones leak light at edges
MAX_LANES = 1 << 17  # groups or texels that share a sequence of random numbers
MIN_LANES = 1 << 12
SEPARABLE = 0.05  # maximum relative error of the product form of a BSDF's diffuse lobes
MIN_DISTANCE = 1e-20  # meters, of surfaces that touch
ALL = int(mi.BSDFFlags.All)
# Sums over samples: R straight from emitters and by way of other surfaces, samples, inverse distances, and the mean
# channel of both in every other sample.
SUMS = np.dtype(
    [("direct", "f4", 3), ("indirect", "f4", 3), ("count", "f4"), ("inverse", "f4"), ("halves", "f4", 2)]
)
NUMBERS = SUMS.itemsize // 4


class RadianceCache:
    """Cache of the diffuse light on the surfaces of a scene.

    Parameters
    ----------
    atlas : Atlas
    complete : bool
        Whether all surfaces have texels.
    translucent : bool
        Whether some surfaces diffusely transmit light.

    Attributes
    ----------
    slots : mitsuba.UInt32
        Two numbers of each texel: its slot in `fine`, 0 for none, and its coarse group.
    fine : mitsuba.Float
        Four numbers of each slot: R, and 1 where it is known.
    source : mitsuba.Float
        Four numbers of each coarse group: sums of R over samples, and samples.
    coarse : Groups
        Groups of all texels.
    lanes : int
        Groups that share a sequence of random numbers.
    groups : list of Groups
        Groups in `fine`, in their order.
    others, own : mitsuba.BSDFContext
        Lobes that are not cached, and cached ones.
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
        self.lanes = min(max(lanes, MIN_LANES), MAX_LANES)

    def add(self, groups: Groups, values: np.ndarray) -> None:
        """Add baked groups of texels.

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

    def picture(self, max_size: int) -> np.ndarray:
        """Image of R over the texture: of texels in view, else of their coarse groups, black elsewhere.

        Parameters
        ----------
        max_size : int
            Maximum pixels along a side; larger textures are subsampled.

        Returns
        -------
        numpy.ndarray, float32, shape (y, x, 3)
            Row 0 is the top.
        """
        width, height = self.atlas.layout.size
        step = math.ceil(max(width, height) / max_size)
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
        sampler: Sampler,
        first: mi.Bool,
        active: mi.Bool,
    ) -> tuple[mi.Color3f, mi.Bool]:
        """Radiance that a surface scatters diffusely to si.wi, and whether it is cached (Dr.Jit types).

        Parameters
        ----------
        surface : mitsuba.PreliminaryIntersection3f
        si : mitsuba.SurfaceInteraction3f
        bsdf : mitsuba.BSDFPtr
        sampler : Sampler
        first : mitsuba.Bool
            Whether the surface is seen directly, where the source is too coarse except for small gaps.
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
        """Reflectance g of the module's description, the factor of R, for the view si.wi of the front or back."""
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
        seed: mi.UInt32,
        lane: mi.UInt32,
    ) -> list[mi.Float]:
        """Sample groups of texels, each sample at a random one of the group, and add up; one kernel.

        Parameters
        ----------
        scene : mitsuba.Scene
        tracer : PathTracer
        pool : mitsuba.UInt32
            Texels, group by group.
        first, count : mitsuba.UInt32
            Start of each group in the pool, and its number of texels.
        samples : int
            Samples of each group.
        done : mitsuba.UInt32
            Samples that each group had before.
        seed, lane : mitsuba.UInt32
            Seed and lane of each group's random numbers, see `Sampler`.

        Returns
        -------
        list of mitsuba.Float
            Sums in the order of SUMS.
        """
        size = dr.width(first)
        sampler = Sampler.seeded(seed, lane)
        # R4 sequences (Roberts 2018), each group from a random start
        leader, key = dr.gather(mi.UInt32, pool, first), 2 * seed
        last = done + dr.opaque(mi.UInt32, samples)
        start = [mi.Float(word) * 2.0**-32 for k in (0, 1) for word in mi.sample_tea_32(leader, key + k)]
        steps = [dr.opaque(mi.Float, 1.1673039782614187 ** -(k + 1)) for k in range(4)]

        def body(number, sums, sampler):
            u = [s + mi.Float(number) * step for s, step in zip(start, steps, strict=True)]
            u = [each - dr.floor(each) for each in u]
            member = dr.minimum(mi.UInt32(sampler.next_1d() * mi.Float(count)), count - 1)
            texel = dr.gather(mi.UInt32, pool, first + member)
            surface, front = self.atlas.place(texel, sampler.next_2d())
            si = surface.compute_surface_interaction(mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1)))
            normal = mi.Frame3f(dr.select(front, si.n, -si.n))
            towards = normal.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
            si.wi = si.to_local(towards)
            g = self.reflectance(si, si.bsdf(), front, True)
            points = mi.Point2f(*u[:2]), mi.Point2f(*u[2:])
            *lights, distance = tracer.scattered_light(scene, sampler, si, self.own, points)
            valid = dr.max(g) > 0
            for light in lights:
                valid &= dr.all(dr.isfinite(light))
            # the light of a channel that the surface does not reflect is unknown: take the mean
            gray = [mean(light) / dr.maximum(mean(g), 1e-30) for light in lights]
            lights = [
                dr.select(valid, dr.select(g > 1e-4 * dr.max(g), light / g, mi.Color3f(rest)), 0)
                for light, rest in zip(lights, gray, strict=True)
            ]
            inverse = dr.rcp(dr.maximum(distance, MIN_DISTANCE))
            more = [*lights[0], *lights[1], dr.select(valid, 1.0, 0.0), dr.select(valid, inverse, 0)]
            more += [dr.select(number % 2 == 0, mean(light), 0) for light in lights]
            return number + 1, [total + m for total, m in zip(sums, more, strict=True)], sampler

        state = (mi.UInt32(done), [dr.zeros(mi.Float, size) for _ in range(NUMBERS)], sampler)
        return dr.while_loop(state, lambda number, *_: number < last, body, label="bake")[1]


def inseparable(triangles: Triangles, samples: int = 64) -> set[int]:
    """Numbers of the shapes whose diffuse lobes are no product of functions of the two directions.

    They count as such, too, if the BSDF does not evaluate its lobes separately.

    Parameters
    ----------
    triangles : Triangles
    samples : int
        Random pairs of directions for each mesh.
    """
    if not triangles.meshes:
        return set()
    meshes = [mesh for mesh in triangles.meshes for _ in range(samples)]
    size = len(meshes)
    sampler = Sampler.seeded(0, dr.arange(mi.UInt32, size))
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
    views, lights = ([mi.warp.square_to_cosine_hemisphere(sampler.next_2d()) for _ in "12"] for _ in "vl")
    everything, own, others = mi.BSDFContext(), mi.BSDFContext(), mi.BSDFContext()
    own.type_mask, others.type_mask = DIFFUSE, ALL & ~DIFFUSE

    def value(context, view, light):
        si.wi = view
        return bsdf.eval(context, si, light)

    product = value(own, views[0], lights[0]) * value(own, views[1], lights[1])
    crossed = value(own, views[0], lights[1]) * value(own, views[1], lights[0])
    apart = value(own, views[0], lights[0]) + value(others, views[0], lights[0])
    whole = value(everything, views[0], lights[0])
    wrong = np.zeros(size // samples, bool)
    for one, other in ((product, crossed), (apart, whole)):
        one, other = (np.array(v, np.float64).reshape(3, -1, samples) for v in (one, other))
        error = np.abs(one - other).sum((0, 2)) / np.maximum(np.maximum(one, other).sum((0, 2)), 1e-12)
        wrong |= error > SEPARABLE
    return {mesh.shape for mesh, bad in zip(triangles.meshes, wrong, strict=True) if bad}


def zeros(count: int) -> mi.Float:
    """Make `count` zeros in memory: a literal would become part of the kernel, which other values compile again."""
    return loaded(mi.Float, np.zeros(count))
