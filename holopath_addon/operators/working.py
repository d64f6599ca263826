"""What operators that take long share: a thread while the window stays usable, and where pictures are shown."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import StringProperty

from .. import engine
from ..blender import preferences, properties
from ..engine.scene import variants
from ..workflow import failures
from . import session
from .jobs import Job

POLL = 0.05  # seconds
REDRAW = 0.25  # seconds between two displays of progress: drawing takes time from the work


if TYPE_CHECKING:
    _Operator = bpy.types.Operator
else:
    _Operator = object


class Working(_Operator):
    """Operator that takes long: in a thread where it is invoked, while the window stays usable; Esc cancels.

    A subclass brings `work`, `finish` and `doing`.
    """

    doing = "working"

    _job = None
    _scene = ""
    _started = 0.0
    _told = ""
    _told_at = 0.0
    _presented = False

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return context.scene is not None and free(cls)

    def work(self, scene):
        """What to do for the scene of that name: a function of a job and its progress that returns the result.

        It runs in a thread, so it must not touch the operator; what needs Blender's data it asks of the job.
        """
        raise NotImplementedError

    def finish(self, context: bpy.types.Context, result):
        """Keep and show the result, on the main thread: what to tell, before the seconds."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context):
        """Work and wait for the end."""
        job = self._begin(context)
        job.run()
        return self._end(context, job)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Work in a thread; the window stays usable."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        job = self._begin(context)
        job.start()
        timer = bpy.data.window_managers[0].event_timer_add(POLL, window=context.window)
        session.current.leave = lambda: _leave(timer)
        bpy.data.window_managers[0].modal_handler_add(self)
        # before the first event: once that is served, the thread imports Mitsuba and holds Python meanwhile
        self._tell(context, job)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event):
        """Poll the thread."""
        job = self._job
        if job is None:  # Blender does not take FINISHED where a window was opened meanwhile, and calls again
            return {"FINISHED"}
        if event.type == "ESC" and event.value == "PRESS" and job.running:
            job.cancel()
            self._tell(context, job)
            return {"RUNNING_MODAL"}
        # without its timer where a file could not be opened, for which the work was stopped
        if (event.type == "TIMER" or job.cancelling) and not job.running:
            if session.current.job is job:
                session.leave()
            return self._end(context, job)
        if event.type == "TIMER":
            job.serve()
            offered = job.take()
            if offered is not None:
                try:
                    self.glimpse(context, offered)
                except Exception as error:  # the work goes on
                    session.fail(error)
            self._tell(context, job)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context):
        """Blender ends the operator: the window closes or another file is opened."""
        job, self._job = self._job, None
        if job is None:  # nothing has begun: a file browser was closed
            return
        job.cancel()
        session.leave()
        if session.current.job is job:
            bpy.app.timers.register(lambda: _clear_away(job))

    def glimpse(self, context: bpy.types.Context, offered):
        """Show what the work offers before its end."""

    def stopped(self):
        """What to tell where it was canceled."""
        return "Canceled"

    def scene_settings(self):
        """HoloPath's settings of the scene that was chosen, or None if it has been deleted since."""
        scene = bpy.data.scenes.get(self._scene)
        return scene and properties.of(scene)

    def present(self, context: bpy.types.Context, image):
        """`present` an image, the first time; later it is only changed."""
        if not self._presented:
            self._presented = True
            present(context, image)

    def _tell(self, context: bpy.types.Context, job):
        """Show progress where there is news, now and then."""
        now = time.monotonic()
        text = session.progress_text(job) + ("" if job.cancelling else " (Esc cancels)")
        if text == self._told or now - self._told_at < REDRAW:
            return
        self._told, self._told_at = text, now
        if context.workspace:
            context.workspace.status_text_set(f"HoloPath: {text}")
        session.redraw(images=False)

    def _begin(self, context: bpy.types.Context):
        """The job."""
        assert context.scene is not None  # as `poll` has it
        self._started, self._scene = time.monotonic(), context.scene.name
        session.current.error = ""
        try:
            work = self.work(self._scene)
        except engine.InvalidInput as error:
            work = _failing(error)
        job = Job(lambda progress: work(job, progress))
        job.message = self.doing.capitalize()
        self._job = session.current.job = job
        return job

    def _end(self, context: bpy.types.Context, job):
        if session.current.job is job:
            session.current.job = None
        try:
            if job.error is not None:
                raise job.error
            told = self.finish(context, job.result)
        except BaseException as error:
            if self._presented:
                session.show_again()
            if not failures.cancelled(error):
                return refused(self, session.fail(error))
            self.report({"INFO"}, f"HoloPath: {self.stopped()}.")
            return {"CANCELLED"}
        finally:
            self._job = None  # Blender keeps its last operators, and would keep the scene and its field
            session.redraw()
        self.report({"INFO"}, f"{told} in {time.monotonic() - self._started:.1f} s.")
        return {"FINISHED"}


