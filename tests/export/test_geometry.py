"""Shapes, transforms and instances of the exported scene, by measuring it."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon.engine import InvalidInput  # noqa: E402


def cube(stage, name="cube", size=1.0, **options):
    h = size / 2
    vertices = [(x, y, z) for x in (-h, h) for y in (-h, h) for z in (-h, h)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return stage.mesh(name, vertices, faces, **options)


def area(scene):
    return sum(float(np.array(shape.surface_area()).sum()) for shape in scene.shapes())


def bounds(scene):
    box = scene.bbox()
    return np.array([box.min, box.max]).reshape(2, 3)


def hit(scene, origin, direction):
    import mitsuba as mi

    return scene.ray_intersect(mi.Ray3f(mi.Point3f(*map(float, origin)), mi.Vector3f(*map(float, direction))))


def test_modifiers_are_applied(stage):
    obj = cube(stage)
    assert area(stage.export().scene) == pytest.approx(6, rel=1e-5)
    array = obj.modifiers.new("array", "ARRAY")
    array.count, array.use_relative_offset, array.use_constant_offset = 3, False, True
    array.constant_offset_displace = (2, 0, 0)
    scene = stage.export().scene
    assert area(scene) == pytest.approx(18, rel=1e-5)
    assert bounds(scene) == pytest.approx(np.array([[-0.5, -0.5, -0.5], [4.5, 0.5, 0.5]]), abs=1e-5)


def test_unit_scale_is_meters(stage):
    obj = cube(stage)
    obj.location = (10, 0, 0)
    stage.scene.unit_settings.scale_length = 0.01
    assert bounds(stage.export().scene) == pytest.approx(
        np.array([[0.095, -0.005, -0.005], [0.105, 0.005, 0.005]]), abs=1e-7
    )


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (-1, -2, -1), (1, 3, 0.5), (1, -1, 1e-3)])
@pytest.mark.parametrize("smooth", [False, True])
def test_normals_point_outwards_under_any_scale(stage, scale, smooth):
    obj = cube(stage)
    obj.scale, obj.rotation_euler = scale, (0.3, 0.2, 0.5)
    if smooth:
        obj.data.shade_smooth()
    bpy.context.view_layer.update()
    rotation = np.array(obj.rotation_euler.to_matrix())
    scene = stage.export().scene
    for local in np.vstack([np.eye(3), -np.eye(3)]):
        outward = rotation @ local
        si = hit(scene, 5 * outward, -outward)
        assert bool(si.is_valid()[0])
        assert np.array(si.n).ravel() == pytest.approx(outward, abs=1e-3)
        assert float(np.array(si.sh_frame.n).ravel() @ outward) > 0.5


def test_smooth_flat_and_custom_normals(stage):
    sphere = stage.sphere(radius=1)
    direction = np.array([0.6, 0.3, 0.74])
    direction /= np.linalg.norm(direction)
    si = hit(stage.export().scene, 3 * direction, -direction)
    assert np.array(si.sh_frame.n).ravel() == pytest.approx(direction, abs=0.01)
    for polygon in sphere.data.polygons:
        polygon.use_smooth = polygon.center.x < 0  # half flat: normals live on corners now
    si = hit(stage.export().scene, 3 * direction, -direction)
    assert np.array(si.sh_frame.n).ravel() == pytest.approx(np.array(si.n).ravel(), abs=1e-3)
    si = hit(stage.export().scene, -3 * direction, direction)
    assert np.array(si.sh_frame.n).ravel() == pytest.approx(-direction, abs=0.01)
    bpy.data.objects.remove(sphere)
    plane = stage.plane()
    plane.data.normals_split_custom_set([(0.6, 0, 0.8)] * 4)
    si = hit(stage.export().scene, (0.1, 0.2, 3), (0, 0, -1))
    assert np.array(si.sh_frame.n).ravel() == pytest.approx((0.6, 0, 0.8), abs=1e-3)


def test_collection_and_dupli_instances(stage):
    collection = bpy.data.collections.new("things")
    obj = cube(stage)
    stage.scene.collection.objects.unlink(obj)
    collection.objects.link(obj)
    for x in (0, 3):
        empty = stage.link(bpy.data.objects.new(f"at {x}", None))
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location = (x, 0, 0)
    scene = stage.export().scene
    assert area(scene) == pytest.approx(12, rel=1e-5)
    assert bounds(scene)[:, 0] == pytest.approx((-0.5, 3.5), abs=1e-5)
    empty.hide_render = True
    bpy.context.view_layer.update()
    assert area(stage.export().scene) == pytest.approx(6, rel=1e-5)

    dupli = stage.plane(size=4, location=(0, 0, 10))
    dupli.instance_type = "VERTS"
    dupli.show_instancer_for_viewport = dupli.show_instancer_for_render = False
    child = cube(stage, "child")
    child.parent = dupli
    # one collection instance, four at the vertices, and the child itself, which Cycles renders too
    assert area(stage.export().scene) == pytest.approx(6 + 4 * 6 + 6, rel=1e-5)


def test_many_instances_share_one_mesh(stage, monkeypatch):
    from holopath_addon.export import contents as module

    obj = cube(stage)
    obj.scale = (-1, 2, 1)
    for k in range(1, 5):
        copy = stage.link(bpy.data.objects.new(f"copy {k}", obj.data))
        copy.location, copy.scale, copy.rotation_euler = (3 * k, 0, 0), (-1, 2, 1), (0.1 * k, 0, 0)
    copies = stage.export().scene
    monkeypatch.setattr(module, "MAX_COPIED_TRIANGLES", 0)
    shared = stage.export().scene
    assert [repr(shape).split("[")[0] for shape in shared.shapes()] == ["Instance"] * 5
    for x in (0, 3, 12):
        for direction in ((0, 0, 1), (0, 1, 0.2)):
            origin = np.array([x + 0.1, 0.05, 0.1]) + 5 * np.array(direction)
            a, b = (hit(scene, origin, -np.array(direction)) for scene in (copies, shared))
            assert float(a.t[0]) == pytest.approx(float(b.t[0]), rel=1e-4)
            assert np.array(a.n).ravel() == pytest.approx(np.array(b.n).ravel(), abs=1e-4)


@pytest.mark.parametrize("kind", ["CURVE", "FONT", "META", "SURFACE"])
def test_other_surfaces_become_meshes(stage, kind):
    if kind == "CURVE":
        bpy.ops.curve.primitive_bezier_circle_add()
        bpy.context.object.data.bevel_depth = 0.1
        expected = 2 * np.pi * 2 * np.pi * 0.1
    elif kind == "FONT":
        bpy.ops.object.text_add()
        bpy.context.object.data.body = "HoloPath"
        expected = None
    elif kind == "META":
        bpy.ops.object.metaball_add(radius=1)
        expected = None
    else:
        bpy.ops.surface.primitive_nurbs_surface_sphere_add()
        expected = None
    exported = stage.export()
    total = area(exported.scene)
    assert total > 0.5
    if expected:
        assert total == pytest.approx(expected, rel=0.05)


def test_materials_by_slot_and_object(stage):
    red = stage.material("ShaderNodeEmission", "red", Color=(1, 0, 0, 1))
    green = stage.material("ShaderNodeEmission", "green", Color=(0, 1, 0, 1))
    blue = stage.material("ShaderNodeEmission", "blue", Color=(0, 0, 1, 1))
    vertices = [(-1, -1, 0), (0, -1, 0), (1, -1, 0), (-1, 1, 0), (0, 1, 0), (1, 1, 0)]
    obj = stage.mesh("two", vertices, [(0, 1, 4, 3), (1, 2, 5, 4)])
    obj.data.materials.append(red)
    obj.data.materials.append(green)
    obj.data.polygons[1].material_index = 1
    image = stage.mitsuba(spp=16)
    assert image[16, 10] == pytest.approx((1, 0, 0))
    assert image[16, 22] == pytest.approx((0, 1, 0))
    obj.material_slots[1].link = "OBJECT"
    obj.material_slots[1].material = blue
    twin = stage.link(bpy.data.objects.new("twin", obj.data))
    twin.location = (0, 0, -1)
    twin.scale = (4, 4, 4)
    image = stage.mitsuba(spp=16)
    assert image[16, 22] == pytest.approx((0, 0, 1))
    assert image[16, 31] == pytest.approx((0, 1, 0))


def test_what_nodes_scatter_is_shown_where_its_source_is_not(stage):
    """Instances stay visible if their source is disabled in renders, as in Cycles."""
    source = cube(stage, "source")
    source.hide_render = True
    ground = stage.plane(size=4, location=(0, 0, 10))
    group = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes = {
        name: group.nodes.new(kind)
        for name, kind in (
            ("in", "NodeGroupInput"),
            ("of", "GeometryNodeObjectInfo"),
            ("on", "GeometryNodeInstanceOnPoints"),
            ("out", "NodeGroupOutput"),
        )
    }
    nodes["of"].inputs["Object"].default_value = source
    nodes["of"].inputs["As Instance"].default_value = True
    group.links.new(nodes["in"].outputs[0], nodes["on"].inputs["Points"])
    group.links.new(nodes["of"].outputs["Geometry"], nodes["on"].inputs["Instance"])
    group.links.new(nodes["on"].outputs[0], nodes["out"].inputs[0])
    ground.modifiers.new("scatter", "NODES").node_group = group
    bpy.context.view_layer.update()
    assert area(stage.export().scene) == pytest.approx(4 * 6, rel=1e-5)


def test_hidden_objects_are_left_out(stage):
    stage.plane(name="shown")
    hidden = stage.plane(name="hidden", location=(5, 0, 0))
    hidden.hide_render = True
    collection = bpy.data.collections.new("not rendered")
    stage.scene.collection.children.link(collection)
    collection.hide_render = True
    inside = stage.plane(name="inside", location=(9, 0, 0))
    stage.scene.collection.objects.unlink(inside)
    collection.objects.link(inside)
    assert bounds(stage.export().scene)[1, 0] == pytest.approx(1)
    hidden.hide_render, hidden.hide_viewport = False, True
    exported = stage.export()
    assert bounds(exported.scene)[1, 0] == pytest.approx(1)
    assert ("hidden", "Hidden in the viewport") in {(n.object, n.feature) for n in exported.notes}


def test_empty_and_zero_size_meshes(stage):
    with pytest.raises(InvalidInput, match="nothing visible"):
        stage.export()
    stage.mesh("no faces", [(0, 0, 0), (1, 0, 0)], [])
    with pytest.raises(InvalidInput, match="nothing visible"):
        stage.export()
    emitter = stage.material("ShaderNodeEmission")
    flat = stage.plane(name="flat", material=emitter)
    flat.scale = (0, 0, 0)
    cube(stage).scale = (1, 1, 0)
    stage.world()
    assert np.isfinite(stage.mitsuba(spp=4)).all()


def test_nan_vertices_name_the_object(stage):
    stage.mesh("broken", [(0, 0, 0), (1, 0, 0), (0, float("nan"), 0)], [(0, 1, 2)])
    with pytest.raises(InvalidInput, match="'broken'.*not finite"):
        stage.export()


def test_unsupported_objects_are_noted(stage):
    stage.plane()
    stage.link(bpy.data.objects.new("fog", bpy.data.volumes.new("fog")))
    assert {n.object for n in stage.export().notes} >= {"fog"}


def test_metaballs_come_once(stage):
    bpy.ops.object.metaball_add(radius=1)
    bpy.context.object.data.resolution = 0.05
    scene = stage.export().scene
    radius = bounds(scene)[1, 0]
    assert area(scene) == pytest.approx(4 * np.pi * radius**2, rel=0.01)


def test_nurbs_sphere_and_text(stage):
    bpy.ops.surface.primitive_nurbs_surface_sphere_add(radius=1)
    sphere = bpy.context.object
    sphere.data.resolution_u = sphere.data.resolution_v = 16
    assert area(stage.export().scene) == pytest.approx(4 * np.pi, rel=0.01)
    bpy.data.objects.remove(sphere)
    bpy.ops.object.text_add()
    text = bpy.context.object.data
    text.body, text.extrude = "I", 0.1
    scene = stage.export().scene
    (x0, y0, z0), (x1, y1, z1) = bounds(scene)
    width, height = x1 - x0, y1 - y0
    assert (z0, z1) == pytest.approx((-0.1, 0.1))
    # the letter is a box
    assert area(scene) == pytest.approx(2 * width * height + 0.4 * (width + height), rel=1e-4)


def _geometry_nodes(obj, build):
    """A geometry-nodes modifier; ``build(tree, input socket, output socket)`` links it up."""
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    begin, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    build(tree, begin.outputs[0], end.inputs[0])
    obj.modifiers.new("nodes", "NODES").node_group = tree


def test_geometry_nodes_instances(stage):
    plane, small = stage.plane(2), stage.plane(0.2, name="small", location=(0, 0, 5))

    def build(tree, begin, end):
        scatter, info = (
            tree.nodes.new("GeometryNodeInstanceOnPoints"),
            tree.nodes.new("GeometryNodeObjectInfo"),
        )
        info.inputs["Object"].default_value = small
        tree.links.new(begin, scatter.inputs["Points"])
        tree.links.new(info.outputs["Geometry"], scatter.inputs["Instance"])
        tree.links.new(scatter.outputs[0], end)

    _geometry_nodes(plane, build)
    scene = stage.export().scene
    assert area(scene) == pytest.approx(5 * 0.04, rel=1e-4)
    assert bounds(scene) == pytest.approx(np.array([[-1.1, -1.1, 0], [1.1, 1.1, 5]]), abs=1e-5)
    for x in (-1, 1):
        assert float(hit(scene, (x, 1, 3), (0, 0, -1)).t[0]) == pytest.approx(3)


def test_particle_instances(stage):
    ground, ball = stage.plane(4), stage.plane(0.1, name="leaf", location=(0, 0, 9))
    ground.modifiers.new("particles", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count = "HAIR", 10
    settings.render_type, settings.instance_object = "OBJECT", ball
    settings.particle_size, settings.use_advanced_hair, settings.use_rotation_instance = 1.0, True, False
    scene = stage.export().scene
    leaves = [shape for shape in scene.shapes() if 'name = "leaf"' in str(shape)]
    assert len(leaves) == 11
    sizes = [float(shape.surface_area()[0]) for shape in leaves]
    expected = [
        np.prod(np.array(i.matrix_world.to_scale())[:2]) * 0.01
        for i in bpy.context.evaluated_depsgraph_get().object_instances
        if i.object.name == "leaf"
    ]
    assert sorted(sizes) == pytest.approx(sorted(expected), rel=1e-4)


def test_smooth_by_angle_and_sharp_edges(stage):
    bpy.ops.mesh.primitive_cylinder_add(vertices=32, radius=1, depth=2)
    cylinder = bpy.context.object

    def normals():
        scene = stage.export().scene
        tilted = np.array([np.cos(0.03), np.sin(0.03), 0])
        side = hit(scene, 3 * tilted + (0, 0, 0.9), -tilted)
        top = hit(scene, (0.9, 0, 3), (0, 0, -1))
        return np.array(side.sh_frame.n).ravel() @ tilted, np.array(top.sh_frame.n).ravel()

    cylinder.data.shade_smooth()
    side, top = normals()
    assert top[2] < 0.9  # without sharp edges the cap is bent, too
    for edge in cylinder.data.edges:
        ends = [cylinder.data.vertices[v].co.z for v in edge.vertices]
        edge.use_edge_sharp = abs(ends[0] - ends[1]) < 1e-6
    side, top = normals()
    assert top == pytest.approx((0, 0, 1), abs=1e-5)
    assert side > 0.9999
    cylinder.data.shade_smooth()
    for edge in cylinder.data.edges:
        edge.use_edge_sharp = False
    bpy.ops.object.shade_auto_smooth(angle=0.6)
    side, top = normals()
    assert top == pytest.approx((0, 0, 1), abs=1e-5)
    assert side > 0.9999


def test_shape_keys_and_armatures(stage):
    plane = stage.plane()
    plane.shape_key_add(name="Basis")
    key = plane.shape_key_add(name="wide")
    for point in key.data:
        point.co.x *= 3
    key.value = 0.5
    assert bounds(stage.export().scene)[:, 0] == pytest.approx((-2, 2))
    rig = stage.link(bpy.data.objects.new("rig", bpy.data.armatures.new("rig")))
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones.new("bone").tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    plane.vertex_groups.new(name="bone").add([0, 1, 2, 3], 1.0, "ADD")
    plane.modifiers.new("rig", "ARMATURE").object = rig
    rig.pose.bones["bone"].location = (0, 2, 0)  # along the bone, which points up
    assert bounds(stage.export().scene)[:, 2] == pytest.approx((2, 2), abs=1e-5)


def test_linked_libraries(stage, tmp_path):
    red = stage.material("ShaderNodeEmission", "red", Color=(1, 0, 0, 1))
    box = cube(stage, "from library", material=red)
    collection = bpy.data.collections.new("library things")
    collection.objects.link(box)
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {collection}, fake_user=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    again = type(stage)()
    with bpy.data.libraries.load(path, link=True) as (_, target):
        target.collections = ["library things"]
    empty = again.link(bpy.data.objects.new("instance", None))
    empty.instance_type, empty.instance_collection = "COLLECTION", target.collections[0]
    empty.location.x = 2
    scene = again.export().scene
    assert bounds(scene)[:, 0] == pytest.approx((1.5, 2.5), abs=1e-4)
    assert all(shape.is_emitter() for shape in scene.shapes())


def test_rays_do_not_slip_between_triangles(stage):
    """Embree by default lets some rays through that meet an edge."""
    import mitsuba as mi

    n, turn = 65, np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0], [0.48, 0.64, 0.6]])
    y, x = np.mgrid[:n, :n] / (n - 1)
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) @ turn.T
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.stack([corner, corner + 1, corner + n + 1, corner + n], axis=-1)
    stage.mesh("grid", vertices.tolist(), faces.tolist())
    scene = stage.export().scene
    rng = np.random.default_rng(0)
    inner = corner.reshape(n - 1, n - 1)[1:, 1:].ravel()
    a, b = (vertices[np.repeat(inner + step, 20)] for step in (0, n))
    place = a + rng.random((len(a), 1)) * (b - a)
    towards = -turn[:, 2] + 0.5 * rng.normal(size=place.shape) @ np.diag([1, 1, 0]) @ turn.T
    start = place - towards
    ray = mi.Ray3f(mi.Point3f(*start.T), mi.Vector3f(*towards.T))
    assert np.asarray(scene.ray_intersect(ray).is_valid()).all()


@pytest.mark.parametrize("hidden", ["child", "nested", "whole"])
def test_what_renders_hide_of_an_instanced_collection(stage, hidden):
    """The viewport shows collections that are disabled in renders where they are instanced; Cycles does not."""
    whole, child, other = (bpy.data.collections.new(name) for name in ("whole", "child", "other"))
    whole.children.link(child)
    for number, collection in enumerate((whole, child, other)):
        plane = stage.plane(0.5, name=collection.name, location=(number - 1, 0, 0))
        stage.scene.collection.objects.unlink(plane)
        collection.objects.link(plane)
    nested = bpy.data.objects.new("nested", None)
    nested.instance_type, nested.instance_collection = "COLLECTION", other
    whole.objects.link(nested)
    outer = bpy.data.objects.new("outer", None)
    outer.instance_type, outer.instance_collection = "COLLECTION", whole
    stage.link(outer)
    assert area(stage.export().scene) == pytest.approx(3 * 0.25, rel=1e-4)
    if hidden == "nested":
        nested.hide_render = True
    else:
        {"child": child, "whole": whole}[hidden].hide_render = True
    if hidden == "whole":
        stage.plane(0.1, location=(0, 1, 0))
        expected = 0.01
    else:
        expected = 2 * 0.25
    bpy.context.view_layer.update()
    assert area(stage.export().scene) == pytest.approx(expected, rel=1e-4)


def test_what_an_instancer_hides_is_noted(stage):
    part = bpy.data.collections.new("part")
    plane = stage.plane(0.5)
    stage.scene.collection.objects.unlink(plane)
    part.objects.link(plane)
    outer = bpy.data.objects.new("outer", None)
    outer.instance_type, outer.instance_collection = "COLLECTION", part
    stage.link(outer)
    stage.world()
    assert stage.export().notes == []
    outer.visible_camera, outer.is_holdout = False, True
    bpy.context.view_layer.update()
    assert {(note.object, note.feature) for note in stage.export().notes} == {
        ("outer", "Ray visibility: hidden from camera"),
        ("outer", "Holdout or shadow catcher"),
    }
