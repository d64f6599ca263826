"""Hair as thin tubes of triangles, and points as balls, so that they are instanced, lit and traced like any mesh.

Cycles' hair and points are smooth, ours have facets: pictures agree within 3 % in brightness.
"""

import math
from functools import cache

import numpy as np
from scipy.spatial import ConvexHull

from .geometry import Surface

# A tube's cross section has this many corners. It is scaled so that its mean width from all sides is that of
# the circle: by Cauchy's formula a convex outline of perimeter P is P / pi wide on average. Fewer corners lose
# light where normals and facets disagree: beside Cycles, 60 hairs are 2 to 5 % dark with 4, within 3 % with 6.
SIDES = 6
_WIDENING = math.pi / (SIDES * math.sin(math.pi / SIDES))
# What Cycles takes where a curve, or a point, says nothing.
DEFAULT_RADIUS = 0.005
POLY = 1  # type of curves whose points straight pieces join, in Cycles as their first says
DEFAULT_POINT_RADIUS = 0.01
# Balls are as fine as this many triangles in all allow: 1280, 320, 80 or, of very many points, 20 each.
MAX_TRIANGLES, MAX_LEVEL = 500_000, 3
# Straight pieces between two points of a hair curve, which is smooth in Cycles.
PIECES = 3


def tubes(points, radii, counts):
    """Tubes around polylines.

    Parameters
    ----------
    points : array, shape (point, 3)
        Points of all lines, one line after the other.
    radii : array, shape (point,)
    counts : array of int, shape (line,)
        Points of each line; those with fewer than 2 are left out.

    Returns
    -------
    Surface or None
        With smooth normals; None if nothing is left.
    """
    points, radii = np.asarray(points, np.float64), np.asarray(radii, np.float64)
    keep = np.repeat(counts > 1, counts)
    points, radii, counts = points[keep], radii[keep], counts[counts > 1]
    if not len(counts):
        return None
    starts = np.cumsum(counts) - counts
    last = np.zeros(len(points), bool)
    last[starts + counts - 1] = True
    first = np.zeros(len(points), bool)
    first[starts] = True
    ahead = np.flatnonzero(~last)
    step = np.zeros_like(points)
    step[ahead] = points[ahead + 1] - points[ahead]
    tangent = step.copy()
    tangent[~first] += step[np.flatnonzero(~first) - 1]
    tangent = _unit(tangent)

    side = np.zeros_like(points)
    axis = np.eye(3)[np.argmin(np.abs(tangent[starts]), axis=1)]
    side[starts] = _unit(np.cross(tangent[starts], axis))
    for number in range(1, counts.max()):
        # carried along the line without twist
        here = starts[counts > number] + number
        before = side[here - 1]
        side[here] = _unit(before - tangent[here] * (before * tangent[here]).sum(1, keepdims=True))
    other = np.cross(tangent, side)

    angle = 2 * math.pi * np.arange(SIDES) / SIDES
    normals = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]
    ring = points[:, None] + _WIDENING * radii[:, None, None] * normals
    corner = SIDES * ahead[:, None] + np.arange(SIDES)
    beside = SIDES * ahead[:, None] + (np.arange(SIDES) + 1) % SIDES
    faces = np.stack(
        [
            np.stack([corner, beside, beside + SIDES], axis=-1),
            np.stack([corner, beside + SIDES, corner + SIDES], axis=-1),
        ]
    ).reshape(-1, 3)
    return Surface(
        ring.reshape(-1, 3).astype(np.float32),
        None,
        normals.reshape(-1, 3).astype(np.float32),
        None,
        faces.astype(np.int32),
    )


def _unit(vectors):
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), (1.0, 0.0, 0.0))


def curve_tubes(curves):
    """Tubes of a hair curves datablock, in its object's space.

    Parameters
    ----------
    curves : bpy.types.Curves
        Evaluated.

    Returns
    -------
    Surface or None
    """
    if not len(curves.points):
        return None
    offsets = np.empty(len(curves.curve_offset_data), np.int32)
    curves.curve_offset_data.foreach_get("value", offsets)
    counts = np.diff(offsets)
    points, radii = _points(curves, DEFAULT_RADIUS, counts)
    kinds = curves.attributes.get("curve_type")
    if kinds is not None and len(kinds.data) and kinds.data[0].value == POLY:
        # a tube for each piece: one that bends at a corner would be thin there
        begin = np.delete(np.arange(len(points)), np.cumsum(counts)[counts > 0] - 1)
        pieces = np.stack([begin, begin + 1], axis=1).ravel()
        return tubes(points[pieces], radii[pieces], np.full(len(begin), 2))
    return tubes(*_smooth(points, radii, counts))


def _points(data, radius, counts=None):
    """Points of a datablock and their radii, `radius` by default; `counts` are those of the points of each curve."""
    size = len(data.points)
    points = np.empty(3 * size, np.float32)
    data.attributes["position"].data.foreach_get("vector", points)
    radii = np.full(size, radius, np.float32)
    own = data.attributes.get("radius")
    if own is not None and own.data_type == "FLOAT":
        values = np.empty(len(own.data), np.float32)
        own.data.foreach_get("value", values)
        radii = np.repeat(values, counts) if own.domain == "CURVE" else values
    return points.reshape(-1, 3), radii


