"""Properties by the names of the version before, in scripts and in files."""

import bpy
import pytest


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
