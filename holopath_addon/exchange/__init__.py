"""Fields and phases in files that other programs read and write, see docs/files.md. Imports no bpy.

`containers` are kinds of files: named arrays, and words and numbers beside them; `pictures` reads some of them. `parts`
says which arrays make a field, `phases` what their numbers mean, `conventions` how programs lay out a complex field.
`holograms` brings all to `WaveField` and `PhaseHologram`, and back. `optics` reads the bench,
and `prints` writes pictures for film.
"""

from .containers import READABLE, SUFFIXES, Container, read, write
from .conventions import CONVENTIONS, Convention
from .holograms import Given, container_of, hologram_of
from .optics import parse_beam, parse_carrier, parse_colors, parse_lens, parse_stop
from .parts import read_parts

__all__ = [
    "CONVENTIONS",
    "READABLE",
    "SUFFIXES",
    "Container",
    "Convention",
    "Given",
    "container_of",
    "hologram_of",
    "parse_beam",
    "parse_carrier",
    "parse_colors",
    "parse_lens",
    "parse_stop",
    "read",
    "read_parts",
    "write",
]
