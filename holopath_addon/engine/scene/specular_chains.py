"""Coherent chains: what a ray meets through mirrors and clear surfaces (stages s4 and s6 of the paper)."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from .differentials import after_hit, crossing, start
from .lobes import SpecularLobes
from .rays import ImagePoint, intersect

if TYPE_CHECKING:
    from ..camera import Camera
    from ..plan import Plan

NARROW = (
    1.5,
    8.0,
)  # widths of a lobe that the view turns across the pupil, from which and up to which it is one
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
        exists = _lit(scene, hit, self.sky)
        return ImagePoint(
            surface.t,
            hit,
            ray,
            surface,
            exists,
            mi.UInt32(0),
            None,
            mi.Bool(True),
            surface.t,
            mi.Float(0),
            mi.Color3f(1),
            surface.t,
            mi.UInt32(0),
            mi.Bool(False),
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


@dataclass
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
    surface: mi.PreliminaryIntersection3f
    share: mi.Float
    own: mi.Float
    own_path: mi.Float
    colour: mi.Color3f
    gloss: mi.Float
    rest: mi.Bool

    @classmethod
    def none(cls, ray):
        """Before the first."""
        nowhere = dr.zeros(mi.PreliminaryIntersection3f)
        one, zero = mi.Float(1), mi.Float(0)
        return cls(mi.Ray3f(ray), nowhere, one, zero, mi.Float(0), mi.Color3f(1), mi.Float(1), mi.Bool(True))

    def over(self, where, coated, narrow, ray, surface, place, path, albedo):
        """Go over one more: light comes from its image as far as its lobe is `narrow`, if no branch is for the rest."""
        first = where & ~self.surface.is_valid()
        near = dr.select(coated, 0, self.share * (1 - narrow))
        return _Rough(
            dr.select(first, ray, self.ray),
            dr.select(first, surface, self.surface),
            dr.select(where & ~coated, self.share * narrow, self.share),
            dr.select(where, self.own + near / place, self.own),
            dr.select(where, self.own_path + near / path, self.own_path),
            dr.select(first, dr.maximum(albedo, LEAST_ALBEDO), self.colour),
            self.gloss,
            self.rest & ~(first & coated),
        )


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
        """The `ImagePoint` of a branch along a ray; of one `drawn` at random, bits that divide nothing do not count."""
        met = intersect(scene, ray, self.coherent)
        chain = self._follow(scene, ray, met, branch)
        last, surface, ahead, weight, length, index, hits, splits, whole, ended, straight, moves, rough = (
            chain
        )
        hit = surface.is_valid()
        # a chain that was cut off, or whose light is zero, shows nothing
        cut = ~ended
        if self.pupil:
            ended |= rough.surface.is_valid()
        exists = ended & (drawn | ((branch >> splits) == 0)) & dr.any(weight > 0)
        path = length + index * dr.select(hit, surface.t + ahead, dr.inf)
        distance = self._distance(moves, last, surface.t + ahead, hit, hits, path)
        taken, colour, image, parts = branch & ((1 << splits) - 1), mi.Color3f(1), mi.Float(0), None
        if self.pupil:
            nearly = rough.surface.is_valid()
            # where nothing is mirrored there is no image either
            distance = dr.select(nearly & ~_lit(scene, hit, self.sky), dr.inf, distance)
            distance, path = (
                dr.rcp(rough.own + rough.share / distance),
                dr.rcp(rough.own_path + rough.share / path),
            )
            last, surface = dr.select(nearly, rough.ray, last), dr.select(nearly, rough.surface, surface)
            hit |= nearly
            colour, weight = rough.colour, weight * rough.colour
            image = dr.select(nearly, rough.share, 1 - rough.gloss)
            if self.lobes.coated:
                parts = rough.gloss, rough.rest
        exists &= _lit(scene, hit, self.sky | ~straight)
        return ImagePoint(
            distance,
            dr.isfinite(distance),
            last,
            surface,
            exists,
            taken,
            weight,
            whole,
            path,
            image,
            colour,
            met.t,
            hits,
            cut,
            parts,
        )

    def _distance(self, moves, last, reach, hit, hits, path):
        """Distance of the image of a point, `reach` beyond the last surface, where there is one."""
        if not self.curvature:
            return path
        return dr.select(hits > 0, crossing(moves, last, dr.select(hit, reach, FAR)), path)

    def _follow(self, scene, ray, met, branch):
        """The chain: last piece, what it meets, how far from the last surface it starts, the radiance's share, the
        optical length before and the index on it, hits, splits, whether P shows all its light, whether there is a
        P, whether the ray was never bent, and ray differentials.
        """
        state = (
            mi.Ray3f(ray),
            mi.PreliminaryIntersection3f(met),
            mi.Float(0),
            mi.Color3f(1),
            mi.Float(0),
            mi.Float(1),
            mi.UInt32(0),
            mi.UInt32(0),
            mi.Bool(True),
            mi.Bool(False),
            mi.Bool(True),
            start(ray) if self.curvature else [],
            _Rough.none(ray) if self.pupil else None,
            mi.Bool(True),
        )

        def body(
            ray,
            surface,
            ahead,
            weight,
            length,
            index,
            hits,
            splits,
            whole,
            ended,
            straight,
            moves,
            rough,
            active,
        ):
            si = surface.compute_surface_interaction(ray, mi.RayFlags.All, active)
            scatters, reflected, transmitted = self.lobes.at(si, active & si.is_valid())
            free, parts = (splits < self.splits) & (hits < self.most_hits), None
            if self.pupil:
                free &= ~rough.surface.is_valid()
                lobe, density, coated = self.lobes.glossy(si, active & si.is_valid())
                path = length + index * (surface.t + ahead)
                narrow = _narrow(lobe, density, path, self.pupil)
                place = self._distance(moves, ray, surface.t + ahead, mi.Bool(True), hits, path)
                over = narrow > 0
                parts = over & coated & free
                over &= ~coated | (parts & (((branch >> splits) & 1) == 1))
                rough = rough.over(over, coated, narrow, ray, surface, place, path, lobe.weight)
                rough.gloss = dr.select(parts & ~over, 1 - narrow, rough.gloss)
                weight = dr.select(over & coated, weight * narrow, weight)
                scatters &= ~over | coated
                through = over & (dr.dot(lobe.direction, si.n) * dr.dot(ray.d, si.n) > 0)
                lobe.weight = mi.Color3f(1)
                reflected = dr.select(over & ~through, lobe, reflected)
                transmitted = dr.select(over & through, lobe, transmitted)
            leaves = reflected.exists | transmitted.exists
            if parts is not None:
                leaves |= parts
            # stay at P, or go on
            dividing = active & leaves & scatters
            stays = ~leaves | (scatters & (~free | (((branch >> splits) & 1) == 0)))
            whole &= ~(dividing & free & stays)
            splits = dr.select(dividing & free, splits + 1, splits)
            ended |= active & stays
            active &= ~stays & (hits < self.most_hits)
            # reflect, or transmit
            both = active & reflected.exists & transmitted.exists
            free &= splits < self.splits
            stronger = dr.max(transmitted.weight) > dr.max(reflected.weight)
            through = dr.select(both & free, ((branch >> splits) & 1) == 1, stronger)
            splits = dr.select(both & free, splits + 1, splits)
            # beyond a rough surface the chain is only followed to where the image lies
            counts = active & ~rough.surface.is_valid() if self.pupil else active
            weight = dr.select(
                counts, weight * dr.select(through, transmitted.weight, reflected.weight), weight
            )
            if self.curvature:
                after = after_hit(moves, ray, surface, ahead, ~through, transmitted.eta, active)
                moves = [
                    (dr.select(active, point, old_point), dr.select(active, turn, old_turn))
                    for (point, turn), (old_point, old_turn) in zip(after, moves, strict=True)
                ]
            length = dr.select(active, length + (surface.t + ahead) * index, length)
            if self.lobes.refracts:
                index = dr.select(active & through, index * transmitted.eta, index)
            hits = dr.select(active, hits + 1, hits)
            straight &= ~active | (through & (transmitted.eta == 1))
            direction = dr.select(through, transmitted.direction, reflected.direction)
            # Mitsuba lets rays start a little off the surface, too much for lenses
            onward = si.spawn_ray(direction)
            ahead = dr.select(active, dr.dot(onward.o - si.p, direction), ahead)
            ray = dr.select(active, onward, ray)
            surface = dr.select(active, intersect(scene, ray, False, active), surface)
            return (
                ray,
                surface,
                ahead,
                weight,
                length,
                index,
                hits,
                splits,
                whole,
                ended,
                straight,
                moves,
                rough,
                active,
            )

        return dr.while_loop(state, lambda *s: s[-1], body, label="specular chain")[:-1]


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


def _lit(scene, hit, sky):
    """Whether there is anything to see: a surface, or beyond all surfaces an environment, where `sky` allows."""
    return hit if scene.environment() is None else hit | sky
