"""Texture atlases: every triangle of a mesh gets a place of its own in one picture."""

import numpy as np

try:
    import xatlas
except ImportError:  # it has no wheel for Blender's newest Python
    xatlas = None

# xatlas unwraps about 20 000 triangles a second; denser meshes get a cell a triangle.
CHARTED_TRIANGLES = 20_000
# Texels between charts, and from the edge of a cell to its triangle: a bilinear lookup reads the next one.
PADDING = 2
SMALLEST_CELL = 6


def unwrap(vertices, triangles, texels):
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
    if len(triangles) > CHARTED_TRIANGLES or xatlas is None:
        return _cells(len(triangles), texels)
    atlas = xatlas.Atlas()
    atlas.add_mesh(np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(triangles, np.uint32))
    packing = xatlas.PackOptions()
    packing.resolution, packing.padding = texels, PADDING
    atlas.generate(pack_options=packing)
    if atlas.width * atlas.height == 0 or atlas.atlas_count != 1:
        return _cells(len(triangles), texels)  # nothing but triangles without area
    _, corners, uv = atlas[0]
    return uv[corners].astype(np.float32), (atlas.width, atlas.height)


def _cells(count, texels):
    """A regular grid; each square holds two triangles, one on either side of its diagonal."""
    side = int(np.ceil(np.sqrt(np.ceil(count / 2))))
    cell = max(texels // side, SMALLEST_CELL)
    number = np.arange(count)
    corner = np.stack([number // 2 % side, number // 2 // side], axis=1) * cell
    # half a texel from the border, so that a bilinear lookup stays inside; PADDING texels of the diagonal
    near, far = 0.5, cell - 0.5 - PADDING
    lower = np.array([(near, near), (far, near), (near, far)])
    upper = cell - lower
    place = np.where((number % 2 == 0)[:, None, None], lower, upper) + corner[:, None, :]
    return (place / (side * cell)).astype(np.float32), (side * cell, side * cell)
