"""Coherent chains: what a ray meets through mirrors and clear surfaces (stages s4 and s6 of the paper)."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .differentials import after_hit, crossing, start
from .lobes import SpecularLobes
from .rays import intersect

SPLITS = 2  # hits of a chain at which more than one way on is followed
FAR = 1e4  # metres: stands for infinity where a ray leaves the scene


@dataclass
class View:
    """What a ray sees (Dr.Jit types).

    Attributes
    ----------
    distance : mitsuba.Float
        Along the ray to the image point, metres; negative for an image behind the viewer.
    hit : mitsuba.Bool
        Whether the image point is at a finite distance; the environment is not, but for curved mirrors and lenses.
    ray : mitsuba.Ray3f
        The last piece, on which the real image point P lies.
    surface : mitsuba.PreliminaryIntersection3f
        Where it meets P.
    exists : mitsuba.Bool
        Whether the ray sees anything, in the branch asked for.
    branch : mitsuba.UInt32
        Number of the branch taken.
    weight : mitsuba.Color3f or None
        Share of the radiance that comes through; None for all of it.
    whole : mitsuba.Bool
        Whether P shows all its light; otherwise its δ lobes are left to other branches.
    path : mitsuba.Float
        Optical path length to P, metres.
    """

    distance: object
    hit: object
    ray: object
    surface: object
    exists: object
    branch: object
    weight: object
    whole: object
    path: object


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

    def __init__(self, coherent=True, sky=True):
        self.coherent, self.sky = coherent, sky

    def view(self, scene, ray, branch):
        """The `View` along a ray."""
        surface = intersect(scene, ray, self.coherent)
        hit = surface.is_valid()
        exists = _lit(scene, hit, self.sky)
        return View(surface.t, hit, ray, surface, exists, mi.UInt32(0), None, mi.Bool(True), surface.t)


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

    def __init__(self, scene, virtual_image, most_hits, splits=SPLITS, coherent=True, sky=True):
        self.lobes = SpecularLobes(scene)
        self.curvature, self.most_hits, self.splits = virtual_image == "curvature", most_hits, splits
        self.branches, self.coherent, self.sky = 1 << splits, coherent, sky

    def view(self, scene, ray, branch):
        """The `View` of a branch along a ray."""
        chain = self._follow(scene, ray, branch)
        last, surface, ahead, weight, length, index, hits, splits, whole, ended, straight, moves = chain
        hit = surface.is_valid()
        # a chain that was cut off, or whose light is zero, shows nothing
        exists = ended & ((branch >> splits) == 0) & dr.any(weight > 0)
        reach = surface.t + ahead
        path = length + index * dr.select(hit, reach, dr.inf)
        distance = path
        if self.curvature:
            image = crossing(moves, last, dr.select(hit, reach, FAR))
            distance = dr.select(hits > 0, image, path)
        taken = branch & ((1 << splits) - 1)
        exists &= _lit(scene, hit, self.sky | ~straight)
        return View(distance, dr.isfinite(distance), last, surface, exists, taken, weight, whole, path)

    def _follow(self, scene, ray, branch):
        """The chain: last piece, what it meets, how far from the last surface it starts, the radiance's share, the
        optical length before and the index on it, hits, splits, whether P shows all its light, whether there is a
        P, whether the ray was never bent, and ray differentials.
        """
        state = (
            mi.Ray3f(ray),
            intersect(scene, ray, self.coherent),
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
            mi.Bool(True),
        )

        def body(
            ray, surface, ahead, weight, length, index, hits, splits, whole, ended, straight, moves, active
        ):
            si = surface.compute_surface_interaction(ray, mi.RayFlags.All, active)
            scatters, reflected, transmitted = self.lobes.at(si, active & si.is_valid())
            leaves = reflected.exists | transmitted.exists
            # stay at P, or go on
            dividing = active & leaves & scatters
            free = (splits < self.splits) & (hits < self.most_hits)
            stays = ~leaves | (scatters & (~free | (((branch >> splits) & 1) == 0)))
            whole &= ~(dividing & free & stays)
            splits = dr.select(dividing & free, splits + 1, splits)
            ended |= active & stays
            active &= ~stays & (hits < self.most_hits)
            # reflect, or transmit
            both = active & reflected.exists & transmitted.exists
            free = splits < self.splits
            stronger = dr.max(transmitted.weight) > dr.max(reflected.weight)
            through = dr.select(both & free, ((branch >> splits) & 1) == 1, stronger)
            splits = dr.select(both & free, splits + 1, splits)
            weight = dr.select(
                active, weight * dr.select(through, transmitted.weight, reflected.weight), weight
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
                active,
            )

        return dr.while_loop(state, lambda *s: s[-1], body, label="specular chain")[:-1]


def _lit(scene, hit, sky):
    """Whether there is anything to see: a surface, or beyond all surfaces an environment, where `sky` allows."""
    return hit if scene.environment() is None else hit | sky
