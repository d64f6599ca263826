"""Operators on a rendered field."""

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.operators import session


def test_focus_from_selected(scene):
    bpy.context.view_layer.objects.active = scene.objects["Wall"]
    assert bpy.ops.holopath.focus_from_selected() == {"FINISHED"}
    assert scene.holopath.focus == pytest.approx(2.0) and not scene.holopath.focus_auto
    scene.objects["Wall"].location.z = 1.0
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="'Wall' is behind the camera"):
        bpy.ops.holopath.focus_from_selected()


def test_save_field(scene, tmp_path):
    with pytest.raises(RuntimeError):
        bpy.ops.holopath.save_field(directory=str(tmp_path))
    bpy.ops.holopath.render_hologram()
    assert bpy.ops.holopath.save_field(directory=str(tmp_path)) == {"FINISHED"}
    stored = engine.WaveField.load(tmp_path / "wavefield")
    np.testing.assert_array_equal(stored.data, session.current.field.data)
    (tmp_path / "file").write_text("")
    with pytest.raises(RuntimeError, match="cannot be made"):
        bpy.ops.holopath.save_field(directory=str(tmp_path / "file"))
