"""Bake the scene's light ahead of rendering, look at it, and delete it."""

import bpy
from bpy.props import BoolProperty

from ..blender import preferences
from . import session
from .working import Working, export, free, present, ready

ANEW = "Bake all of it again, and keep that in place of what was baked before"


class HOLOPATH_OT_bake(Working, bpy.types.Operator):
    """Bake the diffuse light that the camera sees; rendering takes it from there, whatever the focus"""

    bl_idname = "holopath.bake"
    bl_label = "Bake"
    doing = "baking"

    anew: BoolProperty(name="Anew", description=ANEW, options={"SKIP_SAVE"})
    show: BoolProperty(name="Show", description="Show the texture at the end", options={"SKIP_SAVE"})

    @classmethod
    def description(cls, context: bpy.types.Context, settings):
        """Tooltip, by what the button does."""
        if settings.show:
            return HOLOPATH_OT_show_texture.__doc__
        return ANEW if settings.anew else cls.__doc__

    def work(self, scene):
        anew = self.anew

        def bake(job, progress):
            task = export(job, progress, scene)
            return task, *task.bake(progress, anew)

        return bake

    def finish(self, context: bpy.types.Context, result):
        task, texture, done = result
        session.keep_baked(task, texture, done)
        if self.show:
            self.present(context, session.show_texture())
        return "Light taken from disk" if done.reused == "all" else "Light baked"


class HOLOPATH_OT_show_texture(bpy.types.Operator):
    """Show the baked light as a texture in an Image Editor"""

    bl_idname = "holopath.show_texture"
    bl_label = "Show Texture"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        baked = context.scene is not None and session.texture_of(context.scene) is not None
        return ready(cls, baked, "Nothing is baked yet: press Bake") and free(cls)

    def execute(self, context: bpy.types.Context):
        present(context, session.show_texture())
        return {"FINISHED"}


class HOLOPATH_OT_clear_baked(bpy.types.Operator):
    """Delete all baked light that is kept on disk, of every scene"""

    bl_idname = "holopath.clear_baked"
    bl_label = "Clear"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return ready(cls, preferences.store().files(), "No baked light is kept on disk") and free(cls)

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
