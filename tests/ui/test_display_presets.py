"""The user's own displays, as Blender keeps presets."""

import bpy
import pytest


def test_kept_and_taken(scene):
    props = scene.holopath
    props.display = "leto-3"
    props.display = "CUSTOM"
    props.resolution_x, props.pitch_um, props.bits = 1234, 4.25, 10
    props.square_pixels, props.pitch_y_um = False, 5.5
    props.colors, props.wavelength_nm = "MONO", 532.0
    props.wavelengths_nm = (630.0, 520.0, 460.0)
    props.depth_far_mm, props.depth_near_mm = 33.0, 44.0
    props.optics.beam, props.optics.middle_mm, props.optics.stop = "gaussian", (0.5, 0.25), "half"
    frames = props.frames
    names = [
        "display", "resolution_x", "resolution_y", "pitch_um", "square_pixels", "pitch_y_um", "bits", "colors",
        "wavelength_nm", "depth_far_mm", "depth_near_mm",
    ]  # fmt: skip
    kept = {name: getattr(props, name) for name in names} | {"wavelengths": tuple(props.wavelengths_nm)}
    assert bpy.ops.holopath.display_preset_add(name="My SLM") == {"FINISHED"}
    path = bpy.utils.preset_find("My_SLM", "holopath/display")
    assert path is not None

    props.display, props.optics.beam, props.optics.stop = "gaea-2", "flat", "circle"
    props.optics.middle_mm = (0.0, 0.0)
    props.colors, props.wavelengths_nm, props.frames = "RGB", (640, 516, 455), frames + 1
    assert bpy.ops.script.execute_preset(filepath=path, menu_idname="HOLOPATH_PT_display_presets") == {
        "FINISHED"
    }
    assert {name: getattr(props, name) for name in names} | {
        "wavelengths": tuple(props.wavelengths_nm)
    } == kept
    assert (props.optics.beam, tuple(props.optics.middle_mm)) == ("gaussian", (0.5, 0.25))
    assert props.optics.stop == "half" and props.frames == frames + 1
    assert bpy.ops.holopath.display_preset_add(remove_name=True, name="My_SLM") == {"FINISHED"}
    assert bpy.utils.preset_find("My_SLM", "holopath/display") is None


def test_measured_files_are_found_from_other_folders(scene, tmp_path):
    (tmp_path / "here").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "here" / "scene.blend"))
    optics = scene.holopath.optics
    optics.beam_file, optics.stop_file = "//beam.exr", str(tmp_path / "stop.png")
    assert bpy.ops.holopath.display_preset_add(name="Measured") == {"FINISHED"}
    path = bpy.utils.preset_find("Measured", "holopath/display")
    optics.beam_file = optics.stop_file = ""
    bpy.ops.script.execute_preset(filepath=path, menu_idname="HOLOPATH_PT_display_presets")
    assert optics.beam_file == str(tmp_path / "here" / "beam.exr") and optics.beam_phase == ""
    assert optics.stop_file == str(tmp_path / "stop.png")
    assert bpy.ops.holopath.display_preset_add(remove_name=True, name="Measured") == {"FINISHED"}


@pytest.mark.parametrize("place", ["view3d", "render"])
def test_in_the_panels_header(addon, place):
    panel = getattr(bpy.types, f"HOLOPATH_PT_{place}_display")
    assert hasattr(panel, "draw_header_preset")
    assert not hasattr(getattr(bpy.types, f"HOLOPATH_PT_{place}_depth"), "draw_header_preset")
