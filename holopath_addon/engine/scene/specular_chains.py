"""Coherent chains: what a ray meets through mirrors and clear surfaces (stages s4 and s6 of the paper)."""

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

# widths of a lobe that the view turns across the pupil, from which and up to which it is one
NARROW = 1.5, 8.0
LEAST_ALBEDO = 1e-3
SPLITS = 2  # hits of a chain at which more than one way on is followed
FAR = 1e4  # metres: stands for infinity where a ray leaves the scene


class FirstHits:
    """No mirror or clear surface in view: the first surface is the image point.

    Parameters
    ----------
    coherent : bool
        Whether neighbouring rays are traced in packets.
    sky : bool
        Whether rays that miss all surfaces see the environment.
    """

    branches = 1

    def __init__(self, coherent: bool = True, sky: bool = True) -> None:
        self.coherent, self.sky = coherent, sky

    def view(self, scene: mi.Scene, ray: mi.Ray3f, branch: mi.UInt32, drawn: bool = False) -> ImagePoint:
        """The `ImagePoint` along a ray."""
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
    """Surfaces that rays meet straight on, as far as they show no images: the `ImagePoint` of a chain that stays there.

    Parameters
    ----------
    chains : SpecularChains
    sky : bool
        As of `FirstHits`.
    """

    branches = 1

    def __init__(self, chains: SpecularChains, sky: bool) -> None:
        self._chains = copy(chains)
        self._chains.most_hits, self._chains.sky = dr.opaque(mi.UInt32, 1), sky

    def view(self, scene: mi.Scene, ray: mi.Ray3f, branch: mi.UInt32, drawn: bool = False) -> ImagePoint:
        """The `ImagePoint` along a ray."""
        seen = self._chains.view(scene, ray, mi.UInt32(0), drawn)
        seen.exists &= seen.hits == 0
        return seen


class Images:
    """What rays see over mirrors and through clear surfaces, and nothing else.

    Parameters
    ----------
    chains : SpecularChains
    """

    def __init__(self, chains: SpecularChains) -> None:
        self._chains, self.branches = chains, chains.branches

    def view(self, scene: mi.Scene, ray: mi.Ray3f, branch: mi.UInt32, drawn: bool = False) -> ImagePoint:
        """The `ImagePoint` of a branch along a ray."""
        seen = self._chains.view(scene, ray, branch, drawn)
        seen.exists &= seen.hits > 0
        return seen


@dataclass(kw_only=True)
class _Rough:
    """Nearly smooth surfaces that a chain has gone over (Dr.Jit types).

    Attributes
    ----------
    ray : mitsuba.Ray3f
    surface : mitsuba.PreliminaryIntersection3f
        The first one.
    share : mitsuba.Float
        Of the image point's vergence, left to what lies beyond.
    own, own_path : mitsuba.Float
        What their own places add to it, by curvature and by optical path.
    colour : mitsuba.Color3f
        Albedo of the first one.
    gloss, rest : mitsuba.Float, mitsuba.Bool
        Share of P's glossy light that this branch shows, and whether it shows the other light.
    """

    ray: mi.Ray3f
    surface: mi.PreliminaryIntersection3f = field(
        default_factory=lambda: dr.zeros(mi.PreliminaryIntersection3f)
    )
    share: mi.Float = field(default_factory=lambda: mi.Float(1))
    own: mi.Float = field(default_factory=lambda: mi.Float(0))
    own_path: mi.Float = field(default_factory=lambda: mi.Float(0))
    colour: mi.Color3f = field(default_factory=lambda: mi.Color3f(1))
    gloss: mi.Float = field(default_factory=lambda: mi.Float(1))
    rest: mi.Bool = field(default_factory=lambda: mi.Bool(True))

    def over(self, chain, place, narrow, albedo, where, coated):
        """Go over what a chain meets, too: light comes from its image as far as its lobe is `narrow`, if no branch is
        for the rest. `place` is its own image's distance.
        """
        first = where & ~self.surface.is_valid()
        near = dr.select(coated, 0, self.share * (1 - narrow))
        return replace(
            self,
            ray=dr.select(first, chain.ray, self.ray),
            surface=dr.select(first, chain.surface, self.surface),
            share=dr.select(where & ~coated, self.share * narrow, self.share),
            own=dr.select(where, self.own + near / place, self.own),
            own_path=dr.select(where, self.own_path + near / chain.path, self.own_path),
            colour=dr.select(first, dr.maximum(albedo, LEAST_ALBEDO), self.colour),
            rest=self.rest & ~(first & coated),
        )


