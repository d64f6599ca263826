"""The render engine HOLOPATH: thin, F12 over `operators.session`, RENDERED shading over `viewport`."""

import math
import time
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from .. import engine
from ..engine.mapping import squared
from ..engine.progress import Compiling
from ..export import unit_scale
from ..operators import background, session
from ..operators.jobs import run_on_main_thread
from ..operators.rendering import output_size
from ..workflow import output, pipeline, stills
from . import properties, viewport

NO_SURFACE_DEPTH = 1e10  # depth without a surface, as in Cycles
AUTO_PASS = "Focus Auto"  # name of the pass where focusing is automatic and no other distance is listed


class HoloPathEngine(bpy.types.RenderEngine):
    """Render engine whose picture is the reconstruction of a frame's hologram at the focus distance.

    The picture has as many pixels as the Output properties say, and so has the hologram if its pixels are square.
    """

    bl_idname = "HOLOPATH"
    bl_label = "HoloPath"
    bl_use_preview = False
    bl_use_eevee_viewport = True

    def update_render_passes(self, scene, renderlayer):
        """Register a view layer's passes. Blender calls this for renders and for the compositor."""
        for name, channels in _passes(properties.of(scene), renderlayer):
            kind = "VALUE" if len(channels) == 1 else "COLOR"
            self.register_pass(scene, renderlayer, name, len(channels), channels, kind)

    def render(self, depsgraph):
        """Render a view layer of a frame. Blender calls this, in a window on a thread of its own. Raises nothing.

        Blender gets a result in any case: without one it crashes when it writes a multilayer EXR.
        """
        settings, layer = depsgraph.scene.render, depsgraph.view_layer_eval
        size = list(output_size(depsgraph.scene))
        pixels, failure, progress = {}, "", self._progress(Compiling())
        try:
            self.update_progress(0.0)
            self.update_stats("", "HoloPath: Reading the scene")
            start = time.perf_counter()
            props, camera = properties.of(depsgraph.scene), self.camera_override
            _check_passes(properties.hologram_of(props, size), properties.of_layer(layer))
            task = run_on_main_thread(lambda: session.prepare(depsgraph, props, size, camera))
            export_seconds = time.perf_counter() - start
            keep = self.is_animation and props.keep_fields
            uses_list = keep or properties.of_layer(layer).use_pass_focus
            request = task.full_request
            if uses_list and not _is_focused_automatically(props):
                request = replace(request, focus=[*request.focus, *properties.focus_list_of(props)])
            if keep:
                _check_own(depsgraph, request)
                result = self._render_into(request, _folder(depsgraph), progress, export_seconds)
            else:
                result = pipeline.compute(request, progress)
            session.keep(task, result)
            session.current.autofocus_distance = result.focus[0] if request.autofocus else None
            pixels = _pixels(request, result, depsgraph)
        except BaseException as error:
            failure = session.record_error(error)
        target = self.begin_result(0, 0, *size, layer=layer.name)
        try:
            region = _region(settings, target, size)
            for part in target.layers[0].passes:
                if part.name in pixels:
                    # pyrefly: ignore[missing-attribute]  # in Blender's stubs an array of numbers is one
                    part.rect.foreach_set(np.ascontiguousarray(pixels[part.name][::-1][region]).ravel())
        except BaseException as error:
            failure = session.record_error(error)
        finally:
            self.end_result(target)
        if failure:
            self.report({"ERROR"}, failure)

    def _render_into(self, request, folder, progress, export_seconds):
        """Render a request into its folder, or load it from there."""

        def say(text):
            self.report({"INFO"}, f"{folder.name}: {text}")

        result, _ = stills.update(folder, request, progress, export_seconds, say)
        return result or pipeline.compute(request, progress, stills.load_field(folder))

    def view_update(self, context: bpy.types.Context, depsgraph):
        """Do nothing. Blender calls this when its scene has changed; `viewport` has a handler for that."""

    def view_draw(self, context: bpy.types.Context, depsgraph):
        """Draw a 3D View that is shaded RENDERED. Blender calls this."""
        shown = viewport.of(self, context.region)
        self.update_stats("", shown.draw(context, depsgraph, self.get_preview_pixel_size(context.scene)))

    def _progress(self, compiles):
        """Function that reports progress to Blender, and raises `engine.Cancelled` if Blender stops the render."""

        def progress(done, message):
            if self.test_break():
                raise engine.Cancelled
            self.update_progress(done)
            self.update_stats("", f"HoloPath: {'Compiling…' if compiles() else message}")

        return progress


