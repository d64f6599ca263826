"""Operators that render a hologram, estimate a render, and check for processors."""

import bpy

from .. import engine
from ..blender import preferences, properties
from ..engine.waves import libraries
from . import session
from .modal_operator import ModalOperator, push_undo, read_task


class HOLOPATH_OT_render_hologram(ModalOperator, bpy.types.Operator):
    """Render the hologram of the scene and show its reconstruction"""

    bl_idname = "holopath.render_hologram"
    bl_label = "Render Hologram"
    activity = "rendering"

    def work(self, scene):
        previews, last = not bpy.app.background, session.current.task
        if last is not None:
            last.release_scene()  # Mitsuba holds one scene at a time

        def render(job, progress):
            task = read_task(job, progress, scene)

            def offer(image, draft=None):
                job.offer((image, task, draft))

            return task, task.compute(progress, offer if previews else None)

        return render

    def show_offer(self, context: bpy.types.Context, preview):
        self.present(context, session.show_preview(self.scene_settings(), *preview))

    def finish(self, context: bpy.types.Context, result):
        self.present(context, session.keep_and_show(self.scene_settings(), *result))
        push_undo(self.bl_label)
        return "Hologram rendered"

    def cancel_message(self):
        if self._presented and session.current.draft:
            return "Canceled, the draft stays"
        return super().cancel_message()


class HOLOPATH_OT_cancel(bpy.types.Operator):
    """Stop the running work; earlier results stay"""

    bl_idname = "holopath.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return session.running()

    def execute(self, context: bpy.types.Context):
        job = session.current.job
        if job is not None:
            job.cancel()
        return {"FINISHED"}


def own_size(scene):
    """Size of the picture that *Render Hologram* makes.

    Parameters
    ----------
    scene : bpy.types.Scene

    Returns
    -------
    (int, int)
        Width and height, pixels; of the SLM if the settings make no hologram.
    """
    props = properties.of(scene)
    try:
        picture = properties.hologram_of(props).picture
    except (engine.InvalidInput, engine.BackendUnavailable):  # the panel says so elsewhere
        return props.resolution_x, props.resolution_y
    return picture.width, picture.height


def output_size(scene):
    """Width and height, pixels, of the picture that F12 renders of a `bpy.types.Scene`."""
    settings = scene.render
    percent = settings.resolution_percentage
    return tuple(max(1, n * percent // 100) for n in (settings.resolution_x, settings.resolution_y))


def match_output(scene):
    """Set the output size of a `bpy.types.Scene`, and so of F12, to that of *Render Hologram*."""
    scene.render.resolution_x, scene.render.resolution_y = own_size(scene)
    scene.render.resolution_percentage = 100


class HOLOPATH_OT_match_output(bpy.types.Operator):
    """Set the resolution in the Output properties to the hologram's, so that F12 renders the same size"""

    bl_idname = "holopath.match_output"
    bl_label = "Match F12 to Hologram"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return context.scene is not None

    def execute(self, context: bpy.types.Context):
        match_output(context.scene)
        return {"FINISHED"}


class HOLOPATH_OT_plan(ModalOperator, bpy.types.Operator):
    """Probe the scene and list what would be computed, why, and how long it takes"""

    bl_idname = "holopath.plan"
    bl_label = "Estimate"
    activity = "estimating"

    def work(self, scene):
        def estimate(job, progress):
            task = read_task(job, progress, scene)
            return task, task.plan(progress)

        return estimate

    def finish(self, context: bpy.types.Context, result):
        task, plan = result
        session.keep_plan(task, plan)
        if not plan.seconds:  # baselines have no estimate
            return "Estimated"
        return f"About {plan.seconds:.0f} s and {plan.memory_bytes / 1e6:.0f} MB, estimated"


class HOLOPATH_OT_check(bpy.types.Operator):
    """Look again for a graphics card and its libraries, and for LLVM for the processor"""

    bl_idname = "holopath.check"
    bl_label = "Check Again"

    def execute(self, context: bpy.types.Context):
        preferences.forget_backends()
        backend = preferences.used_backend()
        session.current.error = ""
        session.redraw()
        if backend is None:
            self.report({"WARNING"}, preferences.backend_problem())
        else:
            self.report({"INFO"}, f"HoloPath computes with {backend['name']}: {backend['detail']}.")
        problem = preferences.check_card()
        if problem:
            self.report({"WARNING"}, problem)
        return {"FINISHED"}


def show_extensions(context, name):
    """Search for extensions in Blender's preferences.

    Parameters
    ----------
    context : bpy.types.Context
    name : str
        Text to search for.
    """
    context.window_manager.extension_search = name
    context.preferences.active_section = "EXTENSIONS"


class HOLOPATH_OT_get_card_extension(bpy.types.Operator):
    """Search Blender's repositories for it, in Get Extensions"""

    bl_idname = "holopath.get_card_extension"
    bl_label = f"Get {libraries.EXTENSION}"

    def execute(self, context: bpy.types.Context):
        show_extensions(context, libraries.EXTENSION)
        return {"FINISHED"}


CLASSES = (
    HOLOPATH_OT_render_hologram,
    HOLOPATH_OT_cancel,
    HOLOPATH_OT_match_output,
    HOLOPATH_OT_plan,
    HOLOPATH_OT_check,
    HOLOPATH_OT_get_card_extension,
)
