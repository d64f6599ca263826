"""What the 3D View shows of the hologram: focus distances, the near end, the pupil at the camera."""

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
_LISTED = (0.35, 0.75, 1.0)
_NEAR = (0.85, 0.85, 0.85)
_PART = (1.0, 0.9, 0.3)
_CHANNELS = ((1.0, 0.35, 0.3), (0.4, 0.9, 0.4), (0.45, 0.55, 1.0))
_HIDDEN = 0.25  # how much is seen of a line behind a surface
_CIRCLE = 64  # corners
_SIZE = 12  # of labels, at a scale of 1

_handlers = []


@dataclass(frozen=True)
class Outline:
    """A closed line to draw, with its surface.

    Attributes
    ----------
    corners : numpy.ndarray, shape (n, 3)
        World places in Blender units; the label stands at the first.
    colour : tuple of float
        Red, green, blue.
    opacity : float
        Of its surface; 0: none.
    label : str
        May be empty.
    at_camera : bool
        Whether it lies in the plane of the camera's pupil, which is not seen through that camera.
    """

    corners: np.ndarray
    colour: tuple
    opacity: float
    label: str
    at_camera: bool = False


def outlines(scene):
    """All that is drawn for a scene: the pupil, then frames, nearest first. Evaluates nothing.

    Parameters
    ----------
    scene : bpy.types.Scene

    Returns
    -------
    list of Outline

    Raises
    ------
    engine.InvalidInput
        Where the scene has no camera for a hologram.
    """
    props, scale = properties.of(scene), unit_scale(scene)
    down, across = axes(pitch_of(props))
    size = (props.resolution_x * across, props.resolution_y * down)
    camera = view_of(find_camera(scene), size, scale)
    focus = focus_of(props)
    listed = [distance for distance in focus_list_of(props) if distance != focus]
    drawn = [(distance, _LISTED, 0.05, _distance(distance)) for distance in listed]
    drawn.append((focus, _FOCUS, 0.1, _distance(focus)))
    circles = []
    mapped = _mapping(props, camera, session.plan_of(scene))
    if mapped is not None:
        mapping, hologram = mapped
        near = float(mapping.z_to_depth(hologram.depth_near))
        drawn.append((near, _NEAR, 0.0, f"Near End {_distance(near)}"))
        circles = _pupil(props, hologram, mapping, camera, scale)
    drawn.sort(key=lambda row: row[0])
    frames = [
        Outline(_frame(camera, depth, size) / scale, colour, opacity, label)
        for depth, colour, opacity, label in drawn
    ]
    return circles + frames


def _mapping(props, camera, plan):
    """The hologram's depth mapping and the hologram; None where the settings do not say."""
    try:
        hologram = hologram_of(props)
    except (engine.InvalidInput, engine.BackendUnavailable):
        return None
    near = hologram.near or (plan.near if plan else None)
    if near is None and hologram.depth_mapping == "fit":
        return None
    return DepthMapping.of(hologram, camera, near), hologram


def _pupil(props, hologram, mapping, camera, scale):
    """The pupil that each colour's light fills, and the part of it that is looked through."""
    radii = {w: mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths}
    least, most = min(radii.values()), max(radii.values())
    unit, size = ("m", 1.0) if most >= 0.5 else ("mm", 1e3)
    ends = (f"{2 * size * radius:.3g}" for radius in (least, most))
    label = f"Pupil {' to '.join(dict.fromkeys(ends))} {unit}"
    circles = []
    for wavelength, radius in sorted(radii.items(), key=lambda row: -row[1]):
        corners = _circle(camera, 0.0, 0.0, radius) / scale
        circles.append(Outline(corners, _CHANNELS[channel(wavelength)], 0.0, label, at_camera=True))
        label = ""  # once for all
    part = pupil_or_none(props)
    if part is not None:
        corners = _circle(camera, part.x, part.y, part.diameter / 2) / scale
        circles.append(
            Outline(corners, _PART, 0.15, f"Partial Pupil {part.diameter * 1e3:.3g} mm", at_camera=True)
        )
    return circles


