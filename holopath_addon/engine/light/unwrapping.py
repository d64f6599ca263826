"""Texture atlases: every triangle of a mesh gets a place of its own in one texture."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

try:
    import xatlas
except ImportError:  # there is no wheel for Blender's newest Python
    xatlas = None

# Maximum triangles of a mesh with charts: xatlas unwraps about 20 000 a second; denser meshes get a cell a triangle.
CHARTED_TRIANGLES = 20_000 if xatlas else 0
# Texels between charts, and from the edge of a cell to its triangle: a bilinear lookup reads the next one.
PADDING = 2
MIN_CELL = 6  # minimum side of a cell with two triangles, texels
# xatlas ends its threads without a lock: one that is about to wait then misses the signal, and is waited for forever
# (github.com/godotengine/godot/issues/92119). So an atlas is deleted a while after its work.
DELETION_DELAY, MAX_WAITING = 0.02, 4  # seconds, and atlases that wait
# Note for the user; empty if xatlas is there.
LACKING = (
    ""
    if xatlas
    else "This Python has no xatlas (there is none for 3.14 yet). Baked light has a texture cell for each triangle, "
    "which takes more memory, and meshes with triangles of very different sizes are traced."
)


_waiting: deque = deque()


def unwrap(vertices: np.ndarray, triangles: np.ndarray, texels: int) -> tuple[np.ndarray, tuple[int, int]]:
    """Lay a mesh out flat without overlaps.

    Parameters
    ----------
    vertices : float32 [vertex, 3]
    triangles : int [triangle, 3]
    texels : int
        Target side of the texture; it becomes larger where charts or cells need it.

    Returns
    -------
    uv : float32 [triangle, 3, 2]
        Corners of each triangle, 0 to 1.
    size : (int, int)
        Width and height of the texture, texels.
    """
    places, size = charts(vertices, triangles, resolution=texels) or cells_of(len(triangles), texels)
    return (places / np.array(size)).astype(np.float32), size


def charts(
    vertices: np.ndarray, triangles: np.ndarray, **packing
) -> tuple[np.ndarray, tuple[int, int]] | None:
    """Lay a mesh out in charts by xatlas, with few seams and little distortion.

    Parameters
    ----------
    vertices : float32 [vertex, 3]
    triangles : int [triangle, 3]
    **packing
        Attributes of `xatlas.PackOptions`: `resolution`, target side of the texture, or `texels_per_unit`.

    Returns
    -------
    (float32 [triangle, 3, 2], (int, int)) or None
        Corners of each triangle, and width and height, in texels; None if the mesh is too dense or has no area.
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
    _waiting.append((atlas, time.monotonic()))
    if len(_waiting) > MAX_WAITING:
        time.sleep(max(0.0, _waiting[0][1] + DELETION_DELAY - time.monotonic()))
        _waiting.popleft()
    if atlas.width * atlas.height == 0 or atlas.atlas_count != 1:
        return None
    _, corners, uv = atlas[0]
    size = atlas.width, atlas.height
    return uv[corners].astype(np.float32) * np.array(size, np.float32), size


def cells_of(count: int, texels: int) -> tuple:
    """Lay `count` triangles out in `cells` of a texture of about `texels` a side."""
    side = _cells_a_row(count)
    return cells(count, max(texels // side, MIN_CELL))


def cells(count: int, cell: int) -> tuple:
    """Lay triangles out in a grid of square cells, two in each, one on either side of its diagonal.

    Parameters
    ----------
    count : int
        Triangles.
    cell : int
        Side of a cell, texels. Below `MIN_CELL` there is no room for two triangles: each then has one texel.

    Returns
    -------
    places : float32 [triangle, 3, 2]
        Corners, texels.
    size : (int, int)
        Width and height, texels.
    """
    number = np.arange(count)
    if cell < MIN_CELL:
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
