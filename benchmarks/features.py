"""One small scene a feature that the exporter promises, and scenes of several features at random.

A feature's builder fills a `Stage` whose camera sits at (0, 0, 4), looks down, and sees 2.88 units across
z = 0. Surfaces are lit by an emitting panel beside the view and a dim world, which show in mirrors and
glass as well; lamps have scenes of their own.
"""

import itertools
import math
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from .stage import added

BOUND = 0.03
SQUARE, WIDE, TALL = (48, 48), (60, 36), (36, 60)

TAN = (0.6, 0.3, 0.15, 1)
WHITE = (0.8, 0.8, 0.8, 1)
BLUE = (0.1, 0.3, 0.8, 1)

DIFFUSE = "ShaderNodeBsdfDiffuse"
PRINCIPLED = "ShaderNodeBsdfPrincipled"
EMISSION = "ShaderNodeEmission"
TRANSPARENT = "ShaderNodeBsdfTransparent"


def disk(inner, outer):
    """Places of a picture by their distance from its centre, in halves of its width."""
    return lambda x, y: (inner <= np.hypot(x, y)) & (np.hypot(x, y) < outer)


def box(left, right, bottom, top):
    """Places of a picture, in halves of its width and height, y up."""
    return lambda x, y: (left <= x) & (x < right) & (bottom <= y) & (y < top)


EVERYWHERE = {"picture": box(-1, 1, -1, 1)}
BALL = {"centre": disk(0, 0.45), "rim": disk(0.45, 0.72)}
MIDDLE = {"middle": box(-0.55, 0.55, -0.55, 0.55)}
OBJECT = {"object": disk(0, 0.6), "around": disk(0.6, 2)}


@dataclass(frozen=True)
class Feature:
    """A scene that shows one feature.

    Attributes
    ----------
    name, group : str
    build : callable
        ``build(stage)`` fills an empty stage.
    regions : dict of str to callable
        ``region(x, y)`` tells which places of the picture, from -1 to 1 and y up, count.
    bound : float
        Largest mean absolute relative difference from Cycles' picture in any region.
    reason : str
        Why the bound is another than `BOUND`.
    notes : frozenset of str
        Features of the notes that the exporter has to make here, besides those on what was baked.
    resolution : tuple of int
    depth : int
        Longest path, vertices without the camera's.
    reference : callable or None
        ``reference(stage)`` changes the scene, before Cycles renders it, to what the picture should be.
    """

    name: str
    group: str
    build: Callable
    regions: dict = field(default_factory=lambda: BALL)
    bound: float = BOUND
    reason: str = ""
    notes: frozenset = frozenset()
    resolution: tuple = SQUARE
    depth: int = 6
    reference: Callable | None = None


# -- light and objects that the scenes share


def studio(stage, world=0.15):
    """An emitting panel at the upper right, beside the view, and a dim world."""
    panel = stage.plane(1.6, stage.material(EMISSION, "panel", Strength=8.0), "panel", (2, 1, 2.5))
    panel.rotation_euler = (-0.3, 0.8, 0)
    stage.world((1.0, 1.1, 1.3), world)


def backdrop(stage, depth=-1.4):
    """A glowing wall of coloured tiles behind the object."""
    tiles = 0.1 + 0.9 * np.random.default_rng(3).random((6, 6, 3))
    image = stage.image(np.kron(tiles, np.ones((16, 16, 1))), "tiles", True, "Linear Rec.709")
    glow = stage.material(EMISSION, "backdrop")
    stage.texture(glow, image, "Color").interpolation = "Closest"
    stage.plane(6, glow, "backdrop", (0, 0, depth))


def floor(stage, depth=-0.9, colour=WHITE):
    return stage.plane(8, stage.material(DIFFUSE, "floor", Color=colour), "floor", (0, 0, depth))


def ball(stage, material=None, radius=1.0, location=(0, 0, 0), name="ball"):
    """A sphere of triangles too small to see."""
    bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=location, segments=64, ring_count=32)
    made = added()
    made.name = name
    made.data.shade_smooth()
    made.data.materials.append(material)
    return made


def tilted(stage, material, size=2.2):
    plane = stage.plane(size, material, "tilted")
    plane.rotation_euler = (0.5, 0.25, 0.3)
    return plane


def tan(stage):
    return stage.material(DIFFUSE, "tan", Color=TAN)


def node(tree, kind, **values):
    """A new node: lower-case names are its properties, others its inputs; sockets are linked."""
    made = tree.nodes.new("ShaderNode" + kind)
    for key, value in values.items():
        if key.islower():
            setattr(made, key, value)
            continue
        name = key.replace("_", " ")
        socket = next(s for s in made.inputs if s.identifier == key or s.name == name)
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        else:
            socket.default_value = value
    return made


def shader_of(tree):
    """The node that feeds a tree's output."""
    output = next(n for n in tree.nodes if n.bl_idname.startswith("ShaderNodeOutput"))
    return output.inputs["Surface"].links[0].from_node


def painted(stage, source, socket="Color", shader=DIFFUSE, **values):
    """A material with one input fed by what ``source(stage, tree)`` returns."""
    material = stage.material(shader, "painted", **values)
    tree = material.node_tree
    tree.links.new(source(stage, tree), shader_of(tree).inputs[socket])
    return material


def surface(stage, tree, socket):
    """Make a shader socket the tree's surface."""
    output = next(n for n in tree.nodes if n.bl_idname.startswith("ShaderNodeOutput"))
    tree.links.new(socket, output.inputs["Surface"])


def text(stage):
    curve: Any = bpy.data.curves.new("text", "FONT")
    curve.body, curve.size, curve.extrude, curve.bevel_depth = "B", 2.4, 0.2, 0.03
    curve.align_x, curve.align_y = "CENTER", "CENTER"
    return stage.link(bpy.data.objects.new("text", curve))


def monkey(stage, material, smooth=False):
    bpy.ops.mesh.primitive_monkey_add(size=1.9, rotation=(-0.6, 0.3, 0.2))
    made = added()
    if smooth:
        made.data.shade_smooth()
    made.data.materials.append(material)
    return made


def cube(stage, material, size=1.2, name="cube"):
    bpy.ops.mesh.primitive_cube_add(size=size, rotation=(0.5, 0.4, 0.3))
    made = added()
    made.name = name
    made.data.materials.append(material)
    return made


def cylinder(stage, material, segments=12):
    bpy.ops.mesh.primitive_cylinder_add(radius=0.7, depth=1.4, vertices=segments, rotation=(0.9, 0.2, 0))
    made = added()
    made.data.materials.append(material)
    return made


def grid(stage, material, count=24):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=count, y_subdivisions=count, size=2.2)
    made = added()
    made.rotation_euler = (0.5, 0.25, 0.3)
    made.data.materials.append(material)
    return made


# -- geometry


def geometry():
    for name, make in GEOMETRY.items():

        def build(stage, make=make):
            make(stage, tan(stage))
            floor(stage)
            studio(stage)

        bound, reason = GEOMETRY_APPROXIMATE.get(name, (BOUND, ""))
        yield Feature(name, "geometry", build, OBJECT, bound, reason)
    tubes = "tubes of six sides in place of Cycles' ribbons"
    yield Feature("hair particles", "geometry", _hair_particles, OBJECT, 0.1, tubes)
    yield Feature("hair curves", "geometry", _hair_curves, OBJECT, 0.1, tubes)