def _frame(camera, depth, size):
    """Corners of the view at a depth, metres, from the top left on; what is beyond the camera's end, at that end."""
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
    """Corners of a circle about a place to the right of and above the camera's axis, metres."""
    right, up, _ = camera.axes
    angles = 2 * math.pi * np.arange(_CIRCLE) / _CIRCLE
    around = (np.cos(angles) * radius + x)[:, None] * right + (np.sin(angles) * radius + y)[:, None] * up
    return camera.position + around


def _distance(metres):
    """``0.5 m (2 D)``."""
    return "∞ (0 D)" if math.isinf(metres) else f"{metres:.3g} m ({1 / metres:.3g} D)"


# -- drawing


def _wanted(context):
    """What is to be drawn in the context's 3D View."""
    space, scene = context.space_data, context.scene
    if not (space.overlay.show_overlays and properties.of(scene).show_overlay):
        return []
    if not (scene.render.engine == "HOLOPATH" or tab_open(context.area, space)):
        return []
    try:
        wanted = outlines(scene)
    except engine.InvalidInput:
        return []
    if context.region_data.view_perspective != "CAMERA":
        return wanted
    # Frames fill the view: only what is at the focus is tinted, or the scene would be hard to see.
    return [
        outline if outline.colour == _FOCUS else replace(outline, opacity=0.0)
        for outline in wanted
        if not outline.at_camera
    ]


def _draw_lines():
    """In world space: outlines, faint where something hides them, and surfaces."""
    wanted = _wanted(bpy.context)
    preferences = bpy.context.preferences
    if not wanted or preferences is None:
        return
    lines = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    surface = gpu.shader.from_builtin("UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    try:
        for test, strength in (("NONE", _HIDDEN), ("LESS_EQUAL", 1.0)):
            gpu.state.depth_test_set(test)
            # pyrefly: ignore[unsupported-operation]  # Blender's stubs return nothing
            lines.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
            lines.uniform_float("lineWidth", 1.5 * preferences.system.ui_scale)
            for outline in wanted:
                corners: Any = outline.corners.astype(np.float32)  # Blender's stubs take lists alone
                count = len(corners)
                lines.uniform_float("color", (*outline.colour, strength))
                pairs = [(i, (i + 1) % count) for i in range(count)]
                batch_for_shader(lines, "LINES", {"pos": corners}, indices=pairs).draw(lines)
                if outline.opacity and test != "NONE":
                    fan = [(0, i, i + 1) for i in range(1, count - 1)]
                    surface.uniform_float("color", (*outline.colour, outline.opacity))
                    batch_for_shader(surface, "TRIS", {"pos": corners}, indices=fan).draw(surface)
    finally:
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")


def _draw_labels():
    """In pixels: each label beside and below its corner, below others that stand there."""
    context = bpy.context
    region, view, preferences = context.region, context.region_data, context.preferences
    if region is None or view is None or preferences is None:
        return
    scale = preferences.system.ui_scale
    blf.size(0, _SIZE * scale)
    taken = []
    for outline in _wanted(context):
        place = location_3d_to_region_2d(region, view, outline.corners[0])
        if not outline.label or place is None:
            continue
        width, height = blf.dimensions(0, outline.label)[0], 1.3 * _SIZE * scale
        x, y = place.x + 6 * scale, place.y - height
        while any(abs(y - v) < height and x < u + w and u < x + width for u, v, w in taken):
            y -= height
        taken.append((x, y, width))
        draw_plate(x - 4 * scale, y - 0.3 * height, width + 8 * scale, height)
        red, green, blue = outline.colour
        blf.color(0, red, green, blue, 1.0)
        blf.position(0, x, y, 0)
        blf.draw(0, outline.label)


def show_overlay():
    """Begin to draw in 3D Views."""
    drawn = (_draw_lines, "POST_VIEW"), (_draw_labels, "POST_PIXEL"), (draw_bench, "POST_PIXEL")
    for draw, when in drawn:
        _handlers.append(bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", when))


def hide_overlay():
    """Undo `show_overlay`."""
    while _handlers:
        bpy.types.SpaceView3D.draw_handler_remove(_handlers.pop(), "WINDOW")
