"""The render engine HOLOPATH, a thin delegate: F12 of `operators.session`, RENDERED shading of `viewport`."""

import math
import time
from dataclasses import replace

import bpy
import numpy as np

from .. import engine
from ..engine.mapping import squared
from ..engine.progress import Compiling
from ..export import unit_scale
from ..operators import background, session
from ..operators.jobs import on_main_thread
from ..operators.rendering import output_size
from ..workflow import output, pipeline, stills
from . import properties, viewport

NOTHING = 1e10  # depth where there is no surface, as Cycles writes it


class HoloPathEngine(bpy.types.RenderEngine):
    """Renders the hologram of a frame; the picture is its reconstruction at the focus distance.

    Its picture has as many pixels as the render (Output properties), so that they map one to one: as many as the
    hologram where these are square.
    """

    bl_idname = "HOLOPATH"
    bl_label = "HoloPath"
    bl_use_preview = False
    bl_use_eevee_viewport = True

    def update_render_passes(self, scene, renderlayer):
        """Called by Blender to learn which passes a view layer has, for a render and for the compositor."""
        for name, channels in _passes(properties.of(scene), renderlayer):
            kind = "VALUE" if len(channels) == 1 else "COLOR"
            self.register_pass(scene, renderlayer, name, len(channels), channels, kind)

    def render(self, depsgraph):
        """Called by Blender for every view layer of a frame; in a window on a thread of its own. Raises nothing.

        Blender gets a result in any case: writing a multilayer EXR without one crashes it.
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
            task = on_main_thread(lambda: session.prepare(depsgraph, props, size, camera))
            spent = time.perf_counter() - start
            keep = self.is_animation and props.keep_fields
            listed = keep or properties.of_layer(layer).use_pass_focus
            request = task.built
            if listed:
                request = replace(request, focus=[*request.focus, *properties.focus_list_of(props)])
            if keep:
                result = self._kept(request, _folder(depsgraph), progress, spent)
            else:
                result = pipeline.compute(request, progress)
            session.keep(task, result)
            session.current.found = result.focus[0] if request.autofocus else None
            pixels = _pixels(request, result, depsgraph)
        except BaseException as error:
            failure = session.fail(error)
        target = self.begin_result(0, 0, *size, layer=layer.name)
        try:
            region = _region(settings, target, size)
            for part in target.layers[0].passes:
                if part.name in pixels:
                    # pyrefly: ignore[missing-attribute]  # in Blender's stubs an array of numbers is one
                    part.rect.foreach_set(np.ascontiguousarray(pixels[part.name][::-1][region]).ravel())
        except BaseException as error:
            failure = session.fail(error)
        finally:
            self.end_result(target)
        if failure:
            self.report({"ERROR"}, failure)

    def _kept(self, request, folder, progress, export_seconds):
        """The render of a request, made and put into its folder, or taken from there."""

        def say(text):
            self.report({"INFO"}, f"{folder.name}: {text}")

        result, _ = stills.update(folder, request, progress, export_seconds, say)
        return result or pipeline.compute(request, progress, stills.load_field(folder))

    def view_update(self, context: bpy.types.Context, depsgraph):
        """Called by Blender when its scene has changed; `viewport` listens for itself."""

    def view_draw(self, context: bpy.types.Context, depsgraph):
        """Called by Blender to redraw a 3D View that is shaded RENDERED."""
        shown = viewport.of(self, context.region)
        self.update_stats("", shown.draw(context, depsgraph, self.get_preview_pixel_size(context.scene)))

    def _progress(self, compiles):
        """What work calls to tell Blender how far it is, and to learn that it is to stop."""

        def progress(done, message):
            if self.test_break():
                raise engine.Cancelled
            self.update_progress(done)
            self.update_stats("", f"HoloPath: {'Compiling…' if compiles() else message}")

        return progress


def _region(settings, target, size):
    """Rows, bottom first, and columns of the picture that Blender takes: all, or its Render Region."""
    if not settings.use_border:
        return slice(None), slice(None)
    left, bottom = int(settings.border_min_x * size[0]), int(settings.border_min_y * size[1])
    return slice(bottom, bottom + target.resolution_y), slice(left, left + target.resolution_x)


def _folder(depsgraph):
    """Output folder of the current frame of an animation; where several view layers are rendered, of this one's."""
    scene, layer = depsgraph.scene, depsgraph.view_layer
    folder = background.folder_of(scene)
    if sum(each.use for each in scene.view_layers) > 1:
        folder /= bpy.path.clean_name(layer.name)
    return output.frame_folder(folder, scene.frame_current)


def _focus_pass(metres):
    """Name of the pass of a focus distance, in millimetres: in a multilayer EXR a dot would end the name."""
    if math.isinf(metres):
        return "Focus inf"
    return f"Focus {f'{metres * 1e3:.3f}'.rstrip('0').rstrip('.').replace('.', '_')} mm"


def _passes(props, layer):
    """Names and channels of a view layer's passes."""
    colours = "RGB" if props.colours == "RGB" else "X"
    found = [("Combined", "RGBA")]
    if properties.of_layer(layer).use_pass_focus:
        names = map(_focus_pass, properties.focus_list_of(props))
        found += [(name, "RGB") for name in dict.fromkeys(names)]
    if properties.of_layer(layer).use_pass_phase:
        found.append(("Phase", colours))
    if properties.of_layer(layer).use_pass_amplitude:
        found.append(("Amplitude", colours))
    if properties.of_layer(layer).use_pass_depth:
        found.append(("Depth", "Z"))
    return found


def _check_passes(hologram, layer):
    """Refuse passes of the panel's pixels where pictures have others."""
    size = hologram.picture.width, hologram.picture.height
    if size != (hologram.width, hologram.height) and (layer.use_pass_phase or layer.use_pass_amplitude):
        raise engine.InvalidInput(
            f"The passes Phase and Amplitude have the display's {hologram.width} x {hologram.height} pixels, and "
            f"pictures {size[0]} x {size[1]}: switch them off, or use Render Hologram."
        )


def _pixels(request, result, depsgraph):
    """Arrays [y, x, channel] of the passes by their names, row 0 at the top.

    Phase and amplitude are those of the first of the frames that are shown one after the other, a channel a
    wavelength.
    """
    layer = depsgraph.view_layer_eval
    wavelengths = result.field.hologram.wavelengths
    pictures = engine.to_rgb(result.images, wavelengths)
    alpha = np.ones_like(pictures[0, ..., :1])
    found = {"Combined": np.concatenate([pictures[0], alpha], axis=-1)}
    for depth, picture in zip(result.focus, pictures, strict=True):
        found[_focus_pass(depth)] = picture
    wave = np.moveaxis(result.field.data[0], 0, -1)
    if properties.of_layer(layer).use_pass_phase:
        phase = np.angle(wave) % np.float32(2 * np.pi)
        found["Phase"] = np.where(phase < np.float32(2 * np.pi), phase, 0)
    if properties.of_layer(layer).use_pass_amplitude:
        found["Amplitude"] = np.abs(wave)
    if properties.of_layer(layer).use_pass_depth or layer.use_pass_z:
        camera, picture = squared(request.camera, result.field.hologram)
        depth = engine.depth_map(request.scene, camera, picture.width, picture.height)
        found["Depth"] = np.minimum(depth / unit_scale(depsgraph.scene), NOTHING)
    return {name: np.ascontiguousarray(array, np.float32) for name, array in found.items()}


CLASSES = (HoloPathEngine,)
