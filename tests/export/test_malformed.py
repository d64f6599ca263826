"""Broken and extreme scenes end in a picture, a note or a sentence; never in a crash or a hang."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon.engine import InvalidInput  # noqa: E402
from holopath_addon.export.shading.node_graph import Pin, follow  # noqa: E402

from .test_geometry import area, bounds, hit  # noqa: E402


def features(exported):
    return {(note.object, note.feature) for note in exported.notes}


def textured(stage):
    material = stage.material("ShaderNodeBsdfDiffuse", "textured")
    stage.texture(material, stage.image(np.full((4, 4, 3), 0.5)), "Color")
    return material


def test_textured_mesh_without_uvs(stage):
    stage.mesh("bare", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], textured(stage))
    stage.world()
    exported = stage.export()
    assert ("bare", "UV map 'active'") in features(exported)
    assert np.isfinite(stage.mitsuba(spp=4, exported=exported)).all()


def test_uvs_that_are_not_numbers(stage):
    nan = float("nan")
    plane = stage.plane(material=textured(stage))
    plane.data.uv_layers[0].uv.foreach_set("vector", [nan, 0, 1, 0, 1, float("inf"), 0, 1])
    stage.world()
    assert np.isfinite(stage.mitsuba(spp=4)).all()


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 1, 0), (0, 1, 1), (1e-30, 1e-30, 1e-30), (1e18, 1, 1)])
@pytest.mark.parametrize("emits", [False, True])
def test_collapsed_objects(stage, scale, emits):
    sphere = stage.sphere(material=stage.material("ShaderNodeEmission") if emits else None)
    sphere.scale = scale
    stage.plane(location=(0, 0, -1))
    stage.world()
    assert np.isfinite(stage.mitsuba(spp=4)).all()


def test_transform_that_is_not_finite(stage):
    stage.plane(name="lost").location.x = float("nan")
    stage.plane()
    with pytest.raises(InvalidInput, match="'lost'.*not finite"):
        stage.export()


def test_driver_that_fails(stage):
    plane = stage.plane(name="driven")
    driver = plane.driver_add("location", 0).driver
    driver.expression = "no_such_name + 1"
    other = plane.driver_add("scale", 0).driver
    other.expression = "1 / (frame - frame)"
    assert np.isfinite(bounds(stage.export().scene)).all()


def test_links_in_a_circle(stage):
    material = stage.material("ShaderNodeBsdfPrincipled", "circle")
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    first, second = tree.nodes.new("NodeReroute"), tree.nodes.new("NodeReroute")
    tree.links.new(first.outputs[0], second.inputs[0])
    tree.links.new(second.outputs[0], first.inputs[0])
    tree.links.new(second.outputs[0], shader.inputs["Roughness"])
    mix = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(mix.outputs[0], mix.inputs[1])
    tree.links.new(shader.outputs[0], mix.inputs[2])
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    stage.plane(material=material)
    stage.world()
    exported = stage.export()
    assert ("plane", "Nodes linked in a circle") in features(exported)
    assert np.isfinite(stage.mitsuba(spp=4, exported=exported)).all()


def test_sums_of_sums(stage):
    """Each Add Shader has the one before in both inputs: 40 of them have 2^40 shaders."""
    material = stage.material("ShaderNodeEmission", "doubled")
    tree = material.node_tree
    last = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    for _ in range(40):
        add = tree.nodes.new("ShaderNodeAddShader")
        for socket in add.inputs:
            tree.links.new(last.outputs[0], socket)
        last = add
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(last.outputs[0], output.inputs["Surface"])
    stage.plane(material=material)
    exported = stage.export()
    assert ("plane", "Over 1000 shaders in one material") in features(exported)


def test_follow_ends_where_blender_does_not_mark_the_circle():
    class Link:
        is_valid, is_muted = True, False

        def __init__(self, source):
            self.from_socket, self.from_node = source, source.node

    class Node:
        mute, bl_idname = False, "NodeReroute"

    class Socket:
        is_output = True

        def __init__(self, node):
            self.node, self.links = node, []

    first, second = Node(), Node()
    for node in (first, second):
        node.inputs, node.out = [Socket(node)], Socket(node)
    first.inputs[0].links, second.inputs[0].links = [Link(second.out)], [Link(first.out)]
    assert follow(Pin(first.inputs[0])).node in (first, second)


def test_groups_inside_each_other(stage):
    """Blender refuses the second link of such a circle; what is left must export."""
    groups = [bpy.data.node_groups.new(name, "ShaderNodeTree") for name in "ab"]
    for group, other in zip(groups, groups[::-1], strict=True):
        group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
        node, output = group.nodes.new("ShaderNodeGroup"), group.nodes.new("NodeGroupOutput")
        node.node_tree = other
        if node.outputs:
            group.links.new(node.outputs[0], output.inputs[0])
    material = stage.material(name="nested")
    tree = material.node_tree
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = groups[0]
    output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    stage.plane(material=material)
    assert area(stage.export().scene) == pytest.approx(4)


def test_collection_that_instances_itself(stage):
    collection = bpy.data.collections.new("inside itself")
    stage.scene.collection.children.link(collection)
    plane = stage.plane()
    stage.scene.collection.objects.unlink(plane)
    collection.objects.link(plane)
    empty = bpy.data.objects.new("instance", None)
    collection.objects.link(empty)
    empty.instance_type, empty.location.x = "COLLECTION", 3
    try:
        empty.instance_collection = collection
    except RuntimeError:
        pytest.skip("Blender refuses it")
    assert 4 <= area(stage.export().scene) < 100


def test_parents_and_constraints_in_a_circle(stage):
    first, second = stage.plane(name="first"), stage.plane(name="second")
    first.parent = second
    try:
        second.parent = first
    except RuntimeError:
        pass
    for obj, target in ((first, second), (second, first)):
        obj.constraints.new("COPY_LOCATION").target = target
    assert area(stage.export().scene) == pytest.approx(8)


def test_slots_and_indices_that_do_not_exist(stage):
    plane = stage.plane()
    plane.data.materials.append(None)
    plane.data.attributes.new("material_index", "INT", "FACE").data[0].value = 7
    assert area(stage.export().scene) == pytest.approx(4)
    plane.data.attributes["material_index"].data[0].value = -3
    plane.data.materials.clear()
    assert area(stage.export().scene) == pytest.approx(4)


def test_loose_vertices_and_degenerate_faces(stage):
    stage.mesh("loose", [(9, 9, 9), (8, 8, 8)], [])
    stage.mesh("edge", [(9, 9, 9), (8, 8, 8)], []).data.edges.add(1)
    emission = stage.material("ShaderNodeEmission")
    faces = [(0, 1, 2), (0, 0, 1), (0, 1, 3), (2, 4, 5)]
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (0, 1, 0), (0, 1, 0), (50, 50, 50)]
    for name, material in (("gray", None), ("bright", emission)):
        mesh = stage.mesh(name, points, faces, material)
        mesh.data.shade_smooth()
    stage.world()
    exported = stage.export()
    assert bounds(exported.scene)[1] == pytest.approx((2, 1, 0), abs=1e-4)  # loose points do not count
    assert np.isfinite(stage.mitsuba(spp=4, exported=exported)).all()


def test_a_failed_export_leaves_nothing_half_read(stage):
    from holopath_addon.export import ExportCache, export_scene

    plane = stage.plane()
    cache = ExportCache()
    try:
        for x, fails in ((0.0, False), (float("nan"), True), (1.0, False)):
            plane.data.vertices[0].co.x = x
            depsgraph = bpy.context.evaluated_depsgraph_get()
            if fails:
                with pytest.raises(InvalidInput, match="'plane'"):
                    export_scene(depsgraph, (8, 8), cache=cache)
            else:
                ours = export_scene(depsgraph, (8, 8), cache=cache).scene
                assert area(ours) == pytest.approx(area(stage.export().scene))
    finally:
        cache.close()


def scene_of_size(stage, size):
    stage.plane(4 * size, stage.material("ShaderNodeBsdfDiffuse", "red", Color=(0.8, 0.2, 0.2, 1)))
    stage.sphere(0.5 * size, location=(0, 0, 0.5 * size))
    lamp = stage.plane(
        size, stage.material("ShaderNodeEmission", Strength=5.0), "lamp", (size, 0.3 * size, 2.5 * size)
    )
    lamp.rotation_euler = (0, np.pi + 0.3, 0)
    stage.lamp("POINT", 40.0 * size**2, (-size, -size, 3 * size), shadow_soft_size=0.1 * size)
    stage.camera.location, stage.camera.rotation_euler = (0, -size, 4 * size), (0.25, 0, 0)
    stage.camera.data.clip_start, stage.camera.data.clip_end = 0.01 * size, 100 * size
    stage.world((0.2, 0.3, 0.4), 0.3)


@pytest.mark.parametrize("size", [2e-3, 1, 1e4])
def test_small_and_large_scenes_are_as_in_cycles(stage, size):
    scene_of_size(stage, size)
    exported = stage.export()
    assert not any("tiny" in note.feature for note in exported.notes)
    ours, theirs = stage.mitsuba((24, 24), 256, exported=exported), stage.cycles((24, 24), 256)
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.03)


def test_ten_micrometres_are_noted_and_the_unit_scale_helps(stage):
    scene_of_size(stage, 1e-5)
    exported = stage.export()
    assert any("tiny" in note.feature for note in exported.notes)
    assert np.isfinite(stage.mitsuba((16, 16), 16, exported=exported)).all()
    stage.scene.unit_settings.scale_length = 1e4
    exported = stage.export()
    assert not any("tiny" in note.feature for note in exported.notes)
    ours, theirs = stage.mitsuba((24, 24), 256, exported=exported), stage.cycles((24, 24), 256)
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.03)


def test_far_from_the_origin(stage):
    """Float32 positions: 10 km away from the camera they are 1 mm apart."""
    stage.plane(location=(1e4, 0, 0))
    exported = stage.export()
    assert any("far from the camera" in note.feature for note in exported.notes)
    si = hit(exported.scene, (1e4 + 0.5, 0.3, 5), (0, 0, -1))
    assert float(si.t[0]) == pytest.approx(5, abs=1e-3)


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_scene_and_camera_far_from_the_origin(stage, scale):
    """Kilometers away Mitsuba's rays would start a meter above surfaces; instances, hair and lights move along."""
    stage.scene.unit_settings.scale_length = scale
    scene_of_size(stage, 1)
    things = bpy.data.collections.new("things")
    ball = stage.sphere(0.2, name="ball")
    stage.scene.collection.objects.unlink(ball)
    things.objects.link(ball)
    for x in (-0.9, 0.9):
        empty = stage.link(bpy.data.objects.new("ball", None))
        empty.instance_type, empty.instance_collection = "COLLECTION", things
        empty.location = (x, -0.7, 0.2)
    near = stage.export()
    here = stage.mitsuba((24, 24), 256, exported=near)
    for thing in stage.scene.collection.objects:
        if thing.parent is None:
            thing.location = np.add(thing.location, (4096, -16384, 8192))
    far = stage.export()
    assert not any("far" in note.feature for note in far.notes)
    assert abs(far.camera.position).max() <= 32
    there = stage.mitsuba((24, 24), 256, exported=far)
    assert there.mean((0, 1)) == pytest.approx(here.mean((0, 1)), rel=0.01)
    assert abs(there - here).mean() < 0.05 * here.mean()
    assert there.mean((0, 1)) == pytest.approx(stage.cycles((24, 24), 256).mean((0, 1)), rel=0.03)


