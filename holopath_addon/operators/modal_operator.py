"""Base of operators that take long: they work in a thread, while the window stays usable, and show images."""

import time
from pathlib import Path

import bpy
from bpy.props import StringProperty

from .. import engine
from ..blender import preferences, properties
from ..engine.scene import variants
from ..workflow import failures
from . import session
from .jobs import Job
from .long_modal import LongModal, dragging, is_paused

POLL_INTERVAL = 0.05  # seconds
STATUS_INTERVAL = 0.25  # seconds between two displays of progress, as drawing takes time from the work


class ModalOperator(LongModal):
    """Operator that takes long: if it is invoked it works in a thread, and Esc cancels it.

    A subclass brings `work`, `finish` and `activity`, which is shown until the first report of progress.
    """

    activity = "working"

    _job = None
    _scene = ""
    _started = 0.0
    _status = ""
    _status_time = 0.0
    _presented = False

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return context.scene is not None and is_free(cls)

    def work(self, scene):
        """Prepare the work; on the main thread.

        Parameters
        ----------
        scene : str
            Name of the scene to work on.

        Returns
        -------
        callable
            Function of a job and its progress that returns the result. It runs in a thread: it must not touch the
            operator, and has Blender's data read by `Job.query`.

        Raises
        ------
        engine.InvalidInput, engine.BackendUnavailable
            Told to the user as a failure of the work.
        """
        raise NotImplementedError

    def finish(self, context: bpy.types.Context, result):
        """Keep and show the result; on the main thread.

        Returns
        -------
        str
            Report to the user, to which the seconds are added.
        """
        raise NotImplementedError

    def execute(self, context: bpy.types.Context):
        """Work and wait for the end."""
        job = self._start_job(context)
        job.run()
        return self._end_job(context, job)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Work in a thread; the window stays usable."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        if self.resume():
            return self.become_modal()
        job = self._start_job(context)
        job.start()
        timer = bpy.data.window_managers[0].event_timer_add(POLL_INTERVAL, window=context.window)
        session.current.restore_window = lambda: _restore_window(timer)
        # before the first event: once that is served, the thread imports Mitsuba and holds Python meanwhile
        self._show_progress(context, job)
        return self.become_modal()

    def modal(self, context: bpy.types.Context, event: bpy.types.Event):
        """Poll the thread."""
        job = self._job
        if job is None:  # Blender ignores FINISHED if a window was opened meanwhile, and calls again
            return {"FINISHED"}
        if event.type == "ESC" and event.value == "PRESS" and job.running:
            job.cancel()
            self._show_progress(context, job)
            return {"RUNNING_MODAL"}
        # Opening a file cancels the job and removes the timer. If that file is broken, the old one stays open with this
        # operator: then any event ends it.
        if (event.type == "TIMER" or job.canceling) and not job.running:
            if session.current.job is job:
                session.restore_window()
            return self._end_job(context, job)
        if event.type == "TIMER":
            if self.make_way():
                return {"FINISHED", "PASS_THROUGH"}
            if not bpy.app.is_job_running("RENDER"):  # whose thread reads what exporting may change
                job.answer_query()
            elif job.asks:
                job.message = "Waiting for Blender's render"
            preview = job.take_offer()
            if preview is not None:
                try:
                    self.show_offer(context, preview)
                except Exception as error:  # the work goes on
                    session.record_error(error)
            self._show_progress(context, job)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context):
        """End the operator for Blender: the window closes or another file is opened."""
        job, self._job = self._job, None
        if job is None:  # a file browser was closed before any work
            return
        job.cancel()
        session.restore_window()
        if session.current.job is job:
            bpy.app.timers.register(lambda: _forget_job(job))

    def show_offer(self, context: bpy.types.Context, preview):
        """Show an object that the work offers before its end."""

    def cancel_message(self):
        """Report to the user after a cancellation."""
        return "Canceled"

    def scene_settings(self):
        """HoloPath's settings of the scene that is worked on, or None if it was deleted."""
        scene = bpy.data.scenes.get(self._scene)
        return scene and properties.of(scene)

    def present(self, context: bpy.types.Context, image):
        """Call `present` for an image, the first time only: later the image itself is changed."""
        if not self._presented:
            self._presented = True
            present(context, image)

    def _show_progress(self, context: bpy.types.Context, job):
        """Show progress if it is new and the last display was some time ago."""
        now = time.monotonic()
        text = session.progress_text(job) + ("" if job.canceling else " (Esc cancels)")
        if text == self._status or now - self._status_time < STATUS_INTERVAL:
            return
        self._status, self._status_time = text, now
        if context.workspace:
            context.workspace.status_text_set(f"HoloPath: {text}")
        session.redraw(images=False)

    def _start_job(self, context: bpy.types.Context):
        """Make the job."""
        assert context.scene is not None  # by `poll`
        self._started, self._scene = time.monotonic(), context.scene.name
        session.current.error = ""
        try:
            work = self.work(self._scene)
        except (engine.InvalidInput, engine.BackendUnavailable) as error:
            work = _failing(error)
        job = Job(lambda progress: work(job, progress))
        job.message = self.activity.capitalize()
        self._job = session.current.job = job
        return job

    def _end_job(self, context: bpy.types.Context, job):
        """Finish a job and report it."""
        if session.current.job is job:
            session.current.job = None
        try:
            if job.error is not None:
                raise job.error
            report = self.finish(context, job.result)
        except BaseException as error:
            if self._presented:
                session.restore_picture()
            if not failures.cancelled(error):
                return report_error(self, session.record_error(error))
            self.report({"INFO"}, f"HoloPath: {self.cancel_message()}.")
            return {"CANCELLED"}
        finally:
            self._job = None  # Blender keeps its last operators, and would keep the scene and its field
            session.redraw()
        self.report({"INFO"}, f"{report} in {time.monotonic() - self._started:.1f} s.")
        return {"FINISHED"}


