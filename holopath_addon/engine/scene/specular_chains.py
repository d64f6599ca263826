"""Coherent chains of mirrors and clear surfaces that rays follow (stages s4 and s6 of the paper).

An image finder returns the `ImagePoint` that a ray shows, by ``view``, for each of its ``branches``.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from .differentials import after_hit, crossing, start
from .lobes import SpecularLobes
from .rays import ImagePoint, intersect

if TYPE_CHECKING:
    from ..camera import Camera
    from ..plan import Plan

# Turn of the view across the pupil, in widths of a lobe, from which a lobe is partly narrow, and up to fully narrow.
NARROW = 1.5, 8.0
MIN_ALBEDO = 1e-3
SPLITS = 2  # hits of a chain at which more than one lobe is followed
FAR = 1e4  # meters: stands for infinity where a ray leaves the scene


class FirstHits:
    """Image finder without mirrors and clear surfaces: the first surface of a ray is the image point.

    Parameters
    ----------
    coherent : bool
        Whether neighboring rays are traced in packets.
    sky : bool
        Whether the environment is in view where rays miss all surfaces.
    """

    branches = 1

    def __init__(self, coherent: bool = True, sky: bool = True) -> None:
        self.coherent, self.sky = coherent, sky

    def view(self, scene: mi.Scene, ray: mi.Ray3f, branch: mi.UInt32, drawn: bool = False) -> ImagePoint:
        """Find the image point along a ray; see `SpecularChains.view`."""
        surface = intersect(scene, ray, self.coherent)
        hit = surface.is_valid()
        exists = lit(scene, hit, self.sky)
        return ImagePoint(
            distance=surface.t,
            hit=hit,
            ray=ray,
            surface=surface,
            exists=exists,
            path=surface.t,
            first=surface.t,
        )


class OwnLight:
    """Image finder of surfaces themselves, without the images in them: only chains that end at the first surface.

    Parameters
    ----------
    chains : SpecularChains
    sky : bool
        See `FirstHits`.
    """

    branches = 1

    def __init__(self, chains: SpecularChains, sky: bool) -> None:
        self._chains = copy(chains)
        self._chains.max_specular_depth, self._chains.sky = dr.opaque(mi.UInt32, 1), sky

    def view(self, scene: mi.Scene, ray: mi.Ray3f, branch: mi.UInt32, drawn: bool = False) -> ImagePoint:
        """Find the image point along a ray; see `SpecularChains.view`."""
        point = self._chains.view(scene, ray, mi.UInt32(0), drawn)
        point.exists &= point.hits == 0
        return point


class Images:
    """Image finder of what mirrors and clear surfaces show, without these surfaces themselves.

    Parameters
    ----------
    chains : SpecularChains
    """

    def __init__(self, chains: SpecularChains) -> None:
        self._chains, self.branches = chains, chains.branches

    def view(self, scene: mi.Scene, ray: mi.Ray3f, branch: mi.UInt32, drawn: bool = False) -> ImagePoint:
        """Find the image point of a branch along a ray; see `SpecularChains.view`."""
        point = self._chains.view(scene, ray, branch, drawn)
        point.exists &= point.hits > 0
        return point


@dataclass(kw_only=True)
class _Rough:
    """Nearly smooth surfaces along a chain (Dr.Jit types).

    Attributes
    ----------
    ray : mitsuba.Ray3f
        Ray to the first one.
    surface : mitsuba.PreliminaryIntersection3f
        Intersection with the first one.
    weight : mitsuba.Float
        Weight of the surfaces beyond in the image point's vergence.
    own, own_path : mitsuba.Float
        Vergence that their own places add, by curvature and by optical path.
    color : mitsuba.Color3f
        Albedo of the first one.
    gloss, rest : mitsuba.Float, mitsuba.Bool
        Fraction of P's glossy light that this branch shows, and whether it shows the other light.
    """

    ray: mi.Ray3f
    surface: mi.PreliminaryIntersection3f = field(
        default_factory=lambda: dr.zeros(mi.PreliminaryIntersection3f)
    )
    weight: mi.Float = field(default_factory=lambda: mi.Float(1))
    own: mi.Float = field(default_factory=lambda: mi.Float(0))
    own_path: mi.Float = field(default_factory=lambda: mi.Float(0))
    color: mi.Color3f = field(default_factory=lambda: mi.Color3f(1))
    gloss: mi.Float = field(default_factory=lambda: mi.Float(1))
    rest: mi.Bool = field(default_factory=lambda: mi.Bool(True))

    def over(self, chain, place, narrow, albedo, where, coated):
        """Add the surface that a chain meets, `where` it continues over it.

        Its image counts by the weight `narrow`, unless other branches show the rest (`coated`). `place` is the distance
        of the surface's own image.
        """
        first = where & ~self.surface.is_valid()
        near = dr.select(coated, 0, self.weight * (1 - narrow))
        return replace(
            self,
            ray=dr.select(first, chain.ray, self.ray),
            surface=dr.select(first, chain.surface, self.surface),
            weight=dr.select(where & ~coated, self.weight * narrow, self.weight),
            own=dr.select(where, self.own + near / place, self.own),
            own_path=dr.select(where, self.own_path + near / chain.path, self.own_path),
            color=dr.select(first, dr.maximum(albedo, MIN_ALBEDO), self.color),
            rest=self.rest & ~(first & coated),
        )


@dataclass(kw_only=True)
class _Chain:
    """State of a ray that follows mirrors and clear surfaces (Dr.Jit types).

    Attributes
    ----------
    ray : mitsuba.Ray3f
        Last segment.
    surface : mitsuba.PreliminaryIntersection3f
        Intersection of the last segment.
    ahead : mitsuba.Float
        Distance from the surface before at which the last segment starts.
    weight : mitsuba.Color3f
        Fraction of the radiance that is transmitted.
    length, index : mitsuba.Float
        Optical length before the last segment, and the index of refraction on it.
    hits, splits : mitsuba.UInt32
        Surfaces passed, and bits of the branch number used.
    aside : mitsuba.UInt32
        Bits of the choices that continued, and did not stay, or were reflected, and not transmitted.
    whole, ended, straight, active : mitsuba.Bool
        Whether P shows all its light, whether there is a P, whether the ray was never bent, and whether it continues.
    moves : list
        Ray differentials; empty if images lie at the optical path length.
    rough : _Rough or None
    """

    ray: mi.Ray3f
    surface: mi.PreliminaryIntersection3f
    moves: list
    rough: _Rough | None
    ahead: mi.Float = field(default_factory=lambda: mi.Float(0))
    weight: mi.Color3f = field(default_factory=lambda: mi.Color3f(1))
    length: mi.Float = field(default_factory=lambda: mi.Float(0))
    index: mi.Float = field(default_factory=lambda: mi.Float(1))
    hits: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    splits: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    aside: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    whole: mi.Bool = field(default_factory=lambda: mi.Bool(True))
    ended: mi.Bool = field(default_factory=lambda: mi.Bool(False))
    straight: mi.Bool = field(default_factory=lambda: mi.Bool(True))
    active: mi.Bool = field(default_factory=lambda: mi.Bool(True))

    @property
    def reach(self):
        """Length of the last segment."""
        return self.surface.t + self.ahead

    @property
    def path(self):
        """Optical length up to the surface."""
        return self.length + self.index * self.reach

    def chooses(self, branch):
        """Next bit of a branch number."""
        return ((branch >> self.splits) & 1) == 1


class SpecularChains:
    """Image finder that follows rays over mirrors and through clear surfaces to the first point P that scatters.

    At the first `splits` hits with a choice (stay at P, reflect, transmit), bits of the branch number choose. Later
    hits end the chain if the surface scatters at all, with the mirror image as part of P's radiance, and else follow
    the stronger lobe. The image point P' lies on the first segment, at the distance where neighboring rays from P cross
    (mean curvature of the wavefront), or at the optical path length, which is the paper's choice and exact for flat
    mirrors only.

    Parameters
    ----------
    scene : mitsuba.Scene
    virtual_image : {'curvature', 'opl'}
    max_specular_depth : int
        Maximum hits of a chain; light from beyond is black.
    splits : int
        Choices that are followed; 0 if only mirrors are in view.
    coherent : bool
        Whether neighboring rays are traced in packets.
    sky : bool
        Whether the environment is in view of rays that were neither reflected nor refracted.
    pupil : float
        Radius of the pupil by which rough surfaces are nearly smooth, see `Plan`; 0 if none is.
    """

    def __init__(
        self,
        scene: mi.Scene,
        virtual_image: str,
        max_specular_depth: int,
        splits: int = SPLITS,
        coherent: bool = True,
        sky: bool = True,
        pupil: float = 0.0,
    ) -> None:
        self.lobes, self.pupil = SpecularLobes(scene), pupil
        self.curvature, self.splits = virtual_image == "curvature", splits
        self.max_specular_depth = dr.opaque(
            mi.UInt32, max_specular_depth
        )  # opaque: one compiled kernel for all
        self.branches, self.coherent, self.sky = 1 << splits, coherent, sky

    def view(self, scene: mi.Scene, ray: mi.Ray3f, branch: mi.UInt32, drawn: bool = False) -> ImagePoint:
        """Find the image point of a branch along a ray.

        Parameters
        ----------
        scene : mitsuba.Scene
        ray : mitsuba.Ray3f
        branch : mitsuba.UInt32
            Number below `branches`.
        drawn : bool
            Whether the branch is a random one, of which unused bits do not count.
        """
        first = intersect(scene, ray, self.coherent)
        chain = self._follow(scene, ray, first, branch)
        hit, used = chain.surface.is_valid(), 1 << chain.splits
        path = chain.length + chain.index * dr.select(hit, chain.reach, dr.inf)
        point = ImagePoint(
            distance=self._distance(chain, hit, path),
            hit=hit,
            ray=chain.ray,
            surface=chain.surface,
            exists=chain.ended,
            branch=branch & (used - 1),
            aside=chain.aside,
            weight=chain.weight,
            whole=chain.whole,
            path=path,
            first=first.t,
            hits=chain.hits,
            cut=~chain.ended,
        )
        if self.pupil:
            self._add_rough(scene, point, chain.rough)
        # a chain that was cut off, or transmits no light, shows nothing
        point.exists &= (drawn | (branch < used)) & dr.any(chain.weight > 0)
        point.exists &= lit(scene, point.hit, self.sky | ~chain.straight)
        point.hit = dr.isfinite(point.distance)
        return point

    def _add_rough(self, scene, point, rough):
        """Move an image point to the first nearly smooth surface of its chain, with the vergence of all."""
        nearly = rough.surface.is_valid()
        # without a mirrored surface there is no image
        distance = dr.select(nearly & ~lit(scene, point.hit, self.sky), dr.inf, point.distance)
        point.distance = dr.rcp(rough.own + rough.weight / distance)
        point.path = dr.rcp(rough.own_path + rough.weight / point.path)
        point.ray = dr.select(nearly, rough.ray, point.ray)
        point.surface = dr.select(nearly, rough.surface, point.surface)
        point.hit |= nearly
        point.exists |= nearly
        point.color, point.weight = rough.color, point.weight * rough.color
        point.image = dr.select(nearly, rough.weight, 1 - rough.gloss)
        if self.lobes.coated:
            point.parts = rough.gloss, rough.rest

    def _distance(self, chain, hit, path):
        """Distance of the image of the surface at a chain's end; `path` is the optical length."""
        if not self.curvature:
            return path
        reach = dr.select(hit, chain.reach, FAR)
        return dr.select(chain.hits > 0, crossing(chain.moves, chain.ray, reach), path)

    def _follow(self, scene, ray, first, branch):
        """Follow a branch from a ray and its first surface to the end of the chain."""
        chain = _Chain(
            ray=mi.Ray3f(ray),
            surface=mi.PreliminaryIntersection3f(first),
            moves=start(ray) if self.curvature else [],
            rough=_Rough(ray=mi.Ray3f(ray)) if self.pupil else None,
        )

        def body(chain):
            return (self._step(scene, chain, branch),)

        return dr.while_loop((chain,), lambda chain: chain.active, body, label="specular chain")[0]

    def _step(self, scene, chain, branch):
        """End a chain at the surface that it meets, or continue it to the next."""
        si = chain.surface.compute_surface_interaction(chain.ray, mi.RayFlags.All, chain.active)
        scatters, reflected, transmitted = self.lobes.at(si, chain.active & si.is_valid())
        free, coat = (chain.splits < self.splits) & (chain.hits < self.max_specular_depth), mi.Bool(False)
        if self.pupil:
            free &= ~chain.rough.surface.is_valid()
            over, coat, coated, lobe = self._pass_rough(chain, si, free, branch)
            scatters &= ~over | coated
            through = over & (dr.dot(lobe.direction, si.n) * dr.dot(chain.ray.d, si.n) > 0)
            reflected = dr.select(over & ~through, lobe, reflected)
            transmitted = dr.select(over & through, lobe, transmitted)
        leaves = reflected.exists | transmitted.exists | coat
        # stay at P, or continue
        divides = chain.active & leaves & scatters & free
        stays = ~leaves | (scatters & ~(free & chain.chooses(branch)))
        chain.whole &= ~(divides & stays)
        chain.aside |= dr.select(divides & ~stays, 1 << chain.splits, 0)
        chain.splits = dr.select(divides, chain.splits + 1, chain.splits)
        chain.ended |= chain.active & stays
        chain.active &= ~stays & (chain.hits < self.max_specular_depth)
        # reflect, or transmit
        divides = chain.active & reflected.exists & transmitted.exists & free & (chain.splits < self.splits)
        stronger = dr.max(transmitted.weight) > dr.max(reflected.weight)
        through = dr.select(divides, chain.chooses(branch), stronger)
        chain.aside |= dr.select(divides & ~through, 1 << chain.splits, 0)
        chain.splits = dr.select(divides, chain.splits + 1, chain.splits)
        return dr.select(
            chain.active, self._continue(scene, chain, si, reflected, transmitted, through), chain
        )

    def _pass_rough(self, chain, si, free, branch):
        """Continue a chain over a nearly smooth surface.

        Returns
        -------
        over : mitsuba.Bool
            Whether it continues.
        coat : mitsuba.Bool
            Whether the branch chooses between the lobe and other light of the surface.
        coated : mitsuba.Bool
            Whether there is such other light.
        lobe : Lobe
        """
        lobe, density, coated = self.lobes.glossy(si, chain.active & si.is_valid())
        narrow = _narrow(lobe, density, chain.path, self.pupil)
        coat = (narrow > 0) & coated & free
        over = (narrow > 0) & (~coated | (coat & chain.chooses(branch)))
        place = self._distance(chain, mi.Bool(True), chain.path)
        chain.rough = chain.rough.over(chain, place, narrow, lobe.weight, over, coated)
        chain.rough.gloss = dr.select(coat & ~over, 1 - narrow, chain.rough.gloss)
        chain.weight = dr.select(over & coated, chain.weight * narrow, chain.weight)
        lobe.weight = mi.Color3f(1)
        return over, coat, coated, lobe

    def _continue(self, scene, chain, si, reflected, transmitted, through):
        """Reflect a chain, or send it `through` the surface, to the next surface."""
        lobe, eta = dr.select(through, transmitted, reflected), transmitted.eta
        weight, index, moves = chain.weight * lobe.weight, chain.index, chain.moves
        if self.pupil:
            # beyond a rough surface the chain only finds the place of the image
            weight = dr.select(chain.rough.surface.is_valid(), chain.weight, weight)
        if self.lobes.refracts:
            index = dr.select(through, index * eta, index)
        if self.curvature:
            moves = after_hit(moves, chain.ray, chain.surface, chain.ahead, ~through, eta, chain.active)
        ray = si.spawn_ray(lobe.direction)
        return replace(
            chain,
            ray=ray,
            surface=intersect(scene, ray, False, chain.active),
            # Mitsuba starts rays slightly off the surface, too much for lenses
            ahead=dr.dot(ray.o - si.p, lobe.direction),
            weight=weight,
            length=chain.path,
            index=index,
            hits=chain.hits + 1,
            straight=chain.straight & through & (eta == 1),
            moves=moves,
        )


