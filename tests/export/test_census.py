"""The census names all that this Blender has, and what it says of a setting is so."""

import re
from pathlib import Path

import bpy
import numpy as np
import pytest

from holopath_addon.export import census, lights
from holopath_addon.export.notes import Notes
from tests.in_blender import census as walk

EXPORT = Path(census.__file__).parents[1]


@pytest.fixture(scope="module")
def found():
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    return walk.properties() | walk.nodes()


def test_the_census_has_all_that_this_blender_has_once_and_no_more(found):
    assert walk.lacking(census, found) == [], "say in table.toml what becomes of them"
    assert walk.doubled(census, found) == []
    assert walk.stale(census, found, bpy.app.version) == [], "give it the version: name>=5.0, name<5.0"


def test_a_made_up_property_is_missed(stage):
    """New properties of Blender's types and Cycles' settings are found, but not those of add-ons; a node; a socket."""
    cycles = type(bpy.context.scene.cycles)
    bpy.types.Object.made_up = cycles.made_up = bpy.props.FloatProperty()
    try:
        theirs = walk.lacking(census, walk.properties())
        builtin = walk.lacking(census, walk.properties(skipped=lambda prop: False))
    finally:
        del bpy.types.Object.made_up, cycles.made_up
    assert theirs == ["CyclesRenderSettings.made_up"]
    assert {"Object.made_up", "CyclesRenderSettings.made_up"} <= set(builtin)
    nodes = {"ShaderNodeMadeUp": [], "ShaderNodeMixShader": ["in.Made_Up"]}
    assert walk.lacking(census, nodes) == ["ShaderNodeMadeUp.*", "ShaderNodeMixShader.in.Made_Up"]


def test_the_exporter_has_the_notes_that_the_census_names():
    code = "".join(path.read_text("utf-8") for path in EXPORT.rglob("*.py"))
    code = re.sub(r'"\s*\n\s*f?"', "", code)  # strings in parts
    missing = [
        (section.title, row.words)
        for section in census.sections()
        for row in section.rows
        if row.status == census.NOTED and not row.effect and not all(p in code for p in row.words.split("{}"))
    ]
    given = {row.words for section in census.sections() for row in section.rows if row.effect}
    assert [each for each in missing if each[1] not in given] == []


def another(prop, when):
    """A value of a property that a row of the census notes."""
    if prop.type == "POINTER":
        return bpy.data.meshes.new("other")
    if prop.type == "BOOLEAN":
        return not prop.default
    return prop.default // 2 if when.startswith("less") else prop.default + 1


def test_every_note_of_the_table_is_given_where_its_setting_is_not_at_its_default(stage):
    cube, lamp, world, scene = stage.plane(), stage.lamp("POINT"), stage.world(), stage.scene
    structs = [cube, cube.cycles, cube.data, cube.modifiers.new("subdivision", "SUBSURF")]
    structs += [lamp.data.cycles, world.cycles, scene.render, scene.cycles]
    rows = {struct: census.section_of(struct.bl_rna.identifier).rows for struct in structs}
    tried = set()
    pairs = [(struct, row) for struct in structs for row in rows[struct] if row.effect]
    for struct, row in pairs:
        for name in (name.pattern for name in row.names if name.pattern in struct.bl_rna.properties):
            before = getattr(struct, name)
            notes, plain = Notes(), Notes()
            census.add_notes(struct, "x", plain)
            setattr(struct, name, another(struct.bl_rna.properties[name], row.when))
            census.add_notes(struct, "x", notes)
            setattr(struct, name, before)
            assert (list(plain), [note.feature for note in notes]) == ([], [row.words]), name
            tried.add((row, name))
    assert tried == {
        (row, name.pattern)
        for section in census.sections()
        for row in section.rows
        for name in row.names
        if row.effect and name.expected(bpy.app.version)
    }


