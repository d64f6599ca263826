"""Depths in view, along the camera's axis: of the first surfaces, and of the images that mirrors and glass show."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..scene import variants
from .preview import FARTHEST

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..plan import Plan


def depths_along(scene: mi.Scene, camera: Camera, across: np.ndarray, upward: np.ndarray) -> np.ndarray:
    """Depths of what is hit in some directions.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    across, upward : numpy.ndarray, shape (n,)
        Tangents of the directions from the pupil's center, to the right and up of the camera's axis.

    Returns
    -------
    numpy.ndarray, float32, shape (n,)
        World depths in meters; infinite where there is nothing within the camera's clipping range.
    """
    variants.activate_for(scene)
    # of unit length along the axis, so that distances along the ray are depths
    rays = _rays(*_lines(camera, across, upward))
    depths = np.asarray(scene.ray_intersect_preliminary(rays).t) + np.float32(camera.clip_start)
    return np.where(depths < camera.clip_end, depths, np.float32(math.inf))


def depth_map(scene: mi.Scene, camera: Camera, width: int, height: int) -> np.ndarray:
    """Depth of the first surface at every pixel's center.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    width, height : int
        Pixels, which are square.

    Returns
    -------
    numpy.ndarray, float32, shape (height, width)
        World depths in meters, infinite where there is nothing; row 0 at the top.

    Raises
    ------
    BackendUnavailable
    """
    across, upward = _pixels(camera, width, height)
    return depths_along(scene, camera, across, upward).reshape(height, width)


def image_depth_map(scene: mi.Scene, camera: Camera, plan: Plan, width: int, height: int) -> np.ndarray:
    """Depth at which what is seen at every pixel's center comes into focus, by the plan's own optics.

    That of the surface, but for mirrors and clear surfaces: there it is that of the image that they show, seen from
    the pupil's center. Where several things are seen through each other, the one of the largest share counts.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    plan : Plan
        Of a hologram of this view: how far mirrors and glass are followed.
    width, height : int
        Pixels, which are square.

    Returns
    -------
    numpy.ndarray, float32, shape (height, width)
        World depths in meters, row 0 at the top; infinite where there is nothing or the sky, negative for light that
        converges behind the viewer, as of concave mirrors.

    Raises
    ------
    BackendUnavailable
    """
    variants.activate()
    import drjit as dr
    import mitsuba as mi

    from ..scene.specular_chains import optics_of

    origins, directions = _lines(camera, *_pixels(camera, width, height))
    lengths = np.linalg.norm(directions, axis=0)
    ray = _rays(origins, directions / lengths)
    reach = min(camera.clip_end, FARTHEST) - camera.clip_start
    ray.maxt = mi.Float((reach * lengths).astype(np.float32))
    optics = optics_of(scene, camera, plan)
    most = np.zeros(len(lengths), np.float32)
    depths = np.full(len(lengths), math.inf, np.float32)
    for branch in range(optics.branches):
        seen = optics.view(scene, ray, dr.full(mi.UInt32, branch, len(lengths)))
        share = np.asarray(seen.exists, np.float32) * (
            1 if seen.weight is None else np.asarray(dr.max(seen.weight))
        )
        distance = np.asarray(dr.select(seen.hit, seen.distance, dr.inf))
        larger = share > most
        most = np.where(larger, share, most)
        depths = np.where(larger, camera.clip_start + distance / lengths, depths)
    return depths.astype(np.float32).reshape(height, width)


def _pixels(camera, width, height):
    """Tangents of the directions of the pixels' centers, row by row."""
    pixel = 2 * math.tan(camera.fov_x / 2) / width
    columns = (np.arange(width) - 0.5 * (width - 1) + camera.shift_x * width) * pixel
    rows = (0.5 * (height - 1) - np.arange(height) + camera.shift_y * width) * pixel
    return [grid.ravel() for grid in np.meshgrid(columns, rows)]


def _lines(camera, across, upward):
    """Where rays start, and their directions, as long as to be one along the axis."""
    right, up, forward = camera.axes
    directions = forward[:, None] + right[:, None] * across + up[:, None] * upward
    return camera.position[:, None] + camera.clip_start * directions, directions


def _rays(origins, directions):
    import mitsuba as mi

    return mi.Ray3f(mi.Point3f(origins.astype(np.float32)), mi.Vector3f(directions.astype(np.float32)))
