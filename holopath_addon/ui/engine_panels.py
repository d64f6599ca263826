"""Panels of the render engine HOLOPATH only: its passes and its animations."""

import bpy

from ..blender import properties
from .text import split_layout_of


class EnginePanel:
    """Base of panels of the Properties for the render engine HoloPath."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    COMPAT_ENGINES = {"HOLOPATH"}

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return context.engine in cls.COMPAT_ENGINES


class HOLOPATH_PT_passes(EnginePanel, bpy.types.Panel):
    """Passes of F12 beside the picture, in the View Layer properties."""

    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context):
        layout, layer = split_layout_of(self), properties.of_layer(context.view_layer)
        column = layout.column(heading="Pictures", align=True)
        column.prop(layer, "use_pass_focus")
        column = layout.column(heading="Wave Field", align=True)
        column.prop(layer, "use_pass_phase")
        column.prop(layer, "use_pass_amplitude")
        column = layout.column(heading="Scene", align=True)
        column.prop(layer, "use_pass_depth")


class HOLOPATH_PT_animation(EnginePanel, bpy.types.Panel):
    """Wave fields that animation renders keep, below Blender's own output of pictures."""

    bl_label = "Wave Fields"
    bl_context = "output"
    bl_parent_id = "RENDER_PT_output"

    def draw(self, context: bpy.types.Context):
        layout, props = split_layout_of(self), properties.of(context.scene)
        layout.prop(props, "keep_fields", text="Keep")
        row = layout.row()
        row.active = props.keep_fields
        row.prop(props, "animation_folder", text="Folder")


CLASSES = (HOLOPATH_PT_passes, HOLOPATH_PT_animation)
