"""What operators that take long share: a thread while the window stays usable, and where pictures are shown."""

import time

import bpy

from .. import engine
from . import session
from .jobs import Job

REDRAW = 0.25  # seconds between two displays of progress: drawing takes time from the work


class Working:
    """Operator that works on the exported scene, in a thread where it is invoked; Esc cancels.

    A subclass brings `work`, `finish` and `doing`.
    """

    doing = "working"

    _job = None
    _started = 0.0
    _told = ""
    _told_at = 0.0

    @classmethod
    def poll(cls, context):
        return context.scene is not None and free(cls)

    def work(self, progress):
        """Do it with `self.task`, in any thread: the result."""
        raise NotImplementedError

    def finish(self, context, result):
        """Keep and show the result, on the main thread: what to tell, before the seconds."""
        raise NotImplementedError

    def execute(self, context):
        """Work and wait for the end."""
        job = self._begin(context)
        if job is None:
            return {"CANCELLED"}
        job.run()
        return self._end(context)

    def invoke(self, context, event):
        """Work in a thread; the window stays usable."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        job = self._begin(context)
        if job is None:
            return {"CANCELLED"}
        job.start()
        timer = context.window_manager.event_timer_add(0.1, window=context.window)
        session.current.leave = lambda: _leave(timer)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f"HoloPath: {self.doing}, Esc cancels")
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
            self.task = session.prepare(context.evaluated_depsgraph_get(), context.scene.holopath)
        except Exception as error:
            self.report({"ERROR"}, session.fail(error))
            session.redraw()
            return None
        session.current.error = ""
        self._job = session.current.job = Job(self.work)
        return self._job

    def _end(self, context):
        job = self._job
        if session.current.job is job:
            session.current.job = None
        try:
            if job.error is not None:
                raise job.error
            told = self.finish(context, job.result)
        except engine.Cancelled:
            self.report({"INFO"}, "HoloPath: cancelled.")
            return {"CANCELLED"}
        except BaseException as error:
            self.report({"ERROR"}, session.fail(error))
            return {"CANCELLED"}
        finally:
            session.redraw()
        self.report({"INFO"}, f"{told} in {time.monotonic() - self._started:.1f} s.")
        return {"FINISHED"}


def free(operator):
    """Whether nothing is at work; for the `poll` of an operator class, which says so where something is."""
    if session.running():
        operator.poll_message_set("HoloPath is at work: wait for it or cancel it")
        return False
    return True


def _leave(timer):
    """Take back what `invoke` changed in the window."""
    bpy.context.window_manager.event_timer_remove(timer)
    for workspace in bpy.data.workspaces:  # the user may have changed to another one
        workspace.status_text_set(None)


def present(context, image, step):
    """Show a new image where the user sees it: an open Image Editor, else as Blender shows renders.

    Parameters
    ----------
    context : bpy.types.Context
    image : bpy.types.Image
    step : str
        Name of the step that undo takes back.
    """
    if bpy.app.background:
        return
    bpy.ops.ed.undo_push(message=step)
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
