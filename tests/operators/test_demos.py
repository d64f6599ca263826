"""Add > HoloPath Demo."""

import bpy
import numpy as np
import pytest

from holopath_addon.blender import demo, properties


def shapes(scene):
    """Places and data of a scene's objects, without names."""
    things = [
        (
            thing.type,
            tuple(map(tuple, thing.matrix_world)),
            len(getattr(thing.data, "vertices", ())),
            [
                (*node.image.size, node.image.packed_file.size)
                for slot in thing.material_slots
                for node in slot.material.node_tree.nodes
                if node.bl_idname == "ShaderNodeTexImage"
            ],
        )
        for thing in scene.objects
    ]
    return sorted(things, key=repr)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name == "suzanne" else ()) for name in demo.DEMOS]
)
def test_adds_a_scene(scene, name):
    own = {(type(b).__name__, b.name) for blocks in (bpy.data.objects, bpy.data.scenes) for b in blocks}
    scene.objects["Wall"].select_set(True)
    settings = scene.holopath.resolution_x, scene.render.engine, scene.world
    assert bpy.ops.holopath.add_demo(name=name) == {"FINISHED"}
    shown = bpy.context.window.scene
    assert shown.name == f"HoloPath {name.title()}" and shown.render.engine == "HOLOPATH"
    assert properties.focus_list_of(shown.holopath) == list(demo.FOCUS[name]) and shown.holopath.focus_auto
    assert shown.camera.name in shown.objects
    kept = {(type(b).__name__, b.name) for blocks in (bpy.data.objects, bpy.data.scenes) for b in blocks}
    assert own <= kept
    assert set(scene.objects.keys()) == {"Camera", "Near", "Wall"}
    assert settings == (scene.holopath.resolution_x, scene.render.engine, scene.world)

    assert bpy.ops.holopath.add_demo(name=name) == {"FINISHED"}
    again = bpy.context.window.scene
    assert again.name == f"HoloPath {name.title()}.001"
    assert shapes(again) == shapes(shown)
    assert not set(again.objects.keys()) & set(shown.objects.keys())
    np.testing.assert_allclose(again.camera.data.lens, shown.camera.data.lens)


def test_not_while_editing(scene):
    bpy.context.view_layer.objects.active = scene.objects["Wall"]
    bpy.ops.object.mode_set(mode="EDIT")
    assert not bpy.ops.holopath.add_demo.poll()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.ops.holopath.add_demo.poll()
