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

GROUPS = 1 << 18  # about how many groups of texels the source has: coarser ones leak light at edges
MOST_LANES = 1 << 17  # groups or texels that draw random numbers together
LEAST_LANES = 1 << 12
SEPARABLE = 0.05  # most relative error of the product form of a BSDF's diffuse lobes
LEAST_DISTANCE = 1e-20  # of a surface that another touches
ALL = int(mi.BSDFFlags.All)
# what is summed over samples: R by lamps and by what they light, samples, inverse distances, and of every other
# sample the mean channel of both
SUMS = np.dtype(
    [("direct", "f4", 3), ("indirect", "f4", 3), ("count", "f4"), ("inverse", "f4"), ("halves", "f4", 2)]
)
NUMBERS = SUMS.itemsize // 4


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
        Groups that draw their random numbers together.
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
        sampler: Sampler,
        first: mi.Bool,
        active: mi.Bool,
    ) -> tuple[mi.Color3f, mi.Bool]:
        """Radiance that a surface scatters diffusely to si.wi, and whether the cache knows it (Dr.Jit types).

        Parameters
        ----------
        surface : mitsuba.PreliminaryIntersection3f
        si : mitsuba.SurfaceInteraction3f
        bsdf : mitsuba.BSDFPtr
        sampler : Sampler
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
        seed: mi.UInt32,
        lane: mi.UInt32,
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
        seed, lane : mitsuba.UInt32
            Of each group's random numbers, see `Sampler`.

        Returns
        -------
        list of mitsuba.Float
            The numbers of SUMS in turn.
        """
        size = dr.width(first)
        sampler = Sampler.seeded(seed, lane)
        # R4 sequences (Roberts 2018) from a start of each group's own
        leader, key = dr.gather(mi.UInt32, pool, first), 2 * seed
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
            grey = [mean(light) / dr.maximum(mean(g), 1e-30) for light in lights]
            lights = [
                dr.select(valid, dr.select(g > 1e-4 * dr.max(g), light / g, mi.Color3f(rest)), 0)
                for light, rest in zip(lights, grey, strict=True)
            ]
            inverse = dr.rcp(dr.maximum(distance, LEAST_DISTANCE))
            more = [*lights[0], *lights[1], dr.select(valid, 1.0, 0.0), dr.select(valid, inverse, 0)]
            more += [dr.select(number % 2 == 0, mean(light), 0) for light in lights]
            return number + 1, [total + m for total, m in zip(sums, more, strict=True)], sampler

        state = (mi.UInt32(done), [dr.zeros(mi.Float, size) for _ in range(NUMBERS)], sampler)
        return dr.while_loop(state, lambda number, *_: number < last, body, label="bake")[1]


def inseparable(triangles: Triangles, samples: int = 64) -> set[int]:
    """Numbers of the shapes whose diffuse light is not a product of what the viewer's and the lamp's directions give.

    So it is, too, where a BSDF does not keep its lobes apart.
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


def zeros(count: int) -> mi.Float:
    """Zeros in memory: a literal would be compiled into the kernel, and compiled anew once it is none."""
    return loaded(mi.Float, np.zeros(count))
