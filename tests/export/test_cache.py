"""A kept export against a fresh one: the same scene and notes after any change, and nothing read in vain."""

import random

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon.export import ExportCache, export_scene  # noqa: E402
from holopath_addon.export import contents as contents_module  # noqa: E402


@pytest.fixture
def cache():
    kept = ExportCache()
    yield kept
    kept.close()


def by_name(exported):
    """Shapes by the name of their object; the last of each."""
    return {str(shape).split('name = "')[1].split('"')[0]: shape for shape in exported.scene.shapes()}


def fingerprint(exported):
    """Everything that tells two exported scenes apart."""
    import mitsuba as mi

    shapes = []
    for shape in exported.scene.shapes():
        entry = [
            str(shape).partition("bbox")[0],
            str(shape.bsdf()) if shape.is_mesh() else "",
            shape.is_emitter(),
        ]
        if shape.is_emitter():
            entry.append(str(shape.emitter()).split("surface_area")[0])
        for key, value in sorted(mi.traverse(shape)):
            values = value.matrix if hasattr(value, "matrix") else value
            entry.append((key, np.asarray(values).tobytes()))
        shapes.append(entry)
    environment = exported.scene.environment()
    if environment is not None:
        shapes.append(
            [
                (key, np.asarray(value).tobytes())
                for key, value in mi.traverse(environment)
                if "to_world" not in key
            ]
        )
    return shapes, [str(note) for note in exported.notes]


def exported(cache=None, size=(16, 16)):
    return export_scene(bpy.context.evaluated_depsgraph_get(), size, cache=cache)


def assert_same(cache):
    ours, fresh = fingerprint(exported(cache)), fingerprint(exported())
    assert ours[1] == fresh[1]
    assert ours[0] == fresh[0]


@pytest.fixture
def reads(monkeypatch):
    """Names of the objects whose meshes are read."""
    names = []
    read_mesh = contents_module.read_mesh

    def counted(mesh, name, *rest):
        names.append(name)
        return read_mesh(mesh, name, *rest)

    monkeypatch.setattr(contents_module, "read_mesh", counted)
    return names


@pytest.fixture
def furnished(stage):
    """A scene with most of what can change."""
    image = stage.image(np.random.default_rng(0).random((8, 8, 3)), name="picture")
    textured = stage.material("ShaderNodeBsdfPrincipled", "textured", Base_Color=(0.5, 0.2, 0.1, 1))
    stage.texture(textured, image, "Base Color")
    lamp = stage.material("ShaderNodeEmission", "lamp", Strength=2.0)
    noted = stage.material("ShaderNodeBsdfPrincipled", "noted")
    noted.node_tree.nodes["Principled BSDF"].inputs["Sheen Weight"].default_value = 0.5
    for number, material in enumerate((textured, lamp, noted)):
        obj = stage.sphere(0.3, material, (number, 0, 0), f"sphere {number}")
        obj.data.polygons[3].use_smooth = False
    twin = stage.link(bpy.data.objects.new("twin", bpy.data.objects["sphere 0"].data))
    twin.location = (0, 2, 0)
    plane = stage.plane(4, None, "floor", (0, 0, -1))
    plane.shape_key_add(name="Basis")
    key = plane.shape_key_add(name="up")
    key.data[0].co.z = 1
    bpy.ops.object.metaball_add(radius=0.4, location=(0, -2, 0))
    bpy.ops.object.text_add(location=(0, 0, 1))
    stage.lamp("POINT")
    stage.world((0.2, 0.3, 0.4))
    return stage


def test_moving_an_object_reads_that_object(furnished, cache, reads):
    exported(cache)
    # metaballs are read at every export
    reads.clear()
    exported(cache)
    assert reads == ["Mball"]
    reads.clear()
    bpy.data.objects["sphere 1"].location.z = 0.5
    exported(cache)
    assert sorted(reads) == ["Mball", "sphere 1"]
    assert_same(cache)
    reads.clear()
    bpy.data.objects["sphere 2"].data.vertices[0].co.x += 0.1
    exported(cache)
    assert sorted(reads) == ["Mball", "sphere 2"]
    assert_same(cache)


def test_unchanged_shapes_are_the_same_objects(furnished, cache):
    before = by_name(exported(cache))
    bpy.data.objects["sphere 0"].location.z = 0.5
    after = by_name(exported(cache))
    assert after["twin"] is before["twin"] and after["sphere 2"] is before["sphere 2"]
    assert after["sphere 0"] is not before["sphere 0"]


def _principled(name):
    return _principled_node(bpy.data.materials[name])


