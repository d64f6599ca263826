"""A scene of a file, ready to render."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import mitsuba as mi

    from ..engine import Camera


@dataclass(frozen=True)
class BuiltScene:
    """A scene of a file, ready to render.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    notes : list of dict
        Defaults, approximations and omissions: object, feature, effect, material, see `export.Note`.
    """

    scene: mi.Scene
    camera: Camera
    notes: list = field(default_factory=list)