_BELOW = "gloss seen from below the horizon of its normal is missing, Cycles bends the normal"
GEOMETRY_APPROXIMATE = {"smooth over sharp edges": (0.05, _BELOW), "custom normals": (0.05, _BELOW)}


def _curve(stage, material):
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
    for colour in (BLUE, (0.1, 0.6, 0.1, 1)):
        made.data.materials.append(stage.material(DIFFUSE, Color=colour))
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


GEOMETRY = {
    "mesh": lambda stage, material: cube(stage, material),
    "curve": _curve,
    "text": _text,
    "metaball": _metaball,
    "NURBS surface": _nurbs,
    "geometry nodes instances": _instances_on_points,
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
}


def _hair_particles(stage):
    emitter = ball(stage, tan(stage), 0.7)
    emitter.modifiers.new("hair", "PARTICLE_SYSTEM")
    settings = emitter.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", 400, 0.3
    settings.root_radius, settings.tip_radius, settings.radius_scale = 1.0, 0.4, 0.03
    floor(stage)
    studio(stage)


def _hair_curves(stage):
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
    data.materials.append(tan(stage))
    stage.link(bpy.data.objects.new("curves", data))
    floor(stage)
    studio(stage)


# -- materials

# Principled inputs that are varied one at a time: the other inputs, and the values.
_TINT = (0.9, 0.4, 0.2, 1)
_METAL = dict(Metallic=1.0, Roughness=0.4)
_DARK = dict(Base_Color=(0.05, 0.05, 0.05, 1), Roughness=0.3)
PRINCIPLED_INPUTS = (
    ("Metallic", {}, (0.0, 0.5, 1.0)),
    ("Roughness", {}, (0.0, 0.1, 0.3, 1.0)),
    ("Roughness", dict(Metallic=1.0), (0.0, 0.1, 0.3, 1.0)),
    ("IOR", dict(Roughness=0.3), (1.1, 1.8, 2.5)),
    ("Specular IOR Level", dict(Roughness=0.3), (0.0, 0.25, 1.0)),
    ("Specular Tint", dict(_DARK, IOR=2.0), (_TINT,)),
    ("Specular Tint", _METAL, (_TINT,)),
    ("Diffuse Roughness", {}, (0.5, 1.0)),
    ("Coat Weight", {}, (0.5, 1.0)),
    ("Coat Weight", _METAL, (1.0,)),
    ("Coat Roughness", dict(Coat_Weight=1.0), (0.0, 0.3)),
    ("Coat IOR", dict(Coat_Weight=1.0), (2.0,)),
    ("Coat Tint", dict(Coat_Weight=1.0), (_TINT,)),
    ("Sheen Weight", {}, (0.5, 1.0)),
    ("Sheen Roughness", dict(Sheen_Weight=1.0), (0.2, 0.9)),
    ("Sheen Tint", dict(Sheen_Weight=1.0), (_TINT,)),
    ("Emission Strength", dict(Emission_Color=_TINT), (0.5,)),
)
# The same before a glowing backdrop.
PRINCIPLED_CLEAR = (
    ("Alpha", {}, (0.3, 0.7)),
    ("Transmission Weight", dict(Roughness=0.0), (0.5, 1.0)),
    ("Transmission Weight", dict(Roughness=0.3), (0.5, 1.0)),
    ("Transmission roughness", dict(Transmission_Weight=1.0), (0.1, 0.6)),
    ("Transmission IOR", dict(Transmission_Weight=1.0, Roughness=0.0), (1.1, 2.0)),
)
_SUBSURFACE = ("Principled Subsurface Weight", "no model of light inside a surface")
_AXIS = ("Anisotropy about an axis", "")
_WIDE = "Cycles sends light where no facet can refract it, at this roughness"
_FILM = ("Principled Thin Film Thickness", "no model of interference")
PRINCIPLED_APPROXIMATE = (
    ("Anisotropic", _METAL, (0.4, 0.9), BOUND, _AXIS),
    ("Anisotropic Rotation", dict(_METAL, Anisotropic=0.8), (0.25,), BOUND, _AXIS),
    ("Subsurface Weight", dict(Subsurface_Scale=0.1), (0.5, 1.0), 0.15, _SUBSURFACE),
    ("Subsurface Scale", dict(Subsurface_Weight=1.0), (0.02, 0.5), 0.15, _SUBSURFACE),
    ("Thin Film Thickness", dict(Roughness=0.2), (300.0, 600.0), 0.1, _FILM),
    ("Thin Film Thickness", _METAL, (300.0,), 0.5, _FILM),
)


def materials():
    for name, common, values in PRINCIPLED_INPUTS:
        for value in values:
            yield _principled(name, common, value, _before_nothing)
    for name, common, values in PRINCIPLED_CLEAR:
        for value in values:
            yield _principled(name, common, value, backdrop)
    for name, common, values, bound, (note, reason) in PRINCIPLED_APPROXIMATE:
        for value in values:
            yield _principled(name, common, value, _before_nothing, bound, reason, frozenset({note}))
    rough = dict(Transmission_Weight=1.0)
    yield _principled("Transmission roughness", rough, 1.0, backdrop, 0.1, _WIDE)
    for name, (kind, values) in SHADERS.items():
        clear = kind.endswith(("Glass", "Refraction"))

        def build(stage, kind=kind, values=values, clear=clear):
            ball(stage, stage.material(kind, **values))
            studio(stage)
            if clear:
                backdrop(stage)

        bound, reason, notes = SHADERS_APPROXIMATE.get(name, (BOUND, "", frozenset()))
        depth = 8 if clear else 6
        yield Feature(name, "materials", build, BALL, bound, reason, notes, depth=depth)
    for name, make in PANES.items():

        def pane(stage, make=make):
            stage.plane(1.6, make(stage), "pane", (0, 0, 0.5))
            backdrop(stage)
            studio(stage)

        yield Feature(name, "materials", pane, MIDDLE, depth=8)
    for name, make in NODES.items():

        def nodes(stage, make=make):
            ball(stage, make(stage))
            studio(stage)

        yield Feature(name, "materials", nodes)
    yield Feature("Translucent BSDF", "materials", _translucent, MIDDLE)
    yield Feature("Principled under an area lamp", "materials", _principled_under_lamp)


def _before_nothing(stage):
    """No backdrop."""


def _principled(name, common, value, behind, bound=BOUND, reason="", notes=frozenset()):
    socket = {"Transmission roughness": "Roughness", "Transmission IOR": "IOR"}.get(name, name)
    values = {"Base_Color": TAN, "Roughness": 0.5, **common, socket.replace(" ", "_"): value}

    def build(stage):
        ball(stage, stage.material(PRINCIPLED, **values))
        studio(stage)
        behind(stage)

    shown = "tinted" if isinstance(value, tuple) else f"{value:g}"
    besides = {k: v for k, v in common.items() if not isinstance(v, tuple)}
    besides = "".join(f", {k.replace('_', ' ').lower()} {v:g}" for k, v in besides.items())
    label = f"Principled {name} {shown}{besides}"
    return Feature(
        label, "materials", build, BALL, bound, reason, notes, depth=6 if behind is _before_nothing else 8
    )