@pytest.mark.parametrize("case", ["no faces", "nan", "nan matrix", "zero scale", "flat", "metaball", "text"])
def test_what_must_be_baked_of_odd_objects(stage, case):
    """A noise on each; unwrapping code would not survive all of them."""
    material = stage.material("ShaderNodeEmission")
    tree = material.node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise")
    emission = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeEmission")
    tree.links.new(noise.outputs["Color"], emission.inputs["Color"])
    stage.plane(name="sound", material=stage.material("ShaderNodeBsdfDiffuse"), location=(0, 0, -1))
    stage.world()
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    if case == "no faces":
        stage.mesh("odd", corners, [], material)
    elif case == "nan":
        stage.mesh("odd", [*corners[:2], (0, float("nan"), 0)], [(0, 1, 2)], material)
    elif case == "nan matrix":
        stage.mesh("odd", corners, [(0, 1, 2)], material).location.x = float("nan")
    elif case == "zero scale":
        stage.mesh("odd", corners, [(0, 1, 2)], material).scale = (0, 0, 0)
    elif case == "flat":
        stage.mesh("odd", [(0, 0, 0)] * 3, [(0, 1, 2)], material)
    elif case == "metaball":
        bpy.ops.object.metaball_add(radius=1)
        bpy.context.object.data.materials.append(material)
    else:
        bpy.ops.object.text_add()
        bpy.context.object.data.materials.append(material)
    if case.startswith("nan"):
        with pytest.raises(InvalidInput, match="'odd'.*not finite"):
            stage.export()
        return
    exported = stage.export()
    assert np.isfinite(stage.mitsuba(spp=4, exported=exported)).all()
    assert not bpy.data.scenes.get("HoloPath baking")
    baked = any("baked" in note.effect for note in exported.notes)
    assert baked == (case != "no faces")
