"""Scenes of whatever Blender can say: node graphs, flags, images, modifiers and instances at random.

`at_random` draws what the exporter promises to carry. This draws what anyone might do.
"""

import math
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from .staging import ball, cube, floor, grid, monkey

TEXTURES = ("Noise", "Voronoi", "Wave", "Magic", "Gradient", "Checker", "Brick", "Image", "WhiteNoise")
SOURCES = ("TexCoord", "NewGeometry", "ObjectInfo", "Attribute", "UVMap", "VertexColor", "RGB", "Value")
OPERATIONS = (
    *(
        "Mapping",
        "Math",
        "VectorMath",
        "Mix",
        "ValToRGB",
        "HueSaturation",
        "Invert",
        "Gamma",
        "BrightContrast",
    ),
    *("RGBCurve", "SeparateColor", "CombineColor", "MapRange", "Clamp", "RGBToBW", "VectorRotate"),
)
VIEW = ("Fresnel", "LayerWeight", "LightPath", "CameraData", "Bump", "NormalMap", "AmbientOcclusion")
SHADERS = (
    "BsdfPrincipled",
    "BsdfDiffuse",
    "BsdfAnisotropic",
    "Emission",
    "BsdfTransparent",
    "BsdfTranslucent",
)
MODIFIERS = ("ARRAY", "MIRROR", "SUBSURF", "SOLIDIFY", "BEVEL", "SIMPLE_DEFORM", "WIREFRAME", "DISPLACE")
OBJECT_FLAGS = (
    *("visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission", "visible_shadow"),
    *("is_holdout", "is_shadow_catcher", "hide_viewport", "hide_render"),
)
# Without a transparent film, and worlds that cameras do not see: Mitsuba's path tracer, the judge here, hides all that
# shines with them.
SCENE_FLAGS = (
    *("render.use_border", "render.use_simplify", "render.use_motion_blur"),
    *("cycles.caustics_reflective", "cycles.caustics_refractive"),
)
MAX_NODES = 8


def any_scene(stage, seed):
    """Fill a stage with two to five objects, and set some flags of anything.

    Parameters
    ----------
    stage : Stage
    seed : int
        The same seed gives the same scene.
    """
    rng = np.random.default_rng([2027, seed])
    floor(stage)
    for number in range(int(rng.integers(2, 5))):
        _object(stage, rng, number)
    stage.world(tuple(rng.uniform(0.2, 0.8, 3)), rng.uniform(0.2, 0.6))
    if rng.random() < 0.7:
        _lamp(stage, rng)
    around = rng.uniform(0, 2 * math.pi)
    place = np.array([2.4 * math.cos(around), 2.4 * math.sin(around), 3.0])
    stage.camera.location = place
    stage.camera.rotation_euler = Vector(-place).to_track_quat("-Z", "Y").to_euler()
    stage.camera.data.lens = 35
    _flags(stage, rng)
    stage.scene.view_layers[0].update()


def _object(stage, rng, number):
    material = any_material(stage, rng)
    thing = (ball, cube, grid, monkey)[rng.integers(4)](stage, material)
    thing.name = f"thing {number}"
    thing.location = rng.uniform((-0.9, -0.9, -0.5), (0.9, 0.9, 0.3))
    thing.rotation_euler = rng.uniform(-math.pi, math.pi, 3)
    thing.scale = rng.uniform(0.3, 0.5, 3) * rng.choice([-1, 1], 3)
    thing.color, thing.pass_index = (*rng.random(3), 1), int(rng.integers(4))
    thing["tint"] = tuple(rng.random(3))
    if rng.random() < 0.3:
        kind = str(rng.choice(MODIFIERS))
        modifier = thing.modifiers.new(kind, kind)
        modifier.show_viewport, modifier.show_render = bool(rng.random() < 0.9), bool(rng.random() < 0.9)
        if kind == "SUBSURF":
            modifier.levels = modifier.render_levels = 1
    if rng.random() < 0.3:
        for twin in range(int(rng.integers(1, 3))):
            copy = stage.link(bpy.data.objects.new(f"twin {number} {twin}", thing.data))
            copy.location = rng.uniform((-0.9, -0.9, -0.5), (0.9, 0.9, 0.3))
            copy.scale, copy.color = thing.scale, (*rng.random(3), 1)
    elif rng.random() < 0.2:
        collection = bpy.data.collections.new(f"group {number}")
        stage.scene.collection.objects.unlink(thing)
        collection.objects.link(thing)
        empty: Any = stage.link(bpy.data.objects.new(f"instance {number}", None))
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.rotation_euler = rng.uniform(-1, 1, 3)


def _lamp(stage, rng):
    kind = str(rng.choice(["POINT", "SPOT", "AREA", "SUN"]))
    lamp = stage.lamp(kind, 2 if kind == "SUN" else 100, (0.6, -0.8, 3), (0.25, 0.2, 0))
    data = lamp.data
    data.use_shadow = bool(rng.random() < 0.9)
    if kind == "AREA":
        data.size, data.shape = 0.6, str(rng.choice(["SQUARE", "DISK", "RECTANGLE", "ELLIPSE"]))
    elif kind != "SUN":
        data.shadow_soft_size = rng.uniform(0, 0.3)


