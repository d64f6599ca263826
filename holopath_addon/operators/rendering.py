"""Render a hologram, or say what rendering it would take."""

import time

import bpy

from .. import engine, properties
from . import session
from .jobs import Job

REDRAW = 0.25  # seconds between two displays of progress: drawing takes time from the rendering


class HOLOPATH_OT_render_hologram(bpy.types.Operator):
    """Render the hologram of the scene and show its reconstruction"""

    bl_idname = "holopath.render_hologram"
    bl_label = "Render Hologram"

    _job = None
    _started = 0.0
    _told = ""
    _told_at = 0.0

    @classmethod
    def poll(cls, context):
        if session.running():
            cls.poll_message_set("A hologram is being rendered: wait for it or cancel it")
            return False
        return context.scene is not None

    def execute(self, context):
        """Render and wait for the end."""
        job = self._begin(context)
        if job is None:
            return {"CANCELLED"}
        job.run()
        return self._end(context)

    def invoke(self, context, event):
        """Render in a thread; the window stays usable."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        job = self._begin(context)
        if job is None:
            return {"CANCELLED"}
        job.start()
        timer = context.window_manager.event_timer_add(0.1, window=context.window)
        session.current.leave = lambda: _leave(timer)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set("HoloPath: rendering, Esc cancels")
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Poll the thread."""
        job = self._job
        if event.type == "ESC" and event.value == "PRESS" and job.running:
            job.cancel()
            return {"RUNNING_MODAL"}
        if event.type == "TIMER":
            if not job.running:
                session.leave()
                return self._end(context)
            self._tell(context)
        return {"PASS_THROUGH"}

    def cancel(self, context):
        """Blender ends the operator: the window closes or another file is opened."""
        if self._job is not None:
            self._job.cancel()
        session.leave()

    def _tell(self, context):
        """Show progress where there is news, now and then."""
        job, now = self._job, time.monotonic()
        text = "cancelling" if job.cancelling else f"{job.done:.0%} {job.message}, Esc cancels"
        if text == self._told or now - self._told_at < REDRAW:
            return
        self._told, self._told_at = text, now
        if context.workspace:
            context.workspace.status_text_set(f"HoloPath: {text}")
        session.redraw(images=False)

    def _begin(self, context):
        """The job, or None where the scene cannot be rendered."""
        self._started = time.monotonic()
        try:
            self._task = session.prepare(context.evaluated_depsgraph_get(), context.scene.holopath)
        except Exception as error:
            self.report({"ERROR"}, session.fail(error))
            session.redraw()
            return None
        session.current.error = ""
        self._job = session.current.job = Job(self._task.compute)
        return self._job

    def _end(self, context):
        job, task = self._job, self._task
        if session.current.job is job:
            session.current.job = None
        try:
            if job.error is not None:
                raise job.error
            session.keep(task, job.result)
            if task.focus is None:
                properties.note_focus(context.scene.holopath, job.result.focus[0])
            image = session.show(job.result.images[0], task.hologram.wavelengths)
            if not bpy.app.background:
                bpy.ops.ed.undo_push(message="Render Hologram")
                _open_editor(context, image)
        except engine.Cancelled:
            self.report({"INFO"}, "HoloPath: cancelled.")
            return {"CANCELLED"}
        except BaseException as error:
            self.report({"ERROR"}, session.fail(error))
            return {"CANCELLED"}
        finally:
            session.redraw()
        self.report({"INFO"}, f"Hologram rendered in {time.monotonic() - self._started:.1f} s.")
        return {"FINISHED"}


class HOLOPATH_OT_cancel(bpy.types.Operator):
    """Stop rendering the hologram"""

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
        return context.scene is not None and not session.running()

    def execute(self, context):
        try:
            task = session.prepare(context.evaluated_depsgraph_get(), context.scene.holopath)
            session.current.plan = engine.plan(task.scene, task.camera, task.hologram, task.settings)
        except Exception as error:
            self.report({"ERROR"}, session.fail(error))
            return {"CANCELLED"}
        session.current.notes, session.current.error = task.notes, ""
        session.redraw()
        plan = session.current.plan
        self.report({"INFO"}, f"About {plan.seconds:.0f} s and {plan.memory_bytes / 1e6:.0f} MB.")
        return {"FINISHED"}


def _leave(timer):
    """Take back what `invoke` changed in the window."""
    bpy.context.window_manager.event_timer_remove(timer)
    for workspace in bpy.data.workspaces:  # the user may have changed to another one
        workspace.status_text_set(None)


def _open_editor(context, image):
    """Show an image where the user sees it: an open Image Editor, else as Blender shows renders."""
    space = _image_editor(context.window_manager, image)
    if space is None:
        bpy.ops.render.view_show("INVOKE_DEFAULT")
        space = _image_editor(context.window_manager, image)
    if space is not None:
        space.image = image


def _image_editor(window_manager, image):
    """An open Image Editor's space: one with our image, else the largest."""
    areas = [
        area
        for window in window_manager.windows
        for area in window.screen.areas
        if area.type == "IMAGE_EDITOR" and area.ui_type == "IMAGE_EDITOR"
    ]
    areas.sort(key=lambda area: area.width * area.height, reverse=True)
    spaces = [area.spaces.active for area in areas]
    return next((space for space in spaces if space.image == image), spaces[0] if spaces else None)


CLASSES = (HOLOPATH_OT_render_hologram, HOLOPATH_OT_cancel, HOLOPATH_OT_plan)
