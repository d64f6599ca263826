"""Overlay of the 3D View: focus distances, the near end, and the pupil at the camera."""

import math
from dataclasses import dataclass, replace
from typing import Any

import blf
import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader

from .. import engine
from ..blender import properties
from ..blender.properties import focus_list_of, focus_of, hologram_of, pitch_of, pupil_or_none
from ..engine.hologram import channel
from ..engine.mapping import DepthMapping
from ..engine.pixels import axes
from ..export import find_camera, unit_scale, view_of
from ..operators import session
from .bench_overlay import draw_bench
from .plates import draw_plate, tab_open

_FOCUS = (1.0, 0.6, 0.15)
_LISTED_FOCUS = (0.35, 0.75, 1.0)
_NEAR_END = (0.85, 0.85, 0.85)
_PARTIAL_PUPIL = (1.0, 0.9, 0.3)
_CHANNELS = ((1.0, 0.35, 0.3), (0.4, 0.9, 0.4), (0.45, 0.55, 1.0))
_HIDDEN_OPACITY = 0.25  # opacity of a line behind a surface
_CIRCLE_CORNERS = 64
_LABEL_SIZE = 12  # points, at an interface scale of 1

_handlers = []


@dataclass(frozen=True)
class Outline:
    """Closed line to draw, with its surface.

    Attributes
    ----------
    corners : numpy.ndarray, shape (n, 3)
        World coordinates in Blender units. The label stands at the first.
    color : tuple of float
        Red, green, blue.
    opacity : float
        Opacity of the surface; 0: none.
    label : str
        May be empty.
    at_camera : bool
        Whether it lies in the plane of the camera's pupil, which that camera does not see.
    """

    corners: np.ndarray
    color: tuple
    opacity: float
    label: str
    at_camera: bool = False


def outlines(scene):
    """Outlines of a scene: the pupil, then frames, nearest first. Evaluates nothing.

    Parameters
    ----------
    scene : bpy.types.Scene

    Returns
    -------
    list of Outline

    Raises
    ------
    engine.InvalidInput
        If the scene has no camera for a hologram.
    """
    props, scale = properties.of(scene), unit_scale(scene)
    try:
        hologram = hologram_of(props)
    except (engine.InvalidInput, engine.BackendUnavailable):
        hologram, (down, across) = None, axes(pitch_of(props))
        size = (props.resolution_x * across, props.resolution_y * down)
    else:
        picture = hologram.picture
        size = (picture.width * picture.pitch_x, picture.height * picture.pitch_y)
    camera = view_of(find_camera(scene), size, scale)
    focus = focus_of(props)
    listed = [distance for distance in focus_list_of(props) if distance != focus]
    drawn = [(distance, _LISTED_FOCUS, 0.05, _distance(distance)) for distance in listed]
    drawn.append((focus, _FOCUS, 0.1, _distance(focus)))
    circles = []
    mapping = None if hologram is None else _mapping(hologram, camera, session.plan_of(scene))
    if hologram is not None and mapping is not None:
        near = float(mapping.z_to_depth(hologram.depth_near))
        drawn.append((near, _NEAR_END, 0.0, f"Near End {_distance(near)}"))
        circles = _pupil(props, hologram, mapping, camera, scale)
    drawn.sort(key=lambda row: row[0])
    frames = [
        Outline(_frame(camera, depth, size) / scale, color, opacity, label)
        for depth, color, opacity, label in drawn
    ]
    return circles + frames


def _mapping(hologram, camera, plan):
    """The hologram's depth mapping; None if the settings leave it open."""
    near = hologram.near or (plan.near if plan else None)
    if near is None and hologram.depth_mapping == "fit":
        return None
    return DepthMapping.of(hologram, camera, near)


def _pupil(props, hologram, mapping, camera, scale):
    """Outlines of the pupil that each color's light fills behind the stop, and of the chosen part of it."""
    x, y, open_radius = hologram.optics.stop_circle
    whole = {w: mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths}
    radii = {w: open_radius * radius for w, radius in whole.items()}
    min_radius, max_radius = min(radii.values()), max(radii.values())
    unit, size = ("m", 1.0) if max_radius >= 0.5 else ("mm", 1e3)
    ends = (f"{2 * size * radius:.3g}" for radius in (min_radius, max_radius))
    label = f"Pupil {' to '.join(dict.fromkeys(ends))} {unit}"
    circles = []
    for wavelength, radius in sorted(radii.items(), key=lambda row: -row[1]):
        corners = _circle(camera, x * whole[wavelength], y * whole[wavelength], radius) / scale
        circles.append(Outline(corners, _CHANNELS[channel(wavelength)], 0.0, label, at_camera=True))
        label = ""  # one label for all
    part = pupil_or_none(props)
    if part is not None:
        corners = _circle(camera, part.x, part.y, part.diameter / 2) / scale
        circles.append(
            Outline(
                corners, _PARTIAL_PUPIL, 0.15, f"Partial Pupil {part.diameter * 1e3:.3g} mm", at_camera=True
            )
        )
    return circles


