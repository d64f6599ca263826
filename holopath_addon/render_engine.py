"""F12: the render engine HOLOPATH, a thin delegate of `operators.session`."""

import bpy

from . import engine
from .operators import session
from .operators.jobs import on_main_thread


class HoloPathEngine(bpy.types.RenderEngine):
    """Renders the hologram of a frame; the picture is its reconstruction at the focus distance.

    The hologram has as many pixels as the render (Output properties), so that they map one to one.
    """

    bl_idname = "HOLOPATH"
    bl_label = "HoloPath"
    bl_use_preview = False
    bl_use_eevee_viewport = True

    def render(self, depsgraph):
        """Called by Blender for every frame; in a window on a thread of its own. Raises nothing.

        Blender gets a result in any case: writing a multilayer EXR without one crashes it.
        """
        settings = depsgraph.scene.render
        scale = settings.resolution_percentage / 100
        size = [max(1, int(n * scale)) for n in (settings.resolution_x, settings.resolution_y)]
        pixels, failure = None, ""
        try:
            self.update_stats("", "HoloPath: exporting the scene")
            task = on_main_thread(lambda: session.prepare(depsgraph, depsgraph.scene.holopath, size))
            result = task.compute(self._progress)
            session.keep(task, result)
            pixels = session.picture(result.images[0], task.hologram.wavelengths)
        except BaseException as error:
            failure = session.fail(error)
        target = self.begin_result(0, 0, *size)
        try:
            if pixels is not None:
                target.layers[0].passes["Combined"].rect.foreach_set(pixels.ravel())
        except BaseException as error:
            failure = session.fail(error)
        finally:
            self.end_result(target)
        if failure:
            self.report({"ERROR"}, failure)

    def _progress(self, done, message):
        if self.test_break():
            raise engine.Cancelled
        self.update_progress(done)
        self.update_stats("", f"HoloPath: {message}")


CLASSES = (HoloPathEngine,)
