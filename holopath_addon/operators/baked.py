"""Operators for baked light: bake it before rendering, show it, and delete it."""

import bpy
from bpy.props import BoolProperty

from ..blender import preferences
from . import session
from .modal_operator import ModalOperator, check_poll, is_free, present, read_task

ANEW = "Bake all of it again, in place of the light that was baked before"


class HOLOPATH_OT_bake(ModalOperator, bpy.types.Operator):
    """Bake the diffuse light that the camera sees; renders at any focus use it"""

    bl_idname = "holopath.bake"
    bl_label = "Bake"
    activity = "baking"

    anew: BoolProperty(name="Anew", description=ANEW, options={"SKIP_SAVE"})
    show: BoolProperty(name="Show", description="Show the texture at the end", options={"SKIP_SAVE"})

    @classmethod
    def description(cls, context: bpy.types.Context, settings):
        """Tooltip of the button's variant."""
        if settings.show:
            return HOLOPATH_OT_show_texture.__doc__
        return ANEW if settings.anew else cls.__doc__

    _show = False  # `show`, which one that goes on after an auto-save has not as its property

    def work(self, scene):
        self._show, anew = self.show, self.anew

        def bake(job, progress):
            task = read_task(job, progress, scene)
            return task, *task.bake(progress, anew)

        return bake

    def finish(self, context: bpy.types.Context, result):
        task, texture, bake = result
        session.keep_bake(task, texture, bake)
        if self._show:
            self.present(context, session.show_texture())
        return "Light taken from disk" if bake.reused == "all" else "Light baked"


class HOLOPATH_OT_show_texture(bpy.types.Operator):
    """Show the baked light as a texture in an Image Editor"""

    bl_idname = "holopath.show_texture"
    bl_label = "Show Texture"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        baked = context.scene is not None and session.texture_of(context.scene) is not None
        return check_poll(cls, baked, "Nothing is baked yet: press Bake") and is_free(cls)

    def execute(self, context: bpy.types.Context):
        present(context, session.show_texture())
        return {"FINISHED"}


class HOLOPATH_OT_clear_baked(bpy.types.Operator):
    """Delete the baked light of all scenes from disk"""

    bl_idname = "holopath.clear_baked"
    bl_label = "Clear"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return check_poll(cls, preferences.store().files(), "No baked light is on disk") and is_free(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        return bpy.data.window_managers[0].invoke_confirm(
            self,
            event,
            title="Delete Baked Light",
            message=f"{preferences.store().size() / 1e6:.1f} MB of baked light, of all scenes, will be deleted.",
            confirm_text="Delete",
        )

    def execute(self, context: bpy.types.Context):
        freed = preferences.store().clear()
        session.current.bake = session.current.texture = None
        session.redraw()
        self.report({"INFO"}, f"{freed / 1e6:.1f} MB of baked light deleted.")
        return {"FINISHED"}


CLASSES = (HOLOPATH_OT_bake, HOLOPATH_OT_show_texture, HOLOPATH_OT_clear_baked)
