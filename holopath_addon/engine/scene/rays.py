"""Rays of hologram space in the world (stages s1 to s3 and s6 of the paper)."""

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

# Maximum rays that Embree intersects together: hits depend, in the last bit, on the other rays of a packet.
PACKET = 64
OUTSIDE, MIN_RAMP = 1e6, 1e-9  # meters: stand for infinity and for zero
MAX_TILT = 8.0  # maximum slope of surfaces in hologram space: planes seen edge-on


@dataclass(kw_only=True)
class ImagePoint:
    """Image point that a ray leads to (Dr.Jit types).

    Attributes
    ----------
    distance : mitsuba.Float
        Distance of the image point along the ray, meters; negative for an image behind the viewer.
    hit : mitsuba.Bool
        Whether the distance is finite; that of the environment is infinite, except in curved mirrors and lenses.
    ray : mitsuba.Ray3f
        Last segment, on which the real image point P lies.
    surface : mitsuba.PreliminaryIntersection3f
        Intersection of the last segment at P.
    exists : mitsuba.Bool
        Whether there is a surface or environment in the requested branch.
    branch : mitsuba.UInt32
        Number of the branch, without unused bits.
    aside : mitsuba.UInt32
        Bits of the choices, that of the first one last, at which the branch followed the usually weaker lobe.
    weight : mitsuba.Color3f or None
        Fraction of the radiance that is transmitted by the chain; None for all of it.
    whole : mitsuba.Bool
        Whether P shows all its light; otherwise its δ lobes belong to other branches.
    path : mitsuba.Float
        Distance of the image by the optical path length, meters.
    image : mitsuba.Float
        Weight of the image of glossy light in its distance, 1, against that of the surface itself, 0.
    color : mitsuba.Color3f
        Part of `weight` that P's radiance contains, too, and has to be divided by.
    first : mitsuba.Float
        Distance of the first surface along the ray, meters.
    hits : mitsuba.UInt32
        Mirrors and clear surfaces of the chain.
    cut : mitsuba.Bool
        Whether the chain was cut off at the maximum number of hits.
    parts : (mitsuba.Float, mitsuba.Bool) or None
        Fraction of P's glossy light, and whether its other light, that this branch shows; None for all.
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
    color: mi.Color3f = field(default_factory=lambda: mi.Color3f(1))
    first: mi.Float
    hits: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))
    cut: mi.Bool = field(default_factory=lambda: mi.Bool(False))
    parts: tuple[mi.Float, mi.Bool] | None = None


class Rays:
    """Transform of rays from hologram space to the world, and of depths back (s1, s2, s6).

    Parameters
    ----------
    hologram : Hologram
    camera : Camera
    mapping : DepthMapping
    plane : float
        z of the recording plane, meters.
    limit : float
        Maximum distance of image points from the plane, meters; farther ones are clipped to it.
    slab : Slab
        Depths of the first surfaces that the plane records.
    images : Slab
        Depths of the images in them that the plane records.
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
        # opaque numbers, not literals: one compiled program for all displays, depth ranges and scenes
        opaque = partial(dr.opaque, mi.Float)
        self.plane, self.limit = opaque(plane), opaque(limit)
        self.start, self.pitch = opaque(start), opaque(hologram.pitch)
        self._to_far, self._beta = opaque(mapping.z_far - plane), opaque(mapping.beta)
        self._spread, self._per_focal = opaque(mapping.beta / mapping.focal), opaque(1 / mapping.focal)
        self._reach = opaque(end - start) if math.isfinite(end) else None
        self._ramps = [_ramps(which, plane) for which in (slab, images)]
        self._middle = constant(mi.Point2f, (0.5 * (hologram.width - 1), 0.5 * (hologram.height - 1)))
        self._center = constant(mi.Point2f, (mapping.center_x, mapping.center_y))
        self.position = constant(mi.Point3f, camera.position)
        self.right, self.up, self.forward = (constant(mi.Vector3f, axis) for axis in camera.axes)

    def place(self, column: mi.Float, row: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Hologram coordinates, meters, of (fractional) pixel indices; row 0 is the top."""
        return (column - self._middle.x) * self.pitch, (self._middle.y - row) * self.pitch

    def world(
        self, x: mi.Float, y: mi.Float, slope_x: mi.Float | float, slope_y: mi.Float | float
    ) -> tuple[mi.Ray3f, mi.Float]:
        """Transform a ray of hologram space to the world.

        Parameters
        ----------
        x, y : mitsuba.Float
            Place on the recording plane, meters.
        slope_x, slope_y : mitsuba.Float or float
            Slopes dx/dz and dy/dz in hologram space.

        Returns
        -------
        ray : mitsuba.Ray3f
        depth_rate : mitsuba.Float
            World depth per distance along the ray.
        """
        tan_x = (x + slope_x * self._to_far) * self._per_focal + self._center.x
        tan_y = (y + slope_y * self._to_far) * self._per_focal + self._center.y
        direction = self.forward + tan_x * self.right + tan_y * self.up
        origin = self.position + (slope_x * self._spread) * self.right + (slope_y * self._spread) * self.up
        depth_rate = dr.rsqrt(dr.squared_norm(direction))
        ray = mi.Ray3f(origin + self.start * direction, direction * depth_rate)
        if self._reach is not None:
            ray.maxt = self._reach / depth_rate
        return ray, depth_rate

    def height_over_plane(self, distance: mi.Float, depth_rate: mi.Float, hit: mi.Bool) -> mi.Float:
        """Height dz = z_Q - z_p of a hit at a distance along the ray, meters; that of the far end without a hit.

        `depth_rate` is that of `world`.
        """
        depth = self.start + distance * depth_rate
        return self._to_far + dr.select(hit, self._beta / depth, 0)

    def within(self, dz: mi.Float) -> mi.Float:
        """Clip a height dz to the limit, up to which the plane's directions resolve grains."""
        return dr.clip(dz, -self.limit, self.limit)

    def weight(self, first: mi.Float, dz: mi.Float) -> mi.Float | None:
        """Fraction of an amplitude that this plane records, see `Slab`; None for all of it.

        Parameters
        ----------
        first, dz : mitsuba.Float
            Heights over the plane of the first surface and of the image point, meters.
        """
        weights = [_within(ramps, at) for ramps, at in zip(self._ramps, (first, dz), strict=True) if ramps]
        return math.prod(weights[1:], start=weights[0]) if weights else None

    def tilt(self, point: ImagePoint) -> tuple[mi.Float, mi.Float]:
        """Slopes (dz/dx, dz/dy) in hologram space of the tangent plane at an image point; 0 of images and the sky.

        Planes n (P - position) = h stay planes: with P - position = D (x right + y up) / F + D forward, 1/D and with it
        z = z_far + beta / D are linear in x and y.
        """
        direct = point.hit & (point.hits == 0)
        si = point.surface.compute_surface_interaction(point.ray, mi.RayFlags.Minimal, direct)
        per_height = self._spread / dr.dot(si.n, si.p - self.position)
        slopes = [dr.dot(si.n, axis) * per_height for axis in (self.right, self.up)]
        # triangles too small for single precision have no normal
        return tuple(
            dr.select(direct & dr.isfinite(slope), dr.clip(slope, -MAX_TILT, MAX_TILT), 0) for slope in slopes
        )


def _ramps(slab, plane):
    """Start of a slab's two ramps over the plane, and their steepness; None if the slab has no ends."""
    if not slab.bounded:
        return None
    ends = (np.clip(ramp, -OUTSIDE, OUTSIDE) for ramp in (slab.far, slab.near))
    return [
        [dr.opaque(mi.Float, number) for number in (first - plane, 1 / max(last - first, MIN_RAMP))]
        for first, last in ends
    ]


def _within(ramps, dz):
    """Weight of a slab at a height over its plane."""
    (far, far_scale), (near, near_scale) = ramps
    return _smooth((dz - far) * far_scale) * (1 - _smooth((dz - near) * near_scale))


def _smooth(x):
    """Smooth step from 0 at 0 to 1 at 1."""
    x = dr.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def intersect(
    scene: mi.Scene, ray: mi.Ray3f, coherent: bool, active: mi.Bool | bool = True
) -> mi.PreliminaryIntersection3f:
    """Find the first surface along a ray (s3); `coherent` traces neighboring rays in packets."""
    return scene.ray_intersect_preliminary(ray, coherent=coherent, active=active)
