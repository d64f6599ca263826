"""Render a hologram, or say what rendering it would take."""

import bpy

from .. import engine, properties
from . import session
from .working import Working, free, present


class HOLOPATH_OT_render_hologram(Working, bpy.types.Operator):
    """Render the hologram of the scene and show its reconstruction"""

    bl_idname = "holopath.render_hologram"
    bl_label = "Render Hologram"
    doing = "rendering"

    def work(self, progress):
        return self.task.compute(progress)

    def finish(self, context, result):
        session.keep(self.task, result)
        if self.task.focus is None:
            properties.note_focus(context.scene.holopath, result.focus[0])
        image = session.show(result.images[0], self.task.hologram.wavelengths)
        present(context, image, self.bl_label)
        return "Hologram rendered"


class HOLOPATH_OT_cancel(bpy.types.Operator):
    """Stop what is at work"""

    bl_idname = "holopath.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        return session.running()

    def execute(self, context):
        session.current.job.cancel()
        return {"FINISHED"}


class HOLOPATH_OT_plan(bpy.types.Operator):
    """Look at the scene and say what would be computed, why, and how long it takes"""

    bl_idname = "holopath.plan"
    bl_label = "Estimate"

    @classmethod
    def poll(cls, context):
        return context.scene is not None and free(cls)

    def execute(self, context):
        try:
            task = session.prepare(context.evaluated_depsgraph_get(), context.scene.holopath)
            session.current.plan = engine.plan(
                task.scene, task.camera, task.hologram, task.settings, task.store
            )
        except Exception as error:
            self.report({"ERROR"}, session.fail(error))
            return {"CANCELLED"}
        session.current.notes, session.current.error = task.notes, ""
        session.redraw()
        plan = session.current.plan
        self.report({"INFO"}, f"About {plan.seconds:.0f} s and {plan.memory_bytes / 1e6:.0f} MB.")
        return {"FINISHED"}


CLASSES = (HOLOPATH_OT_render_hologram, HOLOPATH_OT_cancel, HOLOPATH_OT_plan)