def test_settings_of_the_render_are_noted(stage):
    plane = stage.plane()
    stage.world()
    scene = stage.scene
    scene.cycles.max_bounces = 0
    scene.cycles.use_fast_gi = scene.cycles.use_camera_cull = scene.render.use_simplify = True
    scene.cycles.texture_limit_render, scene.cycles.film_exposure = "256", 2.0
    plane.cycles.is_caustics_caster = plane.cycles.use_camera_cull = True
    plane.visible_transmission = False
    plane.light_linking.receiver_collection = bpy.data.collections.new("receivers")
    features = {note.feature for note in stage.export().notes}
    assert features >= {
        "Light Paths: fewer bounces",
        "Fast GI Approximation",
        "Texture Limit of Simplify",
        "Film Exposure",
        "Shadow Caustics",
        "Culling of Simplify",
        "Ray visibility: hidden from transmission rays",
        "Light Linking",
    }


def brightness(stage):
    """Mean colors, ours and Cycles'."""
    return tuple(render((8, 8), 256).mean((0, 1)) for render in (stage.mitsuba, stage.cycles))


@pytest.mark.parametrize("setting", ["use_sky", "use_solid", "use_strand"])
def test_a_view_layer_without_sky_faces_or_hair(stage, setting):
    stage.world((0.5, 0.5, 0.5))
    stage.lamp("SUN", 1.0)
    stage.plane(1.5)
    hair = bpy.data.hair_curves.new("hair")
    hair.add_curves([2] * 10)
    ends = np.stack(np.meshgrid([-1.2, 1.2], np.linspace(-1, 1, 10), [0.3]), axis=-1).astype(np.float32)
    hair.attributes["position"].data.foreach_set("vector", ends.ravel())
    radius = hair.attributes.new("radius", "FLOAT", "POINT")
    radius.data.foreach_set("value", np.full(20, 0.05, np.float32))
    hair.materials.append(stage.material("ShaderNodeEmission", Strength=3.0))
    stage.link(bpy.data.objects.new("hair", hair))
    shown = stage.mitsuba((8, 8), 16).mean()
    setattr(bpy.context.view_layer, setting, False)
    ours, theirs = brightness(stage)
    assert ours == pytest.approx(theirs, rel=0.04) and abs(ours.mean() / shown - 1) > 0.05


def emitting(stage, node, output="Color", **values):
    """A material that emits what a node gives."""
    material = stage.material("ShaderNodeEmission")
    tree = material.node_tree
    source = tree.nodes.new(node)
    for key, value in values.items():
        setattr(source, key, value)
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    tree.links.new(source.outputs[output], shader.inputs["Color"])
    return material


def test_a_text_has_its_color_and_properties_of_its_own(stage):
    bpy.ops.object.text_add(location=(-1, -1, 0))
    text = bpy.context.object
    text.data.body, text.data.size = "#", 3
    text.color, text["amount"] = (0.1, 0.9, 0.3, 1), 0.25
    text.data.materials.append(emitting(stage, "ShaderNodeObjectInfo"))
    ours, theirs = brightness(stage)
    assert ours == pytest.approx(theirs, rel=0.03)
    text.data.materials[0] = emitting(
        stage, "ShaderNodeAttribute", attribute_type="OBJECT", attribute_name="amount"
    )
    ours, theirs = brightness(stage)
    assert ours == pytest.approx(theirs, rel=0.03) and theirs[0] > 0.01


def test_a_mesh_has_properties_of_its_own(stage):
    plane = stage.plane(3)
    plane.data["level"] = 0.5
    plane.data.materials.append(
        emitting(stage, "ShaderNodeAttribute", attribute_type="OBJECT", attribute_name="level")
    )
    ours, theirs = brightness(stage)
    assert ours == pytest.approx(theirs, rel=0.03) and theirs[0] > 0.1


@pytest.mark.parametrize("kind", ["OBJECT", "INSTANCER"])
@pytest.mark.parametrize(
    "name", ["amount", "level", "location", "data.texspace_size", 'modifiers["Wave"].width']
)
def test_attributes_of_an_object_are_found_as_in_cycles(stage, kind, name):
    """Its own properties, those of its data, and paths; an object that is no instance is its own instancer."""
    plane = stage.plane(3, location=(0.2, 0.3, 0.1))
    plane["amount"], plane.data["level"] = 0.25, 0.5
    plane.modifiers.new("Wave", "WAVE").height = 0
    plane.data.materials.append(
        emitting(stage, "ShaderNodeAttribute", attribute_type=kind, attribute_name=name)
    )
    ours, theirs = brightness(stage)
    assert ours == pytest.approx(theirs, rel=0.03) and theirs[0] > 0.01
    assert not any("cleared" in note.effect for note in stage.export().notes)


