"""Objects of every kind, in one material on a floor."""

import math
import os
import tempfile
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ..stage import added
from .feature import OBJECT, Feature
from .staging import BLUE, DIFFUSE, EMISSION, ball, cube, cylinder, floor, grid, lit, monkey, tan, text


def curve(stage, material):
    bpy.ops.curve.primitive_bezier_circle_add(radius=0.8, rotation=(0.6, 0.3, 0))
    curve = added()
    curve.data.bevel_depth, curve.data.bevel_resolution = 0.25, 6
    curve.data.materials.append(material)


def _text(stage, material):
    text(stage).data.materials.append(material)


def _metaball(stage, material):
    ball_data = bpy.data.metaballs.new("metaball")
    ball_data.resolution = ball_data.render_resolution = 0.08
    for x in (-0.45, 0.45):
        element = ball_data.elements.new()
        element.co, element.radius = (x, 0.2 * x, 0), 0.9
    ball_data.materials.append(material)
    stage.link(bpy.data.objects.new("metaball", ball_data))


def _nurbs(stage, material):
    bpy.ops.surface.primitive_nurbs_surface_sphere_add(radius=1.0)
    added().data.materials.append(material)


def _instances_on_points(stage, material):
    """Cubes on a grid's points, by geometry nodes."""
    tree: Any = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    scatter, brick = tree.nodes.new("GeometryNodeInstanceOnPoints"), tree.nodes.new("GeometryNodeMeshCube")
    paint = tree.nodes.new("GeometryNodeSetMaterial")
    paint.inputs["Material"].default_value = material
    brick.inputs["Size"].default_value = (0.3, 0.2, 0.4)
    scatter.inputs["Rotation"].default_value = (0.3, 0.5, 0.2)
    tree.links.new(entry.outputs[0], scatter.inputs["Points"])
    tree.links.new(brick.outputs["Mesh"], paint.inputs["Geometry"])
    tree.links.new(paint.outputs["Geometry"], scatter.inputs["Instance"])
    tree.links.new(scatter.outputs["Instances"], end.inputs[0])
    grid(stage, material, 3).modifiers.new("scatter", "NODES").node_group = tree


def _points(stage, material):
    """Balls of a cloud on a grid's points, by geometry nodes."""
    tree: Any = bpy.data.node_groups.new("points", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    points, paint = tree.nodes.new("GeometryNodeMeshToPoints"), tree.nodes.new("GeometryNodeSetMaterial")
    points.inputs["Radius"].default_value = 0.2
    paint.inputs["Material"].default_value = material
    tree.links.new(entry.outputs[0], points.inputs["Mesh"])
    tree.links.new(points.outputs[0], paint.inputs["Geometry"])
    tree.links.new(paint.outputs["Geometry"], end.inputs[0])
    grid(stage, material, 3).modifiers.new("points", "NODES").node_group = tree


def _collection_instance(stage, material):
    collection = bpy.data.collections.new("parts")
    for x in (-0.5, 0.5):
        part = cylinder(stage, material, 24)
        part.location = (x, 0, 0)
        stage.scene.collection.objects.unlink(part)
        collection.objects.link(part)
    empty = stage.link(bpy.data.objects.new("empty", None))
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.rotation_euler, empty.scale = (0.4, 0.2, 0.7), (1, 0.8, 1.2)


def _instances_on_faces(stage, material):
    parent, part = grid(stage, material, 3), cube(stage, material, 0.4)
    part.parent = parent
    parent.instance_type = "FACES"
    parent.show_instancer_for_render = parent.show_instancer_for_viewport = False


def _hidden(stage, material):
    """Two objects that renders do not show, and one in a collection that is excluded."""
    monkey(stage, material)
    for place in ((0, 0, 1.2), (0.5, 0.5, 1.4)):
        stage.plane(0.8, material, "hidden", place).hide_render = True
    collection = bpy.data.collections.new("excluded")
    stage.scene.collection.children.link(collection)
    part = stage.plane(0.8, material, "excluded", (-0.5, 0, 1.3))
    stage.scene.collection.objects.unlink(part)
    collection.objects.link(part)
    stage.scene.view_layers[0].layer_collection.children["excluded"].exclude = True


def _negative_scale(stage, material):
    monkey(stage, material, smooth=True).scale = (-0.9, 1.1, 0.8)


def _sheared(stage, material):
    parent = stage.link(bpy.data.objects.new("parent", None))
    parent.rotation_euler, parent.scale = (0.2, 0.1, 0.8), (1.4, 0.7, 1)
    monkey(stage, material, smooth=True).parent = parent


def _smooth_by_angle(stage, material):
    made = cylinder(stage, material)
    made.data.shade_smooth()
    made.data.set_sharp_from_angle(angle=math.radians(40))


def _custom_normals(stage, material):
    made = cylinder(stage, material)
    up = [(0.5 * v.co.x, 0.5 * v.co.y, 0.8) for v in made.data.vertices]
    made.data.normals_split_custom_set_from_vertices(up)


def _shape_key(stage, material):
    made = monkey(stage, material, smooth=True)
    made.shape_key_add(name="Basis")
    key = made.shape_key_add(name="wide")
    for point in key.data:
        point.co.x *= 1.6
        point.co.z *= 0.7
    key.value = 0.7


def _armature(stage, material):
    """A bar bent by its second bone."""
    bones = stage.link(bpy.data.objects.new("rig", bpy.data.armatures.new("rig")))
    stage.scene.view_layers[0].objects.active = bones
    bpy.ops.object.mode_set(mode="EDIT")
    lower, upper = (bones.data.edit_bones.new(name) for name in ("lower", "upper"))
    lower.head, lower.tail, upper.head, upper.tail = (0, -1, 0), (0, 0, 0), (0, 0, 0), (0, 1, 0)
    upper.parent = lower
    bpy.ops.object.mode_set(mode="OBJECT")
    bar = grid(stage, material)
    bar.rotation_euler, bar.scale = (0, 0, 0), (0.5, 1, 1)
    for name, side in (("lower", -1), ("upper", 1)):
        group = bar.vertex_groups.new(name=name)
        for vertex in bar.data.vertices:
            group.add([vertex.index], float(np.clip(0.5 + 2 * side * vertex.co.y, 0, 1)), "REPLACE")
    bar.modifiers.new("rig", "ARMATURE").object = bones
    bones.pose.bones["upper"].rotation_mode = "XYZ"
    bones.pose.bones["upper"].rotation_euler = (0.7, 0, 0.4)


def _linked(stage, material):
    """An object of another file."""
    made = monkey(stage, material)
    made.name = "linked"
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "library.blend")
        bpy.data.libraries.write(path, {made})
        bpy.data.objects.remove(made)
        library: Any = bpy.data.libraries.load(path, link=True)
        with library as (_, wanted):
            wanted.objects = ["linked"]
        stage.link(wanted.objects[0])


