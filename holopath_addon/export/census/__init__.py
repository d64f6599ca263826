"""The census of Blender's properties: the effect of each one on a hologram, and notes on it."""

from .table import CARRIED, NOTED, WITHOUT, add_notes, row_of, section_of, sections

__all__ = [
    "CARRIED",
    "NOTED",
    "WITHOUT",
    "add_notes",
    "row_of",
    "section_of",
    "sections",
]