def image_finder_of(scene: mi.Scene, camera: Camera, plan: Plan) -> FirstHits | SpecularChains:
    """Image finder over as many mirrors and clear surfaces as a plan follows."""
    if not plan.chain:
        return FirstHits(plan.coherent, camera.sees_sky)
    return SpecularChains(
        scene, plan.virtual_image, plan.chain, plan.splits, plan.coherent, camera.sees_sky, plan.pupil
    )


def nearly_smooth(scene: mi.Scene, si: mi.SurfaceInteraction3f, distance: mi.Float, pupil: float) -> mi.Float:
    """Weight of the image of surfaces' glossy light in its distance, 1, against that of the surfaces, 0.

    Parameters
    ----------
    scene : mitsuba.Scene
    si : mitsuba.SurfaceInteraction3f
    distance : mitsuba.Float
        Distance of the viewer, meters.
    pupil : float
        Radius of the pupil, meters.
    """
    lobe, density, _ = SpecularLobes(scene).glossy(si, si.is_valid())
    return _narrow(lobe, density, distance, pupil)


def _narrow(lobe, density, distance, pupil):
    """Weight of the image for a lobe of a density along its middle, at a distance from a pupil; see `nearly_smooth`."""
    # a lobe of constant density over a cap of half-angle a has a = 1 / sqrt(pi density)
    turn = 2 * pupil / distance * dr.sqrt(math.pi * density) / lobe.eta
    x = dr.clip(dr.log(dr.maximum(turn, 1e-6) / NARROW[0]) / math.log(NARROW[1] / NARROW[0]), 0, 1)
    return x * x * (3 - 2 * x)


def lit(scene, hit, sky):
    """Whether a surface is in view, or, where `sky` is true, an environment."""
    return hit if scene.environment() is None else hit | sky