def _region(settings, target, size):
    """Slices of rows, bottom first, and columns of the picture that Blender takes: all, or its Render Region."""
    if not settings.use_border:
        return slice(None), slice(None)
    # in single precision, as Blender
    ends = settings.border_min_x, settings.border_min_y
    left, bottom = (int(np.float32(end) * np.float32(n)) for end, n in zip(ends, size, strict=True))
    return slice(bottom, bottom + target.resolution_y), slice(left, left + target.resolution_x)


def _folder(depsgraph):
    """Output folder of the current frame of an animation, and of this view layer if there are several."""
    scene, layer = depsgraph.scene, depsgraph.view_layer
    folder = background.folder_of(scene)
    if sum(each.use for each in scene.view_layers) > 1:
        folder /= bpy.path.clean_name(layer.name)
    return output.frame_folder(folder, scene.frame_current)


def _check_own(depsgraph, request):
    """Refuse to replace frames of another file or scene."""
    scene, origin = depsgraph.scene, request.origin
    file = Path(bpy.data.filepath).name or background.UNTITLED
    background.check_free(background.folder_of(scene), file, scene.name)
    report = output.read_report(_folder(depsgraph))
    name, other = Path(report.get("scene") or file).name, (report.get("scene_state") or {}).get("scene")
    is_file = name.endswith(".blend")  # which may have been saved since
    # reports of earlier versions name no scene
    if report and ((is_file and name != file) or other not in (None, origin.scene_state["scene"])):
        raise engine.InvalidInput(
            f"{_folder(depsgraph)} holds a frame of {name}, scene '{other}', which would be replaced: choose another "
            "folder in the Output properties, or delete that one."
        )


def _is_focused_automatically(props):
    """Whether the only focus is that of automatic focusing, which no earlier distance stands for."""
    return props.focus_auto and not props.focus_list


def _focus_pass(distance):
    """Name of the pass of a focus distance, in millimeters: in a multilayer EXR a dot would end the name."""
    if math.isinf(distance):
        return "Focus inf"
    return f"Focus {f'{distance * 1e3:.3f}'.rstrip('0').rstrip('.').replace('.', '_')} mm"


def _passes(props, layer):
    """Names and channels of a view layer's passes."""
    channels = "RGB" if props.colors == "RGB" else "X"
    passes = [("Combined", "RGBA")]
    if properties.of_layer(layer).use_pass_focus:
        automatic = _is_focused_automatically(props)
        names = [AUTO_PASS] if automatic else map(_focus_pass, properties.focus_list_of(props))
        passes += [(name, "RGB") for name in dict.fromkeys(names)]
    if properties.of_layer(layer).use_pass_phase:
        passes.append(("Phase", channels))
    if properties.of_layer(layer).use_pass_amplitude:
        passes.append(("Amplitude", channels))
    if properties.of_layer(layer).use_pass_depth:
        passes.append(("Depth", "Z"))
    return passes


def _check_passes(hologram, layer):
    """Refuse passes with the display's pixels if pictures have others."""
    size = hologram.picture.width, hologram.picture.height
    if size != (hologram.width, hologram.height) and (layer.use_pass_phase or layer.use_pass_amplitude):
        raise engine.InvalidInput(
            f"The passes Phase and Amplitude have the display's {hologram.width} x {hologram.height} pixels, and "
            f"pictures {size[0]} x {size[1]}: switch them off, or use Render Hologram."
        )


def _pixels(request, result, depsgraph):
    """Arrays of the passes, shape (y, x, channel), by name; row 0 is the top.

    Phase and amplitude are of the first of the hologram's frames, with a channel per wavelength.
    """
    layer = depsgraph.view_layer_eval
    wavelengths = result.field.hologram.wavelengths
    pictures = engine.to_rgb(result.images, wavelengths)
    alpha = np.ones_like(pictures[0, ..., :1])
    arrays = {"Combined": np.concatenate([pictures[0], alpha], axis=-1)}
    for depth, picture in zip(result.focus, pictures, strict=True):
        arrays[_focus_pass(depth)] = picture
    arrays[AUTO_PASS] = pictures[0]
    wave = np.moveaxis(result.field.data[0], 0, -1)
    if properties.of_layer(layer).use_pass_phase:
        phase = np.angle(wave) % np.float32(2 * np.pi)
        arrays["Phase"] = np.where(phase < np.float32(2 * np.pi), phase, 0)
    if properties.of_layer(layer).use_pass_amplitude:
        arrays["Amplitude"] = np.abs(wave)
    if properties.of_layer(layer).use_pass_depth or layer.use_pass_z:
        camera, picture = squared(request.camera, result.field.hologram)
        depth = engine.depth_map(request.scene, camera, picture.width, picture.height)
        arrays["Depth"] = np.minimum(depth / unit_scale(depsgraph.scene), NO_SURFACE_DEPTH)
    return {name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()}


CLASSES = (HoloPathEngine,)
