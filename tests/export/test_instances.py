"""Materials that read the instance, its place or its instancer: each instance looks as in Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon.export import contents  # noqa: E402


def worst(stage, resolution=(32, 32)):
    """Largest difference from Cycles' image in blocks of 8 x 8 pixels, of their mean; and the notes."""
    exported = stage.export(resolution)
    ours, theirs = stage.mitsuba(resolution, 256, exported=exported), stage.cycles(resolution, 256)
    ours, theirs = (image.reshape(4, 8, 4, 8, 3).mean((1, 3)) for image in (ours, theirs))
    return np.abs(ours - theirs).max() / theirs.mean(), exported.notes


def shining(stage, node, output, **values):
    """A material that emits the absolute value of a node's output."""
    material = stage.material("ShaderNodeEmission")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    source, positive = nodes.new(node), nodes.new("ShaderNodeVectorMath")
    positive.operation = "ABSOLUTE"
    for name, value in values.items():
        setattr(source, name, value)
    links.new(source.outputs[output], positive.inputs[0])
    links.new(
        positive.outputs[0], next(n for n in nodes if n.bl_idname == "ShaderNodeEmission").inputs["Color"]
    )
    return material


@pytest.mark.parametrize(
    ("node", "output"),
    [
        ("ShaderNodeObjectInfo", "Location"),
        ("ShaderNodeObjectInfo", "Color"),
        ("ShaderNodeObjectInfo", "Object Index"),
        ("ShaderNodeObjectInfo", "Random"),
        ("ShaderNodeNewGeometry", "Position"),
    ],
)
def test_linked_duplicates(stage, node, output):
    """Objects of one mesh (Alt D)."""
    first = stage.plane(1, shining(stage, node, output), location=(-0.8, 0.7, 0))
    for number, place in enumerate([(0.7, 0.6, 0), (0.2, -0.7, 0)]):
        twin = stage.link(bpy.data.objects.new(f"twin {number}", first.data))
        twin.location, twin.color, twin.pass_index = place, (0.1, 0.5 * number, 0.9, 1), number
    found, notes = worst(stage)
    assert found < 0.07 and {note.effect for note in notes} == {"baked to a texture"}


def scattered(stage, material):
    """Sixteen leaves on points, with a color of each as an attribute."""
    leaf, grid = stage.plane(0.4, material, name="leaf", location=(0, 0, -50)), stage.plane(name="grid")
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    kinds = ("MeshGrid", "InstanceOnPoints", "ObjectInfo", "StoreNamedAttribute")
    points, place, thing, store = (tree.nodes.new(f"GeometryNode{kind}") for kind in kinds)
    exit, random = tree.nodes.new("NodeGroupOutput"), tree.nodes.new("FunctionNodeRandomValue")
    for name, value in (("Vertices X", 4), ("Vertices Y", 4), ("Size X", 2), ("Size Y", 2)):
        points.inputs[name].default_value = value
    thing.inputs["Object"].default_value, thing.inputs["As Instance"].default_value = leaf, True
    store.data_type, store.domain, random.data_type = "FLOAT_VECTOR", "INSTANCE", "FLOAT_VECTOR"
    store.inputs["Name"].default_value = "tint"
    for source, target in (
        (points.outputs[0], place.inputs["Points"]),
        (thing.outputs["Geometry"], place.inputs["Instance"]),
        (place.outputs[0], store.inputs["Geometry"]),
        (random.outputs[0], store.inputs["Value"]),
        (store.outputs[0], exit.inputs[0]),
    ):
        tree.links.new(source, target)
    grid.modifiers.new("nodes", "NODES").node_group = tree


@pytest.mark.skipif(bpy.app.version < (5, 0, 0), reason="older ones do not tell attributes of instances")
@pytest.mark.parametrize(
    ("node", "output", "values"),
    [
        ("ShaderNodeAttribute", "Color", {"attribute_type": "INSTANCER", "attribute_name": "tint"}),
        ("ShaderNodeObjectInfo", "Random", {}),
    ],
)
def test_instances_of_geometry_nodes(stage, node, output, values):
    scattered(stage, shining(stage, node, output, **values))
    found, notes = worst(stage)
    assert found < 0.08 and len(notes) == 1


def test_instances_beyond_the_limit_are_told_of(stage, monkeypatch):
    monkeypatch.setattr(contents, "MAX_BAKED_INSTANCES", 3)
    scattered(stage, shining(stage, "ShaderNodeObjectInfo", "Random"))
    (note,) = [note for note in stage.export().notes if "More than 3 instances" in note.feature]
    assert note.object == "leaf" and note.effect == "the others look like one another"


def test_a_second_export_bakes_no_instance_again(stage, monkeypatch):
    from holopath_addon.export import ExportCache, export_scene
    from holopath_addon.export.shading import baking

    values = {"attribute_type": "INSTANCER", "attribute_name": "tint"}
    scattered(stage, shining(stage, "ShaderNodeAttribute", "Color", **values))
    cache, bakes, bake = ExportCache(), [], baking.bake_surface
    monkeypatch.setattr(baking, "bake_surface", lambda *words: bakes.append(1) or bake(*words))
    for _ in range(2):
        export_scene(bpy.context.evaluated_depsgraph_get(), (32, 32), None, cache)
        made = len(bakes)
    assert made == 17  # sixteen instances and the leaf itself


def test_attributes_of_the_view_layer_and_the_scene(stage):
    stage.scene["tint"] = (0.2, 0.9, 0.4)
    values = {"attribute_type": "VIEW_LAYER", "attribute_name": "tint"}
    stage.plane(3, shining(stage, "ShaderNodeAttribute", "Color", **values))
    assert worst(stage)[0] < 0.02


@pytest.mark.parametrize(
    "modifiers", [("ARRAY",), ("MIRROR", "ARRAY"), ("SUBSURF", "ARRAY"), ("ARRAY", "SIMPLE_DEFORM")]
)
def test_generated_coordinates_of_what_modifiers_made(stage, modifiers):
    """They are of the mesh's own box, and go on beyond it."""
    corners = [(0.1, -1.3, 0), (1.3, -1.3, 0), (1.3, -0.1, 0), (0.1, -0.1, 0)]
    thing = stage.mesh("thing", corners, [(0, 1, 2, 3)], shining(stage, "ShaderNodeTexCoord", "Generated"))
    for kind in modifiers:
        modifier = thing.modifiers.new(kind, kind)
        if kind == "ARRAY":
            modifier.relative_offset_displace = (0, 1, 0)
        elif kind == "SUBSURF":
            modifier.levels = modifier.render_levels
        elif kind == "SIMPLE_DEFORM":
            modifier.deform_method, modifier.factor = "STRETCH", 0.3
    blocks = len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.scenes)
    assert worst(stage)[0] < 0.05
    assert (len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.scenes)) == blocks
