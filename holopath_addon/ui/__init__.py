"""Panels of the 3D View, the Properties and the Image Editor; menu entries; overlays of the 3D View."""

from . import display_presets, engine_panels, focus_list, menus, panels
from .menus import add_to_menus, remove_from_menus
from .overlay import hide_overlay, show_overlay
from .shared_panels import share_panels, unshare_panels

CLASSES = (
    *display_presets.CLASSES,
    *focus_list.CLASSES,
    *menus.CLASSES,
    *panels.CLASSES,
    *engine_panels.CLASSES,
)

__all__ = [
    "CLASSES",
    "add_to_menus",
    "hide_overlay",
    "remove_from_menus",
    "share_panels",
    "show_overlay",
    "unshare_panels",
]
