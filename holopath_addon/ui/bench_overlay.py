"""The sketch of the bench in the 3D View, at its lower left."""

import math
from collections import defaultdict
from functools import lru_cache

import blf
import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from .. import engine
from ..blender import properties
from ..engine.viewing import bench_sketch
from .plates import draw_plate, tab_open

_INK = (0.9, 0.9, 0.9)
_DASH = (5.0, 4.0)  # pixels of a dash, and between two, at a scale of 1
_MARGIN, _PLATE = 16.0, 0.75  # pixels around it, and how dark what is behind it becomes
_NARROWEST = 300.0  # pixels: a view that is less wide has none


@lru_cache(maxsize=4)
def sketch(hologram, width, scale):
    """`bench_sketch.Drawing` for a view that is so many pixels wide; `scale` is that of the interface."""
    font = bench_sketch.FONT * scale
    blf.size(0, font)
    return bench_sketch.drawing(hologram, lambda text: blf.dimensions(0, text)[0], width, font)


def pieces(drawing, scale):
    """What is drawn together: triangles by color and opacity, and pairs of a line's ends by color and width.

    Parameters
    ----------
    drawing : bench_sketch.Drawing
    scale : float

    Returns
    -------
    areas, lines : dict
        (role, opacity) or (role, width) to arrays of shape (n, 2), of pixels to the right and down.
    """
    areas, lines = defaultdict(list), defaultdict(list)
    for line in drawing.lines:
        points = line.points
        if line.opacity:
            for second, third in zip(points[1:-1], points[2:], strict=True):
                areas[line.role, line.opacity] += [points[0], second, third]
            continue
        for start, end in zip(points[:-1], points[1:], strict=True):
            lines[line.role, line.width] += _dashes(start, end, scale) if line.dashed else [start, end]
    return {key: np.array(found) for key, found in areas.items()}, {
        key: np.array(found) for key, found in lines.items()
    }


def _dashes(start, end, scale):
    """Ends of the dashes between two points."""
    length = math.dist(start, end)
    dash, period = _DASH[0] * scale, sum(_DASH) * scale
    if not length:
        return []
    begins = np.arange(0.0, length, period)
    shares = np.stack([begins, np.minimum(begins + dash, length)], 1).ravel() / length
    return list(start + shares[:, None] * (end - start))


def wanted(context):
    """The hologram whose bench is to be drawn in the context's 3D View, or None."""
    space, scene = context.space_data, context.scene
    if not (space.overlay.show_overlays and properties.of(scene).show_bench):
        return None
    if not (scene.render.engine == "HOLOPATH" or tab_open(context.area, space)):
        return None
    try:
        return properties.hologram_of(properties.of(scene))
    except (engine.InvalidInput, engine.BackendUnavailable):  # which the panel says
        return None


def draw_bench():
    """Draw it where it is wanted."""
    context = bpy.context
    region, preferences, hologram = context.region, context.preferences, wanted(context)
    if region is not None and preferences is not None and hologram is not None:
        draw_sketch(hologram, region, preferences.system.ui_scale)


def draw_sketch(hologram, region, scale):
    """Draw the sketch of a hologram's bench in pixels of a region."""
    margin = _MARGIN * scale
    width = min(bench_sketch.WIDTH * scale, region.width - 4 * margin)
    if width < _NARROWEST * scale:
        return
    drawing = sketch(hologram, width, scale)
    place, top = 2 * margin, 2 * margin + drawing.height
    draw_plate(margin, margin, drawing.width + 2 * margin, drawing.height + 2 * margin, _PLATE)
    areas, lines = pieces(drawing, scale)
    surface = gpu.shader.from_builtin("UNIFORM_COLOR")
    outline = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    try:
        for (role, opacity), points in areas.items():
            surface.uniform_float("color", (*_color(role), opacity))
            batch_for_shader(surface, "TRIS", {"pos": _placed(points, place, top)}).draw(surface)
        # pyrefly: ignore[unsupported-operation]  # Blender's stubs return nothing
        outline.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        for (role, thick), points in lines.items():
            outline.uniform_float("lineWidth", thick * scale)
            outline.uniform_float("color", (*_color(role), 1.0))
            batch_for_shader(outline, "LINES", {"pos": _placed(points, place, top)}).draw(outline)
    finally:
        gpu.state.blend_set("NONE")
    blf.size(0, bench_sketch.FONT * scale)
    blf.color(0, *_INK, 1.0)
    for text in drawing.texts:
        blf.position(0, place + text.x, top - text.y, 0)
        blf.draw(0, text.text)


def _color(role):
    return _INK if role == bench_sketch.INK else bench_sketch.COLORS[role]


def _placed(points, left, top):
    """Corners in the region, whose pixels count upwards."""
    return [(left + x, top - y, 0.0) for x, y in points]
