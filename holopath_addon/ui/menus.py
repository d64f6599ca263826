"""Entries in Blender's own menus."""

import bpy


class HOLOPATH_MT_demos(bpy.types.Menu):
    """Add > HoloPath Demo."""

    bl_label = "HoloPath Demo"

    def draw(self, context):
        self.layout.operator_enum("holopath.add_demo", "name")


def _add_menu(self, context):
    self.layout.menu(HOLOPATH_MT_demos.__name__, icon="SCENE_DATA")


def add_to_menus():
    """Add the entries."""
    bpy.types.VIEW3D_MT_add.append(_add_menu)


def remove_from_menus():
    """Undo `add_to_menus`."""
    bpy.types.VIEW3D_MT_add.remove(_add_menu)


CLASSES = (HOLOPATH_MT_demos,)
