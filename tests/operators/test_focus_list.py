"""The buttons of the focus list."""

import math

import bpy
import pytest

from holopath_addon.blender import properties
from holopath_addon.operators import focus_list


def test_add_remove_sort(scene):
    props = scene.holopath
    assert not bpy.ops.holopath.focus_list_remove.poll() and not bpy.ops.holopath.focus_list_sort.poll()
    for meters in (2.0, math.inf, 0.5, 2.0):
        properties.set_focus(props, meters)
        assert bpy.ops.holopath.focus_list_add() == {"FINISHED"}
    assert properties.focus_list_of(props) == [2.0, math.inf, 0.5] and len(props.focus_list) == 3
    props.focus_index = 0
    bpy.ops.holopath.focus_list_sort()
    assert properties.focus_list_of(props) == [0.5, 2.0, math.inf] and props.focus_index == 1
    props.focus_index = 2
    bpy.ops.holopath.focus_list_remove()
    assert properties.focus_list_of(props) == [0.5, 2.0]
    assert props.focus_index == 1 and props.focus_infinity  # as looked at before
    for _ in range(2):
        bpy.ops.holopath.focus_list_remove()
    assert len(props.focus_list) == 0 and props.focus_index == 0


def test_from_selected(scene):
    assert not bpy.ops.holopath.focus_list_from_selected.poll()
    scene.unit_settings.scale_length = 0.1
    for name in ("Wall", "Near", "Camera"):
        scene.objects[name].select_set(True)
    bpy.ops.holopath.focus_list_from_selected()
    assert properties.focus_list_of(scene.holopath) == [0.05, 0.2]
    scene.objects["Near"].location.z = scene.objects["Wall"].location.z = 1.0
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="Behind the camera: (Near, Wall|Wall, Near)"):
        bpy.ops.holopath.focus_list_from_selected()
    assert properties.focus_list_of(scene.holopath) == [0.05, 0.2]


def test_buttons_leave_the_focus_alone(scene):
    """Only a click on a row looks there."""
    props = scene.holopath
    for meters in (0.5, 1.0, 3.0):
        focus_list.add(props, meters)
    props.focus = 0.5
    props.focus_auto = True
    for press in (
        bpy.ops.holopath.focus_list_add,
        bpy.ops.holopath.focus_list_sort,
        bpy.ops.holopath.focus_list_remove,
    ):
        press()
        assert props.focus == 0.5 and props.focus_auto
    props.focus_index = len(props.focus_list) - 1
    assert props.focus == 3.0 and not props.focus_auto
