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


def test_unit_scale_is_metres(stage):
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
    from holopath_addon.export import scene as module

    obj = cube(stage)
    obj.scale = (-1, 2, 1)
    for k in range(1, 5):
        copy = stage.link(bpy.data.objects.new(f"copy {k}", obj.data))
        copy.location, copy.scale, copy.rotation_euler = (3 * k, 0, 0), (-1, 2, 1), (0.1 * k, 0, 0)
    copies = stage.export().scene
    monkeypatch.setattr(module, "COPIED_TRIANGLES", 0)
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
    stage.link(bpy.data.objects.new("fur", bpy.data.hair_curves.new("fur")))
    assert {n.object for n in stage.export().notes} >= {"fog", "fur"}
