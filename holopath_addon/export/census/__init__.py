"""The census of what Blender can say: what becomes of each property, and the notes that follow from it."""

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