@dataclass(kw_only=True)
class _Chain:
    """A ray on its way over mirrors and through clear surfaces, or where it has ended (Dr.Jit types).

    Attributes
    ----------
    ray : mitsuba.Ray3f
        The last piece.
    surface : mitsuba.PreliminaryIntersection3f
        What it meets.
    ahead : mitsuba.Float
        How far from the surface before it the last piece starts.
    weight : mitsuba.Color3f
        Share of the radiance that comes through.
    length, index : mitsuba.Float
        The optical length before the last piece, and the index of refraction on it.
    hits, splits : mitsuba.UInt32
        Surfaces on the way, and bits of the branch number that have chosen.
    aside : mitsuba.UInt32
        Bits of these choices that were to go on, not to stay, or to be reflected, not transmitted.
    whole, ended, straight, active : mitsuba.Bool
        Whether P shows all its light, whether there is a P, whether the ray was never bent, whether it is to go on.
    moves : list
        Ray differentials, or none where images lie at the optical path length.
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
        """Length of the last piece."""
        return self.surface.t + self.ahead

    @property
    def path(self):
        """Optical length to what is met."""
        return self.length + self.index * self.reach

    def chooses(self, branch):
        """The next bit of a branch number."""
        return ((branch >> self.splits) & 1) == 1


class SpecularChains:
    """Rays are followed over mirrors and through clear surfaces to the first point P that scatters.

    At the first `splits` hits with more than one way on (stay at P, reflect, transmit), bits of the branch number
    choose. Later hits end the chain where the surface scatters at all, P then showing its mirror image as part of
    its radiance, and else take the stronger way. The image point P' lies on the first piece, at the distance where
    neighbouring rays from P cross (mean curvature of the wavefront), or at the optical path length, which is the
    paper's choice and exact for flat mirrors only.

    Parameters
    ----------
    scene : mitsuba.Scene
    virtual_image : {'curvature', 'opl'}
    most_hits : int
        Longest chain; what is beyond is black.
    splits : int
        0 where mirrors only are in view.
    coherent : bool
        Whether neighbouring rays are traced in packets.
    sky : bool
        Whether rays that were neither reflected nor refracted see the environment.
    pupil : float
        Radius of the pupil that tells which rough surfaces are nearly smooth, see `Plan`; 0 where none is.
    """

    def __init__(
        self,
        scene: mi.Scene,
        virtual_image: str,
        most_hits: int,
        splits: int = SPLITS,
        coherent: bool = True,
        sky: bool = True,
        pupil: float = 0.0,
    ) -> None:
        self.lobes, self.pupil = SpecularLobes(scene), pupil
        self.curvature, self.splits = virtual_image == "curvature", splits
        self.most_hits = dr.opaque(mi.UInt32, most_hits)  # no literal: one kernel for all lengths
        self.branches, self.coherent, self.sky = 1 << splits, coherent, sky

    def view(self, scene: mi.Scene, ray: mi.Ray3f, branch: mi.UInt32, drawn: bool = False) -> ImagePoint:
        """The `ImagePoint` of a branch along a ray.

        Of a branch `drawn` at random, bits that nothing divides by do not count.
        """
        met = intersect(scene, ray, self.coherent)
        chain = self._followed(scene, ray, met, branch)
        hit, used = chain.surface.is_valid(), 1 << chain.splits
        path = chain.length + chain.index * dr.select(hit, chain.reach, dr.inf)
        seen = ImagePoint(
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
            first=met.t,
            hits=chain.hits,
            cut=~chain.ended,
        )
        if self.pupil:
            self._show_rough(scene, seen, chain.rough)
        # a chain that was cut off, or whose light is zero, shows nothing
        seen.exists &= (drawn | (branch < used)) & dr.any(chain.weight > 0)
        seen.exists &= lit(scene, seen.hit, self.sky | ~chain.straight)
        seen.hit = dr.isfinite(seen.distance)
        return seen

    def _show_rough(self, scene, seen, rough):
        """Have an image point show the nearly smooth surfaces before it, the first of which it then lies on."""
        nearly = rough.surface.is_valid()
        # where nothing is mirrored there is no image either
        distance = dr.select(nearly & ~lit(scene, seen.hit, self.sky), dr.inf, seen.distance)
        seen.distance = dr.rcp(rough.own + rough.share / distance)
        seen.path = dr.rcp(rough.own_path + rough.share / seen.path)
        seen.ray = dr.select(nearly, rough.ray, seen.ray)
        seen.surface = dr.select(nearly, rough.surface, seen.surface)
        seen.hit |= nearly
        seen.exists |= nearly
        seen.colour, seen.weight = rough.colour, seen.weight * rough.colour
        seen.image = dr.select(nearly, rough.share, 1 - rough.gloss)
        if self.lobes.coated:
            seen.parts = rough.gloss, rough.rest

    def _distance(self, chain, hit, path):
        """Distance of the image of what a chain meets, where it does; `path` is the optical one."""
        if not self.curvature:
            return path
        reach = dr.select(hit, chain.reach, FAR)
        return dr.select(chain.hits > 0, crossing(chain.moves, chain.ray, reach), path)

    def _followed(self, scene, ray, met, branch):
        """The `_Chain` of a branch that begins with a ray and what it has met."""
        chain = _Chain(
            ray=mi.Ray3f(ray),
            surface=mi.PreliminaryIntersection3f(met),
            moves=start(ray) if self.curvature else [],
            rough=_Rough(ray=mi.Ray3f(ray)) if self.pupil else None,
        )

        def body(chain):
            return (self._stepped(scene, chain, branch),)

        return dr.while_loop((chain,), lambda chain: chain.active, body, label="specular chain")[0]

    def _stepped(self, scene, chain, branch):
        """A chain that stays at the surface that it meets, or goes on to the next."""
        si = chain.surface.compute_surface_interaction(chain.ray, mi.RayFlags.All, chain.active)
        scatters, reflected, transmitted = self.lobes.at(si, chain.active & si.is_valid())
        free, coat = (chain.splits < self.splits) & (chain.hits < self.most_hits), mi.Bool(False)
        if self.pupil:
            free &= ~chain.rough.surface.is_valid()
            over, coat, coated, lobe = self._gone_over(chain, si, free, branch)
            scatters &= ~over | coated
            through = over & (dr.dot(lobe.direction, si.n) * dr.dot(chain.ray.d, si.n) > 0)
            reflected = dr.select(over & ~through, lobe, reflected)
            transmitted = dr.select(over & through, lobe, transmitted)
        leaves = reflected.exists | transmitted.exists | coat
        # stay at P, or go on
        divides = chain.active & leaves & scatters & free
        stays = ~leaves | (scatters & ~(free & chain.chooses(branch)))
        chain.whole &= ~(divides & stays)
        chain.aside |= dr.select(divides & ~stays, 1 << chain.splits, 0)
        chain.splits = dr.select(divides, chain.splits + 1, chain.splits)
        chain.ended |= chain.active & stays
        chain.active &= ~stays & (chain.hits < self.most_hits)
        # reflect, or transmit
        divides = chain.active & reflected.exists & transmitted.exists & free & (chain.splits < self.splits)
        stronger = dr.max(transmitted.weight) > dr.max(reflected.weight)
        through = dr.select(divides, chain.chooses(branch), stronger)
        chain.aside |= dr.select(divides & ~through, 1 << chain.splits, 0)
        chain.splits = dr.select(divides, chain.splits + 1, chain.splits)
        return dr.select(chain.active, self._onward(scene, chain, si, reflected, transmitted, through), chain)

    def _gone_over(self, chain, si, free, branch):
        """Have a chain go over a nearly smooth surface: where it does, where that or the rest is a branch's choice,
        where there is a rest, and the `Lobe` by which it goes.
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

    def _onward(self, scene, chain, si, reflected, transmitted, through):
        """A chain that is reflected or goes `through` a surface, to the next surface."""
        way, eta = dr.select(through, transmitted, reflected), transmitted.eta
        weight, index, moves = chain.weight * way.weight, chain.index, chain.moves
        if self.pupil:
            # beyond a rough surface the chain is only followed to where the image lies
            weight = dr.select(chain.rough.surface.is_valid(), chain.weight, weight)
        if self.lobes.refracts:
            index = dr.select(through, index * eta, index)
        if self.curvature:
            moves = after_hit(moves, chain.ray, chain.surface, chain.ahead, ~through, eta, chain.active)
        ray = si.spawn_ray(way.direction)
        return replace(
            chain,
            ray=ray,
            surface=intersect(scene, ray, False, chain.active),
            # Mitsuba lets rays start a little off the surface, too much for lenses
            ahead=dr.dot(ray.o - si.p, way.direction),
            weight=weight,
            length=chain.path,
            index=index,
            hits=chain.hits + 1,
            straight=chain.straight & through & (eta == 1),
            moves=moves,
        )