@pytest.mark.parametrize(
    ("node", "output", "values", "effect"),
    [
        ("VectorTransform", "Vector", {"convert_to": "CAMERA"}, "looks down"),
        ("LightFalloff", "Linear", {}, "square of the distance"),
    ],
)
def test_what_a_bake_cannot_see_is_noted(stage, node, output, values, effect):
    stage.plane(2, emitting(stage, f"ShaderNode{node}", output, **values))
    assert any(effect in note.effect for note in stage.export().notes)


@pytest.mark.parametrize(
    ("node", "output", "effect"),
    [
        ("ObjectInfo", "Color", "world's origin"),
        ("NewGeometry", "Position", "world's origin"),
        ("LightFalloff", "Linear", "square of the distance"),
    ],
)
def test_what_a_lamp_reads_of_its_object_or_a_smooth_falloff_is_noted(
    stage, monkeypatch, node, output, effect
):
    monkeypatch.setattr(lights, "PROFILE", (32, 16))
    lamp = stage.lamp("POINT").data
    lamp.use_nodes = True
    tree = lamp.node_tree
    shader = next(each for each in tree.nodes if each.bl_idname == "ShaderNodeEmission")
    source = tree.nodes.new(f"ShaderNode{node}")
    if "Smooth" in source.inputs:
        source.inputs["Smooth"].default_value = 3
    tree.links.new(source.outputs[output], shader.inputs["Strength" if source.inputs else "Color"])
    stage.plane()
    assert any(effect in note.effect for note in stage.export().notes)


@pytest.mark.parametrize("socket", ["Color", "Strength"])
def test_negative_emission_of_a_texture_is_noted(stage, socket):
    material = emitting(stage, "ShaderNodeTexCoord", "Object")
    emission = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeEmission")
    link = emission.inputs["Color"].links[0]
    material.node_tree.links.new(link.from_socket, emission.inputs[socket])
    if socket == "Strength":
        material.node_tree.links.remove(emission.inputs["Color"].links[0])
    stage.plane(2, material)
    assert "Negative emission" in [note.feature for note in stage.export().notes]


def test_normals_that_point_away_are_noted(stage):
    """A number as a normal: (f, f, f) in the world, behind half of a cube."""
    material = stage.material("ShaderNodeBsdfDiffuse")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    source = nodes.new("ShaderNodeTexWave")
    shader = next(n for n in nodes if n.bl_idname == "ShaderNodeBsdfDiffuse")
    links.new(source.outputs["Factor"], shader.inputs["Normal"])
    stage.sphere(0.5, material)
    assert any("normals that point away" in note.effect for note in stage.export().notes)


def test_an_environment_texture_has_a_mapping_of_its_own(stage, small_worlds):
    tree = stage.world().node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    pixels = np.zeros((4, 8, 3))
    pixels[:, :4], pixels[:, 4:] = (1, 0.2, 0.1), (0.1, 0.2, 1)
    texture.image = stage.image(pixels, float_buffer=True, space="Non-Color")
    background = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBackground")
    tree.links.new(texture.outputs[0], background.inputs["Color"])
    texture.texture_mapping.rotation = (0, 0, 1.2)
    stage.sphere(0.01)
    stage.camera.rotation_euler, stage.camera.location = (1.5, 0, 0.4), (0, -9, 0)
    ours, theirs = brightness(stage)
    assert ours == pytest.approx(theirs, rel=0.05)


def test_what_the_viewport_has_otherwise_than_renders_is_noted(stage):
    plane = stage.plane()
    plane.modifiers.new("subdivision", "SUBSURF").render_levels = 3
    hidden = plane.modifiers.new("array", "ARRAY")
    hidden.show_viewport = False
    alike = plane.modifiers.new("bevel", "BEVEL")
    assert alike.show_render
    stage.world()
    found = {note.feature for note in stage.export().notes if "viewport" in note.effect}
    assert found == {"Modifier 'subdivision'", "Modifier 'array'"}
    stage.scene.render.use_simplify = True
    stage.scene.render.simplify_subdivision = stage.scene.render.simplify_subdivision_render = 1
    plane.modifiers.remove(hidden)
    assert not [note for note in stage.export().notes if "viewport" in note.effect]