class SaveOperator(ModalOperator):
    """Operator that writes into a folder, which a file browser asks for unless it is given.

    A subclass brings `kind`, `content` and `write`.
    """

    activity = "saving"
    kind = "hologram"

    directory: StringProperty(
        name="Folder", description="Folder to save into", subtype="DIR_PATH", options={"SKIP_SAVE"}
    )

    _browsing = False

    def content(self):
        """Object to save; on the main thread."""
        raise NotImplementedError

    @staticmethod
    def write(content, folder, progress):
        """Write the object into a folder; in a thread."""
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Ask for a folder, unless one is given."""
        if self.directory or is_paused(type(self)):
            return super().invoke(context, event)
        self._browsing = True
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context):
        """Save; after the file browser, which ends this operator, in the thread of another one."""
        if not self._browsing:
            return super().execute(context)
        if not type(self).poll(context):
            return report_error(
                self,
                f"The {self.kind} was not saved: HoloPath is at work, or has rendered something else meanwhile.",
            )
        group, name = self.bl_idname.split(".")
        return getattr(getattr(bpy.ops, group), name)("INVOKE_DEFAULT", directory=self.directory)

    def work(self, scene):
        # not the operator itself, which a thread must not touch
        directory, content = bpy.path.abspath(self.directory), self.content()
        kind, write = self.kind, self.write

        def save(job, progress):
            if not directory:
                raise engine.InvalidInput(f"No folder is given: choose one to save the {kind} in.")
            folder = Path(directory) / kind.replace(" ", "")
            write(content, folder, progress)
            return folder

        return save

    def finish(self, context: bpy.types.Context, result):
        return f"{self.kind.capitalize()} saved in {result}"


def push_undo(message):
    """Add an undo step, when nothing is being dragged: it would be caught half way.

    Parameters
    ----------
    message : str
        Name of the step in Blender's undo history.
    """
    if bpy.app.background:
        return

    def push():
        if dragging():
            return POLL_INTERVAL
        with bpy.context.temp_override(window=bpy.data.window_managers[0].windows[0]):
            bpy.ops.ed.undo_push(message=message)
        return None

    if push() is not None:
        bpy.app.timers.register(push, first_interval=POLL_INTERVAL)


def read_task(job, progress, scene):
    """Start Mitsuba in the job's thread, then have the main thread read a scene.

    Parameters
    ----------
    job : Job
        Job that calls this.
    progress : callable
    scene : str
        Name of the scene.

    Returns
    -------
    session.Task

    Raises
    ------
    engine.InvalidInput
        If the scene cannot be rendered, or is no longer the window's.
    engine.BackendUnavailable
        If Mitsuba cannot compute as the preferences choose.
    engine.Cancelled
    """

    def read():
        if bpy.context.scene is None or bpy.context.scene.name != scene:
            raise engine.InvalidInput(
                f"The scene '{scene}' was left or deleted before it was read: press the button again."
            )
        return session.prepare(bpy.context.evaluated_depsgraph_get(), properties.of(bpy.context.scene))

    progress(0.0, "Starting Mitsuba")
    variants.activate(job.query(preferences.chosen_backend))
    progress(0.0, "Reading the scene")
    task = job.query(read)
    variants.take_over()  # variables of Dr.Jit that the main thread made
    return task


def check_poll(operator, condition, message):
    """Check a condition for an operator's `poll`.

    Parameters
    ----------
    operator : type
        Class of the operator.
    condition : object
        Truth value.
    message : str
        Tooltip of the disabled button: what is missing.

    Returns
    -------
    bool
    """
    if not condition:
        operator.poll_message_set(message)
    return bool(condition)


def report_error(operator, sentence):
    """Report why an operator cannot do its work.

    Parameters
    ----------
    operator : bpy.types.Operator
    sentence : str

    Returns
    -------
    set of str
        The operator's end, for Blender.
    """
    operator.report({"ERROR"}, sentence)
    return {"CANCELLED"}


def has_field(operator):
    """Check that there is a wave field, see `check_poll`."""
    return check_poll(operator, session.current.field is not None, "Render a hologram first")


def has_phase(operator):
    """Check that the field is encoded, see `check_poll`."""
    return check_poll(operator, session.current.phase is not None, "Encode a hologram first")


def is_free(operator):
    """Check that no job is running, see `check_poll`."""
    free = is_paused(operator) or not session.running()
    return check_poll(operator, free, "HoloPath is at work: wait for it or cancel it")


def _failing(error):
    """Work that raises an error, which is then reported as all failures are."""

    def work(job, progress):
        raise error

    return work


def _forget_job(job):
    """Forget a job whose operator is gone, once it has ended; as a timer."""
    if job.running:
        return 0.1
    if session.current.job is job:
        session.current.job = None
        session.restore_picture()
        session.redraw()
    return None


def _restore_window(timer):
    """Take back what `invoke` changed in the window."""
    bpy.data.window_managers[0].event_timer_remove(timer)
    for workspace in bpy.data.workspaces:  # the user may have changed to another one
        workspace.status_text_set(None)


def present(context, image):
    """Show a new image in an open Image Editor, else as Blender shows renders.

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
    """Space of an open Image Editor that shows an image, else of the largest one; None without one."""
    areas = [
        area
        for window in window_manager.windows
        for area in window.screen.areas
        if area.type == "IMAGE_EDITOR" and area.ui_type == "IMAGE_EDITOR"
    ]
    areas.sort(key=lambda area: area.width * area.height, reverse=True)
    spaces = [area.spaces.active for area in areas]
    return next((space for space in spaces if space.image == image), spaces[0] if spaces else None)
