"""A picture with depth as a scene: a surface that shines with the picture, cut where the depth jumps.

Each pixel is a square of the surface, whose corners lie on the lines of sight through the pixel's corners. Inverse
depth of a plane is linear across a picture, so corners take the mean inverse depth of the pixels that meet there, and
planes stay planes. Where two pixels' depths jump, their squares have no corner in common. The viewer's pupil then sees
past the near edge, at what the picture does not show: the far surface goes on behind the near one, with its own slope
and with the colors that lie beside the edge, mirrored. The picture's borders are mirrored likewise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...camera import Camera
from ...errors import InvalidInput
from .. import variants

if TYPE_CHECKING:
    import mitsuba as mi
    from numpy.typing import ArrayLike

# Field of view of a 50 mm lens on 36 mm of film, which is Blender's default camera. Radians.
FIELD_OF_VIEW = 2 * math.atan(18 / 50)
# Tangent of the angle between a surface's normal and the line of sight from which its pixels are cut apart: 84 degrees.
MAX_SLOPE = 10.0
# Fraction of the largest inverse depth that is never an edge: with default volumes it is an eighth of a pixel's shift
# from the middle of the pupil to its rim.
MIN_JUMP = 0.01
# Fraction of the picture's shorter side that surfaces go on behind nearer ones and beyond borders: with default volumes
# infinity shifts by so much against the near end, from the middle of the pupil to its rim.
REACH = 0.05
INSET = 0.25  # distance of texture coordinates of single pixels from the texel's edge, texels


@dataclass(frozen=True)
class PictureMesh:
    """Surface of a picture with depth, in camera space: the camera is at the origin and looks along -z, y is up.

    Attributes
    ----------
    vertices : numpy.ndarray, float32, shape (vertex, 3)
        Meters.
    uv : numpy.ndarray, float32, shape (vertex, 2)
        Place in the picture: (0, 0) is its top left corner, (1, 1) its bottom right one. Values outside are mirrored.
    triangles : numpy.ndarray, int32, shape (triangle, 3)
        They face the camera.
    """

    vertices: np.ndarray
    uv: np.ndarray
    triangles: np.ndarray


def picture_scene(
    image: ArrayLike, depth: ArrayLike, fov_x: float = FIELD_OF_VIEW, reach: int | None = None
) -> tuple[mi.Scene, Camera]:
    """Make a scene of a picture with depth, and the pinhole camera that sees it as the picture.

    Parameters
    ----------
    image : array_like, shape (y, x, 3)
        Linear RGB radiance, top row first.
    depth : array_like, shape (y, x)
        Distance along the camera's axis, meters.
    fov_x : float
        Full horizontal field of view of the picture, radians. Default: that of a 50 mm lens on 36 mm of film.
    reach : int, optional
        See `picture_mesh`.

    Returns
    -------
    mitsuba.Scene
    Camera
        At the origin; it looks along -z, y is up.

    Raises
    ------
    InvalidInput
        If the shapes differ, a depth is not positive and finite, a radiance is negative or not finite, or the angle is
        out of range.
    BackendUnavailable
    """
    image, depth = np.asarray(image, np.float32), np.asarray(depth)
    if image.ndim != 3 or image.shape[2] != 3 or image.shape[:2] != depth.shape:
        raise InvalidInput(
            f"The picture's array has the shape {image.shape} and its depth's {depth.shape}: give (y, x, 3) and (y, x)."
        )
    if not (np.isfinite(image).all() and (image >= 0).all()):
        raise InvalidInput("The picture has colors that are negative or not finite: correct them.")
    mesh = picture_mesh(depth, fov_x, reach)
    variants.activate()
    import mitsuba as mi

    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(image)),
        "raw": True,
        "filter_type": "nearest",  # a pixel's mean is then the picture's
        "wrap_mode": "mirror",
    }
    shape = shining_mesh("picture", mesh.vertices, mesh.triangles, texture, uv=mesh.uv)
    return variants.made({"type": "scene", "picture": shape}), Camera(np.eye(4), fov_x)


def shining_mesh(name, vertices, triangles, radiance, uv=None, face_colors=None) -> mi.Mesh:
    """Make a mesh that shines and reflects nothing.

    Parameters
    ----------
    name : str
    vertices : numpy.ndarray, float32, shape (vertex, 3)
    triangles : numpy.ndarray, int32, shape (triangle, 3)
    radiance : dict
        Texture, as `mitsuba.load_dict` takes it.
    uv : numpy.ndarray, float32, shape (vertex, 2), optional
    face_colors : numpy.ndarray, float32, shape (triangle, 3), optional
        Kept as the attribute ``face_color``.
    """
    import mitsuba as mi

    from ..buffers import loaded

    properties = mi.Properties()
    properties["bsdf"] = variants.made({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}})
    properties["emitter"] = variants.made({"type": "area", "radiance": radiance})
    properties["face_normals"] = True
    mesh = mi.Mesh(name, len(vertices), len(triangles), props=properties, has_vertex_texcoords=uv is not None)
    if face_colors is not None:
        mesh.add_attribute("face_color", 3, loaded(mi.Float, face_colors.ravel()))
    parts = mi.traverse(mesh)
    parts["vertex_positions"] = loaded(mi.Float, vertices.ravel())
    parts["faces"] = loaded(mi.UInt32, triangles.astype(np.uint32).ravel())
    if uv is not None:
        parts["vertex_texcoords"] = loaded(mi.Float, uv.ravel())
    parts.update()
    return mesh


def picture_mesh(depth: ArrayLike, fov_x: float = FIELD_OF_VIEW, reach: int | None = None) -> PictureMesh:
    """Make the surface of a picture with depth.

    Parameters
    ----------
    depth : array_like, shape (y, x)
        Distance along the camera's axis, meters, top row first.
    fov_x : float
        Full horizontal field of view, radians.
    reach : int, optional
        Pixels by which surfaces go on behind nearer ones, and beyond the picture's borders. Default: a twentieth of the
        shorter side, as much as default depth volumes show.

    Returns
    -------
    PictureMesh

    Raises
    ------
    InvalidInput
        If a depth is not positive and finite, or the angle is out of range.
    """
    depth = np.asarray(depth, np.float64)
    if depth.ndim != 2 or not depth.size:
        raise InvalidInput(f"The depth's array has the shape {depth.shape}: give (y, x).")
    if not 0 < fov_x < math.pi:
        raise InvalidInput(
            f"The picture's field of view must lie between 0 and 180 degrees, not {math.degrees(fov_x):g}."
        )
    wrong = ~(np.isfinite(depth) & (depth > 0))
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise InvalidInput(
            f"{np.count_nonzero(wrong)} of {depth.size} depths are not positive and finite, the first in column "
            f"{column}, row {row}: fill them in, and give what is far away a large depth."
        )
    height, width = depth.shape
    margin = math.ceil(REACH * min(height, width)) if reach is None else reach
    pixel = 2 * math.tan(fov_x / 2) / width
    inverse = np.pad(1 / depth, margin, mode="symmetric")
    edges = _Edges(MAX_SLOPE * pixel, MIN_JUMP * inverse.max())

    front = _corners(inverse, edges)
    places, heights, corners = _shared(*front)
    vertices, uvs, triangles = [_positions(places, heights)], [places.astype(np.float64)], [_halves(corners)]

    behind, source = _behind(inverse, edges, margin)
    hidden = np.argwhere(source >= 0)
    if len(hidden):
        values, _ = _corners(np.where(source >= 0, behind, inverse), edges)
        row, column = hidden.T
        # a pixel's corners in the order of `_shared`, and which of the four pixels around the corner it is there
        at = [(row + y, column + x, 3 - x - 2 * y) for y, x in _SQUARE]
        places = np.stack([np.stack([x, y], -1) for y, x, _ in at], 1).reshape(-1, 2)
        heights = np.stack([values[k][y, x] for y, x, k in at], 1).ravel()
        origin = np.stack(np.divmod(source[row, column], inverse.shape[1])[::-1], -1)
        inset = np.array([(abs(x - INSET), abs(y - INSET)) for y, x in _SQUARE])
        first = len(vertices[0])
        vertices.append(_positions(places, heights))
        uvs.append((origin[:, None] + inset).reshape(-1, 2))
        triangles.append(_halves(first + np.arange(len(places)).reshape(-1, 4)))

    size = np.array([width, height])
    points = np.concatenate(vertices)
    middle = margin + size / 2
    points[:, :2] = (points[:, :2] - middle) * (pixel, -pixel) * -points[:, 2:]
    return PictureMesh(
        points.astype(np.float32),
        ((np.concatenate(uvs) - margin) / size).astype(np.float32),
        np.concatenate(triangles),
    )


_SQUARE = (
    (0, 0),
    (1, 0),
    (1, 1),
    (0, 1),
)  # rows and columns of a pixel's corners, counterclockwise to the viewer


@dataclass(frozen=True)
class _Edges:
    """Threshold of a jump between two inverse depths that is an edge.

    Attributes
    ----------
    relative : float
        Fraction of the larger one, per pixel of distance.
    minimum : float
        Inverse meters.
    """

    relative: float
    minimum: float

    def jump(self, first, second, distance=1):
        """Largest difference, between pixels at some distance, that is no edge."""
        return np.maximum(self.relative * np.maximum(first, second) * distance, self.minimum)

    def joined(self, first, second):
        """Whether neighbors belong to one surface."""
        return np.abs(first - second) <= self.jump(first, second)


def _corners(inverse, edges):
    """Inverse depths at the corners of pixels, and the corners that are joined.

    Parameters
    ----------
    inverse : numpy.ndarray, shape (y, x)
    edges : _Edges

    Returns
    -------
    values : list of 4 numpy.ndarray, shape (y + 1, x + 1)
        Values of the pixels above left, above right, below left and below right of each corner.
    numbers : list of 4 numpy.ndarray of int
        The first of the four with which each of them is joined.
    """
    around = np.pad(inverse, 1, mode="edge")
    a, b, c, d = around[:-1, :-1], around[:-1, 1:], around[1:, :-1], around[1:, 1:]
    ab, ac, bd, cd = (edges.joined(*pair) for pair in ((a, b), (a, c), (b, d), (c, d)))
    joined = {
        (0, 1): ab | (ac & cd & bd),
        (0, 2): ac | (ab & bd & cd),
        (0, 3): (ab & bd) | (ac & cd),
        (1, 2): (ab & ac) | (bd & cd),
        (1, 3): bd | (ab & ac & cd),
        (2, 3): cd | (ac & ab & bd),
    }
    values, numbers, pixels = [], [], (a, b, c, d)
    for k, own in enumerate(pixels):
        total, count, number = own.copy(), np.ones(own.shape), np.full(own.shape, k, np.int8)
        for other in (3, 2, 1, 0):
            if other != k:
                together = joined[min(k, other), max(k, other)]
                total += np.where(together, pixels[other], 0)
                count += together
                if other < k:
                    number[together] = other
        values.append(total / count)
        numbers.append(number)
    return values, numbers


def _shared(values, numbers):
    """Vertices that squares side by side share.

    Returns
    -------
    places : numpy.ndarray of int, shape (vertex, 2)
        Column and row of the corner of each.
    heights : numpy.ndarray, shape (vertex,)
        Inverse depth.
    corners : numpy.ndarray of int, shape (pixel, 4)
        Vertices of each pixel, in the order of `_SQUARE`.
    """
    own = np.stack([number == k for k, number in enumerate(numbers)], -1)
    index = np.cumsum(own.ravel(), dtype=np.int32).reshape(own.shape) - 1
    rows, columns = (side - 1 for side in own.shape[:2])
    corners = []
    for y, x in _SQUARE:
        here = slice(y, y + rows), slice(x, x + columns)
        number = numbers[3 - x - 2 * y][here]
        corners.append(np.take_along_axis(index[here], number[..., None].astype(np.intp), -1)[..., 0].ravel())
    row, column, _ = np.nonzero(own)
    return np.stack([column, row], -1), np.stack(values, -1)[own], np.stack(corners, -1)


def _halves(corners):
    """Two triangles of each square."""
    return corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3).astype(np.int32)


def _positions(places, heights):
    """Column, row and z of vertices."""
    return np.column_stack([places, -1 / heights])


def _behind(inverse, edges, reach):
    """Continue far surfaces behind nearer ones, near their edges.

    From each edge the far side grows by a pixel at a time behind the near one.

    Returns
    -------
    values : numpy.ndarray, shape (y, x)
        Inverse depth of the hidden surface.
    source : numpy.ndarray of int, shape (y, x)
        Index of the pixel whose color it has; -1 where there is no hidden surface.
    """
    rows, columns = inverse.shape
    flat, lowest = inverse.ravel(), inverse.min()
    values, source = np.zeros(flat.size), np.full(flat.size, -1)
    here = edge = np.arange(flat.size)
    depth_here = flat
    for _ in range(reach):
        row, column = np.divmod(here, columns)
        place, start = [], []
        for y, x in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            inside = (row + y >= 0) & (row + y < rows) & (column + x >= 0) & (column + x < columns)
            there = np.where(inside, here + y * columns + x, here)
            near = flat[there]
            hidden = inside & (source[there] < 0) & (near - depth_here > edges.jump(near, depth_here))
            place.append(there[hidden])
            start.append(edge[hidden])
        place, start = np.concatenate(place), np.concatenate(start)
        # of several the nearest
        order = np.argsort(flat[start], kind="stable")[::-1]
        here, first = np.unique(place[order], return_index=True)
        edge = start[order][first]
        if not len(here):
            break
        y, x = np.divmod(here, columns)
        y0, x0 = np.divmod(edge, columns)
        mirrored = np.clip(2 * y0 - y, 0, rows - 1) * columns + np.clip(2 * x0 - x, 0, columns - 1)
        base, beside = flat[edge], flat[mirrored]
        distance = np.maximum(np.abs(y - y0), np.abs(x - x0))
        same = np.abs(base - beside) <= edges.jump(base, beside, distance)
        beyond = np.maximum(2 * base - beside, lowest)
        same &= flat[here] - beyond > edges.jump(flat[here], beyond)
        depth_here = np.where(same, beyond, base)
        values[here], source[here] = depth_here, np.where(same, mirrored, edge)
    return values.reshape(inverse.shape), source.reshape(inverse.shape)