def _flags(stage, rng):
    """Turn over a few flags of objects, collections, the world and the scene."""
    scene, objects = stage.scene, [thing for thing in stage.scene.objects if thing.type == "MESH"]
    if rng.random() < 0.3:
        thing, name = objects[rng.integers(len(objects))], str(rng.choice(OBJECT_FLAGS))
        setattr(thing, name, not getattr(thing, name))
    if rng.random() < 0.15:
        collection = bpy.data.collections.new("set apart")
        scene.collection.children.link(collection)
        thing = objects[rng.integers(len(objects))]
        for other in thing.users_collection:
            other.objects.unlink(thing)
        collection.objects.link(thing)
        layer = scene.view_layers[0].layer_collection.children["set apart"]
        setattr(layer, str(rng.choice(["indirect_only", "holdout", "exclude"])), True)
    if rng.random() < 0.1:
        setattr(scene.world.cycles_visibility, str(rng.choice(["diffuse", "glossy", "transmission"])), False)
    if rng.random() < 0.2:
        owner, name = str(rng.choice(SCENE_FLAGS)).split(".")
        block = getattr(scene, owner)
        setattr(block, name, not getattr(block, name))


def any_material(stage, rng):
    """A material with a graph of up to `MAX_NODES` nodes besides its shader."""
    material = stage.material("ShaderNode" + str(rng.choice(SHADERS)))
    tree = material.node_tree
    shader = next(n for n in tree.nodes if not n.bl_idname.startswith("ShaderNodeOutput"))
    made = []
    for _ in range(int(rng.integers(0, MAX_NODES + 1))):
        pool = (TEXTURES, SOURCES, OPERATIONS, VIEW)[rng.choice(4, p=(0.3, 0.25, 0.35, 0.1))]
        node = _node(stage, tree, str(rng.choice(pool)), rng)
        for socket in node.inputs:
            if made and socket.enabled and rng.random() < 0.5:
                _link(tree, made, socket, rng)
        made.append(node)
    for socket in shader.inputs:
        usual = socket.name in ("Color", "Base Color", "Strength")
        if made and socket.enabled and socket.type != "SHADER" and rng.random() < (0.8 if usual else 0.1):
            _link(tree, made, socket, rng)
    material.use_transparent_shadow = bool(rng.random() < 0.95)
    return material


def _link(tree, made, socket, rng):
    """Feed a socket by some output of a node that was made before."""
    outputs = [
        s for node in made for s in node.outputs if s.enabled and s.type in ("VALUE", "RGBA", "VECTOR")
    ]
    if outputs:
        source = outputs[rng.integers(len(outputs))]
        if socket.name in ("Color", "Base Color"):  # colors between 0 and 1, as people paint them
            clamp: Any = tree.nodes.new("ShaderNodeMix")
            clamp.data_type, clamp.clamp_result = "RGBA", True
            inputs = {each.identifier: each for each in clamp.inputs}
            inputs["Factor_Float"].default_value = 0.0
            tree.links.new(source, inputs["A_Color"])
            source = next(each for each in clamp.outputs if each.identifier == "Result_Color")
        tree.links.new(source, socket)


def _node(stage, tree, kind, rng):
    """A node with some of its menus and numbers drawn."""
    name = {"Image": "TexImage", "WhiteNoise": "TexWhiteNoise"}.get(kind)
    name = name or (f"Tex{kind}" if kind in TEXTURES else kind)
    node: Any = tree.nodes.new("ShaderNode" + name)
    for menu in ("operation", "vector_type", "blend_type", "wave_type", "gradient_type", "feature"):
        if menu in node.bl_rna.properties and rng.random() < 0.5:
            items = [item.identifier for item in node.bl_rna.properties[menu].enum_items]
            if menu != "operation" or kind == "VectorMath":
                node_value = str(rng.choice(items))
                setattr(node, menu, node_value)
    if kind == "Math":
        node.operation = str(rng.choice(["ADD", "MULTIPLY", "SINE", "FRACT", "GREATER_THAN", "POWER"]))
    elif kind == "Attribute":
        node.attribute_type = str(rng.choice(["GEOMETRY", "OBJECT", "INSTANCER", "VIEW_LAYER"]))
        node.attribute_name = "tint"
    elif kind == "TexCoord":
        node.from_instancer = bool(rng.random() < 0.1)
    elif kind == "Image":
        node.image = _image(stage, rng)
        node.interpolation = str(rng.choice(["Linear", "Closest", "Cubic", "Smart"]))
        node.extension = str(rng.choice(["REPEAT", "EXTEND", "CLIP", "MIRROR"]))
        node.projection = str(rng.choice(["FLAT", "FLAT", "FLAT", "BOX", "SPHERE", "TUBE"]))
        if rng.random() < 0.2:
            node.texture_mapping.scale = tuple(rng.uniform(0.5, 2, 3))
    for socket in node.inputs:
        if socket.type == "VALUE" and socket.name in ("Scale", "Detail", "Roughness", "Factor", "Value"):
            socket.default_value = float(rng.uniform(0.2, 1 if socket.name != "Scale" else 4))
    return node


def _image(stage, rng):
    """A noisy image of any depth, with or without alpha, in any of the usual color spaces."""
    side = int(rng.choice([8, 64]))
    space = str(rng.choice(["sRGB", "sRGB", "Non-Color", "Linear Rec.709"]))
    image = stage.image(rng.random((side, side, 3)), "noise", bool(rng.random() < 0.3), space)
    if rng.random() < 0.3:
        pixels = np.array(image.pixels[:], np.float32).reshape(-1, 4)
        pixels[:, 3] = rng.random(len(pixels))
        image.pixels.foreach_set(pixels.ravel())
        image.alpha_mode = str(rng.choice(["STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"]))
        image.update()
        image.pack()
    return image
