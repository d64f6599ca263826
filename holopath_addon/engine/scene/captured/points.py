"""Points with colors as a scene: each is a small disk that faces the viewer and shines.

A disk is a hexagonal cone, whose tip at the point is nearest to the viewer: of disks that overlap, the one whose point
is nearest is seen (Hoff et al., SIGGRAPH 1999, draw Voronoi diagrams so). So they may be large enough to leave no gaps,
and the colors stay apart. All disks are one mesh.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ...camera import Camera
from ...errors import InvalidInput
from .. import variants
from .picture import FIELD_OF_VIEW, shining_mesh

if TYPE_CHECKING:
    import mitsuba as mi
    from numpy.typing import ArrayLike

MAX_POINTS = 4_000_000  # of 228 bytes each, without the ray tracer's data
# Sides of a cone, and its height over its radius: on surfaces turned by up to 45 degrees no point hides its neighbors.
SIDES, TILT = 6, 1.0
NEIGHBORS = 4  # on a square grid they are all at the grid's spacing
# Radius over the distance to the fourth neighbor. Of points at random on a surface, disks leave exp(-4 * 1.2^2) = 0.3 %
# open, of a square grid nothing.
COVERING = 1.2
# Bounds of a point's distance to its fourth neighbor, times the median of its neighbors' own: points that stand alone
# are no larger, and copies of a point do not vanish.
SPACING = 0.1, 3.0
FRAME = 1.05  # width of the view over the points' extent
VIEWERS = ("front", "origin")


def point_scene(
    points: ArrayLike,
    colors: ArrayLike,
    radius: float | None = None,
    fov_x: float = FIELD_OF_VIEW,
    aspect: float = 1.0,
    viewer: str = "front",
) -> tuple[mi.Scene, Camera]:
    """Make a scene of points with colors, and a camera that sees them.

    Parameters
    ----------
    points : array_like, shape (point, 3)
        Meters; the viewer looks along -z, y is up.
    colors : array_like, shape (point, 3)
        Linear RGB radiance.
    radius : float, optional
        Radius of the disks, meters. Default: one for each point by the distance to its fourth neighbor, so that a
        surface whose points are spread evenly has no gaps.
    fov_x : float
        Full horizontal field of view, radians. Default: that of a 50 mm lens on 36 mm of film.
    aspect : float
        Width of the view over its height.
    viewer : {'front', 'origin'}
        Place of the camera: before the middle of the points, as near as all are in view, or the origin.

    Returns
    -------
    mitsuba.Scene
    Camera

    Raises
    ------
    InvalidInput
        If the shapes differ, there are no or too many points, a number is not finite, a color is negative, the
        radius cannot be found or is not positive, or no point is before the viewer.
    BackendUnavailable
    """
    points, colors = np.asarray(points, np.float64), np.asarray(colors, np.float32)
    if points.ndim != 2 or points.shape[1] != 3 or points.shape != colors.shape:
        raise InvalidInput(
            f"The points' array has the shape {points.shape} and their colors' {colors.shape}: give (point, 3) of both."
        )
    if not 0 < len(points) <= MAX_POINTS:
        raise InvalidInput(f"There are {len(points)} points: give from 1 to {MAX_POINTS}.")
    if not (np.isfinite(points).all() and np.isfinite(colors).all() and (colors >= 0).all()):
        raise InvalidInput(
            "There are points or colors that are not finite, or negative colors: leave them out."
        )
    camera = _camera(points, fov_x, aspect, viewer)
    radii = _radii(points) if radius is None else np.full(len(points), float(radius))
    if not (np.isfinite(radii).all() and (radii > 0).all()):
        raise InvalidInput(f"The radius of points must be positive, not {radius:g} m.")
    variants.activate()
    vertices, triangles = _cones(points, radii, camera.position)
    texture = {"type": "mesh_attribute", "name": "face_color"}
    shape = shining_mesh("points", vertices, triangles, texture, face_colors=np.repeat(colors, SIDES, axis=0))
    return variants.made({"type": "scene", "points": shape}), camera


def _camera(points, fov_x, aspect, viewer):
    if viewer not in VIEWERS:
        raise InvalidInput(f"Expected the viewer {' or '.join(VIEWERS)}, got '{viewer}'.")
    to_world = np.eye(4)
    if viewer == "front":
        middle = 0.5 * (points.min(0) + points.max(0))
        extent = (
            FRAME * np.abs(points[:, :2] - middle[:2]) / (math.tan(fov_x / 2) * np.array([1, 1 / aspect]))
        )
        size = np.ptp(points, axis=0).max()
        to_world[:3, 3] = (
            *middle[:2],
            max((points[:, 2] + extent.max(1)).max(), points[:, 2].max() + 0.1 * size),
        )
        if size == 0:
            to_world[2, 3] += 1.0
    elif not (points[:, 2] < 0).any():
        raise InvalidInput(
            "No point is before a viewer at the origin: choose other axes, or a viewer in front of all points."
        )
    return Camera(to_world, fov_x)


def _radii(points):
    """Radius of each point's disk."""
    from scipy.spatial import KDTree

    if len(points) <= NEIGHBORS:
        raise InvalidInput(
            f"{len(points)} points are too few to tell how far they are apart: give their radius."
        )
    distances, neighbors = KDTree(points).query(points, NEIGHBORS + 1)
    spacing = distances[:, -1]
    around = np.median(spacing[neighbors[:, 1:]], axis=1)
    spacing = np.clip(spacing, SPACING[0] * around, SPACING[1] * around)
    if not spacing.all():
        raise InvalidInput("Five or more points lie in one place: leave out the copies, or give a radius.")
    return COVERING * spacing


def _cones(points, radii, viewer):
    """Vertices and triangles of cones whose tips point at the viewer."""
    axis = viewer - points
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(length > 0, axis / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))
    across = np.cross(np.where(np.abs(axis[:, 1:2]) < 0.9, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), axis)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    upward = np.cross(axis, across)
    turn = 2 * math.pi * np.arange(SIDES) / SIDES
    rim = np.cos(turn)[:, None] * across[:, None] + np.sin(turn)[:, None] * upward[:, None]
    vertices = np.empty((len(points), SIDES + 1, 3), np.float32)
    vertices[:, 0] = points
    vertices[:, 1:] = points[:, None] + radii[:, None, None] * (rim - TILT * axis[:, None])
    number = np.arange(SIDES)
    faces = np.stack([np.zeros_like(number), 1 + number, 1 + (number + 1) % SIDES], -1)
    triangles = faces + (SIDES + 1) * np.arange(len(points))[:, None, None]
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int32)
