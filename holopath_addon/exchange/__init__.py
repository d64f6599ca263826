"""Fields and phases in files that other programs read and write, see docs/files.md. Imports no bpy.

`containers` are kinds of files: named arrays, and words and numbers beside them. `conventions` are the ways in which
programs lay out a complex field. `holograms` brings both to `WaveField` and `PhaseHologram`, and back.
"""

from .containers import SUFFIXES, Container, read, write
from .conventions import CONVENTIONS, Convention
from .holograms import Given, container_of, hologram_of

__all__ = [
    "CONVENTIONS",
    "SUFFIXES",
    "Container",
    "Convention",
    "Given",
    "container_of",
    "hologram_of",
    "read",
    "write",
]
