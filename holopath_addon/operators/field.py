"""What can be done with a rendered wave field without rendering again."""

import math
import time

import bpy

from ..blender import properties
from ..export import depth_of, unit_scale
from . import session
from .working import Saving, free, ready, refused, rendered


class HOLOPATH_OT_refocus(bpy.types.Operator):
    """Refocus the stored wave field and show it, without rendering again"""

    bl_idname = "holopath.refocus"
    bl_label = "Refocus"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return rendered(cls)

    def execute(self, context: bpy.types.Context):
        props = properties.of(context.scene)
        try:
            session.refocus(*properties.seen_of(props))
        except Exception as error:
            return refused(self, session.fail(error))
        session.redraw()
        return {"FINISHED"}


class HOLOPATH_OT_save_field(Saving, bpy.types.Operator):
    """Write the stored wave field to a folder: field.npy and meta.json"""

    bl_idname = "holopath.save_field"
    bl_label = "Save Wave Field"
    thing = "wave field"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return rendered(cls) and super().poll(context)

    def what(self):
        return session.rendered().field

    @staticmethod
    def write(what, folder, progress):
        progress(0.0, "Writing the wave field")
        what.save(folder)


class HOLOPATH_OT_focus_from_selected(bpy.types.Operator):
    """Focus at the distance of the active object from the camera"""

    bl_idname = "holopath.focus_from_selected"
    bl_label = "Focus on Active Object"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        scene, thing = context.scene, context.active_object
        camera = scene and scene.camera
        there = camera is not None and thing is not None
        return ready(cls, there, "Select an object, and give the scene a camera") and thing is not camera

    def execute(self, context: bpy.types.Context):
        scene, thing = context.scene, context.active_object
        assert scene is not None and thing is not None  # as `poll` has it
        depth = depth_of(scene.camera, thing, unit_scale(scene))
        if depth <= 0:
            return refused(self, f"'{thing.name}' is behind the camera: select another object.")
        properties.set_focus(properties.of(scene), depth)
        return {"FINISHED"}


class HOLOPATH_OT_sweep(bpy.types.Operator):
    """Move the focus to and fro between the nearest and the farthest thing in view; again, or Esc, stops it"""

    bl_idname = "holopath.sweep"
    bl_label = "Play Focus"

    PERIOD = 8.0  # seconds there and back

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return rendered(cls) and free(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Begin, or stop what plays."""
        if session.current.sweep is not None:
            session.stop_sweep()
            return {"FINISHED"}
        assert context.scene is not None  # else there is nothing to refocus
        self._near, self._far = session.current.in_view
        self._scene, self._started = context.scene.name, time.monotonic()
        self._sweep = session.current.sweep = bpy.data.window_managers[0].event_timer_add(
            0.05, window=context.window
        )
        bpy.data.window_managers[0].modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event):
        """The next focus, as soon as the last one is shown."""
        stopped = event.type == "ESC" and event.value == "PRESS"
        scene = bpy.data.scenes.get(self._scene)
        if stopped or scene is None or session.current.field is None or session.running():
            session.stop_sweep(self._sweep)
        if scene is None or session.current.sweep is not self._sweep:
            return {"FINISHED", "PASS_THROUGH"}
        if event.type == "TIMER" and not session.refocusing():
            turn = 2 * math.pi * (time.monotonic() - self._started) / self.PERIOD
            share = 0.5 + 0.5 * math.cos(turn)
            dioptres = self._far + (self._near - self._far) * share
            properties.note_focus(properties.of(scene), 1 / max(dioptres, 1e-9))
            session.refocus_as_set(properties.of(scene))
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context):
        """The window closes or another file is opened."""
        session.stop_sweep(self._sweep)


CLASSES = (HOLOPATH_OT_refocus, HOLOPATH_OT_sweep, HOLOPATH_OT_save_field, HOLOPATH_OT_focus_from_selected)