def _principled_node(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")


def _group_edit():
    tree = bpy.data.materials["noted"].node_tree
    group = bpy.data.node_groups.get("inner")
    if group is None:
        group = bpy.data.node_groups.new("inner", "ShaderNodeTree")
        group.interface.new_socket("Value", in_out="OUTPUT", socket_type="NodeSocketFloat")
        value, output = group.nodes.new("ShaderNodeValue"), group.nodes.new("NodeGroupOutput")
        group.links.new(value.outputs[0], output.inputs[0])
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        tree.links.new(node.outputs[0], _principled("noted").inputs["Roughness"])
    value = next(node for node in group.nodes if node.bl_idname == "ShaderNodeValue")
    value.outputs[0].default_value = random.random()


def _paint():
    image = bpy.data.images["picture"]
    pixels = np.random.default_rng(random.randrange(1 << 30)).random(8 * 8 * 4).astype(np.float32)
    image.pixels.foreach_set(pixels)


def _pack():
    _paint()
    bpy.data.images["picture"].pack()


def _hidden_edit():
    obj = bpy.data.objects["sphere 2"]
    obj.hide_viewport = True
    bpy.context.view_layer.update()
    obj.data.vertices[1].co.x += 0.05
    bpy.context.view_layer.update()
    obj.hide_viewport = False


def _replace_object():
    """Remove an object and its mesh, and make another of the same names: addresses may come back."""
    old = bpy.data.objects["sphere 2"]
    mesh, material = old.data, old.data.materials[0]
    bpy.data.objects.remove(old)
    bpy.data.meshes.remove(mesh)
    new = bpy.data.meshes.new("sphere 2")
    new.from_pydata([(0, 0, 0), (1, 0, 0), (random.random(), 1, 0)], [], [(0, 1, 2)])
    new.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("sphere 2", new))


def _toggle_modifier():
    obj = bpy.data.objects["sphere 0"]
    if obj.modifiers:
        obj.modifiers.clear()
    else:
        obj.modifiers.new("array", "ARRAY").count = 2


def _swap_material():
    slot = bpy.data.objects["sphere 0"].material_slots[0]
    slot.material = bpy.data.materials[random.choice(("textured", "lamp", "noted"))]


def _object_material():
    slot = bpy.data.objects["twin"].material_slots[0]
    slot.link = random.choice(("OBJECT", "DATA"))
    slot.material = bpy.data.materials[random.choice(("textured", "lamp", "noted"))]


def _uv_layers():
    layers = bpy.data.objects["sphere 0"].data.uv_layers
    if len(layers) < 2:
        layers.new(name="other").uv.foreach_set(
            "vector", np.full(2 * len(bpy.data.objects["sphere 0"].data.loops), 0.3, np.float32)
        )
    chosen = random.choice(layers[:])
    chosen.active_render = True


def _set(path, value):
    def change():
        block, _, name = path.rpartition(".")
        setattr(eval(block, {"D": bpy.data, "C": bpy.context}), name, value())

    return change


def _custom_property():
    """A property that a material reads, which Blender reports as a change of neither geometry nor place."""
    obj, material = bpy.data.objects["sphere 0"], bpy.data.materials["textured"]
    tree = material.node_tree
    if "Attribute" not in tree.nodes:
        node = tree.nodes.new("ShaderNodeAttribute")
        node.attribute_type, node.attribute_name = "OBJECT", "glow"
        tree.links.new(node.outputs["Fac"], _principled("textured").inputs["Emission Strength"])
    obj["glow"] = random.random()
    obj.update_tag()


