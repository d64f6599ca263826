"""Emitter types ``point_lamp``, ``area_lamp`` and ``sun_lamp``: Blender's lights, which have a size but no surface.

Blender's lights are invisible to the camera and to other light, and occlude nothing. Mitsuba's invisible emitters are
points and directions without extent. These are, too, for a path tracer (``delta``: no ray meets them, so they need no
multiple importance sampling), but each sample takes another point of the extent, so that shadows are soft.

The models are those of Blender's renderer Cycles. Lengths are meters; ``to_world`` places the light, which shines
along its own -z. ``profile``, if given, is a tensor [v, u, 3] of factors over the direction in which light leaves,
in the light's own frame without scale: rows at equal angles from +z (top) to -z, columns at equal azimuths from +x
through +y, each value in the middle of its cell. ``falloff`` multiplies the light by this power of the distance in
``unit``: 1 makes it fall off linearly, 2 not at all.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from .buffers import constant
from .fingerprint import text_of_properties

MIN_SPREAD = 1e-3  # minimum half spread of an area light, radians: its light is parallel below that
SUN_DISTANCE = 1e8  # meters, beyond any scene
EDGE = 1e-7  # width of a sharp spot's edge, in the cosine
MIN_DISTANCE = 1e-12  # meters: distances from a light below this count as this


class Lamp(mi.Emitter):
    """Base class of the lights; `_reach` samples a point of the extent."""

    def __init__(self, props):
        super().__init__(props)
        self.settings = text_of_properties(props)
        self.m_flags = mi.EmitterFlags.DeltaPosition
        matrix = np.array(props["to_world"].matrix)
        axes = matrix[:3, :3].T
        self.center = constant(mi.Vector3f, matrix[:3, 3])
        self.axes = [constant(mi.Vector3f, axis / np.linalg.norm(axis)) for axis in axes]
        self.cone_axes = [constant(mi.Vector3f, axis / np.dot(axis, axis)) for axis in axes]
        self.profile = _directional(props["profile"]) if "profile" in props else None
        self.falloff = props.get("falloff", 0)
        self.unit = dr.opaque(mi.Float, props.get("unit", 1.0))

    def _reach(self, place, sample):
        raise NotImplementedError

    def sample_direction(self, it, sample, active=True):
        offset, strength = self._reach(it.p, sample)
        distance = dr.maximum(dr.norm(offset), MIN_DISTANCE)
        direction = offset / distance
        if self.profile is not None:
            local = mi.Vector3f(*(-dr.dot(direction, axis) for axis in self.axes))
            strength = strength * self.profile(local)
        if self.falloff:
            strength = strength * (distance / self.unit) ** self.falloff
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p, ds.d, ds.dist, ds.n = it.p + offset, direction, distance, mi.Normal3f(-direction)
        ds.pdf, ds.delta, ds.time = mi.Float(1), mi.Bool(True), it.time
        ds.emitter = mi.EmitterPtr(self)
        return ds, dr.select(active, strength, 0)

    def pdf_direction(self, it, ds, active=True):
        return mi.Float(0)

    def eval_direction(self, it, ds, active=True):
        return mi.Color3f(0)

    def eval(self, si, active=True):
        return mi.Color3f(0)

    def bbox(self):
        return mi.ScalarBoundingBox3f()

    def traverse(self, callback):
        pass

    def to_string(self):
        return f"{type(self).__name__}[{self.settings}]"


class PointLamp(Lamp):
    """Disk of ``radius`` that faces every point it lights, or with ``sphere`` a sphere of uniform radiance.

    Parameters are ``intensity`` (from afar, W/sr, by channel), ``radius``, ``sphere``, and for a spot ``cone``,
    the half-angle, and ``blend``, the fraction of 1 - cos(cone) over which its edge is smooth; the scale of
    ``to_world`` makes the cone elliptic.
    """

    def __init__(self, props):
        super().__init__(props)
        self.intensity = constant(mi.Color3f, props["intensity"])
        radius = props.get("radius", 0.0)
        self.radius, self.sphere = dr.opaque(mi.Float, radius), props.get("sphere", False) and radius > 0
        self.spot = "cone" in props
        if self.spot:
            cosine = math.cos(props["cone"])
            self.edge = dr.opaque(mi.Float, cosine)
            self.rise = dr.opaque(mi.Float, 1 / max((1 - cosine) * props.get("blend", 0.0), EDGE))

    def _reach(self, p, sample):
        inwards = self.center - p
        squared = dr.maximum(dr.squared_norm(inwards), MIN_DISTANCE**2)
        frame = mi.Frame3f(inwards * dr.rsqrt(squared))
        if not self.sphere:
            disk = self.radius * mi.warp.square_to_uniform_disk_concentric(sample)
            offset = inwards + disk.x * frame.s + disk.y * frame.t
            distance = dr.sqrt(squared + dr.squared_norm(disk))
            # radiance I / (pi r^2) times area pi r^2 times cosine over squared distance
            return offset, self.intensity * (self._through(-offset) * dr.sqrt(squared) / distance**3)
        r2 = self.radius**2
        outside = squared > r2
        sine2 = dr.minimum(r2 / squared, 1)
        lost = dr.select(outside, sine2 / (1 + dr.sqrt(1 - sine2)), 2)  # 1 - cos of the cone it fills
        local = _cone(sample, lost)
        half_chord = dr.sqrt(dr.maximum(r2 - squared * (local.x**2 + local.y**2), 0))
        along = local.z * dr.sqrt(squared) - dr.select(outside, half_chord, -half_chord)
        direction = frame.to_world(local)
        passing = dr.select(outside, self._through(-direction), 1)
        return along * direction, self.intensity * (2 * lost / r2 * passing)

    def _through(self, leaving):
        """Fraction of the light that a spot emits in a direction, a vector of any length."""
        if not self.spot:
            return mi.Float(1)
        local = dr.normalize(mi.Vector3f(*(dr.dot(leaving, axis) for axis in self.cone_axes)))
        t = dr.clip((-local.z - self.edge) * self.rise, 0, 1)
        return t**2 * (3 - 2 * t)


class AreaLamp(Lamp):
    """Rectangle of ``width`` and ``height`` along x and y, or with ``round`` an ellipse, bright on one side.

    Its ``radiance`` is that of an open rectangle of the same power. With half the ``spread`` below a right angle it
    shines through a grid of slats, with the factor (tan a - tan x) / (tan a - a) at an angle x, where a is half the
    spread (Cycles' model, which preserves the power).
    """

    def __init__(self, props):
        super().__init__(props)
        self.radiance = constant(mi.Color3f, props["radiance"])
        self.half = [dr.opaque(mi.Float, 0.5 * props[side]) for side in ("width", "height")]
        self.round = props.get("round", False)
        self.area = dr.opaque(mi.Float, props["width"] * props["height"] * (math.pi / 4 if self.round else 1))
        limit = max(0.5 * props.get("spread", math.pi), MIN_SPREAD)
        self.slats = limit < math.radians(89.9)
        if self.slats:
            self.limit = dr.opaque(mi.Float, math.tan(limit))
            self.gain = dr.opaque(mi.Float, 1 / (math.tan(limit) - limit))

    def _reach(self, p, sample):
        inwards = self.center - p
        x, y, z = (dr.dot(inwards, axis) for axis in self.axes)  # z: height of p on the bright side
        disk = mi.warp.square_to_uniform_disk_concentric(sample)
        place = disk if self.round else 2 * sample - 1
        place = mi.Point2f(place.x * self.half[0], place.y * self.half[1])
        area, lit = self.area, z > 0
        if self.slats:
            # the smaller of the light and the disk whose light reaches p
            foot, near = mi.Point2f(-x, -y), math.pi * (z * self.limit) ** 2
            place = dr.select(near < area, foot + z * self.limit * disk, place)
            area = dr.minimum(near, area)
            across = mi.Point2f(place.x / self.half[0], place.y / self.half[1])
            size = dr.squared_norm(across) if self.round else dr.max(dr.abs(across))
            tangent = dr.norm(place - foot) / z
            lit &= (size <= 1) & (tangent < self.limit)
            area *= (self.limit - tangent) * self.gain
        offset = inwards + place.x * self.axes[0] + place.y * self.axes[1]
        squared = dr.maximum(dr.squared_norm(offset), MIN_DISTANCE**2)
        return offset, dr.select(lit, self.radiance * (area * z * dr.rsqrt(squared) / squared), 0)


class SunLamp(Lamp):
    """Disk of the sky of half-angle ``radius`` and uniform radiance; ``irradiance`` is its total.

    The irradiance, W/m^2, is integrated over directions without the cosine: L 2 pi (1 - cos(radius)).
    """

    def __init__(self, props):
        super().__init__(props)
        self.irradiance = constant(mi.Color3f, props["irradiance"])
        self.lost = dr.opaque(mi.Float, 2 * math.sin(0.5 * props.get("radius", 0.0)) ** 2)

    def _reach(self, p, sample):
        return SUN_DISTANCE * mi.Frame3f(self.axes[2]).to_world(_cone(sample, self.lost)), self.irradiance


KINDS = {"point_lamp": PointLamp, "area_lamp": AreaLamp, "sun_lamp": SunLamp}
for name, kind in KINDS.items():
    mi.register_emitter(name, kind)


def _cone(sample, lost):
    """Sample a direction uniformly in the cone around +z with cosines down to 1 - `lost`."""
    disk = mi.warp.square_to_uniform_disk_concentric(sample)
    depth = lost * dr.squared_norm(disk)
    aside = dr.sqrt(lost * (2 - depth))
    return mi.Vector3f(aside * disk.x, aside * disk.y, 1 - depth)


def _directional(values):
    """Function that looks up factors [v, u, 3] by a unit vector, bilinearly; u is periodic."""
    values = np.asarray(values, np.float32)
    columns = values.shape[1]
    around = np.concatenate([values[:, -1:], values, values[:, :1]], axis=1)
    # pyrefly: ignore[not-callable]  # missing from Mitsuba's stubs
    texture = mi.Texture2f(mi.TensorXf(around), wrap_mode=dr.WrapMode.Clamp)

    def look_up(direction):
        azimuth = dr.atan2(direction.y, direction.x) / (2 * math.pi)
        u = (dr.select(azimuth < 0, azimuth + 1, azimuth) * columns + 1) / (columns + 2)
        v = dr.safe_acos(direction.z) / math.pi
        return mi.Color3f(*texture.eval(mi.Point2f(u, v)))

    return look_up
