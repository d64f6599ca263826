"""Export of Blender's evaluated scene to a Mitsuba scene and the engine's camera."""

from .cache import ExportCache
from .camera import depth_of, find_camera, view_of
from .notes import Note
from .render_state import show_as_rendered
from .scene import ExportedScene, Reading, export_scene, read_scene, unit_scale

__all__ = [
    "ExportCache",
    "ExportedScene",
    "Note",
    "Reading",
    "depth_of",
    "export_scene",
    "find_camera",
    "read_scene",
    "show_as_rendered",
    "unit_scale",
    "view_of",
]
