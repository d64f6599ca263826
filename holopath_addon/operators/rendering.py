"""Render a hologram, or say what rendering it would take."""

import bpy

from .. import engine
from ..blender import preferences, properties
from ..engine.waves import libraries
from . import session
from .working import Working, export, push_undo


class HOLOPATH_OT_render_hologram(Working, bpy.types.Operator):
    """Render the hologram of the scene and show its reconstruction"""

    bl_idname = "holopath.render_hologram"
    bl_label = "Render Hologram"
    doing = "rendering"

    def work(self, scene):
        watched, last = not bpy.app.background, session.current.task
        if last is not None:
            last.put_away()  # one scene at a time in Mitsuba

        def render(job, progress):
            task = export(job, progress, scene)

            def offer(picture, draft=None):
                job.offer((picture, task, draft))

            return task, task.compute(progress, offer if watched else None)

        return render

    def glimpse(self, context: bpy.types.Context, offered):
        self.present(context, session.show_early(self.scene_settings(), *offered))

    def finish(self, context: bpy.types.Context, result):
        self.present(context, session.keep_shown(self.scene_settings(), *result))
        push_undo(self.bl_label)
        return "Hologram rendered"

    def stopped(self):
        if self._presented and session.current.draft:
            return "Canceled, the draft stays"
        return super().stopped()


class HOLOPATH_OT_cancel(bpy.types.Operator):
    """Stop what is at work; what was there before stays"""

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
    """Pixels of the picture of the hologram that the button renders, of the panel where it cannot be: width, height."""
    props = properties.of(scene)
    try:
        picture = properties.hologram_of(props).picture
    except (engine.InvalidInput, engine.BackendUnavailable):  # another part of the panel says so
        return props.resolution_x, props.resolution_y
    return picture.width, picture.height


def output_size(scene):
    """Pixels of F12's picture: width and height."""
    settings = scene.render
    percent = settings.resolution_percentage
    return tuple(max(1, n * percent // 100) for n in (settings.resolution_x, settings.resolution_y))


def match_output(scene):
    """Have F12 render as many pixels as the button does."""
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


class HOLOPATH_OT_plan(Working, bpy.types.Operator):
    """Look at the scene and say what would be computed, why, and how long it takes"""

    bl_idname = "holopath.plan"
    bl_label = "Estimate"
    doing = "estimating"

    def work(self, scene):
        def estimate(job, progress):
            task = export(job, progress, scene)
            return task, task.plan(progress)

        return estimate

    def finish(self, context: bpy.types.Context, result):
        task, plan = result
        session.keep_plan(task, plan)
        if not plan.seconds:  # of baselines nothing is foretold
            return "Estimated"
        return f"About {plan.seconds:.0f} s and {plan.memory_bytes / 1e6:.0f} MB, estimated"


class HOLOPATH_OT_check(bpy.types.Operator):
    """Look again for what computes: a graphics card, and what it needs, or LLVM for the processor"""

    bl_idname = "holopath.check"
    bl_label = "Check Again"

    def execute(self, context: bpy.types.Context):
        preferences.look_again()
        problem = preferences.missing()
        session.current.error = ""
        session.redraw()
        if problem:
            self.report({"WARNING"}, problem)
        else:
            used = next(row for row in preferences.backends() if row["available"])
            self.report({"INFO"}, f"HoloPath computes with {used['name']}: {used['detail']}.")
        lacking = preferences.try_card()
        if lacking:
            self.report({"WARNING"}, lacking)
        return {"FINISHED"}


def show_extensions(context, name):
    """Have the preferences show the extensions of that name that Blender's repositories have."""
    context.window_manager.extension_search = name
    context.preferences.active_section = "EXTENSIONS"


class HOLOPATH_OT_get_card_extension(bpy.types.Operator):
    """Look for it among the extensions of Blender's repositories, in Get Extensions"""

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