def _modifiers(stage, material):
    made = cube(stage, material, 0.5)
    made.data.transform(Matrix.Translation((0.4, 0.35, 0)))
    array = made.modifiers.new("array", "ARRAY")
    array.count, array.relative_offset_displace = 2, (0.2, 1.3, 0)
    made.modifiers.new("mirror", "MIRROR").use_axis = (True, True, False)
    smooth = made.modifiers.new("smooth", "SUBSURF")
    smooth.levels = smooth.render_levels = 2
    made.modifiers.new("solid", "SOLIDIFY").thickness = 0.05


def _slots(stage, material):
    """Faces of three materials, one of them set on the object instead of the mesh."""
    made = monkey(stage, material)
    for color in (BLUE, (0.1, 0.6, 0.1, 1)):
        made.data.materials.append(stage.material(DIFFUSE, Color=color))
    made.data.polygons.foreach_set("material_index", np.arange(len(made.data.polygons)) % 3)
    made.material_slots[2].link = "OBJECT"
    made.material_slots[2].material = stage.material(EMISSION, Color=(0.4, 0.1, 0.3, 1))


def _particle_instances(stage, material):
    """A ball at every vertex of a grid."""
    emitter, part = grid(stage, material, 5), ball(stage, material, 0.15, (0, 0, 100), "grain")
    emitter.modifiers.new("grains", "PARTICLE_SYSTEM")
    settings = emitter.particle_systems[0].settings
    settings.emit_from, settings.use_emit_random = "VERT", False
    settings.count, settings.frame_start, settings.frame_end = len(emitter.data.vertices), 1, 1
    settings.lifetime, settings.physics_type = 100, "NO"
    settings.render_type, settings.instance_object, settings.particle_size = "OBJECT", part, 1
    stage.scene.frame_set(2)


def _hair_particles(stage, material):
    emitter = ball(stage, material, 0.7)
    emitter.modifiers.new("hair", "PARTICLE_SYSTEM")
    settings = emitter.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", 400, 0.3
    settings.root_radius, settings.tip_radius, settings.radius_scale = 1.0, 0.4, 0.03


def _hair_curves(stage, material):
    rng = np.random.default_rng(4)
    count, points = 300, 6
    roots = rng.normal(size=(count, 3))
    roots /= np.linalg.norm(roots, axis=1, keepdims=True)
    along = np.linspace(0.5, 1.0, points)[None, :, None]
    places = roots[:, None] * along + 0.1 * rng.normal(size=(count, 1, 3)) * (along - 0.5)
    data = bpy.data.hair_curves.new("curves")
    data.add_curves([points] * count)
    data.points.foreach_set("position", places.astype(np.float32).ravel())
    data.points.foreach_set("radius", np.tile(np.linspace(0.03, 0.01, points), count).astype(np.float32))
    data.materials.append(material)
    stage.link(bpy.data.objects.new("curves", data))


GEOMETRY = {
    "mesh": lambda stage, material: cube(stage, material),
    "curve": curve,
    "text": _text,
    "metaball": _metaball,
    "NURBS surface": _nurbs,
    "geometry nodes instances": _instances_on_points,
    "point cloud": _points,
    "collection instance": _collection_instance,
    "instances on faces": _instances_on_faces,
    "particle instances": _particle_instances,
    "hidden and excluded": _hidden,
    "negative scale": _negative_scale,
    "sheared by a parent": _sheared,
    "flat": monkey,
    "smooth": lambda stage, material: stage.sphere(1.0, material),
    "smooth over sharp edges": lambda stage, material: cylinder(stage, material, 24).data.shade_smooth(),
    "smooth by angle": _smooth_by_angle,
    "custom normals": _custom_normals,
    "shape key": _shape_key,
    "armature": _armature,
    "linked library": _linked,
    "modifiers": _modifiers,
    "material slots": _slots,
    "hair particles": _hair_particles,
    "hair curves": _hair_curves,
}
_BELOW = "gloss seen from below the horizon of its normal is missing, Cycles bends the normal"
_TUBES = "tubes of six sides in place of Cycles' ribbons"
APPROXIMATE = {
    "smooth over sharp edges": (0.05, _BELOW),
    "custom normals": (0.05, _BELOW),
    "hair particles": (0.1, _TUBES),
    "hair curves": (0.1, _TUBES),
}


def _of(make):
    def build(stage):
        make(stage, tan(stage))
        floor(stage)

    return lit(build)


FEATURES = [
    Feature(name, "geometry", _of(make), OBJECT, *APPROXIMATE.get(name, ()))
    for name, make in GEOMETRY.items()
]