def point_balls(cloud):
    """Balls around the points of a point cloud, in its object's space.

    Parameters
    ----------
    cloud : bpy.types.PointCloud
        Evaluated.

    Returns
    -------
    Surface or None
    """
    return balls(*_points(cloud, DEFAULT_POINT_RADIUS))


def balls(points, radii):
    """Balls around points.

    Parameters
    ----------
    points : array, shape (point, 3)
    radii : array, shape (point,)
        Points without one, or whose place is no number, are left out.

    Returns
    -------
    Surface or None
        With smooth normals; None if nothing is left.
    """
    keep = np.isfinite(points).all(1) & (radii > 0)
    points, radii = points[keep], radii[keep]
    if not len(points):
        return None
    level = next((n for n in range(MAX_LEVEL, 0, -1) if len(points) * 20 * 4**n <= MAX_TRIANGLES), 0)
    corners, faces, widened = _ball(level)
    places = points[:, None] + widened * radii[:, None, None] * corners
    numbers = faces + len(corners) * np.arange(len(points))[:, None, None]
    return Surface(
        places.reshape(-1, 3).astype(np.float32),
        None,
        np.tile(corners, (len(points), 1)).astype(np.float32),
        None,
        numbers.reshape(-1, 3).astype(np.int32),
    )


@cache
def _ball(level):
    """Corners and faces of a unit icosphere, and the factor by which it must grow to look as large as its sphere.

    By Cauchy's formula the outline of a convex body is a quarter of its surface on average.
    """
    golden = (1 + math.sqrt(5)) / 2
    turns = [(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)]
    corners = _unit(np.array([np.roll(turn, axis) for turn in turns for axis in range(3)], float))
    for _ in range(level):
        faces = ConvexHull(corners).simplices
        edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)
        corners = np.concatenate([corners, _unit(corners[edges].sum(1))])
    faces = ConvexHull(corners).simplices
    a, b, c = (corners[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    inward = (across * a).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    area = 0.5 * np.linalg.norm(across, axis=1).sum()
    return corners, faces, math.sqrt(4 * math.pi / area)


def _smooth(points, radii, counts):
    """Polylines along Catmull-Rom splines through points, with `PIECES` pieces between two of them."""
    starts = np.repeat(np.cumsum(counts) - counts, counts)
    ends = starts + np.repeat(counts, counts) - 1
    number = np.arange(len(points))
    values = np.column_stack([points, radii]).astype(np.float64)
    p = [values[np.clip(number + shift, starts, ends)] for shift in (-1, 0, 1, 2)]
    t = (np.arange(PIECES) / PIECES)[:, None, None]
    spline = 0.5 * (
        2 * p[1]
        + (p[2] - p[0]) * t
        + (2 * p[0] - 5 * p[1] + 4 * p[2] - p[3]) * t**2
        + (3 * p[1] - p[0] - 3 * p[2] + p[3]) * t**3
    ).swapaxes(0, 1)
    keep = (number < ends)[:, None] | (np.arange(PIECES) == 0)
    values = spline[keep]
    return values[:, :3], np.maximum(values[:, 3], 0), np.where(counts > 0, (counts - 1) * PIECES + 1, 0)


def particle_tubes(object, system, render=False):
    """Tubes of a particle system's hair, in world space.

    The radius goes from root to tip as in Cycles: with x from 1 at the root to 0 at the tip and s the strand
    shape, tip + (root - tip) x^(1 + s) for s < 0 and x^(1 / (1 - s)) otherwise.

    Parameters
    ----------
    object : bpy.types.Object
        Evaluated.
    system : bpy.types.ParticleSystem
        One of its particle systems, of type hair.
    render : bool
        Whether the object comes from a render's depsgraph, where paths have as many steps as in renders.

    Returns
    -------
    Surface or None
    """
    settings = system.settings
    parents, children = len(system.particles), len(system.child_particles)
    begin = parents if children else 0  # with children Cycles shows these alone
    steps = 2 ** (settings.render_step if render else settings.display_step) + 1
    if settings.kink == "SPIRAL":
        steps += settings.kink_extra_steps
    lines = np.array(
        [
            system.co_hair(object, particle_no=number, step=step)
            for number in range(begin, parents + children)
            for step in range(steps)
        ]
    ).reshape(-1, steps, 3)
    # beyond a hair's end Blender gives the origin
    counts = steps - (~lines.any(axis=2))[:, ::-1].argmin(axis=1)
    counts[~lines.any(axis=(1, 2))] = 0
    inside = np.arange(steps) < counts[:, None]
    rest = 1 - np.arange(steps) / np.maximum(counts - 1, 1)[:, None]
    shape = settings.shape
    profile = np.clip(rest, 0, 1) ** (1 + shape if shape < 0 else 1 / max(1 - shape, 1e-6))
    radii = settings.tip_radius + (settings.root_radius - settings.tip_radius) * profile
    if settings.use_close_tip:
        radii[np.arange(len(radii)), counts - 1] = 0
    # radii are of the object's space
    size = abs(np.linalg.det(np.array(object.matrix_world)[:3, :3])) ** (1 / 3)
    line = lines[inside], (0.5 * size * settings.radius_scale * radii)[inside], counts
    is_bent = settings.kink != "NO"  # where the spline that Cycles has differs from straight pieces
    return tubes(*(_smooth(*line) if is_bent else line))