def _frame(camera, depth, size):
    """Corners of the view at a depth, meters, from the top left on; at the far clipping plane if that is nearer."""
    depth = min(depth, camera.clip_end)
    right, up, forward = camera.axes
    across, height = 2 * math.tan(camera.fov_x / 2), size[1] / size[0]
    return np.stack(
        [
            camera.position
            + depth
            * (forward + right * across * (camera.shift_x + x) + up * across * (camera.shift_y + y * height))
            for x, y in ((-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5))
        ]
    )


def _circle(camera, x, y, radius):
    """Corners of a circle; its center and radius are in meters, right of and above the camera's axis."""
    right, up, _ = camera.axes
    angles = 2 * math.pi * np.arange(_CIRCLE_CORNERS) / _CIRCLE_CORNERS
    around = (np.cos(angles) * radius + x)[:, None] * right + (np.sin(angles) * radius + y)[:, None] * up
    return camera.position + around


def _distance(meters):
    """Label of a distance: ``0.5 m (2 D)``."""
    return "∞ (0 D)" if math.isinf(meters) else f"{meters:.3g} m ({1 / meters:.3g} D)"


# -- drawing


def _visible_outlines(context):
    """Outlines to draw in the context's 3D View."""
    space, scene = context.space_data, context.scene
    if not (space.overlay.show_overlays and properties.of(scene).show_overlay):
        return []
    if not (scene.render.engine == "HOLOPATH" or tab_open(context.area, space)):
        return []
    try:
        found = outlines(scene)
    except engine.InvalidInput:
        return []
    if context.region_data.view_perspective != "CAMERA":
        return found
    # Frames fill the view: only that of the focus is tinted, or the scene would be hard to see.
    return [
        outline if outline.color == _FOCUS else replace(outline, opacity=0.0)
        for outline in found
        if not outline.at_camera
    ]


def _draw_lines():
    """Draw outlines, faint behind surfaces, and their areas; in world space."""
    visible = _visible_outlines(bpy.context)
    preferences = bpy.context.preferences
    if not visible or preferences is None:
        return
    lines = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    surface = gpu.shader.from_builtin("UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    try:
        for test, strength in (("NONE", _HIDDEN_OPACITY), ("LESS_EQUAL", 1.0)):
            gpu.state.depth_test_set(test)
            # pyrefly: ignore[unsupported-operation]  # Blender's stubs return nothing
            lines.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
            lines.uniform_float("lineWidth", 1.5 * preferences.system.ui_scale)
            for outline in visible:
                corners: Any = outline.corners.astype(np.float32)  # Blender's stubs take lists alone
                count = len(corners)
                lines.uniform_float("color", (*outline.color, strength))
                pairs = [(i, (i + 1) % count) for i in range(count)]
                batch_for_shader(lines, "LINES", {"pos": corners}, indices=pairs).draw(lines)
                if outline.opacity and test != "NONE":
                    fan = [(0, i, i + 1) for i in range(1, count - 1)]
                    surface.uniform_float("color", (*outline.color, outline.opacity))
                    batch_for_shader(surface, "TRIS", {"pos": corners}, indices=fan).draw(surface)
    finally:
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")


def _draw_labels():
    """Draw labels beside and below their corners, and below other labels there; in pixels."""
    context = bpy.context
    region, view, preferences = context.region, context.region_data, context.preferences
    if region is None or view is None or preferences is None:
        return
    scale = preferences.system.ui_scale
    blf.size(0, _LABEL_SIZE * scale)
    taken = []
    for outline in _visible_outlines(context):
        place = location_3d_to_region_2d(region, view, outline.corners[0])
        if not outline.label or place is None:
            continue
        width, height = blf.dimensions(0, outline.label)[0], 1.3 * _LABEL_SIZE * scale
        x, y = place.x + 6 * scale, place.y - height
        while any(abs(y - v) < height and x < u + w and u < x + width for u, v, w in taken):
            y -= height
        taken.append((x, y, width))
        draw_plate(x - 4 * scale, y - 0.3 * height, width + 8 * scale, height)
        red, green, blue = outline.color
        blf.color(0, red, green, blue, 1.0)
        blf.position(0, x, y, 0)
        blf.draw(0, outline.label)


def show_overlay():
    """Start drawing in 3D Views."""
    functions = (_draw_lines, "POST_VIEW"), (_draw_labels, "POST_PIXEL"), (draw_bench, "POST_PIXEL")
    for draw, when in functions:
        _handlers.append(bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", when))


def hide_overlay():
    """Undo `show_overlay`."""
    while _handlers:
        bpy.types.SpaceView3D.draw_handler_remove(_handlers.pop(), "WINDOW")