CHANGES = {
    "custom property": _custom_property,
    "move": _set("D.objects['sphere 0'].location.x", random.random),
    "mirror": _set("D.objects['sphere 1'].scale.x", lambda: random.choice((-1, 1))),
    "vertex": lambda: setattr(bpy.data.objects["sphere 0"].data.vertices[0].co, "x", random.random()),
    "smooth": lambda: bpy.data.objects["sphere 2"].data.shade_flat(),
    "shape key": _set("D.objects['floor'].data.shape_keys.key_blocks['up'].value", random.random),
    "text": _set("D.objects['Text'].data.body", lambda: random.choice("abc")),
    "metaball": _set("D.objects['Mball'].data.elements[0].radius", lambda: random.uniform(0.3, 0.6)),
    "modifier": _toggle_modifier,
    "slot": _swap_material,
    "object slot": _object_material,
    "color": lambda: setattr(
        _principled("noted").inputs["Base Color"], "default_value", (random.random(), 0, 0, 1)
    ),
    "emission": _set(
        "D.materials['lamp'].node_tree.nodes['Emission'].inputs[1].default_value", random.random
    ),
    "group": _group_edit,
    "paint": _paint,
    "pack": _pack,
    "color space": _set(
        "D.images['picture'].colorspace_settings.name", lambda: random.choice(("sRGB", "Non-Color"))
    ),
    "hide": _set("D.objects['sphere 1'].hide_viewport", lambda: random.random() < 0.5),
    "hide in renders": _set("D.objects['sphere 1'].hide_render", lambda: random.random() < 0.5),
    "hidden edit": _hidden_edit,
    "rename": _set("D.objects['Camera' if 'Camera' in D.objects else 'camera'].name", lambda: "camera"),
    "replace": _replace_object,
    "uv": _uv_layers,
    "unit": _set("C.scene.unit_settings.scale_length", lambda: random.choice((1.0, 0.1))),
    "world": _set("D.worlds['world'].node_tree.nodes['Background'].inputs[1].default_value", random.random),
    "visibility": _set("D.objects['sphere 0'].visible_shadow", lambda: random.random() < 0.5),
    "override": _set(
        "C.view_layer.material_override", lambda: random.choice((None, bpy.data.materials["noted"]))
    ),
    "frame": lambda: bpy.context.scene.frame_set(random.randrange(1, 50)),
}


@pytest.mark.parametrize("change", CHANGES)
def test_change_comes_through(furnished, cache, change):
    random.seed(change)
    exported(cache)
    for _ in range(3):
        CHANGES[change]()
        assert_same(cache)
        assert_same(cache)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3))])
def test_many_changes_in_any_order(furnished, cache, seed):
    random.seed(seed)
    for _ in range(12):
        for change in random.sample(sorted(CHANGES), random.randrange(1, 5)):
            CHANGES[change]()
        assert_same(cache)


def test_animation_and_drivers(furnished, cache):
    obj = bpy.data.objects["floor"]
    block = obj.data.shape_keys.key_blocks["up"]
    block.value = 0
    block.keyframe_insert("value", frame=1)
    block.value = 1
    block.keyframe_insert("value", frame=20)
    driver = _principled("noted").inputs["Roughness"].driver_add("default_value").driver
    driver.expression = "0.2 + frame / 100"
    for frame in (1, 5, 9, 5):
        bpy.context.scene.frame_set(frame)
        assert_same(cache)


def test_armature(stage, cache):
    arm = stage.link(bpy.data.objects.new("arm", bpy.data.armatures.new("arm")))
    bpy.context.view_layer.objects.active = arm
    bpy.ops.object.mode_set(mode="EDIT")
    arm.data.edit_bones.new("bone").tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    plane = stage.plane()
    plane.vertex_groups.new(name="bone").add([0, 1, 2, 3], 1.0, "ADD")
    plane.modifiers.new("arm", "ARMATURE").object = arm
    for x in (0.0, 0.5):
        arm.pose.bones["bone"].location.x = x
        assert_same(cache)


def test_undo_and_opening_a_file_forget(furnished, cache, tmp_path):
    bpy.ops.ed.undo_push(message="before")
    bpy.data.objects["sphere 0"].data.vertices[0].co.x = 3
    bpy.ops.ed.undo_push(message="after")
    assert_same(cache)
    bpy.ops.ed.undo()
    assert_same(cache)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.data.objects["sphere 0"].data.vertices[0].co.x = 2
    assert_same(cache)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert_same(cache)


def test_another_scene_and_view_layer(furnished, cache):
    exported(cache)
    layer = bpy.context.scene.view_layers.new("second")
    bpy.context.window.view_layer = layer
    assert_same(cache)
    other = bpy.context.scene.copy()
    bpy.context.window.scene = other
    bpy.data.objects["sphere 0"].location.x = 5
    assert_same(cache)


def test_image_file_changed_and_reloaded(stage, cache, tmp_path):
    path = tmp_path / "picture.png"

    def paint(value):
        image = bpy.data.images.new("made", 4, 4)
        image.pixels.foreach_set(np.full(64, value, np.float32))
        image.filepath_raw, image.file_format = str(path), "PNG"
        image.save()
        bpy.data.images.remove(image)

    paint(0.2)
    image = bpy.data.images.load(str(path))
    material = stage.material("ShaderNodeBsdfDiffuse")
    stage.texture(material, image, "Color")
    stage.plane(material=material)
    before = fingerprint(exported(cache))
    paint(0.9)
    assert_same(cache)
    image.reload()
    assert_same(cache)
    assert fingerprint(exported(cache)) != before


