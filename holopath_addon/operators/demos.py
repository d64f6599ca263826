"""Operator of Add > HoloPath Demo: example scenes, each as a new scene of the file."""

import bpy
from bpy.props import EnumProperty

from ..blender import demo, properties
from . import focus_list
from .modal_operator import check_poll


class HOLOPATH_OT_add_demo(bpy.types.Operator):
    """Add an example scene to the file, ready for Render Hologram, and show it; other scenes stay as they are"""

    bl_idname = "holopath.add_demo"
    bl_label = "Add HoloPath Demo"
    bl_options = {"UNDO"}

    name: EnumProperty(
        name="Demo",
        description="Example scene to add",
        items=[
            (name, name.title(), text[:1].upper() + text[1:], number)
            for number, (name, text) in enumerate(demo.DEMOS.items())
        ],
    )

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return check_poll(cls, context.mode == "OBJECT", "Change to Object Mode first")

    def execute(self, context: bpy.types.Context):
        scene = demo.add(self.name)
        # pyrefly: ignore[bad-assignment]  # Blender's stubs know no engines of others
        scene.render.engine = "HOLOPATH"
        distances = demo.FOCUS[self.name]
        properties.note_focus(properties.of(scene), distances[0])
        for distance in distances:
            focus_list.add(properties.of(scene), distance)
        if context.window is not None:
            context.window.scene = scene
        space = context.space_data
        if isinstance(space, bpy.types.SpaceView3D) and space.region_3d is not None:
            space.region_3d.view_perspective = "CAMERA"
        return {"FINISHED"}


CLASSES = (HOLOPATH_OT_add_demo,)