def optics_of(scene: mi.Scene, camera: Camera, plan: Plan) -> FirstHits | SpecularChains:
    """How rays are followed to what they see, as planned: `FirstHits` or `SpecularChains`."""
    if not plan.chain:
        return FirstHits(plan.coherent, camera.sees_sky)
    return SpecularChains(
        scene, plan.virtual_image, plan.chain, plan.splits, plan.coherent, camera.sees_sky, plan.pupil
    )


def nearly_smooth(scene: mi.Scene, si: mi.SurfaceInteraction3f, distance: mi.Float, pupil: float) -> mi.Float:
    """How far surfaces' glossy light is taken to come from its image, 1, rather than from themselves, 0."""
    lobe, density, _ = SpecularLobes(scene).glossy(si, si.is_valid())
    return _narrow(lobe, density, distance, pupil)


def _narrow(lobe, density, distance, pupil):
    """The same for lobes seen at a distance in metres, of a density along their middle, by a pupil of this radius."""
    # a lobe of constant density over a cap of half-angle a has a = 1 / sqrt(pi density)
    turn = 2 * pupil / distance * dr.sqrt(math.pi * density) / lobe.eta
    x = dr.clip(dr.log(dr.maximum(turn, 1e-6) / NARROW[0]) / math.log(NARROW[1] / NARROW[0]), 0, 1)
    return x * x * (3 - 2 * x)


def lit(scene, hit, sky):
    """Whether there is anything to see: a surface, or beyond all surfaces an environment, where `sky` allows."""
    return hit if scene.environment() is None else hit | sky
