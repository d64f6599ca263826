"""Entries in Blender's own menus."""

import bpy

from .text import layout_of


class HOLOPATH_MT_demos(bpy.types.Menu):
    """Menu Add > HoloPath Demo."""

    bl_label = "HoloPath Demo"

    def draw(self, context: bpy.types.Context):
        layout_of(self).operator_enum("holopath.add_demo", "name")


def _add_menu(self, context):
    layout_of(self).menu(HOLOPATH_MT_demos.__name__, icon="SCENE_DATA")
    layout_of(self).operator("holopath.choose_picture", icon="IMAGE_DATA")


def _render_menu(self, context):
    layout_of(self).operator("holopath.render_views", icon="IMAGE_DATA")


def add_to_menus():
    """Add the entries to Blender's menus."""
    bpy.types.VIEW3D_MT_add.append(_add_menu)
    bpy.types.TOPBAR_MT_render.append(_render_menu)


def remove_from_menus():
    """Undo `add_to_menus`."""
    bpy.types.TOPBAR_MT_render.remove(_render_menu)
    bpy.types.VIEW3D_MT_add.remove(_add_menu)


CLASSES = (HOLOPATH_MT_demos,)
