"""Baking by Cycles against Cycles' own pictures."""

import threading

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon.engine.light import unwrapping  # noqa: E402

DIFFUSE = "ShaderNodeBsdfDiffuse"
PRINCIPLED = "ShaderNodeBsdfPrincipled"
EMISSION = "ShaderNodeEmission"
BALL = (slice(4, 28), slice(4, 28))
COLLECTIONS = ("scenes", "objects", "meshes", "materials", "images", "node_groups", "worlds", "lights")


def add(material, node, **values):
    """A new node with its inputs set."""
    node = material.node_tree.nodes.new(node)
    for name, value in values.items():
        node.inputs[name.replace("_", " ")].default_value = value
    return node


def shader_of(material):
    output = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    return output.inputs["Surface"].links[0].from_node


def noise(stage, socket="Color", kind=EMISSION, **values):
    """A material with a noise in generated coordinates."""
    material = stage.material(kind)
    texture = add(material, "ShaderNodeTexNoise", **values)
    material.node_tree.links.new(texture.outputs["Color"], shader_of(material).inputs[socket])
    return material, texture


def apart(stage, region=slice(None), spp=64, depth=4, **options):
    """Mean relative difference from Cycles in blocks of 4 x 4 pixels, and Cycles' contrast."""
    ours, theirs = (
        render(spp=spp, depth=depth, **options)[region] for render in (stage.mitsuba, stage.cycles)
    )
    ours, theirs = (v.reshape(len(v) // 4, 4, -1, 4, 3).mean((1, 3)) for v in (ours, theirs))
    return np.abs(ours - theirs).mean() / theirs.mean(), theirs.std() / theirs.mean()


def counts():
    return {name: len(getattr(bpy.data, name)) for name in COLLECTIONS}


def features(exported):
    return {(note.object, note.material, note.feature, note.effect) for note in exported.notes}


@pytest.mark.parametrize("coordinates", [None, "Generated", "Object", "UV", "Normal"])
def test_noise_in_any_coordinates(stage, coordinates):
    material, texture = noise(stage, Scale=2.0)
    if coordinates:
        source = add(material, "ShaderNodeTexCoord").outputs[coordinates]
        material.node_tree.links.new(source, texture.inputs["Vector"])
    ball = stage.sphere(1, material)
    ball.rotation_euler, ball.scale = (0.4, 0.3, 0.2), (1.0, 1.2, 0.8)
    before = counts()
    exported = stage.export()
    assert counts() == before
    assert features(exported) == {
        ("sphere", "material", "Noise Texture node into Color", "baked to a texture")
    }
    difference, contrast = apart(stage, BALL)
    assert difference < 0.02 < 0.1 < contrast


def test_generated_coordinates_stay_with_the_undeformed_mesh(stage):
    ball = stage.sphere(1, noise(stage, Scale=2.0)[0])
    taper = ball.modifiers.new("taper", "SIMPLE_DEFORM")
    taper.deform_method, taper.factor = "TAPER", 1.0
    assert apart(stage, BALL)[0] < 0.02


def test_nodes_inside_groups_and_numbers(stage):
    """Three numbers and a color, two of them from within a group within a group."""
    inner = bpy.data.node_groups.new("inner", "ShaderNodeTree")
    inner.interface.new_socket("Scale", in_out="INPUT", socket_type="NodeSocketFloat")
    inner.interface.new_socket("Surface", in_out="OUTPUT", socket_type="NodeSocketShader")
    entry, exit = inner.nodes.new("NodeGroupInput"), inner.nodes.new("NodeGroupOutput")
    principled, texture = inner.nodes.new(PRINCIPLED), inner.nodes.new("ShaderNodeTexNoise")
    inner.links.new(entry.outputs[0], texture.inputs["Scale"])
    for socket in ("Base Color", "Roughness", "Metallic", "Alpha"):
        inner.links.new(texture.outputs["Color"], principled.inputs[socket])
    inner.links.new(principled.outputs[0], exit.inputs[0])
    outer = bpy.data.node_groups.new("outer", "ShaderNodeTree")
    outer.interface.new_socket("Surface", in_out="OUTPUT", socket_type="NodeSocketShader")
    node, exit = outer.nodes.new("ShaderNodeGroup"), outer.nodes.new("NodeGroupOutput")
    node.node_tree = inner
    node.inputs["Scale"].default_value = 3.0
    outer.links.new(node.outputs[0], exit.inputs[0])
    material = stage.material()
    group = add(material, "ShaderNodeGroup")
    group.node_tree = outer
    output = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    material.node_tree.links.new(group.outputs[0], output.inputs["Surface"])
    stage.plane(3, material)
    stage.world((0.6, 0.5, 0.4))
    before = counts()
    difference, contrast = apart(stage, spp=256)
    assert difference < 0.03 < contrast
    assert counts() == before | {"images": counts()["images"]}
    assert len(stage.export().notes) == 4


def test_image_adjusted_by_nodes_and_a_second_uv_map(stage):
    """An image in a named map, brightened, mixed with one in the default map."""
    rng = np.random.default_rng(2)
    material = stage.material(EMISSION)
    tree = material.node_tree
    first, second = (add(material, "ShaderNodeTexImage") for _ in range(2))
    for texture in (first, second):
        texture.image = stage.image(np.kron(rng.random((4, 4, 3)), np.ones((8, 8, 1))), space="Non-Color")
        texture.interpolation = "Closest"
    uv = add(material, "ShaderNodeUVMap")
    uv.uv_map = "other"
    tree.links.new(uv.outputs[0], first.inputs["Vector"])
    bright = add(material, "ShaderNodeBrightContrast", Bright=0.2)
    tree.links.new(first.outputs["Color"], bright.inputs["Color"])
    mix = add(material, "ShaderNodeMix")
    mix.data_type = "RGBA"
    colors = [socket for socket in mix.inputs if socket.type == "RGBA"]
    tree.links.new(bright.outputs["Color"], colors[0])
    tree.links.new(second.outputs["Color"], colors[1])
    result = next(socket for socket in mix.outputs if socket.type == "RGBA")
    tree.links.new(result, shader_of(material).inputs["Color"])
    plane = stage.plane(3, material)
    turned = plane.data.uv_layers.new(name="other")
    turned.uv.foreach_set("vector", np.array([1, 0, 1, 1, 0, 1, 0, 0], np.float32))
    difference, contrast = apart(stage)
    assert difference < 0.02 < 0.1 < contrast


def test_two_uv_maps_of_plain_images(stage):
    rng = np.random.default_rng(3)
    material = stage.material(PRINCIPLED, Roughness=1.0)
    for socket, name in (("Base Color", "UVMap"), ("Emission Color", "other")):
        image = stage.image(np.kron(rng.random((4, 4, 3)), np.ones((8, 8, 1))), space="Non-Color")
        texture = stage.texture(material, image, socket, shader_of(material))
        uv = add(material, "ShaderNodeUVMap")
        uv.uv_map = name
        material.node_tree.links.new(uv.outputs[0], texture.inputs["Vector"])
    shader_of(material).inputs["Emission Strength"].default_value = 0.5
    plane = stage.plane(3, material)
    turned = plane.data.uv_layers.new(name="other")
    turned.uv.foreach_set("vector", np.array([1, 0, 1, 1, 0, 1, 0, 0], np.float32))
    stage.world((0.5, 0.5, 0.5))
    assert apart(stage, spp=256)[0] < 0.03
    assert {note.effect for note in stage.export().notes} == {"baked to a texture"}


@pytest.mark.parametrize("source", ["bump", "displacement", "normal map"])
@pytest.mark.parametrize("scale", [pytest.param((1, 1, 1), marks=pytest.mark.slow), (-1, 1.3, 0.8)])
def test_bumps(stage, source, scale):
    """Bumps under a lamp; the same without them is told apart."""
    material = stage.material(DIFFUSE, Color=(0.7, 0.7, 0.7, 1))
    tree = material.node_tree
    diffuse = shader_of(material)
    texture = add(material, "ShaderNodeTexNoise", Scale=1.5)
    if source == "bump":
        node = add(material, "ShaderNodeBump", Distance=0.6, Strength=0.8)
        tree.links.new(texture.outputs[0], node.inputs["Height"])
        tree.links.new(node.outputs[0], diffuse.inputs["Normal"])
    elif source == "displacement":
        output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
        node = add(material, "ShaderNodeDisplacement", Scale=0.6)
        tree.links.new(texture.outputs[0], node.inputs["Height"])
        tree.links.new(node.outputs[0], output.inputs["Displacement"])
        material.displacement_method = "BUMP"
    else:
        rng = np.random.default_rng(4)
        normals = np.kron(rng.normal(0, 0.3, (6, 6, 3)), np.ones((8, 8, 1))) + (0, 0, 1)
        normals = 0.5 + 0.5 * normals / np.linalg.norm(normals, axis=2, keepdims=True)
        node = add(material, "ShaderNodeNormalMap", Strength=1.0)
        stage.texture(material, stage.image(normals, float_buffer=True, space="Non-Color"), "Color", node)
        tree.links.new(node.outputs[0], diffuse.inputs["Normal"])
    ball = stage.sphere(0.9, material)
    ball.scale, ball.rotation_euler = scale, (0.7, 0.2, 0.3)
    stage.lamp("AREA", 200, (2, 1, 3), (0, 0.6, 0.4))
    stage.world((0.1, 0.1, 0.1))
    difference, _ = apart(stage, BALL, spp=128)
    assert difference < 0.03
    bumpy = stage.mitsuba(spp=64)
    for link in list(node.outputs[0].links):
        tree.links.remove(link)
    plain = stage.mitsuba(spp=64)
    assert np.abs(bumpy - plain).mean() / plain.mean() > 3 * difference


def test_objects_of_one_mesh_share_a_bake(stage, monkeypatch):
    from holopath_addon.export.shading import baking

    material, _ = noise(stage)
    first = stage.sphere(0.5, material)
    stage.link(bpy.data.objects.new("twin", first.data)).location.x = 1
    calls = []
    real = baking.bake_surface
    monkeypatch.setattr(baking, "bake_surface", lambda *a: calls.append(1) or real(*a))
    stage.export()
    assert len(calls) == 1


@pytest.mark.parametrize("right", ["image", "another noise"])
def test_slots_of_one_mesh(stage, right):
    """Left half noise, right half something else, which may need no baking."""
    material, _ = noise(stage, Scale=2.0)
    if right == "image":
        other = stage.material(EMISSION)
        rng = np.random.default_rng(5)
        image = stage.image(np.kron(rng.random((4, 4, 3)), np.ones((8, 8, 1))), space="Non-Color")
        stage.texture(other, image, "Color").interpolation = "Closest"
    else:
        other, _ = noise(stage, Scale=5.0, Detail=0.0)
    vertices = [(-1, -1, 0), (0, -1, 0), (1, -1, 0), (-1, 1, 0), (0, 1, 0), (1, 1, 0)]
    uv = [(0, 0), (1, 0), (1, 1), (0, 1)] * 2
    both = stage.mesh("both", vertices, [(0, 1, 4, 3), (1, 2, 5, 4)], material, uv)
    both.data.materials.append(other)
    both.data.polygons[1].material_index = 1
    assert apart(stage)[0] < 0.02


def test_dense_meshes_get_a_cell_a_triangle(stage, monkeypatch):
    monkeypatch.setattr(unwrapping, "CHARTED_TRIANGLES", 0)
    stage.sphere(1, noise(stage, Scale=2.0)[0])
    assert apart(stage, BALL)[0] < 0.02


@pytest.mark.parametrize("charted", [0, 20_000])
def test_atlas_has_no_overlaps(stage, monkeypatch, charted):
    """Every triangle's middle is inside that triangle only, and a texel away from all others."""
    monkeypatch.setattr(unwrapping, "CHARTED_TRIANGLES", charted)
    mesh = stage.sphere(1).data
    mesh.calc_loop_triangles()
    vertices = np.array([v.co for v in mesh.vertices])
    triangles = np.array([t.vertices for t in mesh.loop_triangles])
    uv, size = unwrapping.unwrap(vertices, triangles, 256)
    assert uv.min() >= 0 and uv.max() <= 1
    a, b, c = (uv[:, k].astype(float) * size for k in range(3))
    cross = lambda p, q: p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]  # noqa: E731
    twice = np.abs(cross(b - a, c - a))
    middles = (a + b + c) / 3
    for middle in middles[:: len(middles) // 50]:
        parts = sum(np.abs(cross(p - middle, q - middle)) for p, q in ((a, b), (b, c), (c, a)))
        assert ((parts < twice * (1 + 1e-6)) & (twice > 1e-3)).sum() == 1


def test_from_another_thread_nothing_is_baked_but_noted(stage):
    """Baking is impossible, as where the main thread is busy while Blender renders."""
    stage.plane(3, noise(stage)[0])
    stage.world((0.1, 0.1, 0.1))
    before, found = counts(), []
    depsgraph = bpy.context.evaluated_depsgraph_get()

    def work():
        from holopath_addon.export import export_scene

        found.append(export_scene(depsgraph, (32, 32)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert counts() == before
    assert [note.effect for note in found[0].notes] == ["not supported: replaced by a constant"]


def test_a_bake_that_fails_is_noted_and_leaves_nothing(stage, monkeypatch):
    from holopath_addon.export.shading import baking

    def fail(*_):
        raise baking.BakingFailed("no luck")

    stage.plane(3, noise(stage)[0])
    stage.world((0.1, 0.1, 0.1))
    before = counts()
    monkeypatch.setattr(baking._Studio, "bake", fail)
    exported = stage.export()
    assert counts() == before
    assert ("plane", "", "Baking", "failed: no luck") in features(exported)


@pytest.mark.parametrize("sun_disc", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_sky(stage, sun_disc, request):
    if not sun_disc:
        request.getfixturevalue("small_worlds")
    stage.plane(6, stage.material(DIFFUSE, Color=(0.8, 0.5, 0.2, 1)), location=(0, 0, -1))
    stage.sphere(0.7, stage.material(DIFFUSE, "ball"))
    tree = stage.world().node_tree
    sky = tree.nodes.new("ShaderNodeTexSky")
    sky.sun_disc, sky.sun_elevation, sky.sun_rotation = sun_disc, 1.0, 1.0
    background = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBackground")
    tree.links.new(sky.outputs[0], background.inputs["Color"])
    before = counts()
    assert apart(stage, spp=128)[0] < 0.02
    assert counts()["scenes"] == before["scenes"]


def test_worlds_of_two_shaders(stage, small_worlds):
    stage.plane(1.5, stage.material(DIFFUSE, Color=(0.8, 0.5, 0.2, 1)))
    tree = stage.world((0.2, 0.5, 0.8)).node_tree
    output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputWorld")
    first = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBackground")
    second, mix, noise = (
        tree.nodes.new(k) for k in ("ShaderNodeBackground", "ShaderNodeMixShader", "ShaderNodeTexNoise")
    )
    second.inputs["Color"].default_value = (0.9, 0.3, 0.1, 1)
    tree.links.new(noise.outputs[0], mix.inputs[0])
    tree.links.new(first.outputs[0], mix.inputs[1])
    tree.links.new(second.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    assert apart(stage, spp=128)[0] < 0.02


@pytest.mark.parametrize("how", ["color and strength", "sum", "mix by a texture"])
def test_emission_of_several_textures(stage, how):
    material = stage.material(EMISSION)
    tree, first = material.node_tree, shader_of(material)
    textures = [add(material, "ShaderNodeTexNoise", Scale=s, Detail=0.0) for s in (1.5, 3.0, 2.0)]
    tree.links.new(textures[0].outputs["Color"], first.inputs["Color"])
    if how == "color and strength":
        tree.links.new(textures[1].outputs["Color"], first.inputs["Strength"])
    else:
        second = add(material, EMISSION)
        tree.links.new(textures[1].outputs["Color"], second.inputs["Color"])
        both = add(material, "ShaderNodeAddShader" if how == "sum" else "ShaderNodeMixShader")
        for socket, node in zip(both.inputs[-2:], (first, second), strict=True):
            tree.links.new(node.outputs[0], socket)
        if how != "sum":
            tree.links.new(textures[2].outputs[0], both.inputs[0])
        output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
        tree.links.new(both.outputs[0], output.inputs["Surface"])
    stage.plane(3, material)
    difference, contrast = apart(stage)
    assert difference < 0.02 < contrast
    assert "Emission of several textures" in {note.feature for note in stage.export().notes}


def test_nodes_that_depend_on_the_view_are_told(stage):
    material = stage.material(DIFFUSE)
    tree = material.node_tree
    tree.links.new(
        add(material, "ShaderNodeLayerWeight").outputs["Facing"], shader_of(material).inputs["Color"]
    )
    stage.plane(3, material)
    stage.world((0.5, 0.5, 0.5))
    (note,) = stage.export().notes
    assert note.effect.endswith("as seen by the camera from straight above the surface")


def test_nodes_that_ask_for_the_back_are_told(stage):
    material = stage.material(DIFFUSE)
    geometry = add(material, "ShaderNodeNewGeometry")
    material.node_tree.links.new(geometry.outputs["Backfacing"], shader_of(material).inputs["Color"])
    stage.plane(3, material)
    stage.world((0.5, 0.5, 0.5))
    assert any("straight above the surface" in note.effect for note in stage.export().notes)


def test_what_is_baked_stays_in_place_beside_anisotropy(stage):
    """The direction of anisotropy is that of a UV map, which baking replaces."""
    material, texture = noise(stage, "Base Color", PRINCIPLED, Scale=2.0, Detail=0.0)
    principled = shader_of(material)
    for name, value in (("Metallic", 1.0), ("Roughness", 0.8), ("Anisotropic", 0.2)):
        principled.inputs[name].default_value = value
    bpy.ops.mesh.primitive_cube_add(size=1.6, rotation=(0.5, 0.6, 0.2))
    bpy.context.object.data.materials.append(material)
    stage.world((0.5, 0.5, 0.5))
    difference, contrast = apart(stage, spp=256)
    assert difference < 0.03 < 0.1 < contrast


def test_a_second_export_bakes_only_what_changed(stage, monkeypatch):
    from holopath_addon.export import ExportCache, export_scene
    from holopath_addon.export.shading import baking

    names = []
    real = baking.bake_surface
    monkeypatch.setattr(
        baking, "bake_surface", lambda flat, *rest: names.append(flat.original.name) or real(flat, *rest)
    )
    left, right = (noise(stage)[0] for _ in range(2))
    stage.plane(1, left, "left", (-1, 0, 0))
    stage.plane(1, right, "right", (1, 0, 0))
    cache = ExportCache()

    def export(size=32):
        names.clear()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        exported = export_scene(depsgraph, (size, size), cache=cache)
        assert {note.effect for note in exported.notes} == {"baked to a texture"}
        return sorted(names)

    try:
        assert export() == ["left", "right"]
        assert export() == []
        bpy.data.objects["left"].location.y = 0.5
        assert export() == ["left"]
        texture = next(n for n in right.node_tree.nodes if n.bl_idname == "ShaderNodeTexNoise")
        texture.inputs["Scale"].default_value = 9.0
        assert export() == ["right"]
        assert export(128) == ["left", "right"]  # of four times the pixels
        assert export(32) == []
    finally:
        cache.close()


def test_inputs_that_take_no_texture(stage):
    material, _ = noise(stage, "IOR", PRINCIPLED)
    stage.plane(3, material)
    stage.world((0.5, 0.5, 0.5))
    assert features(stage.export()) == {
        ("plane", "material", "Noise Texture node into IOR", "replaced by a constant")
    }


@pytest.mark.parametrize("mode", ["EDIT", "SCULPT"])
def test_in_other_modes(stage, mode):
    ball = stage.sphere(1, noise(stage)[0])
    bpy.context.view_layer.objects.active = ball
    bpy.ops.object.mode_set(mode=mode)
    try:
        assert {note.effect for note in stage.export().notes} == {"baked to a texture"}
        assert ball.mode == mode and bpy.context.view_layer.objects.active == ball
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")


def test_instances_that_geometry_nodes_make(stage):
    """Noise on cubes that exist nowhere else, on the points of a plane that is not shown."""
    material = noise(stage)[0]
    plane = stage.plane(2)
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    entry, exit, cube, paint, place = (
        tree.nodes.new(kind)
        for kind in (
            "NodeGroupInput",
            "NodeGroupOutput",
            "GeometryNodeMeshCube",
            "GeometryNodeSetMaterial",
            "GeometryNodeInstanceOnPoints",
        )
    )
    cube.inputs["Size"].default_value = (0.5, 0.5, 0.5)
    paint.inputs["Material"].default_value = material
    tree.links.new(cube.outputs["Mesh"], paint.inputs["Geometry"])
    tree.links.new(entry.outputs[0], place.inputs["Points"])
    tree.links.new(paint.outputs[0], place.inputs["Instance"])
    tree.links.new(place.outputs[0], exit.inputs[0])
    plane.modifiers.new("nodes", "NODES").node_group = tree
    exported = stage.export()
    area = sum(float(np.array(shape.surface_area()).sum()) for shape in exported.scene.shapes())
    assert area == pytest.approx(2 * 4 * 6 * 0.25, rel=1e-4)  # what emits has two sides
    assert {note.effect for note in exported.notes} == {"baked to a texture"}
    assert apart(stage)[0] < 0.04


def test_sheared_objects(stage):
    """A turned child of a stretched parent."""
    ball = stage.sphere(0.7, noise(stage, Scale=2.0)[0])
    parent = stage.link(bpy.data.objects.new("parent", None))
    parent.scale = (1.6, 0.7, 1.0)
    ball.parent, ball.rotation_euler = parent, (0.0, 0.3, 0.8)
    material = ball.data.materials[0]
    coordinates = add(material, "ShaderNodeNewGeometry").outputs["Position"]
    texture = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeTexNoise")
    material.node_tree.links.new(coordinates, texture.inputs["Vector"])
    assert apart(stage, BALL)[0] < 0.02


def test_between_frames(stage):
    material, texture = noise(stage, Scale=2.0)
    texture.noise_dimensions = "4D"
    w = texture.inputs["W"]
    for frame, value in ((1, 0.0), (10, 9.0)):
        w.default_value = value
        w.keyframe_insert("default_value", frame=frame)
    stage.plane(3, material)
    stage.scene.frame_set(3, subframe=0.5)
    assert apart(stage)[0] < 0.02


def test_the_world_is_baked_once(stage, monkeypatch):
    from holopath_addon.export import ExportCache, export_scene, world

    calls = []
    real = world.baking.bake_world
    monkeypatch.setattr(world.baking, "bake_world", lambda *a: calls.append(1) or real(*a))
    monkeypatch.setattr(world, "WIDTH", 64)
    monkeypatch.setattr(world, "HEIGHT", 32)
    stage.plane(3, noise(stage)[0])
    tree = stage.world().node_tree
    background = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBackground")
    sky = tree.nodes.new("ShaderNodeTexSky")
    tree.links.new(sky.outputs[0], background.inputs["Color"])
    cache = ExportCache()
    try:
        for _ in range(3):
            export_scene(bpy.context.evaluated_depsgraph_get(), (32, 32), cache=cache)
        assert len(calls) == 1
    finally:
        cache.close()


def test_object_color(stage):
    from holopath_addon.export import ExportCache, export_scene

    material = stage.material(EMISSION)
    info = add(material, "ShaderNodeObjectInfo")
    material.node_tree.links.new(info.outputs["Color"], shader_of(material).inputs["Color"])
    plane = stage.plane(6, material)
    cache = ExportCache()
    try:
        for color in ((1, 0, 0, 1), (0, 1, 0, 1)):
            plane.color = color
            exported = export_scene(bpy.context.evaluated_depsgraph_get(), (32, 32), cache=cache)
            assert stage.mitsuba(spp=4, exported=exported)[16, 16] == pytest.approx(color[:3], abs=0.01)
    finally:
        cache.close()


@pytest.mark.parametrize("holdout", [True, False])
def test_holdouts_and_shadow_catchers_are_baked_as_what_they_are(stage, holdout):
    plane = stage.plane(6, noise(stage)[0])
    expected = stage.mitsuba(spp=16).mean()
    plane.is_holdout, plane.is_shadow_catcher = holdout, not holdout
    bpy.context.view_layer.update()
    assert stage.mitsuba(spp=16).mean() == pytest.approx(expected, rel=0.02)
