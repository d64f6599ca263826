"""Differences between renders and viewport: the command line shows renders, the window notes them."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon import engine  # noqa: E402
from holopath_addon.cli import sources  # noqa: E402
from holopath_addon.export import find_camera, show_as_rendered  # noqa: E402
from holopath_addon.export.contents import AS_IN_VIEWPORT, LEFT_OUT  # noqa: E402
from holopath_addon.export.render_state import differences  # noqa: E402


def effects(stage):
    """Effect of each note by its object and feature."""
    return {(note.object, note.feature): note.effect for note in stage.export().notes}


def brightness(stage, samples=32):
    """Ratio of Mitsuba's image to Cycles'."""
    return float(np.mean(stage.ratio(spp=samples)))


def collection(stage, thing, name="things"):
    """A new collection with an object, and its layer collection."""
    found = bpy.data.collections.new(name)
    stage.scene.collection.children.link(found)
    stage.scene.collection.objects.unlink(thing)
    found.objects.link(thing)
    return found, stage.scene.view_layers[0].layer_collection.children[name]


def shining(stage, strength=1.0):
    return stage.material("ShaderNodeEmission", Strength=strength)


def hide_object(stage, thing):
    thing.hide_viewport = True
    return (thing.name, "Hidden in the viewport"), LEFT_OUT


def hide_by_eye(stage, thing):
    thing.hide_set(True)
    return (thing.name, "Hidden in the viewport"), LEFT_OUT


def hide_collection(stage, thing):
    collection(stage, thing)[0].hide_viewport = True
    return ("things", "Collection hidden in the viewport"), LEFT_OUT


def modifier_in_renders(stage, thing):
    modifier = thing.modifiers.new("Array", "ARRAY")
    modifier.show_viewport = False
    return (thing.name, "Modifier 'Array'"), AS_IN_VIEWPORT


def levels(stage, thing):
    modifier = thing.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.render_levels = 0, 3
    return (thing.name, "Modifier 'Subdivision'"), AS_IN_VIEWPORT


def simplify(stage, thing):
    modifier = thing.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = 3
    stage.scene.render.use_simplify, stage.scene.render.simplify_subdivision = True, 0
    return (stage.scene.name, "Simplify"), AS_IN_VIEWPORT


def curve(stage, thing):
    data = bpy.data.curves.new("curve", "CURVE")
    data.dimensions, data.fill_mode, data.resolution_u, data.render_resolution_u = "2D", "BOTH", 1, 24
    spline = data.splines.new("BEZIER")
    spline.bezier_points.add(3)
    spline.use_cyclic_u, spline.resolution_u = True, 1
    for point, place in zip(
        spline.bezier_points, [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)], strict=True
    ):
        point.co, point.handle_left_type, point.handle_right_type = place, "AUTO", "AUTO"
    data.materials.append(shining(stage))
    stage.link(bpy.data.objects.new("curve", data)).location = (0, 0, 0.5)
    return ("curve", "Curve resolution"), AS_IN_VIEWPORT


CASES = [
    *(hide_object, hide_by_eye, hide_collection),
    *(modifier_in_renders, levels, simplify, curve),
]


@pytest.mark.parametrize("case", CASES)
def test_noted_in_the_window_and_as_in_renders_otherwise(stage, case):
    stage.world((0.1, 0.1, 0.1))
    what, effect = case(stage, stage.plane(1, shining(stage)))
    bpy.context.view_layer.update()
    assert effects(stage)[what] == effect
    assert abs(brightness(stage) - 1) > 0.02
    show_as_rendered(stage.scene, stage.scene.view_layers[0])
    bpy.context.view_layer.update()
    assert list(differences(stage.scene, stage.scene.view_layers[0])) == [] and effects(stage) == {}
    assert brightness(stage) == pytest.approx(1, abs=0.01)


def test_nothing_differs_in_a_new_file():
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    scene = bpy.context.scene
    assert list(differences(scene, scene.view_layers[0])) == []


def test_collections_of_their_own_kind_are_noted(stage):
    for name in ("indirect_only", "holdout"):
        setattr(collection(stage, stage.plane(1, shining(stage), name=name), name)[1], name, True)
    found = effects(stage)
    assert found["indirect_only", "Collection > Indirect Only"].startswith("ignored: its objects are seen")
    assert "ignored" in found["holdout", "Collection > Holdout"]


def test_a_world_that_lights_only_some_is_noted(stage):
    stage.plane(2)
    world = stage.world((0.3, 0.3, 0.3))
    assert effects(stage) == {}
    world.cycles_visibility.diffuse = False
    assert effects(stage) == {
        ("world", "World > Ray Visibility > Diffuse off"): "ignored: the world lights everything"
    }


def test_shadows_that_pass_nothing_are_noted(stage):
    material = stage.material("ShaderNodeBsdfTransparent")
    stage.plane(2, material)
    stage.world()
    assert effects(stage) == {}
    material.use_transparent_shadow = False
    ((feature, effect),) = [(key[1], value) for key, value in effects(stage).items()]
    assert (
        feature == "Transparent Shadow off" and effect == "ignored: light passes through what is transparent"
    )


def test_background_scenes_are_rendered(stage):
    """Also one behind another, and only what they render."""
    stage.plane(3, shining(stage, 0.5))
    stage.plane(3, shining(stage, 9.0), location=(0, 0, 1)).hide_render = True
    back = stage.scene
    front = bpy.data.scenes.new("front")
    front.collection.objects.link(stage.camera)
    front.camera, front.background_set = stage.camera, back
    thing = bpy.data.objects.new("thing", bpy.data.meshes.new("thing"))
    thing.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    thing.data.materials.append(shining(stage, 2.0))
    thing.location.z = 1
    front.collection.objects.link(thing)
    bpy.context.window.scene = stage.scene = front
    assert brightness(stage) == pytest.approx(1, abs=0.01)
    back.objects["plane"].hide_viewport = True
    assert effects(stage)["plane", "Hidden in the viewport"] == LEFT_OUT


def test_the_camera_of_the_frame(stage):
    """Markers switch it in renders, also where the file was saved with another one."""
    for number, frame in ((1, 5), (2, 20)):
        camera = stage.link(bpy.data.objects.new(f"camera {number}", stage.camera.data))
        stage.scene.timeline_markers.new("marker", frame=frame).camera = camera
    for frame, name in (
        (1, "camera 1"),
        (5, "camera 1"),
        (19, "camera 1"),
        (20, "camera 2"),
        (90, "camera 2"),
    ):
        stage.scene.frame_current = frame
        stage.scene.camera = stage.camera
        assert find_camera(stage.scene).name == name
    assert find_camera(stage.scene, stage.camera) == stage.camera


def test_view_layers_that_renders_use(stage, tmp_path):
    """The first one that is used, in the command line."""
    thing = stage.plane(1, shining(stage))
    _, first = collection(stage, thing)
    first.exclude = True
    stage.scene.view_layers.new("second")
    stage.scene.view_layers[0].use = False
    stage.plane(3, shining(stage), location=(0, 0, -1))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    source = sources.open_source(str(tmp_path / "scene.blend"))
    assert len(source.load(8, 8).scene.shapes()) == 4  # what shines has two sides
    source.choose(view_layer=source.scene.view_layers[0].name)
    assert len(source.load(8, 8).scene.shapes()) == 2
    source.choose()
    for layer in source.scene.view_layers:
        layer.use = False
    with pytest.raises(
        engine.InvalidInput, match="Turn on Use for Rendering of one, or choose one with --view-layer"
    ):
        source.load(8, 8)