class Saving(Working):
    """Operator that writes into a folder, which a file browser asks for unless it is given.

    A subclass brings `thing`, `what` and `write`.
    """

    doing = "saving"
    thing = "hologram"

    directory: StringProperty(
        name="Folder", description="Where to save", subtype="DIR_PATH", options={"SKIP_SAVE"}
    )

    _browsing = False

    def what(self):
        """What is saved; on the main thread."""
        raise NotImplementedError

    @staticmethod
    def write(what, folder, progress):
        """Write it into a folder; in a thread."""
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Ask for a folder, unless one is given."""
        if self.directory:
            return super().invoke(context, event)
        self._browsing = True
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context):
        """Save; after the file browser in a thread, of another operator: Blender ends this one."""
        if not self._browsing:
            return super().execute(context)
        if not type(self).poll(context):
            return refused(
                self,
                f"The {self.thing} was not saved: HoloPath is at work, or has rendered something else meanwhile.",
            )
        group, name = self.bl_idname.split(".")
        return getattr(getattr(bpy.ops, group), name)("INVOKE_DEFAULT", directory=self.directory)

    def work(self, scene):
        directory, what, thing, write = bpy.path.abspath(self.directory), self.what(), self.thing, self.write

        def save(job, progress):
            if not directory:
                raise engine.InvalidInput(f"No folder is given: choose one to save the {thing} in.")
            folder = Path(directory) / thing.replace(" ", "")
            write(what, folder, progress)
            return folder

        return save

    def finish(self, context: bpy.types.Context, result):
        return f"{self.thing.capitalize()} saved in {result}"


def push_undo(message):
    """Add an undo step of what was shown; once nothing is being dragged, which would be in it half way."""
    if bpy.app.background:
        return

    def push():
        if dragging():
            return POLL
        with bpy.context.temp_override(window=bpy.data.window_managers[0].windows[0]):
            bpy.ops.ed.undo_push(message=message)
        return None

    if push() is not None:
        bpy.app.timers.register(push, first_interval=POLL)


def dragging():
    """Whether the user is moving, painting or sculpting something."""
    return any(
        {"BLOCKING", "MACRO"} & operator.bl_options  # what moves a copy is a macro
        for window in bpy.data.window_managers[0].windows
        for operator in getattr(window, "modal_operators", ())
    )


def export(job, progress, scene):
    """Have the scene of that name read on the main thread, once Mitsuba has started in this one.

    Returns
    -------
    session.Task

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled
    """

    def read():
        if bpy.context.scene is None or bpy.context.scene.name != scene:
            raise engine.InvalidInput(
                f"The scene '{scene}' was left or deleted before it was read: press the button again."
            )
        return session.prepare(bpy.context.evaluated_depsgraph_get(), properties.of(bpy.context.scene))

    progress(0.0, "Starting Mitsuba")
    variants.activate(job.ask(preferences.wanted))
    progress(0.0, "Reading the scene")
    task = job.ask(read)
    variants.take_over()
    return task


def ready(operator, condition, otherwise):
    """Whether a condition holds; for the `poll` of an operator class, which says `otherwise` where it does not."""
    if not condition:
        operator.poll_message_set(otherwise)
    return bool(condition)


def refused(operator, sentence):
    """The end of an operator that cannot do what it is asked for, and says why."""
    operator.report({"ERROR"}, sentence)
    return {"CANCELLED"}


def rendered(operator):
    """Whether there is a wave field; as `ready`."""
    return ready(operator, session.current.field is not None, "Render a hologram first")


def encoded(operator):
    """Whether that is encoded; as `ready`."""
    return ready(operator, session.current.phase is not None, "Encode a hologram first")


def free(operator):
    """Whether nothing is at work; as `ready`."""
    return ready(operator, not session.running(), "HoloPath is at work: wait for it or cancel it")


def _failing(error):
    """Work that only says what is wrong, so that it is told as all failures are."""

    def work(job, progress):
        raise error

    return work


def _clear_away(job):
    """Once a job whose operator is gone has ended, forget it; as a timer."""
    if job.running:
        return 0.1
    if session.current.job is job:
        session.current.job = None
        session.show_again()
        session.redraw()
    return None


def _leave(timer):
    """Take back what `invoke` changed in the window."""
    bpy.data.window_managers[0].event_timer_remove(timer)
    for workspace in bpy.data.workspaces:  # the user may have changed to another one
        workspace.status_text_set(None)


def present(context, image):
    """Show a new image where the user sees it: an open Image Editor, else as Blender shows renders.

    Parameters
    ----------
    context : bpy.types.Context
    image : bpy.types.Image
    """
    if bpy.app.background:
        return
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
