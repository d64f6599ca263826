"""Rays of hologram space as rays of the world (stages s1 to s3 and s6 of the paper)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..slabs import EVERYWHERE, Slab
from .buffers import constant

if TYPE_CHECKING:
    from ..camera import Camera
    from ..hologram import Hologram
    from ..mapping import DepthMapping

# Rays that Embree may intersect as one, at most: what it finds depends, in the last bit, on which are together.
PACKET = 64
OUTSIDE, LEAST_RAMP = 1e6, 1e-9  # metres: stand for infinity and for nothing
STEEPEST = 8.0  # slope in hologram space: planes that are seen from their edge


@dataclass(kw_only=True)
class ImagePoint:
    """The image point that a ray sees (Dr.Jit types).

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
    aside : mitsuba.UInt32
        Bits of the choices, the first one's last, at which the branch took the way that is mostly the weaker one.
    weight : mitsuba.Color3f or None
        Share of the radiance that comes through; None for all of it.
    whole : mitsuba.Bool
        Whether P shows all its light; otherwise its δ lobes are left to other branches.
    path : mitsuba.Float
        The distance if images lay at the optical path length, metres.
    image : mitsuba.Float
        How far glossy light is taken to come from its image, 1, rather than from the surface itself, 0.
    colour : mitsuba.Color3f
        Part of `weight` that P's radiance has too, and is to be divided by.
    first : mitsuba.Float
        Along the ray to the first surface, metres.
    hits : mitsuba.UInt32
        Mirrors and clear surfaces on the way.
    cut : mitsuba.Bool
        Whether the chain goes on beyond the hits that are followed.
    parts : (mitsuba.Float, mitsuba.Bool) or None
        Share of P's glossy light, and whether its other light, that this branch shows; None for all.
    """

    distance: mi.Float
    hit: mi.Bool
    ray: mi.Ray3f
    surface: mi.PreliminaryIntersection3f
    exists: mi.Bool
    branch: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    aside: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    weight: mi.Color3f | None = None
    whole: mi.Bool = field(default_factory=lambda: mi.Bool(True))
    path: mi.Float
    image: mi.Float = field(default_factory=lambda: mi.Float(0))
    colour: mi.Color3f = field(default_factory=lambda: mi.Color3f(1))
    first: mi.Float
    hits: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    cut: mi.Bool = field(default_factory=lambda: mi.Bool(False))
    parts: tuple[mi.Float, mi.Bool] | None = None


class Rays:
    """Rays of hologram space as rays of the world, and depths back (s1, s2, s6).

    Parameters
    ----------
    hologram : Hologram
    camera : Camera
    mapping : DepthMapping
    plane : float
        z of the recording plane, metres.
    limit : float
        Image points farther from the plane than this, metres, are taken to be at this distance.
    slab : Slab
        First surfaces that are seen.
    images : Slab
        What is recorded of what they show.
    """

    def __init__(
        self,
        hologram: Hologram,
        camera: Camera,
        mapping: DepthMapping,
        plane: float,
        limit: float = math.inf,
        slab: Slab = EVERYWHERE,
        images: Slab = EVERYWHERE,
    ) -> None:
        far, near = (z - mapping.z_far for z in (slab.far[0], slab.near[1]))
        start = max(camera.clip_start, mapping.beta / near)
        end = min(camera.clip_end, mapping.beta / far if far > 0 else math.inf)
        # no literals: one program for all displays, depth ranges and scenes alike
        opaque = partial(dr.opaque, mi.Float)
        self.plane, self.limit = opaque(plane), opaque(limit)
        self.start, self.pitch = opaque(start), opaque(hologram.pitch)
        self._to_far, self._beta = opaque(mapping.z_far - plane), opaque(mapping.beta)
        self._spread, self._per_focal = opaque(mapping.beta / mapping.focal), opaque(1 / mapping.focal)
        self._reach = opaque(end - start) if math.isfinite(end) else None
        self._ramps = [_ramps(which, plane) for which in (slab, images)]
        self._middle = constant(mi.Point2f, (0.5 * (hologram.width - 1), 0.5 * (hologram.height - 1)))
        self._centre = constant(mi.Point2f, (mapping.center_x, mapping.center_y))
        self.position = constant(mi.Point3f, camera.position)
        self.right, self.up, self.forward = (constant(mi.Vector3f, axis) for axis in camera.axes)

    def place(self, column: mi.Float, row: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Hologram coordinates in metres of (fractional) pixel indices; row 0 is the top."""
        return (column - self._middle.x) * self.pitch, (self._middle.y - row) * self.pitch

    def world(
        self, x: mi.Float, y: mi.Float, slope_x: mi.Float | float, slope_y: mi.Float | float
    ) -> tuple[mi.Ray3f, mi.Float]:
        """The world ray through (x, y) of the recording plane with the given slopes, and depth per distance."""
        tan_x = (x + slope_x * self._to_far) * self._per_focal + self._centre.x
        tan_y = (y + slope_y * self._to_far) * self._per_focal + self._centre.y
        direction = self.forward + tan_x * self.right + tan_y * self.up
        origin = self.position + (slope_x * self._spread) * self.right + (slope_y * self._spread) * self.up
        depth_rate = dr.rsqrt(dr.squared_norm(direction))
        ray = mi.Ray3f(origin + self.start * direction, direction * depth_rate)
        if self._reach is not None:
            ray.maxt = self._reach / depth_rate
        return ray, depth_rate

    def height_over_plane(self, distance: mi.Float, depth_rate: mi.Float, hit: mi.Bool) -> mi.Float:
        """dz = z_Q - z_p of a hit after `distance` along the ray; the far end where nothing was hit."""
        depth = self.start + distance * depth_rate
        return self._to_far + dr.select(hit, self._beta / depth, 0)

    def within(self, dz: mi.Float) -> mi.Float:
        """The distance from the plane up to which its directions tell grains apart."""
        return dr.clip(dz, -self.limit, self.limit)

    def share(self, first: mi.Float, dz: mi.Float) -> mi.Float | None:
        """Share that this plane has of the amplitude of what lies at dz, behind a surface at `first`, both from the
        plane, see `Slab`; None for all of it.
        """
        shares = [_within(ramps, at) for ramps, at in zip(self._ramps, (first, dz), strict=True) if ramps]
        return math.prod(shares[1:], start=shares[0]) if shares else None

    def tilt(self, seen: ImagePoint) -> tuple[mi.Float, mi.Float]:
        """Slopes (dz/dx, dz/dy) in hologram space of the plane that a surface goes on as; 0 of images and the sky.

        Planes n (P - position) = h stay planes: with P - position = D (x right + y up) / F + D forward, 1/D and with it
        z = z_far + beta / D are linear in x and y.
        """
        direct = seen.hit & (seen.hits == 0)
        point = seen.surface.compute_surface_interaction(seen.ray, mi.RayFlags.Minimal, direct)
        per_height = self._spread / dr.dot(point.n, point.p - self.position)
        slopes = [dr.dot(point.n, axis) * per_height for axis in (self.right, self.up)]
        # triangles too small for single precision have no normal
        return tuple(
            dr.select(direct & dr.isfinite(slope), dr.clip(slope, -STEEPEST, STEEPEST), 0) for slope in slopes
        )


def _ramps(slab, plane):
    """Begin and steepness of a slab's two ramps, from the plane; None where it has no ends."""
    if not slab.bounded:
        return None
    ends = (np.clip(ramp, -OUTSIDE, OUTSIDE) for ramp in (slab.far, slab.near))
    return [
        [dr.opaque(mi.Float, number) for number in (first - plane, 1 / max(last - first, LEAST_RAMP))]
        for first, last in ends
    ]


def _within(ramps, dz):
    """Share of a slab at a distance from its plane."""
    (far, far_scale), (near, near_scale) = ramps
    return _smooth((dz - far) * far_scale) * (1 - _smooth((dz - near) * near_scale))


def _smooth(x):
    """From 0 at 0 to 1 at 1."""
    x = dr.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def intersect(
    scene: mi.Scene, ray: mi.Ray3f, coherent: bool, active: mi.Bool | bool = True
) -> mi.PreliminaryIntersection3f:
    """The first surface along a ray (s3); `coherent` traces neighbouring rays in packets."""
    return scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
