"""Depth of the first surfaces in view, along the camera's axis."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..scene import variants

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera


def depths_along(scene: mi.Scene, camera: Camera, across: np.ndarray, upward: np.ndarray) -> np.ndarray:
    """Depths of what is hit in some directions.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    across, upward : numpy.ndarray, shape (n,)
        Tangents of the directions from the pupil's centre, to the right and up of the camera's axis.

    Returns
    -------
    numpy.ndarray, float32, shape (n,)
        World depths in metres; infinite where there is nothing within the camera's clipping range.
    """
    variants.activate()
    import mitsuba as mi

    right, up, forward = camera.axes
    # of unit length along the axis, so that distances along the ray are depths
    directions = forward[:, None] + right[:, None] * across + up[:, None] * upward
    origins = camera.position[:, None] + camera.clip_start * directions
    rays = mi.Ray3f(mi.Point3f(origins.astype(np.float32)), mi.Vector3f(directions.astype(np.float32)))
    depths = np.asarray(scene.ray_intersect_preliminary(rays).t) + np.float32(camera.clip_start)
    return np.where(depths < camera.clip_end, depths, np.float32(math.inf))


def depth_map(scene: mi.Scene, camera: Camera, width: int, height: int) -> np.ndarray:
    """Depth of the first surface at every pixel's centre.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    width, height : int
        Pixels, which are square.

    Returns
    -------
    numpy.ndarray, float32, shape (height, width)
        World depths in metres, infinite where there is nothing; row 0 at the top.

    Raises
    ------
    BackendUnavailable
    """
    pixel = 2 * math.tan(camera.fov_x / 2) / width
    columns = (np.arange(width) - 0.5 * (width - 1) + camera.shift_x * width) * pixel
    rows = (0.5 * (height - 1) - np.arange(height) + camera.shift_y * width) * pixel
    across, upward = (grid.ravel() for grid in np.meshgrid(columns, rows))
    return depths_along(scene, camera, across, upward).reshape(height, width)