_GLOSSY = "ShaderNodeBsdfAnisotropic"
_GLASS = "ShaderNodeBsdfGlass"
_REFRACTION = "ShaderNodeBsdfRefraction"
SHADERS = {
    "Diffuse BSDF": (DIFFUSE, dict(Color=TAN)),
    "Diffuse BSDF roughness 0.5": (DIFFUSE, dict(Color=TAN, Roughness=0.5)),
    "Diffuse BSDF roughness 1": (DIFFUSE, dict(Color=TAN, Roughness=1.0)),
    "Glossy BSDF roughness 0": (_GLOSSY, dict(Color=TAN, Roughness=0.0)),
    "Glossy BSDF roughness 0.1": (_GLOSSY, dict(Color=TAN, Roughness=0.1)),
    "Glossy BSDF roughness 0.4": (_GLOSSY, dict(Color=TAN, Roughness=0.4)),
    "Glossy BSDF roughness 1": (_GLOSSY, dict(Color=TAN, Roughness=1.0)),
    "Glossy BSDF anisotropy 0.7": (_GLOSSY, dict(Color=TAN, Roughness=0.4, Anisotropy=0.7)),
    "Glass BSDF roughness 0": (_GLASS, dict(Color=WHITE, Roughness=0.0)),
    "Glass BSDF roughness 0.3": (_GLASS, dict(Color=WHITE, Roughness=0.3)),
    "Glass BSDF roughness 1": (_GLASS, dict(Color=WHITE, Roughness=1.0)),
    "Glass BSDF IOR 1.2, tinted": (_GLASS, dict(Color=TAN, Roughness=0.0, IOR=1.2)),
    "Refraction BSDF roughness 0": (_REFRACTION, dict(Color=WHITE, Roughness=0.0, IOR=1.4)),
    "Refraction BSDF roughness 0.3": (_REFRACTION, dict(Color=WHITE, Roughness=0.3, IOR=1.4)),
    "Emission": (EMISSION, dict(Color=TAN, Strength=2.0)),
}


SHADERS_APPROXIMATE = {
    "Glass BSDF roughness 1": (0.1, _WIDE, frozenset()),
    "Glossy BSDF anisotropy 0.7": (BOUND, "", frozenset({_AXIS[0]})),
}


def _mixed_with_transparent(stage):
    material = tan(stage)
    stage.mix(material, TRANSPARENT, 0.4)
    return material


PANES = {
    "Transparent BSDF": lambda stage: stage.material(TRANSPARENT, Color=(1, 1, 1, 1)),
    "Transparent BSDF grey": lambda stage: stage.material(TRANSPARENT, Color=(0.5, 0.5, 0.5, 1)),
    "Transparent BSDF tinted": lambda stage: stage.material(TRANSPARENT, Color=(0.9, 0.4, 0.2, 1)),
    "Mix with Transparent": _mixed_with_transparent,
    "single sheet of Glass": lambda stage: stage.material(_GLASS, Color=WHITE, Roughness=0.0),
    "single sheet of Principled, transmission 1": lambda stage: stage.material(
        PRINCIPLED, Base_Color=WHITE, Roughness=0.2, Transmission_Weight=1.0
    ),
}


def _mix(stage):
    material = tan(stage)
    _, gloss = stage.mix(material, _GLOSSY, 0.3)
    gloss.inputs["Roughness"].default_value = 0.3
    return material


def _by_angle(kind, output, **values):
    """Gloss over a matt surface by a Fresnel or Layer Weight node."""

    def make(stage):
        material = tan(stage)
        tree = material.node_tree
        mix, gloss = stage.mix(material, _GLOSSY)
        gloss.inputs["Roughness"].default_value = 0.2
        tree.links.new(node(tree, kind, **values).outputs[output], mix.inputs[0])
        return material

    return make


def _nested_mix(stage):
    material = _mix(stage)
    _, glow = stage.mix(material, EMISSION, 0.25)
    glow.inputs["Color"].default_value = BLUE
    return material


def _add(stage, kind, **values):
    material = tan(stage)
    tree = material.node_tree
    add = tree.nodes.new("ShaderNodeAddShader")
    tree.links.new(shader_of(tree).outputs[0], add.inputs[0])
    tree.links.new(node(tree, kind, **values).outputs[0], add.inputs[1])
    surface(stage, tree, add.outputs[0])
    return material


def _group(stage):
    """A Diffuse BSDF inside a group inside a group, its colour from outside."""
    inner = _group_of(lambda tree: node(tree, "BsdfDiffuse"))

    def nested(tree):
        made = tree.nodes.new("ShaderNodeGroup")
        made.node_tree = inner
        return made

    material = stage.material()
    group = node(material.node_tree, "Group", node_tree=_group_of(nested))
    group.inputs[0].default_value = TAN
    surface(stage, material.node_tree, group.outputs[0])
    return material


def _group_of(make):
    tree: Any = bpy.data.node_groups.new("group", "ShaderNodeTree")
    tree.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
    tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    entry, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    made = make(tree)
    tree.links.new(entry.outputs[0], made.inputs[0])
    tree.links.new(made.outputs[0], end.inputs[0])
    return tree


def _reroute(stage):
    """A shader by way of a reroute and of a muted Mix."""
    material = tan(stage)
    tree = material.node_tree
    mix, _ = stage.mix(material, EMISSION, 0.5)
    mix.mute = True
    reroute = tree.nodes.new("NodeReroute")
    tree.links.new(mix.outputs[0], reroute.inputs[0])
    surface(stage, tree, reroute.outputs[0])
    return material


NODES = {
    "Mix Shader": _mix,
    "Mix Shader, nested": _nested_mix,
    "Mix Shader by Fresnel": _by_angle("Fresnel", "Fac", IOR=1.6),
    "Mix Shader by Layer Weight, Fresnel": _by_angle("LayerWeight", "Fresnel", Blend=0.4),
    "Mix Shader by Layer Weight, Facing": _by_angle("LayerWeight", "Facing", Blend=0.3),
    "Mix Shader by Layer Weight, Facing 0.8": _by_angle("LayerWeight", "Facing", Blend=0.8),
    "Add Shader with Emission": lambda stage: _add(stage, "Emission", Color=BLUE, Strength=0.3),
    "Add Shader of two surfaces": lambda stage: _add(
        stage, "BsdfAnisotropic", Color=(0.3, 0.3, 0.3, 1), Roughness=0.3
    ),
    "node group": _group,
    "reroute and muted node": _reroute,
}


def _translucent(stage):
    """A sheet between the panel in front and another behind it."""
    tilted(stage, stage.material("ShaderNodeBsdfTranslucent", Color=TAN))
    behind = stage.plane(1.6, stage.material(EMISSION, "behind", Strength=6.0), "behind", (-2, 0, -2.5))
    behind.rotation_euler = (0, 0.7, 0)
    studio(stage)


