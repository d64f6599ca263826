"""What can be done with a rendered wave field without rendering again."""

from pathlib import Path

import bpy
from bpy.props import StringProperty

from .. import engine, properties
from ..export import unit_scale
from . import session


class HOLOPATH_OT_refocus(bpy.types.Operator):
    """Refocus the stored wave field and show it, without rendering again"""

    bl_idname = "holopath.refocus"
    bl_label = "Refocus"

    @classmethod
    def poll(cls, context):
        if session.current.field is None:
            cls.poll_message_set("Render a hologram first")
            return False
        return True

    def execute(self, context):
        props = context.scene.holopath
        try:
            session.refocus(properties.focus_of(props), properties.pupil_or_none(props))
        except Exception as error:
            self.report({"ERROR"}, session.fail(error))
            return {"CANCELLED"}
        session.redraw()
        return {"FINISHED"}


class HOLOPATH_OT_save_field(bpy.types.Operator):
    """Write the stored wave field to a folder: field.npy and meta.json"""

    bl_idname = "holopath.save_field"
    bl_label = "Save Wave Field"

    directory: StringProperty(name="Folder", description="Where to save", subtype="DIR_PATH")

    @classmethod
    def poll(cls, context):
        if session.current.field is None:
            cls.poll_message_set("Render a hologram first")
            return False
        return True

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        try:
            if not self.directory:
                raise engine.InvalidInput("No folder is given: choose one to save the wave field in.")
            folder = Path(bpy.path.abspath(self.directory)) / "wavefield"
            session.current.field.save(folder)
        except Exception as error:
            self.report({"ERROR"}, session.fail(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Wave field saved in {folder}.")
        return {"FINISHED"}


class HOLOPATH_OT_focus_from_selected(bpy.types.Operator):
    """Focus at the distance of the active object from the camera"""

    bl_idname = "holopath.focus_from_selected"
    bl_label = "Focus on Active Object"

    @classmethod
    def poll(cls, context):
        if context.scene.camera is None or context.active_object is None:
            cls.poll_message_set("Select an object, and give the scene a camera")
            return False
        return context.active_object is not context.scene.camera

    def execute(self, context):
        camera = context.scene.camera.matrix_world
        offset = context.active_object.matrix_world.translation - camera.translation
        depth = -offset.dot(camera.to_3x3().col[2].normalized()) * unit_scale(context.scene)
        if depth <= 0:
            name = context.active_object.name
            self.report({"ERROR"}, f"'{name}' is behind the camera: select another object.")
            return {"CANCELLED"}
        properties.set_focus(context.scene.holopath, depth)
        return {"FINISHED"}


CLASSES = (HOLOPATH_OT_refocus, HOLOPATH_OT_save_field, HOLOPATH_OT_focus_from_selected)
