"""Render an animation in the background."""

import bpy

from . import background, session
from .modal_operator import check_poll, report_error


class HOLOPATH_OT_render_animation(bpy.types.Operator):
    """Render every frame's wave field and pictures into the animation's folder, in the background; frames that exist, made of the same scene with the same settings, are skipped"""  # noqa: E501

    bl_idname = "holopath.render_animation"
    bl_label = "Render Animation"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        message = "An animation is being rendered: wait for it or cancel it"
        return context.scene is not None and check_poll(cls, not background.running(), message)

    def execute(self, context: bpy.types.Context):
        """Render and wait for the end, for scripts."""
        status = self._start(context)
        if status == {"CANCELLED"}:
            return status
        background.current.wait()
        if background.current.error:
            return report_error(self, background.current.error)
        return status

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Render while the window stays usable."""
        return self._start(context)

    def _start(self, context):
        try:
            background.start(context.scene, context.view_layer)
        except Exception:
            return report_error(self, background.current.error)
        finally:
            session.redraw(images=False)
        return {"FINISHED"}


class HOLOPATH_OT_cancel_animation(bpy.types.Operator):
    """Stop rendering the animation; finished frames stay, and Render Animation continues after them"""

    bl_idname = "holopath.cancel_animation"
    bl_label = "Cancel Animation"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return background.running()

    def execute(self, context: bpy.types.Context):
        background.current.cancel()
        session.redraw(images=False)
        return {"FINISHED"}


CLASSES = (HOLOPATH_OT_render_animation, HOLOPATH_OT_cancel_animation)
