"""Presets of the user's own displays."""

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..blender import properties
from ..blender.properties.optics import HoloPathOptics


class HOLOPATH_OT_display_preset_add(AddPresetBase, bpy.types.Operator):
    """Save these display settings, depth range, wavelengths and optics as a preset, or remove one"""

    bl_idname = "holopath.display_preset_add"
    bl_label = "Add Display Preset"
    preset_menu = "HOLOPATH_PT_display_presets"
    preset_subdir = "holopath/display"
    preset_values = [
        f"bpy.context.scene.holopath.{name}"
        for name in (
            "display",  # first: it sets others
            "resolution_x",
            "resolution_y",
            "pitch_um",
            "square_pixels",
            "pitch_y_um",
            "bits",
            "colors",
            "wavelengths_nm",
            "wavelength_nm",
            "depth_far_mm",
            "depth_near_mm",
            "depth_auto",  # after those, which switch it off
            *(f"optics.{name}" for name in HoloPathOptics.__annotations__),
        )
    ]

    def post_cb(self, context: bpy.types.Context, filepath: str = ""):
        """Give measured files their whole paths in the new preset, for it serves other .blend files, too."""
        path = bpy.utils.preset_find(self.as_filename(self.name), self.preset_subdir)
        if path is None:  # one was removed
            return
        text, optics = Path(path).read_text("utf-8"), properties.of(context.scene).optics
        for file in (optics.beam_file, optics.beam_phase, optics.stop_file):
            if file.startswith("//"):
                text = text.replace(f"= {file!r}\n", f"= {bpy.path.abspath(file)!r}\n")
        Path(path).write_text(text, "utf-8")


class HOLOPATH_PT_display_presets(PresetPanel, bpy.types.Panel):
    """List of presets in the header of the section Display."""

    bl_label = "Display Presets"
    preset_subdir = HOLOPATH_OT_display_preset_add.preset_subdir
    preset_operator = "script.execute_preset"
    preset_add_operator = HOLOPATH_OT_display_preset_add.bl_idname


CLASSES = (HOLOPATH_OT_display_preset_add, HOLOPATH_PT_display_presets)
