"""From Blender's evaluated scene to a Mitsuba scene and the engine's camera."""

from .cache import ExportCache
from .notes import Note
from .scene import Exported, Reading, export_scene, read_scene, unit_scale

__all__ = ["ExportCache", "Exported", "Note", "Reading", "export_scene", "read_scene", "unit_scale"]