def test_materials_that_share_a_group_and_images(stage, cache):
    """Several are dropped at once, and a note on an image comes whichever material has read it."""
    group = bpy.data.node_groups.new("shared", "ShaderNodeTree")
    group.interface.new_socket("Value", in_out="OUTPUT", socket_type="NodeSocketFloat")
    value, output = group.nodes.new("ShaderNodeValue"), group.nodes.new("NodeGroupOutput")
    group.links.new(value.outputs[0], output.inputs[0])
    image = bpy.data.images.new("lost", 4, 4)
    image.source, image.filepath = "FILE", "//nowhere.png"
    image.reload()
    for number in range(4):
        material = stage.material("ShaderNodeBsdfPrincipled", f"material {number}")
        shader = _principled_node(material)
        stage.texture(material, image, "Base Color", shader)
        node = material.node_tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        material.node_tree.links.new(node.outputs[0], shader.inputs["Roughness"])
        stage.plane(material=material, name=f"plane {number}", location=(number, 0, 0))
    for number in range(4):
        value.outputs[0].default_value = 0.2 + 0.1 * number
        assert_same(cache)
        _principled_node(bpy.data.materials[f"material {number}"]).inputs["IOR"].default_value = 1.4
        assert_same(cache)
        assert "lost" in {note.object for note in exported(cache).notes}
    bpy.data.objects.remove(bpy.data.objects["plane 0"])
    assert_same(cache)


def test_own_settings_of_a_material(stage, cache):
    """HoloPath's Abbe number."""
    from holopath_addon.blender import properties

    registered = hasattr(bpy.types.Scene, "holopath")
    if not registered:
        for cls in properties.CLASSES:
            bpy.utils.register_class(cls)
        properties.attach()
    try:
        glass = stage.material("ShaderNodeBsdfGlass", "glass", Roughness=0.0)
        stage.sphere(material=glass)
        stage.world()
        for abbe in (0.0, 30.0, 60.0):
            glass.holopath.abbe_number = abbe
            assert_same(cache)
    finally:
        if not registered:
            properties.detach()
            for cls in reversed(properties.CLASSES):
                bpy.utils.unregister_class(cls)


def test_instances_shared_or_copied(stage, cache, monkeypatch):
    obj = stage.sphere(0.2)
    for x in range(1, 4):
        stage.link(bpy.data.objects.new(f"copy {x}", obj.data)).location = (x, 0, 0)
    for limit in (10**9, 0, 10**9, 0):
        monkeypatch.setattr(contents_module, "MAX_COPIED_TRIANGLES", limit)
        assert_same(cache)
        bpy.data.objects["copy 1"].location.y += 1
        assert_same(cache)


def test_a_renders_own_depsgraph_is_not_cached(furnished, cache):
    array = bpy.data.objects["sphere 0"].modifiers.new("array", "ARRAY")
    array.show_viewport = False
    in_window = by_name(exported(cache))
    rendered = []

    class Probe(bpy.types.RenderEngine):
        bl_idname = "HOLOPATH_PROBE"
        bl_label = "Probe"

        def render(self, depsgraph):
            rendered.append(by_name(export_scene(depsgraph, (16, 16), cache=cache)))

    bpy.utils.register_class(Probe)
    try:
        bpy.context.scene.render.engine = "HOLOPATH_PROBE"
        bpy.ops.render.render()
    finally:
        bpy.utils.unregister_class(Probe)
    faces = in_window["sphere 0"].face_count()
    assert rendered[0]["sphere 0"].face_count() == 2 * faces
    assert by_name(exported(cache))["sphere 0"].face_count() == faces
    assert_same(cache)


def test_handlers_come_and_go(stage):
    handlers = bpy.app.handlers
    lists = (
        handlers.depsgraph_update_post,
        handlers.frame_change_post,
        handlers.undo_post,
        handlers.redo_post,
        handlers.load_post,
    )
    before = [len(callbacks) for callbacks in lists]
    stage.plane()
    first, second = ExportCache(), ExportCache()
    exported(first), exported(second)
    assert [len(callbacks) for callbacks in lists] == [n + 1 for n in before]
    first.close()
    bpy.data.objects["plane"].location.x = 1
    assert_same(second)
    handlers.depsgraph_update_post.clear()  # by someone else
    bpy.data.objects["plane"].data.vertices[0].co.z = 1
    assert_same(second)
    second.close()
    assert [len(callbacks) for callbacks in lists] == before