def _principled_under_lamp(stage):
    ball(stage, stage.material(PRINCIPLED, Base_Color=TAN, Roughness=0.4))
    stage.lamp("AREA", 100, (1.5, 1, 3), (-0.3, 0.45, 0), size=1.0)
    stage.world((1, 1, 1), 0.1)


# -- textures


def tiles(stage, space="Linear Rec.709", float_buffer=True, count=4, size=64):
    """An image of coloured tiles, none of them black."""
    colours = 0.15 + 0.8 * np.random.default_rng(1).random((count, count, 3))
    pixels = np.kron(colours, np.ones((size // count, size // count, 1)))
    return stage.image(pixels, "tiles", float_buffer, space)


def picture(stage, tree, vector=None, **settings):
    """An Image Texture of `tiles`."""
    made = node(tree, "TexImage", **{"image": tiles(stage), **settings})
    if vector is not None:
        tree.links.new(vector, made.inputs["Vector"])
    return made


def textures():
    for name, source in PICTURES.items():

        def build(stage, source=source):
            tilted(stage, painted(stage, source))
            studio(stage)

        yield Feature(name, "textures", build, MIDDLE)
    for name, make in MAPPED.items():

        def mapped(stage, make=make):
            make(stage)
            studio(stage)

        yield Feature(name, "textures", mapped, MIDDLE)
    for (name, kind), space in itertools.product(PROCEDURAL.items(), ("Generated", "Object", "UV")):

        def procedural(stage, kind=kind, space=space):
            def source(stage, tree):
                return kind(tree, node(tree, "TexCoord").outputs[space])

            shape = {"Generated": ball, "Object": cube, "UV": tilted}[space]
            shape(stage, painted(stage, source))
            studio(stage)

        yield Feature(f"{name}, {space}", "textures", procedural, MIDDLE)
    missing = frozenset({"Image file"})
    yield Feature("missing image", "textures", _missing_image, MIDDLE, notes=missing)


def _with_alpha(stage):
    """Tiles of several opacities."""
    image = tiles(stage, "sRGB", False)
    pixels = np.empty(64 * 64 * 4, np.float32)
    image.pixels.foreach_get(pixels)
    alpha = np.kron(np.random.default_rng(2).random((4, 4)), np.ones((16, 16)))
    pixels.reshape(64, 64, 4)[..., 3] = 0.2 + 0.8 * alpha
    image.pixels.foreach_set(pixels)
    image.update()
    image.pack()
    return image


def _mapping(stage, tree, kind):
    values = dict(Location=(0.3, -0.2, 0), Rotation=(0, 0, 0.5), Scale=(1.7, 2.3, 1))
    uv = node(tree, "TexCoord").outputs["UV"]
    return node(tree, "Mapping", vector_type=kind, Vector=uv, **values).outputs[0]


def _extension(kind):
    def source(stage, tree):
        return picture(stage, tree, _mapping(stage, tree, "POINT"), extension=kind).outputs[0]

    return source


def _through(make):
    """An image's colour through another node."""
    return lambda stage, tree: make(tree, picture(stage, tree).outputs[0])


def _curves(tree, colour):
    made = node(tree, "RGBCurve", Color=colour)
    made.mapping.curves[3].points[0].location = (0, 0.2)
    made.mapping.curves[0].points.new(0.5, 0.8)
    made.mapping.curves[2].points.new(0.5, 0.3)
    made.mapping.update()
    return made.outputs[0]


def _mix_colour(tree, colour, blend):
    made = node(tree, "Mix", data_type="RGBA", blend_type=blend, Factor_Float=0.6, A_Color=colour)
    made.inputs[7].default_value = BLUE
    return made.outputs[2]


def _math(tree, colour):
    red = node(tree, "SeparateColor", Color=colour).outputs["Red"]
    squared = node(tree, "Math", operation="MULTIPLY")
    tree.links.new(red, squared.inputs[0])
    tree.links.new(red, squared.inputs[1])
    return squared.outputs[0]


def _ramp(tree, factor, middle=(0.9, 0.5, 0.1, 1)):
    made = node(tree, "ValToRGB", Factor=factor)
    made.color_ramp.elements[0].color, made.color_ramp.elements[1].color = BLUE, WHITE
    made.color_ramp.elements.new(0.45).color = middle
    return made.outputs[0]


PICTURES = {
    "image, linear": lambda stage, tree: picture(stage, tree).outputs[0],
    "image, sRGB": lambda stage, tree: picture(stage, tree, image=tiles(stage, "sRGB", False)).outputs[0],
    "image, Non-Color": lambda stage, tree: picture(
        stage, tree, image=tiles(stage, "Non-Color", False)
    ).outputs[0],
    "image, Linear Rec.2020": lambda stage, tree: picture(
        stage, tree, image=tiles(stage, "Linear Rec.2020")
    ).outputs[0],
    "image, few pixels, linear interpolation": lambda stage, tree: picture(
        stage, tree, image=tiles(stage, size=4)
    ).outputs[0],
    "image, few pixels, closest": lambda stage, tree: picture(
        stage, tree, image=tiles(stage, size=4), interpolation="Closest"
    ).outputs[0],
    "image with alpha, colour": lambda stage, tree: picture(stage, tree, image=_with_alpha(stage)).outputs[0],
    "image with alpha, alpha": lambda stage, tree: picture(stage, tree, image=_with_alpha(stage)).outputs[1],
    "extension repeat": _extension("REPEAT"),
    "extension extend": _extension("EXTEND"),
    "extension clip": _extension("CLIP"),
    "extension mirror": _extension("MIRROR"),
    "Mapping, texture": lambda stage, tree: picture(stage, tree, _mapping(stage, tree, "TEXTURE")).outputs[0],
    "RGB Curves": _through(_curves),
    "Mix Color, mix": _through(lambda tree, colour: _mix_colour(tree, colour, "MIX")),
    "Mix Color, multiply": _through(lambda tree, colour: _mix_colour(tree, colour, "MULTIPLY")),
    "Mix Color, screen": _through(lambda tree, colour: _mix_colour(tree, colour, "SCREEN")),
    "Math": _through(_math),
    "ColorRamp": _through(_ramp),
    "Invert Color": _through(lambda tree, colour: node(tree, "Invert", Color=colour).outputs[0]),
    "Gamma": _through(lambda tree, colour: node(tree, "Gamma", Color=colour, Gamma=2.0).outputs[0]),
    "Hue/Saturation/Value": _through(
        lambda tree, colour: node(tree, "HueSaturation", Color=colour, Hue=0.7, Value=0.8).outputs[0]
    ),
    "RGB node": lambda stage, tree: _math(
        tree, node(tree, "Gamma", Color=(0.9, 0.9, 0.9, 1), Gamma=1.5).outputs[0]
    ),
}


def _uv_map(stage):
    """The second of two UV maps, by name; the first would show one pixel."""

    def source(stage, tree):
        return picture(stage, tree, node(tree, "UVMap", uv_map="second").outputs[0]).outputs[0]

    plane = tilted(stage, painted(stage, source))
    uv = np.array([(0.1, 0), (1.3, 0.2), (1, 1.4), (0, 1)], np.float32)
    plane.data.uv_layers.new(name="second").uv.foreach_set("vector", uv.ravel())
    plane.data.uv_layers["UVMap"].uv.foreach_set("vector", np.full(8, 0.25, np.float32))


def _two_uv_maps(stage):
    """Two images on two UV maps, multiplied."""

    def source(stage, tree):
        first = picture(stage, tree, node(tree, "UVMap", uv_map="UVMap").outputs[0])
        second = picture(stage, tree, node(tree, "UVMap", uv_map="second").outputs[0])
        product = node(tree, "Mix", data_type="RGBA", blend_type="MULTIPLY", Factor_Float=1.0)
        tree.links.new(first.outputs[0], product.inputs[6])
        tree.links.new(second.outputs[0], product.inputs[7])
        return product.outputs[2]

    plane = tilted(stage, painted(stage, source))
    uv = np.array([(0.1, 0), (1.3, 0.2), (1, 1.4), (0, 1)], np.float32)
    plane.data.uv_layers.new(name="second").uv.foreach_set("vector", uv.ravel())


def _vertex_colours(stage, domain, kind, attribute_node):
    def source(stage, tree):
        named = {"layer_name": "paint"} if attribute_node == "VertexColor" else {"attribute_name": "paint"}
        return node(tree, attribute_node, **named).outputs["Color"]

    data = grid(stage, painted(stage, source), 8).data
    layer = data.color_attributes.new("paint", kind, domain)
    colours = np.ones((len(layer.data), 4), np.float32)
    colours[:, :3] = 0.1 + 0.8 * np.random.default_rng(6).random((len(layer.data), 3))
    layer.data.foreach_set("color", colours.ravel())


def _alpha_cut(stage, colour=False):
    def source(stage, tree):
        return node(tree, "TexImage", image=_with_alpha(stage)).outputs["Alpha"]

    material = painted(stage, source, "Alpha", PRINCIPLED, Base_Color=TAN, Roughness=1.0)
    if colour:
        inputs = shader_of(material.node_tree).inputs
        texture = inputs["Alpha"].links[0].from_node
        material.node_tree.links.new(texture.outputs["Color"], inputs["Base Color"])
    tilted(stage, material)
    backdrop(stage)


def _file_image(stage):
    """An image from a file, packed."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "tiles.png")
        image = tiles(stage, "sRGB", False)
        image.filepath_raw, image.file_format = path, "PNG"
        image.save()
        loaded = bpy.data.images.load(path)
        loaded.pack()
    return loaded


def _packed_image(stage):
    tilted(stage, painted(stage, lambda s, tree: node(tree, "TexImage", image=_file_image(s)).outputs[0]))


def _missing_image(stage):
    lost = bpy.data.images.new("lost", 4, 4)
    lost.source, lost.filepath = "FILE", os.path.join(tempfile.gettempdir(), "nowhere", "lost.png")
    lost.reload()
    tilted(stage, painted(stage, lambda s, tree: node(tree, "TexImage", image=lost).outputs[0]))
    studio(stage)


def _grey_tiles(stage, tree):
    """Numbers from 0.15 to 0.95."""
    return node(tree, "TexImage", image=tiles(stage, "Non-Color")).outputs[0]


def _textured(socket, shape=tilted, **values):
    def make(stage):
        values_here = {"Base_Color": TAN, "Roughness": 0.5, **values}
        shape(stage, painted(stage, _grey_tiles, socket, PRINCIPLED, **values_here))

    return make


def _height(stage, tree):
    y, x = np.mgrid[:64, :64] / 64
    waves = 0.5 + 0.5 * np.sin(2 * np.pi * 3 * x) * np.sin(2 * np.pi * 3 * y)
    return node(tree, "TexImage", image=stage.float_image(waves)).outputs[0]


def _bump(height, **values):
    def source(stage, tree):
        return node(tree, "Bump", Height=height(stage, tree), **values).outputs[0]

    return source


def _noise_height(stage, tree):
    return node(tree, "TexNoise", Scale=3.0, Detail=1.0).outputs[0]


def _normal_map(space, strength=1.0):
    def source(stage, tree):
        y, x = np.mgrid[:64, :64] / 64 * 2 * np.pi * 3
        normal = np.stack([0.4 * np.sin(x), 0.4 * np.cos(y), np.ones_like(x)], axis=2)
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        image = stage.image(0.5 + 0.5 * normal, "normals", True, "Non-Color")
        colour = node(tree, "TexImage", image=image).outputs[0]
        return node(tree, "NormalMap", space=space, Color=colour, Strength=strength).outputs[0]

    return source


def _normal_on(source, shape, shader=DIFFUSE, **values):
    return lambda stage: shape(stage, painted(stage, source, "Normal", shader, Color=TAN, **values))


MAPPED = {
    "UV map by name": _uv_map,
    "two UV maps in one material": _two_uv_maps,
    "vertex colours, Color Attribute": lambda s: _vertex_colours(s, "POINT", "FLOAT_COLOR", "VertexColor"),
    "vertex colours, Attribute, corners": lambda s: _vertex_colours(s, "CORNER", "BYTE_COLOR", "Attribute"),
    "image alpha on Principled Alpha": _alpha_cut,
    "image colour and alpha on Principled": lambda stage: _alpha_cut(stage, colour=True),
    "packed image": _packed_image,
    "textured Roughness": _textured("Roughness"),
    "textured Roughness, metal": _textured("Roughness", Metallic=1.0),
    "textured Metallic": _textured("Metallic", Roughness=0.4),
    "textured Emission Strength": _textured("Emission Strength", Emission_Color=(0.9, 0.4, 0.2, 1)),
    "textured Coat Weight": _textured("Coat Weight"),
    "textured Transmission Weight": lambda stage: (
        _textured("Transmission Weight", ball, Roughness=0.3)(stage),
        backdrop(stage),
    ),
    "Bump from an image": _normal_on(_bump(_height, Strength=0.7, Distance=0.15), tilted),
    "Bump from noise": _normal_on(_bump(_noise_height, Strength=0.6, Distance=0.2), ball),
    "Bump from an image, glossy": _normal_on(
        _bump(_height, Strength=0.7, Distance=0.1), tilted, _GLOSSY, Roughness=0.4
    ),
    "Normal Map, tangent space": _normal_on(_normal_map("TANGENT"), tilted),
    "Normal Map, tangent space, strength 0.5": _normal_on(_normal_map("TANGENT", 0.5), ball),
    "Normal Map, object space": _normal_on(_normal_map("OBJECT"), tilted),
}

PROCEDURAL = {
    "Noise Texture": lambda tree, at: _ramp(tree, node(tree, "TexNoise", Vector=at, Scale=4.0).outputs[0]),
    "Voronoi Texture": lambda tree, at: node(tree, "TexVoronoi", Vector=at, Scale=5.0).outputs["Color"],
    "Checker Texture": lambda tree, at: node(
        tree, "TexChecker", Vector=at, Scale=5.0, Color1=BLUE, Color2=WHITE
    ).outputs[0],
    "Brick Texture": lambda tree, at: node(
        tree, "TexBrick", Vector=at, Scale=3.0, Color1=TAN, Color2=BLUE, Mortar=WHITE
    ).outputs[0],
    "Wave Texture": lambda tree, at: _ramp(
        tree, node(tree, "TexWave", Vector=at, Scale=2.0, Distortion=3.0).outputs["Factor"]
    ),
}


# -- lamps


def lights():
    for name, (kind, values) in LAMPS.items():

        def build(stage, kind=kind, values=values):
            stage.lamp(kind, **{"energy": 3.0 if kind == "SUN" else 60.0, **_AIMED, **values})
            _set(stage)

        yield Feature(name, "lights", build, EVERYWHERE)
    for name, wire in LAMP_NODES.items():

        def wired(stage, wire=wire):
            lamp = stage.lamp("POINT", 60.0, shadow_soft_size=0.2, **_AIMED)
            lamp.data.use_nodes = True
            wire(stage, lamp.data.node_tree, shader_of(lamp.data.node_tree))
            _set(stage)

        yield Feature(name, "lights", wired, EVERYWHERE)
    for kind in ("POINT", "AREA", "SUN"):

        def gloss(stage, kind=kind):
            sizes = {"POINT": dict(shadow_soft_size=0.3), "AREA": dict(size=1.0), "SUN": dict(angle=0.3)}
            stage.lamp(kind, 3.0 if kind == "SUN" else 60.0, **_AIMED, **sizes[kind])
            _set(stage, stage.material(PRINCIPLED, Base_Color=TAN, Metallic=1.0, Roughness=0.35))

        yield Feature(f"{kind.lower()} lamp on a rough metal", "lights", gloss, EVERYWHERE)
    yield Feature(
        "area lamp on a polished ball",
        "lights",
        _lamp_mirrored,
        bound=0.1,
        reason="lamps do not show in mirrors",
        notes=frozenset({"Lamps mirrored in or shining through a smooth or transparent surface"}),
    )
    yield Feature("emitting mesh, strength 20", "lights", _emitting_mesh, EVERYWHERE)
    yield Feature("emitting mesh, textured", "lights", _emitting_texture, EVERYWHERE)


_AIMED = dict(location=(1.2, 0.8, 2.2), rotation=(-0.3, 0.5, 0))


def _set(stage, material=None):
    """A floor with a ball on it."""
    ball(stage, material or tan(stage), 0.6, (-0.2, -0.1, -0.3))
    floor(stage)
    stage.world((1, 1, 1), 0.05)


LAMPS = {
    "point, radius 0": ("POINT", dict(shadow_soft_size=0.0)),
    "point, radius 0.3": ("POINT", dict(shadow_soft_size=0.3)),
    "point, coloured": ("POINT", dict(shadow_soft_size=0.1, color=(1, 0.5, 0.1))),
    "point, temperature 3000 K": (
        "POINT",
        dict(shadow_soft_size=0.1, use_temperature=True, temperature=3000),
    ),
    "point, exposure 1": ("POINT", dict(shadow_soft_size=0.1, exposure=1.0)),
    "point, not normalised": ("POINT", dict(shadow_soft_size=0.3, normalize=False)),
    "spot, sharp": ("SPOT", dict(shadow_soft_size=0.0, spot_size=0.8, spot_blend=0.0)),
    "spot, blended": ("SPOT", dict(shadow_soft_size=0.1, spot_size=1.2, spot_blend=0.6)),
    "spot, large": ("SPOT", dict(shadow_soft_size=0.4, spot_size=1.0, spot_blend=0.2)),
    "area, square": ("AREA", dict(size=1.0)),
    "area, rectangle": ("AREA", dict(shape="RECTANGLE", size=1.6, size_y=0.4)),
    "area, disk": ("AREA", dict(shape="DISK", size=1.0)),
    "area, ellipse": ("AREA", dict(shape="ELLIPSE", size=1.6, size_y=0.5)),
    "area, spread 60 degrees": ("AREA", dict(size=0.6, spread=math.radians(60))),
    "area, not normalised": ("AREA", dict(size=1.0, normalize=False, energy=20.0)),
    "sun, angle 0": ("SUN", dict(angle=0.0)),
    "sun, angle 20 degrees": ("SUN", dict(angle=math.radians(20))),
    "sun, not normalised": ("SUN", dict(angle=math.radians(20), normalize=False)),
}


def _blackbody(stage, tree, emission):
    tree.links.new(node(tree, "Blackbody", Temperature=2800.0).outputs[0], emission.inputs["Color"])


def _emission_values(stage, tree, emission):
    emission.inputs["Color"].default_value = TAN
    emission.inputs["Strength"].default_value = 2.5


def _strength_math(stage, tree, emission):
    half = node(tree, "Math", operation="POWER")
    half.inputs[0].default_value, half.inputs[1].default_value = 1.5, 2.0
    tree.links.new(half.outputs[0], emission.inputs["Strength"])


def _falloff(kind):
    def wire(stage, tree, emission):
        falloff = node(tree, "LightFalloff", Strength=0.4)
        tree.links.new(falloff.outputs[kind], emission.inputs["Strength"])

    return wire


def _ies(stage, tree, emission):
    """A lamp that shines sideways most; LM-63, one plane, cylinder of revolution."""
    angles = np.arange(0, 181, 5)
    candela = 200 + 800 * np.sin(np.radians(angles)) ** 2
    lines = ["IESNA:LM-63-1995", "TILT=NONE", f"1 1000 1 {len(angles)} 1 1 2 0 0 0", "1 1 50"]
    lines += [" ".join(f"{v:.1f}" for v in angles), "0", " ".join(f"{v:.1f}" for v in candela)]
    document = bpy.data.texts.new("lamp.ies")
    document.write("\n".join(lines) + "\n")
    profile = node(tree, "TexIES", ies=document, Strength=1.0)
    tree.links.new(profile.outputs[0], emission.inputs["Strength"])


LAMP_NODES = {
    "light nodes, Emission values": _emission_values,
    "light nodes, Blackbody": _blackbody,
    "light nodes, Math": _strength_math,
    "light nodes, Light Falloff linear": _falloff("Linear"),
    "light nodes, Light Falloff constant": _falloff("Constant"),
    "light nodes, IES": _ies,
}


def _lamp_mirrored(stage):
    ball(stage, stage.material(PRINCIPLED, Base_Color=TAN, Roughness=0.0))
    stage.lamp("AREA", 60, size=1.0, **_AIMED)
    stage.world((1, 1, 1), 0.1)


def _emitting_mesh(stage):
    glow = stage.material(EMISSION, Color=(1, 0.7, 0.4, 1), Strength=20.0)
    ball(stage, glow, 0.25, (0.8, 0.6, 0.6), "bulb")
    _set(stage)


def _emitting_texture(stage):
    glow = stage.material(EMISSION, Strength=4.0)
    stage.texture(glow, tiles(stage), "Color")
    stage.plane(1.2, glow, "screen", (0.7, 0.6, 0.6)).rotation_euler = (-0.9, 0.7, 0)
    _set(stage)


# -- world


def world():
    for name, wire in WORLDS.items():

        def build(stage, wire=wire):
            made = stage.world((1, 1, 1), 1.0)
            wire(stage, made.node_tree, shader_of(made.node_tree))
            _outdoors(stage)

        yield Feature(name, "world", build, EVERYWHERE)

    def clear(stage):
        _outdoors(stage)
        stage.world((0.5, 0.6, 0.8), 1.0)
        stage.scene.render.film_transparent = True

    def exposed(stage):
        _outdoors(stage)
        stage.world((0.5, 0.6, 0.8), 1.0)
        stage.scene.view_settings.exposure, stage.scene.cycles.film_exposure = 2.0, 3.0

    def unexposed(stage):
        stage.scene.cycles.film_exposure = 1.0

    yield Feature("film transparent", "world", clear, EVERYWHERE)
    yield Feature("exposure is not baked in", "world", exposed, EVERYWHERE, reference=unexposed)


def _outdoors(stage):
    """A rough and a shiny ball, seen from the side with the horizon behind them."""
    ball(stage, tan(stage), 0.7, (-0.7, 0, 0), "rough")
    ball(stage, stage.material(PRINCIPLED, Metallic=1.0, Roughness=0.3), 0.7, (0.7, 0, 0), "shiny")
    stage.camera.location, stage.camera.rotation_euler = (0.5, -4.2, 0.8), (1.38, 0, 0.12)
    stage.camera.data.lens = 40


def _colour(stage, tree, background):
    background.inputs["Color"].default_value = (0.2, 0.4, 0.6, 1)
    background.inputs["Strength"].default_value = 1.5


def _hdri(rotation=None, kind="POINT"):
    def wire(stage, tree, background):
        pixels = 0.1 + np.random.default_rng(5).random((8, 16, 3)) ** 2
        image = stage.image(np.kron(pixels, np.ones((8, 8, 1))), "sky", True, "Linear Rec.709")
        texture = node(tree, "TexEnvironment", image=image)
        background.inputs["Strength"].default_value = 1.5
        tree.links.new(texture.outputs[0], background.inputs["Color"])
        if rotation:
            at = node(tree, "TexCoord").outputs["Generated"]
            mapping = node(tree, "Mapping", vector_type=kind, Vector=at, Rotation=rotation)
            tree.links.new(mapping.outputs[0], texture.inputs["Vector"])

    return wire


def _hdri_through_nodes(stage, tree, background):
    _hdri((0, 0, 0.7))(stage, tree, background)
    colour = background.inputs["Color"].links[0].from_socket
    tinted = node(tree, "Mix", data_type="RGBA", blend_type="MULTIPLY", Factor_Float=1.0)
    tree.links.new(colour, tinted.inputs[6])
    tinted.inputs[7].default_value = (1, 0.7, 0.4, 1)
    tree.links.new(tinted.outputs[2], background.inputs["Color"])


def _sky(kind, disc=False, **values):
    def wire(stage, tree, background):
        strength = 0.5 if kind in ("PREETHAM", "HOSEK_WILKIE") else 0.05
        background.inputs["Strength"].default_value = strength
        sky = node(tree, "TexSky", sky_type=kind, **values)
        if kind in ("PREETHAM", "HOSEK_WILKIE"):
            sky.sun_direction = (0.5, -0.5, 0.7)
        else:
            sky.sun_disc, sky.sun_elevation, sky.sun_rotation = disc, 0.7, 2.5
        tree.links.new(sky.outputs[0], background.inputs["Color"])

    return wire


def _mixed_worlds(stage, tree, background):
    """Two Backgrounds, mixed by height."""
    background.inputs["Color"].default_value = (0.5, 0.3, 0.1, 1)
    other = node(tree, "Background", Color=(0.2, 0.4, 0.9, 1))
    height = node(tree, "SeparateXYZ", Vector=node(tree, "TexCoord").outputs["Generated"]).outputs["Z"]
    factor = node(tree, "MapRange", Value=height, From_Min=-1.0).outputs[0]
    mix = node(tree, "MixShader")
    for socket, source in zip(mix.inputs, (factor, background.outputs[0], other.outputs[0]), strict=True):
        tree.links.new(source, socket)
    surface(stage, tree, mix.outputs[0])


def _gradient(stage, tree, background):
    at = node(tree, "TexCoord").outputs["Generated"]
    height = node(tree, "SeparateXYZ", Vector=at).outputs["Z"]
    tree.links.new(_ramp(tree, height), background.inputs["Color"])


def _blackbody_world(stage, tree, background):
    tree.links.new(node(tree, "Blackbody", Temperature=4000.0).outputs[0], background.inputs["Color"])


WORLDS = {
    "world colour": _colour,
    "HDRI": _hdri(),
    "HDRI, turned": _hdri((0.4, -0.3, 1.1)),
    "HDRI, turned, texture mapping": _hdri((0.4, -0.3, 1.1), "TEXTURE"),
    "HDRI, tinted": _hdri_through_nodes,
    "sky, single scattering": _sky("SINGLE_SCATTERING"),
    "sky, single scattering, sun disc": _sky("SINGLE_SCATTERING", True),
    "sky, single scattering, large sun disc": _sky("SINGLE_SCATTERING", True, sun_size=0.2),
    "sky, multiple scattering": _sky("MULTIPLE_SCATTERING"),
    "sky, multiple scattering, sun disc": _sky("MULTIPLE_SCATTERING", True),
    "sky, Preetham": _sky("PREETHAM"),
    "sky, Hosek and Wilkie": _sky("HOSEK_WILKIE"),
    "world, ColorRamp of height": _gradient,
    "world, mix of Backgrounds": _mixed_worlds,
    "world, Blackbody": _blackbody_world,
}


# -- camera


def camera():
    for fit, (shape, resolution) in itertools.product(
        ("AUTO", "HORIZONTAL", "VERTICAL"), {"square": SQUARE, "wide": WIDE, "tall": TALL}.items()
    ):

        def build(stage, fit=fit):
            data = stage.camera.data
            data.sensor_fit, data.sensor_width, data.sensor_height, data.lens = fit, 30, 20, 26
            _view(stage)

        yield Feature(
            f"sensor fit {fit.lower()}, {shape}", "camera", build, EVERYWHERE, resolution=resolution
        )
    for name, adjust in CAMERAS.items():

        def adjusted(stage, adjust=adjust):
            adjust(stage, stage.camera.data)
            _view(stage)

        yield Feature(name, "camera", adjusted, EVERYWHERE, resolution=WIDE)

    def focused(stage):
        stage.camera.data.dof.use_dof = True
        stage.camera.data.dof.focus_distance, stage.camera.data.dof.aperture_fstop = 1.0, 0.1
        _view(stage)

    def sharp(stage):
        stage.camera.data.dof.use_dof = False

    ignored = frozenset({"Depth of Field"})
    yield Feature("depth of field ignored", "camera", focused, EVERYWHERE, notes=ignored, reference=sharp)


def _view(stage):
    """Tiles with a ball in front."""
    glow = stage.material(EMISSION, "tiles")
    stage.texture(glow, tiles(stage, count=8), "Color").interpolation = "Closest"
    stage.plane(6, glow, "tiles")
    ball(stage, tan(stage), 0.4, (0.3, -0.2, 1))
    stage.world((1, 1, 1), 0.3)


def _shifted(stage, data):
    data.shift_x, data.shift_y = 0.2, -0.15


def _clipped_near(stage, data):
    data.clip_start = 2.9


def _clipped_far(stage, data):
    data.clip_end = 3.9


def _turned(stage, data):
    stage.camera.rotation_euler = (0.2, -0.15, 0.4)
    stage.camera.scale = (2, 2, 2)


def _by_angle(stage, data):
    data.lens_unit, data.angle = "FOV", math.radians(30)


def _centimetres(stage, data):
    stage.scene.unit_settings.scale_length = 0.01


CAMERAS = {
    "shift": _shifted,
    "clip start through an object": _clipped_near,
    "clip end before an object": _clipped_far,
    "turned and scaled camera": _turned,
    "field of view": _by_angle,
    "unit scale 0.01": _centimetres,
}


# -- scenes at random


def random_scene(stage, seed):
    """Fill a stage with objects, materials, lights, a world and a camera drawn at random.

    Only what is promised to `BOUND` is drawn: mirrors and clear glass not together with lamps, which do
    not show in them.

    Parameters
    ----------
    stage : Stage
    seed : int
        The same seed gives the same scene.
    """
    rng = np.random.default_rng([2026, seed])
    lamps = rng.random() < 0.6
    floor(stage, colour=_random_colour(rng))
    for number in range(rng.integers(3, 6)):
        _random_object(stage, rng, _random_material(stage, rng, sharp=not lamps), number)
    if lamps:
        for _ in range(rng.integers(1, 4)):
            _random_lamp(stage, rng)
    else:
        panel = stage.plane(1.5, stage.material(EMISSION, "panel", Strength=6.0), "panel", (1.5, 1.5, 4))
        panel.rotation_euler = (-0.4, 0.4, 0)
    tree = stage.world(_random_colour(rng)[:3], rng.uniform(0.1, 0.5)).node_tree
    if rng.random() < 0.5:
        background = shader_of(tree)
        _hdri(tuple(rng.uniform(-1, 1, 3)))(stage, tree, background)
        background.inputs["Strength"].default_value = rng.uniform(0.2, 0.8)
    around, height = rng.uniform(0, 2 * math.pi), rng.uniform(2.0, 3.5)
    place = np.array([2.4 * math.cos(around), 2.4 * math.sin(around), height])
    stage.camera.location = place
    stage.camera.rotation_euler = Vector(-place).to_track_quat("-Z", "Y").to_euler()
    data = stage.camera.data
    data.sensor_fit = str(rng.choice(["AUTO", "HORIZONTAL", "VERTICAL"]))
    data.lens, data.shift_x, data.shift_y = rng.uniform(25, 45), *rng.uniform(-0.1, 0.1, 2)


def _random_colour(rng):
    return (*rng.uniform(0.1, 0.9, 3), 1)


def _random_material(stage, rng, sharp):
    kind = rng.choice(["diffuse", "plastic", "metal", "glossy", "mix", "image", "noise", "glow", "glass"])
    rough = rng.uniform(0.3, 0.6)
    colour = _random_colour(rng)
    if kind == "diffuse" or (kind == "glass" and not sharp):
        return stage.material(DIFFUSE, Color=colour, Roughness=rng.choice([0.0, 0.5]))
    if kind == "plastic":
        return stage.material(PRINCIPLED, Base_Color=colour, Roughness=rough, IOR=rng.uniform(1.3, 1.8))
    if kind == "metal":
        return stage.material(PRINCIPLED, Base_Color=colour, Metallic=1.0, Roughness=0.0 if sharp else rough)
    if kind == "glossy":
        return stage.material(_GLOSSY, Color=colour, Roughness=rough)
    if kind == "mix":
        material = stage.material(DIFFUSE, Color=colour)
        _, gloss = stage.mix(material, _GLOSSY, rng.uniform(0.2, 0.8))
        gloss.inputs["Roughness"].default_value = rough
        return material
    if kind == "image":
        return painted(stage, _extension("MIRROR"), "Base Color", PRINCIPLED, Roughness=rough)
    if kind == "noise":
        return painted(stage, lambda s, tree: PROCEDURAL["Noise Texture"](tree, _object_space(tree)))
    if kind == "glow":
        return stage.material(EMISSION, Color=colour, Strength=rng.uniform(0.5, 2))
    return stage.material(_GLASS, Color=colour, Roughness=0.0, IOR=rng.uniform(1.2, 1.6))


def _object_space(tree):
    return node(tree, "TexCoord").outputs["Object"]


def _random_object(stage, rng, material, number):
    kind = rng.choice(["ball", "cube", "cylinder", "monkey", "torus", "curve", "text"])
    if kind == "ball":
        made = ball(stage, material)
    elif kind == "torus":
        bpy.ops.mesh.primitive_torus_add(major_segments=64, minor_segments=24)
        made = added()
        made.data.shade_smooth()
        made.data.materials.append(material)
    elif kind == "curve":
        _curve(stage, material)
        made = added()
    elif kind == "text":
        made = text(stage)
        made.data.materials.append(material)
    else:
        made = {"cube": cube, "cylinder": cylinder, "monkey": monkey}[kind](stage, material)
    made.name = f"{kind} {number}"
    made.location = rng.uniform((-0.9, -0.9, -0.5), (0.9, 0.9, 0.3))
    made.rotation_euler = rng.uniform(-math.pi, math.pi, 3)
    made.scale = rng.uniform(0.3, 0.5, 3) * rng.choice([-1, 1], 3)


def _random_lamp(stage, rng):
    kind = str(rng.choice(["POINT", "SPOT", "AREA", "SUN"]))
    values = {
        "POINT": dict(shadow_soft_size=rng.uniform(0.05, 0.3)),
        "SPOT": dict(spot_size=rng.uniform(0.8, 1.4), spot_blend=rng.uniform(0.1, 0.8)),
        "AREA": dict(size=rng.uniform(0.3, 1.0), shape=str(rng.choice(["SQUARE", "DISK"]))),
        "SUN": dict(angle=rng.uniform(0.0, 0.3)),
    }[kind]
    x, y = rng.uniform(-0.4, 0.4, 2)
    place = (3 * math.sin(y), -3 * math.sin(x), 3)  # the lamp's -z then points at the scene
    energy = rng.uniform(1, 3) if kind == "SUN" else rng.uniform(60, 150)
    stage.lamp(kind, energy, place, (x, y, 0), color=_random_colour(rng)[:3], **values)


def at_random():
    for seed in range(10):

        def build(stage, seed=seed):
            random_scene(stage, seed)

        yield Feature(f"random {seed}", "random", build, EVERYWHERE, depth=8)


FEATURES = tuple(
    itertools.chain(geometry(), materials(), textures(), lights(), world(), camera(), at_random())
)
