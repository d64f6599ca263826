"""Properties by the names of the version before, in scripts and in files."""

from pathlib import Path

import bpy
import pytest

from holopath_addon.blender.properties import former as former_properties


def test_scripts_may_use_former_names(scene):
    props = scene.holopath
    with pytest.warns(
        DeprecationWarning, match="^The property colours is called colors now. The next version "
    ):
        props.colours = "MONO"
    with pytest.warns(DeprecationWarning, match="called focus_diopters now"):
        props.focus_dioptres = 4.0
    assert (props.colors, props.focus) == ("MONO", 0.25)
    with pytest.warns(DeprecationWarning):
        assert props.most_hits == props.max_specular_depth == 8


def test_files_with_former_names_are_adopted(addon, tmp_path):
    """Values that the version before stored, of a menu and of a number; later changes are not undone."""
    file = str(tmp_path / "former.blend")
    props = bpy.context.scene.holopath
    props["colours"], props["most_hits"] = 1, 5  # as files hold them
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    props = bpy.context.scene.holopath
    assert (props.colors, props.max_specular_depth) == ("MONO", 5)
    props.colors = "RGB"
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    assert bpy.context.scene.holopath.colors == "RGB"


def test_linked_scenes_with_former_names_are_adopted(addon):
    """They cannot be saved, so each time that they are linked."""
    file = Path(__file__).with_name("data") / "settings-0.1.0.blend"
    with bpy.data.libraries.load(str(file), link=True) as (source, target):
        target.scenes = source.scenes
    (scene,) = target.scenes
    try:
        assert scene.library is not None
        assert (scene.holopath.colors, scene.holopath.max_specular_depth) == ("MONO", 9)
    finally:
        bpy.data.scenes.remove(scene)


def test_animations_of_former_names_go_on(addon, tmp_path):
    """Keyframes and a driver, which Blender ignores where their property is not there."""
    file, scene = str(tmp_path / "animated.blend"), bpy.context.scene
    for frame, diopters in ((1, 1.0), (11, 3.0)):
        scene.holopath.focus_diopters = diopters
        scene.holopath.keyframe_insert("focus_diopters", frame=frame)
    scene.holopath.driver_add("max_specular_depth").driver.expression = "frame + 1"
    former = {new: old for old, new in former_properties.NAMES.items()}
    for curve in former_properties._curves():
        path, _, name = curve.data_path.rpartition(".")
        curve.data_path = f"{path}.{former[name]}"
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    scene = bpy.context.scene
    for frame, diopters in ((1, 1.0), (6, 2.0), (11, 3.0)):
        scene.frame_set(frame)
        assert scene.holopath.focus_diopters == pytest.approx(diopters, rel=1e-5)
        assert scene.holopath.max_specular_depth == frame + 1
