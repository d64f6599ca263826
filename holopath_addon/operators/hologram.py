"""Operators on phases: encode the stored wave field for an SLM and its bench, and save the hologram."""

from dataclasses import replace

import bpy
from bpy.props import StringProperty

from .. import engine
from ..blender import preferences, properties
from ..blender.device_properties import calibration_of
from ..blender.properties.optics import optics_of, set_colors
from ..engine.displays import ENOUGH_BITS
from ..engine.scene import variants
from ..slm.calibration import colors_of
from ..workflow import failures, pipeline
from ..workflow.request import Encoding
from . import session
from .modal_operator import ModalOperator, SaveOperator, has_field, has_phase, report_error


def _quality(phase):
    """PSNR of the phases' last stage against its target, in words: ``, 31.2 dB``; empty if none was measured."""
    stages = phase.report["stages"]
    last = stages[-1]["stage"] if stages else None
    psnr = [stage["psnr_db"] for stage in stages if stage["stage"] == last and "psnr_db" in stage]
    return f", {sum(psnr) / len(psnr):.1f} dB" if psnr else ""


class HOLOPATH_OT_encode(ModalOperator, bpy.types.Operator):
    """Turn the stored wave field into the phases that an SLM shows, and show them"""

    bl_idname = "holopath.encode"
    bl_label = "Encode"
    activity = "encoding"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return has_field(cls) and super().poll(context)

    def work(self, scene):
        field, task, before = session.stored_refocuser().field, session.current.task, session.current.phase
        props = properties.of(bpy.data.scenes[scene])
        optics = optics_of(props)
        method, calibration = props.encoding, calibration_of(props.device)
        encoding = Encoding(method, properties.encode_seconds_of(props), properties.eyebox_of(props))
        if calibration is not None:
            levels = calibration.levels_of(field.hologram)
            display = calibration.display(field.hologram.wavelengths)
            encoding = replace(encoding, levels=levels, display=display)
        elif props.bits < ENOUGH_BITS:
            encoding = replace(encoding, bits=props.bits)
        backend = preferences.chosen_backend()

        def encode(job, progress):
            scene = ()
            if task is not None and field.report.get("variant") == variants.activate(backend):
                scene = task.exported.scene, task.request.settings, task.request.store
            elif method == "refine":
                raise engine.InvalidInput(
                    "The scene of this hologram is no longer at hand: press Render Hologram, or choose another "
                    "encoding."
                )
            try:
                phase = pipeline.encode(engine.at_panel(field, optics), encoding, progress, *scene)
                return field, phase, encoding
            except engine.Cancelled as error:
                if error.kept is None or before is not None:
                    raise
                return field, error.kept, encoding

        return encode

    def cancel_message(self):
        return "Canceled" if session.current.phase is None else "Canceled, the last hologram stays"

    def finish(self, context: bpy.types.Context, result):
        field, phase, encoding = result
        if field is not session.current.field:
            raise engine.InvalidInput("Another hologram has been rendered meanwhile: press Encode again.")
        session.keep_phase(phase, encoding)
        props = self.scene_settings()
        self.present(context, session.show_phase(props.phase_frame if props else 0))
        if props and props.refocused == "PHASE":
            session.refocus_by_settings(props)
        if phase.report.get("advice"):
            self.report({"INFO"}, phase.report["advice"])
        return (
            f"{'Stopped: hologram' if phase.report.get('stopped') else 'Hologram'} encoded{_quality(phase)}"
        )


class HOLOPATH_OT_save_hologram(SaveOperator, bpy.types.Operator):
    """Write the phases to a folder: phase.npy, and for each frame and color an 8-bit picture for an SLM"""

    bl_idname = "holopath.save_hologram"
    bl_label = "Save Hologram"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return has_phase(cls) and super().poll(context)

    def content(self):
        return session.encoded_hologram()

    @staticmethod
    def write(content, folder, progress):
        content.save(folder, progress)


class HOLOPATH_OT_colors_from(bpy.types.Operator):
    """Take the place and scale of each color from a calibration of all wavelengths, as its camera saw them"""

    bl_idname = "holopath.colors_from"
    bl_label = "From Calibration"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(name="File", description="Calibration, a JSON file", subtype="FILE_PATH")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context):
        props = properties.of(context.scene)
        try:
            hologram = properties.hologram_of(props)
            panel = replace(hologram, optics=hologram.optics.of_rays)
            set_colors(props.optics, colors_of(bpy.path.abspath(self.filepath), panel))
        except Exception as error:
            return report_error(self, failures.sentence(error))
        return {"FINISHED"}


CLASSES = (HOLOPATH_OT_encode, HOLOPATH_OT_save_hologram, HOLOPATH_OT_colors_from)
