"""Sketch of the bench in the 3D View, at its lower left."""

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
# Lengths in pixels, at an interface scale of 1.
_DASH = (5.0, 4.0)  # length of a dash, and of a gap
_MARGIN = 16.0
_MIN_WIDTH = 300.0  # narrower sketches are left out
_PLATE_OPACITY = 0.75


@lru_cache(maxsize=4)
def sketch(hologram, width, scale):
    """Sketch of a bench.

    Parameters
    ----------
    hologram : engine.Hologram
        Hologram with the bench.
    width : float
        Pixels.
    scale : float
        Blender's interface scale.

    Returns
    -------
    bench_sketch.Drawing
    """
    font = bench_sketch.FONT * scale
    blf.size(0, font)
    return bench_sketch.drawing(hologram, lambda text: blf.dimensions(0, text)[0], width, font)


def pieces(drawing, scale):
    """Group a drawing for the graphics card: triangles by color and opacity, line segments by color and width.

    Parameters
    ----------
    drawing : bench_sketch.Drawing
    scale : float
        Blender's interface scale.

    Returns
    -------
    areas : dict of (role, opacity) to numpy.ndarray, shape (n, 2)
        Corners of triangles, pixels to the right and down.
    lines : dict of (role, width) to numpy.ndarray, shape (n, 2)
        Ends of segments.
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
    return {key: np.array(points) for key, points in areas.items()}, {
        key: np.array(points) for key, points in lines.items()
    }


def _dashes(start, end, scale):
    """Ends of the dashes between two points."""
    length = math.dist(start, end)
    dash, period = _DASH[0] * scale, sum(_DASH) * scale
    if not length:
        return []
    starts = np.arange(0.0, length, period)
    fractions = np.stack([starts, np.minimum(starts + dash, length)], 1).ravel() / length
    return list(start + fractions[:, None] * (end - start))


def visible_hologram(context):
    """The `engine.Hologram` whose bench the 3D View of a `bpy.types.Context` shows, or None."""
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
    """Draw the sketch in the current 3D View, if it is on."""
    context = bpy.context
    region, preferences, hologram = context.region, context.preferences, visible_hologram(context)
    if region is not None and preferences is not None and hologram is not None:
        draw_sketch(hologram, region, preferences.system.ui_scale)


def draw_sketch(hologram, region, scale):
    """Draw the sketch of a bench at the lower left of a region.

    Parameters
    ----------
    hologram : engine.Hologram
    region : bpy.types.Region
    scale : float
        Blender's interface scale.
    """
    margin = _MARGIN * scale
    width = min(bench_sketch.WIDTH * scale, region.width - 4 * margin)
    if width < _MIN_WIDTH * scale:
        return
    drawing = sketch(hologram, width, scale)
    left, top = 2 * margin, 2 * margin + drawing.height
    draw_plate(margin, margin, drawing.width + 2 * margin, drawing.height + 2 * margin, _PLATE_OPACITY)
    areas, lines = pieces(drawing, scale)
    surface = gpu.shader.from_builtin("UNIFORM_COLOR")
    outline = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    try:
        for (role, opacity), points in areas.items():
            surface.uniform_float("color", (*_color(role), opacity))
            batch_for_shader(surface, "TRIS", {"pos": _corners(points, left, top)}).draw(surface)
        # pyrefly: ignore[unsupported-operation]  # Blender's stubs return nothing
        outline.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        for (role, line_width), points in lines.items():
            outline.uniform_float("lineWidth", line_width * scale)
            outline.uniform_float("color", (*_color(role), 1.0))
            batch_for_shader(outline, "LINES", {"pos": _corners(points, left, top)}).draw(outline)
    finally:
        gpu.state.blend_set("NONE")
    blf.size(0, bench_sketch.FONT * scale)
    blf.color(0, *_INK, 1.0)
    for text in drawing.texts:
        blf.position(0, left + text.x, top - text.y, 0)
        blf.draw(0, text.text)


def _color(role):
    return _INK if role == bench_sketch.INK else bench_sketch.COLORS[role]


def _corners(points, left, top):
    """Points of a drawing in the region, whose y axis points up."""
    return [(left + x, top - y, 0.0) for x, y in points]
