"""Views from a grid of viewpoints as a scene: a panel that shines as a light-field display does.

Depth before or behind the panel exists in the views' parallax only, without surfaces. So only methods that start from
pictures through parts of the pupil show it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ...camera import Camera
from ...errors import InvalidInput
from .. import variants
from .picture import FIELD_OF_VIEW, REACH, shining_mesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mitsuba as mi
    from numpy.typing import ArrayLike

METHODS = ("light-field",)  # methods that show a panel of views correctly


def view_scene(
    views: ArrayLike,
    span: Sequence[float],
    focus: float,
    fov_x: float = FIELD_OF_VIEW,
    aspect: float | None = None,
    panel: float | None = None,
) -> tuple[mi.Scene, Camera]:
    """Make a scene of views from a grid of viewpoints, and a camera in the middle of them.

    All viewpoints lie in one plane, and all views show the same part of the plane at the focus, which is parallel to
    it. Between viewpoints the views are interpolated, which is exact at the panel. The outermost views continue beyond
    their viewpoints.

    Parameters
    ----------
    views : array_like, shape (view row, view column, y, x, 3)
        Linear RGB radiance. View rows run down and view columns to the right, as rows and columns of a picture.
    span : sequence of 2 float
        Distances between the first and the last view, to the right and down, meters; 0 where there is one view.
    focus : float
        Distance of the plane at which all views agree, meters; infinite for parallel cameras.
    fov_x : float
        Full horizontal field of view of the view from the middle, radians. Default: that of a 50 mm lens on 36 mm of
        film.
    aspect : float, optional
        Width of a view over its height. Default: its pixels are square.
    panel : float, optional
        Distance of the panel, meters. Default: the focus, if it is finite.

    Returns
    -------
    mitsuba.Scene
    Camera
        At the origin, in the middle of the viewpoints; it looks along -z, y is up.

    Raises
    ------
    InvalidInput
        If the shape is another one, there is one view, a radiance is negative or not finite, or a length or the angle
        is out of range.
    BackendUnavailable
    """
    views = np.asarray(views, np.float32)
    if views.ndim != 5 or views.shape[-1] != 3 or not views.size:
        raise InvalidInput(
            f"The views' array has the shape {views.shape}: give (view row, view column, y, x, 3)."
        )
    rows, columns, height, width, _ = views.shape
    if rows * columns < 2:
        raise InvalidInput("There is one view: give at least two, or make it a picture with depth.")
    if not (np.isfinite(views).all() and (views >= 0).all()):
        raise InvalidInput("The views have colors that are negative or not finite: correct them.")
    for count, length, way in zip((columns, rows), span, ("to the right", "down"), strict=True):
        if not (0 < length < math.inf if count > 1 else length == 0):
            need = "positive and finite" if count > 1 else "0"
            raise InvalidInput(
                f"The span of the views {way} must be {need}, for {count} of them, not {length:g} m."
            )
    if not focus > 0:
        raise InvalidInput(f"The distance at which the views agree must be positive, not {focus:g} m.")
    panel = focus if panel is None else panel
    if not 0 < panel < math.inf:
        raise InvalidInput(
            f"The panel of the views must lie at a positive, finite distance, not at {panel:g} m: choose one in the "
            "middle of what they show."
        )
    if not 0 < fov_x < math.pi:
        raise InvalidInput(
            f"The views' field of view must lie between 0 and 180 degrees, not {math.degrees(fov_x):g}."
        )
    aspect = width / height if aspect is None else aspect
    if not 0 < aspect < math.inf:
        raise InvalidInput(f"The aspect of a view must be positive and finite, not {aspect:g}.")
    variants.activate()
    import mitsuba as mi

    half = math.tan(fov_x / 2) * np.array([1, 1 / aspect])  # half size of a view at depth 1
    steps = [length / max(1, count - 1) for length, count in zip(span, (columns, rows), strict=True)]
    shift_x, shift_y = (1 / focus - 1 / panel) * np.array(steps) / (2 * half)
    texture = {
        "type": "views",
        "bitmap": mi.Bitmap(np.ascontiguousarray(views.reshape(-1, width, 3))),
        "columns": columns,
        "rows": rows,
        "width": float(span[0]),
        "height": float(span[1]),
        "shift_x": float(shift_x),
        "shift_y": float(shift_y),
    }
    # views that do not agree at the panel reach beyond the view of the middle one
    beyond = 2 * REACH * half.min() + abs(1 / focus - 1 / panel) * np.array(span) / 2
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (half + beyond)
    vertices = panel * np.column_stack([corners, np.full(4, -1)])
    uv = 0.5 + 0.5 * corners / half * (1, -1)
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    mesh = shining_mesh("views", vertices.astype(np.float32), triangles, texture, uv=uv.astype(np.float32))
    return variants.made({"type": "scene", "views": mesh}), Camera(np.eye(4), fov_x)
