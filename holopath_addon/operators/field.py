"""Operators on a rendered wave field: refocus and save it, without rendering again."""

import math
import time

import bpy

from .. import engine
from ..blender import properties
from ..export import depth_of, find_camera, unit_scale
from . import session
from .long_modal import LongModal
from .modal_operator import SaveOperator, check_poll, has_field, is_free, report_error


class HOLOPATH_OT_refocus(bpy.types.Operator):
    """Refocus the stored wave field and show it, without rendering again"""

    bl_idname = "holopath.refocus"
    bl_label = "Refocus"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return has_field(cls)

    def execute(self, context: bpy.types.Context):
        props = properties.of(context.scene)
        try:
            session.refocus(*properties.reconstruction_of(props))
        except Exception as error:
            return report_error(self, session.record_error(error))
        session.redraw()
        return {"FINISHED"}


class HOLOPATH_OT_save_field(SaveOperator, bpy.types.Operator):
    """Write the stored wave field to a folder: field.npy and meta.json"""

    bl_idname = "holopath.save_field"
    bl_label = "Save Wave Field"
    kind = "wave field"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return has_field(cls) and super().poll(context)

    def content(self):
        return session.stored_refocuser().field

    @staticmethod
    def write(content, folder, progress):
        progress(0.0, "Writing the wave field")
        content.save(folder)


class HOLOPATH_OT_focus_from_selected(bpy.types.Operator):
    """Focus at the distance of the active object from the camera"""

    bl_idname = "holopath.focus_from_selected"
    bl_label = "Focus on Active Object"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context):
        scene, target = context.scene, context.active_object
        camera = scene and scene.camera
        both = camera is not None and target is not None and target != camera
        return check_poll(cls, both, "Select an object other than the camera, and give the scene a camera")

    def execute(self, context: bpy.types.Context):
        scene, target = context.scene, context.active_object
        assert scene is not None and target is not None  # by `poll`
        try:
            depth = depth_of(find_camera(scene), target, unit_scale(scene))
        except engine.InvalidInput as error:
            return report_error(self, str(error))
        if depth <= 0:
            return report_error(self, f"'{target.name}' is behind the camera: select another object.")
        properties.set_focus(properties.of(scene), depth)
        return {"FINISHED"}


class HOLOPATH_OT_sweep(LongModal, bpy.types.Operator):
    """Move the focus back and forth between the nearest and the farthest thing in view; press again, or Esc, to stop"""

    bl_idname = "holopath.sweep"
    bl_label = "Play Focus"

    PERIOD = 8.0  # seconds, back and forth

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return has_field(cls) and is_free(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Start, or stop the running one."""
        if self.resume():
            return self.become_modal()
        if session.current.sweep_timer is not None:
            session.stop_sweep()
            return {"FINISHED"}
        assert context.scene is not None  # otherwise there is nothing to refocus
        self._near, self._far = session.current.diopter_range
        self._scene, self._started = context.scene.name, time.monotonic()
        self._sweep = session.current.sweep_timer = bpy.data.window_managers[0].event_timer_add(
            0.05, window=context.window
        )
        return self.become_modal()

    def modal(self, context: bpy.types.Context, event: bpy.types.Event):
        """Request the next focus when the last one is shown."""
        stopped = event.type == "ESC" and event.value == "PRESS"
        scene = bpy.data.scenes.get(self._scene)
        if stopped or scene is None or session.current.field is None or session.running():
            session.stop_sweep(self._sweep)
        if scene is None or session.current.sweep_timer is not self._sweep:
            return {"FINISHED", "PASS_THROUGH"}
        if event.type == "TIMER" and self.make_way():
            return {"FINISHED", "PASS_THROUGH"}
        if event.type == "TIMER" and not session.is_refocusing():
            angle = 2 * math.pi * (time.monotonic() - self._started) / self.PERIOD
            weight = 0.5 + 0.5 * math.cos(angle)
            diopters = self._far + (self._near - self._far) * weight
            properties.note_focus(properties.of(scene), 1 / max(diopters, 1e-9))
            session.refocus_by_settings(properties.of(scene))
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context):
        """End the operator for Blender: the window closes or another file is opened."""
        session.stop_sweep(self._sweep)


CLASSES = (HOLOPATH_OT_refocus, HOLOPATH_OT_sweep, HOLOPATH_OT_save_field, HOLOPATH_OT_focus_from_selected)
