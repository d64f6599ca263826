"""Fields and phases in files of other programs, see docs/files.md. Imports no bpy.

`containers` has the kinds of files: named arrays with attributes; `pictures` reads some of them. `parts` finds the
arrays that make a field, `phases` the unit of their numbers, and `conventions` the order of their axes. `holograms`
converts to `WaveField` and `PhaseHologram`, and back. `optics` reads the bench, and `prints` writes pictures for film.
"""

from .containers import READABLE, SUFFIXES, Container, read, write
from .conventions import CONVENTIONS, Convention
from .holograms import ReadOptions, container_of, hologram_of
from .optics import parse_beam, parse_carrier, parse_colors, parse_lens, parse_stop
from .parts import read_parts

__all__ = [
    "CONVENTIONS",
    "READABLE",
    "SUFFIXES",
    "Container",
    "Convention",
    "ReadOptions",
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
