"""Depth maps along the camera's axis: of the first surfaces, and of the images that mirrors and glass show."""

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
    """Depths of the first surfaces in some directions.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    across, upward : numpy.ndarray, shape (n,)
        Tangents of the directions from the pupil's center, to the right and up of the camera's axis.

    Returns
    -------
    numpy.ndarray, float32, shape (n,)
        World depths in meters; infinite where there is no surface within the camera's clipping range.

    Raises
    ------
    BackendUnavailable
        If Mitsuba cannot compute on this machine.
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
        Numbers of pixels, which are square.

    Returns
    -------
    numpy.ndarray, float32, shape (height, width)
        World depths in meters, infinite where there is no surface; row 0 is the top.

    Raises
    ------
    BackendUnavailable
        If Mitsuba cannot compute on this machine.
    """
    across, upward = _pixels(camera, width, height)
    return depths_along(scene, camera, across, upward).reshape(height, width)


def image_depth_map(scene: mi.Scene, camera: Camera, plan: Plan, width: int, height: int) -> np.ndarray:
    """Depth at which each pixel's center comes into focus, over the mirrors and clear surfaces that the plan follows.

    For mirrors and clear surfaces it is the depth of the image that they show, seen from the pupil's center; for all
    others that of the surface. Where several images overlap, the brightest one counts.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    plan : Plan
        Plan of a hologram of this view. It says how many mirrors and clear surfaces in a row are followed.
    width, height : int
        Numbers of pixels, which are square.

    Returns
    -------
    numpy.ndarray, float32, shape (height, width)
        World depths in meters, row 0 is the top. Infinite for the sky and where there is no surface, negative for light
        that converges behind the viewer, for example from concave mirrors.

    Raises
    ------
    BackendUnavailable
        If Mitsuba cannot compute on this machine.
    """
    variants.activate()
    import drjit as dr
    import mitsuba as mi

    from ..scene.specular_chains import image_finder_of

    origins, directions = _lines(camera, *_pixels(camera, width, height))
    lengths = np.linalg.norm(directions, axis=0)
    ray = _rays(origins, directions / lengths)
    reach = min(camera.clip_end, FARTHEST) - camera.clip_start
    ray.maxt = mi.Float((reach * lengths).astype(np.float32))
    image_finder = image_finder_of(scene, camera, plan)
    max_weight = np.zeros(len(lengths), np.float32)
    depths = np.full(len(lengths), math.inf, np.float32)
    for branch in range(image_finder.branches):
        view = image_finder.view(scene, ray, dr.full(mi.UInt32, branch, len(lengths)))
        weight = np.asarray(view.exists, np.float32) * (
            1 if view.weight is None else np.asarray(dr.max(view.weight))
        )
        distance = np.asarray(dr.select(view.hit, view.distance, dr.inf))
        larger = weight > max_weight
        max_weight = np.where(larger, weight, max_weight)
        depths = np.where(larger, camera.clip_start + distance / lengths, depths)
    return depths.astype(np.float32).reshape(height, width)


def _pixels(camera, width, height):
    """Tangents of the directions of the pixels' centers, row by row."""
    pixel = 2 * math.tan(camera.fov_x / 2) / width
    columns = (np.arange(width) - 0.5 * (width - 1) + camera.shift_x * width) * pixel
    rows = (0.5 * (height - 1) - np.arange(height) + camera.shift_y * width) * pixel
    return [grid.ravel() for grid in np.meshgrid(columns, rows)]


def _lines(camera, across, upward):
    """Origins and directions of rays; directions have the length 1 along the axis."""
    right, up, forward = camera.axes
    directions = forward[:, None] + right[:, None] * across + up[:, None] * upward
    return camera.position[:, None] + camera.clip_start * directions, directions


def _rays(origins, directions):
    import mitsuba as mi

    return mi.Ray3f(mi.Point3f(origins.astype(np.float32)), mi.Vector3f(directions.astype(np.float32)))
