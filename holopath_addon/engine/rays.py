"""Rays of hologram space as rays of the world (stages s1 to s3 and s6 of the paper)."""

import math

import drjit as dr
import mitsuba as mi


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
    """

    def __init__(self, hologram, camera, mapping, plane, limit=math.inf):
        self.limit = limit
        self.width, self.height, self.pitch = hologram.width, hologram.height, hologram.pitch
        self.mapping = mapping
        self.to_far = mapping.z_far - plane
        self.position = mi.Point3f(*map(float, camera.position))
        self.right, self.up, self.forward = (mi.Vector3f(*map(float, axis)) for axis in camera.axes)
        self.clip_start = camera.clip_start

    def place(self, column, row):
        """Hologram coordinates in metres of (fractional) pixel indices; row 0 is the top."""
        return ((column - 0.5 * (self.width - 1)) * self.pitch, (0.5 * (self.height - 1) - row) * self.pitch)

    def world(self, x, y, slope_x, slope_y):
        """The world ray through (x, y) of the recording plane with the given slopes, and depth per distance."""
        mapping = self.mapping
        spread = mapping.beta / mapping.focal
        tan_x = (x + slope_x * self.to_far) / mapping.focal + mapping.centre_x
        tan_y = (y + slope_y * self.to_far) / mapping.focal + mapping.centre_y
        direction = self.forward + tan_x * self.right + tan_y * self.up
        origin = self.position + (slope_x * spread) * self.right + (slope_y * spread) * self.up
        depth_rate = dr.rsqrt(dr.squared_norm(direction))
        return mi.Ray3f(origin + self.clip_start * direction, direction * depth_rate), depth_rate

    def height_over_plane(self, distance, depth_rate, hit):
        """dz = z_Q - z_p of a hit after `distance` along the ray; the far end where nothing was hit."""
        depth = self.clip_start + distance * depth_rate
        return dr.clip(self.to_far + dr.select(hit, self.mapping.beta / depth, 0), -self.limit, self.limit)


def intersect(scene, ray):
    """Distance to the first surface and whether there is one (s3)."""
    hit = scene.ray_intersect_preliminary(ray, coherent=True)
    return hit.t, hit.is_valid()
