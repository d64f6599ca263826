"""Texture atlases: every triangle of a mesh gets a place of its own in one picture."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

try:
    import xatlas
except ImportError:  # it has no wheel for Blender's newest Python
    xatlas = None

# xatlas unwraps about 20 000 triangles a second; denser meshes get a cell a triangle.
CHARTED_TRIANGLES = 20_000 if xatlas else 0
# Texels between charts, and from the edge of a cell to its triangle: a bilinear lookup reads the next one.
PADDING = 2
SMALLEST_CELL = 6
# xatlas ends its threads without a lock: one that is just lying down then misses that it is to end, and is waited for
# forever (github.com/godotengine/godot/issues/92119). So an atlas goes a while after its work.
REST, RESTING = 0.02, 4  # seconds, and how many atlases may wait
# What the user should know; empty where xatlas is there.
LACKING = (
    ""
    if xatlas
    else "This Python has no xatlas (there is none for 3.14 yet): baked light has a cell of its texture for every "
    "triangle, which takes more memory, and is traced on meshes whose triangles differ much in size."
)


_resting: deque = deque()


def unwrap(vertices: np.ndarray, triangles: np.ndarray, texels: int) -> tuple[np.ndarray, tuple[int, int]]:
    """Lay a mesh out flat without overlaps.

    Parameters
    ----------
    vertices : float32 [vertex, 3]
    triangles : int [triangle, 3]
    texels : int
        Side of the picture to aim at; it becomes larger where the charts or cells need it.

    Returns
    -------
    uv : float32 [triangle, 3, 2]
        Place of each triangle's corners, 0 to 1.
    size : (int, int)
        Width and height of the picture in texels.
    """
    places, size = charts(vertices, triangles, resolution=texels) or cells_of(len(triangles), texels)
    return (places / np.array(size)).astype(np.float32), size


def charts(
    vertices: np.ndarray, triangles: np.ndarray, **packing
) -> tuple[np.ndarray, tuple[int, int]] | None:
    """Charts by xatlas, with few seams and little distortion.

    Parameters
    ----------
    vertices : float32 [vertex, 3]
    triangles : int [triangle, 3]
    **packing
        Of `xatlas.PackOptions`: `resolution`, side of the picture to aim at, or `texels_per_unit`.

    Returns
    -------
    (float32 [triangle, 3, 2], (int, int)) or None
        Place of each triangle's corners, and width and height, in texels; None where the mesh is too dense, or
        has no area.
    """
    if len(triangles) > CHARTED_TRIANGLES or xatlas is None:
        return None
    atlas = xatlas.Atlas()
    atlas.add_mesh(np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(triangles, np.uint32))
    options = xatlas.PackOptions()
    options.padding = PADDING
    for name, value in packing.items():
        setattr(options, name, value)
    atlas.generate(pack_options=options)
    _resting.append((atlas, time.monotonic()))
    if len(_resting) > RESTING:
        time.sleep(max(0.0, _resting[0][1] + REST - time.monotonic()))
        _resting.popleft()
    if atlas.width * atlas.height == 0 or atlas.atlas_count != 1:
        return None
    _, corners, uv = atlas[0]
    size = atlas.width, atlas.height
    return uv[corners].astype(np.float32) * np.array(size, np.float32), size


def cells_of(count: int, texels: int) -> tuple:
    """`cells` for a picture of about `texels` a side."""
    side = _cells_a_row(count)
    return cells(count, max(texels // side, SMALLEST_CELL))


def cells(count: int, cell: int) -> tuple:
    """A regular grid of squares of `cell` texels; each holds two triangles, one on either side of its diagonal.

    Squares smaller than `SMALLEST_CELL` have no room for two triangles: each triangle then has one texel.

    Returns
    -------
    places : float32 [triangle, 3, 2]
        Of the corners, in texels.
    size : (int, int)
        Width and height in texels.
    """
    number = np.arange(count)
    if cell < SMALLEST_CELL:
        side = int(np.ceil(np.sqrt(count)))
        place = np.stack([number % side, number // side], axis=1) + 0.5
        return np.repeat(place[:, None], 3, axis=1).astype(np.float32), (side, -(-count // side))
    side = _cells_a_row(count)
    corner = np.stack([number // 2 % side, number // 2 // side], axis=1) * cell
    # half a texel from the border, so that a bilinear lookup stays inside; PADDING texels of the diagonal
    near, far = 0.5, cell - 0.5 - PADDING
    lower = np.array([(near, near), (far, near), (near, far)])
    upper = cell - lower
    place = np.where((number % 2 == 0)[:, None, None], lower, upper) + corner[:, None, :]
    return place.astype(np.float32), (side * cell, side * cell)


def _cells_a_row(count):
    return int(np.ceil(np.sqrt(np.ceil(count / 2))))
