"""From Blender's evaluated scene to a Mitsuba scene and the engine's camera."""

from .notes import Note
from .scene import Exported, export_scene, unit_scale

__all__ = ["Exported", "Note", "export_scene", "unit_scale"]
