"""Images and procedural textures: how they are read, placed and worn."""

import itertools
import os
import tempfile

import bpy
import numpy as np

from .feature import MIDDLE, Feature
from .staging import (
    BLUE,
    DIFFUSE,
    GLOSSY,
    PRINCIPLED,
    TAN,
    WHITE,
    backdrop,
    ball,
    cube,
    grid,
    lit,
    node,
    painted,
    picture,
    ramp,
    shader_of,
    tiles,
    tilted,
)


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


def extension(kind):
    def source(stage, tree):
        return picture(stage, tree, _mapping(stage, tree, "POINT"), extension=kind).outputs[0]

    return source


def _through(make):
    """An image's color through another node."""
    return lambda stage, tree: make(tree, picture(stage, tree).outputs[0])


def _curves(tree, color):
    made = node(tree, "RGBCurve", Color=color)
    made.mapping.curves[3].points[0].location = (0, 0.2)
    made.mapping.curves[0].points.new(0.5, 0.8)
    made.mapping.curves[2].points.new(0.5, 0.3)
    made.mapping.update()
    return made.outputs[0]


def _mix_color(tree, color, blend):
    made = node(tree, "Mix", data_type="RGBA", blend_type=blend, Factor_Float=0.6, A_Color=color)
    made.inputs[7].default_value = BLUE
    return made.outputs[2]


def _math(tree, color):
    red = node(tree, "SeparateColor", Color=color).outputs["Red"]
    squared = node(tree, "Math", operation="MULTIPLY")
    tree.links.new(red, squared.inputs[0])
    tree.links.new(red, squared.inputs[1])
    return squared.outputs[0]


def _image(*space, size=64, **settings):
    def source(stage, tree):
        return node(tree, "TexImage", image=tiles(stage, *space, size=size), **settings).outputs[0]

    return source


def _noise(stage, size):
    pixels = np.random.default_rng(3).random((size, size, 3)) ** 2
    return stage.image(pixels, "noise", space="sRGB")


def _sampled(size, mapping=None, **settings):
    """An sRGB image of noise."""

    def source(stage, tree):
        made = node(tree, "TexImage", image=_noise(stage, size), **settings)
        for name, value in (mapping or {}).items():
            setattr(made.texture_mapping, name, value)
        return made.outputs[0]

    return source


def _sequence(stage, tree):
    """Its second frame; there is no file of the one that its path names."""
    kept = os.path.join(tempfile.mkdtemp(prefix="holopath-bench-"), "frame_0002.png")
    image = _noise(stage, 8)
    image.filepath_raw, image.file_format = kept, "PNG"
    image.save()
    loaded = bpy.data.images.load(kept)
    loaded.source, loaded.filepath = "SEQUENCE", kept.replace("0002", "0000")
    made = node(tree, "TexImage", image=loaded)
    made.image_user.frame_duration, made.image_user.frame_offset = 9, 1
    return made.outputs[0]


PICTURES = {
    "image, linear": _image(),
    "image, sRGB": _image("sRGB", False),
    "image, Non-Color": _image("Non-Color", False),
    "image, Linear Rec.2020": _image("Linear Rec.2020"),
    "image, few pixels, linear interpolation": _image(size=4),
    "image, few pixels, closest": _image(size=4, interpolation="Closest"),
    "image, few pixels, cubic": _image(size=4, interpolation="Cubic"),
    "image, sRGB, few pixels": _sampled(6),
    "image, sRGB, few pixels, smart": _sampled(6, interpolation="Smart"),
    "image, sRGB, a texel a pixel": _sampled(64),
    "image with a Texture Mapping of its own": _sampled(
        6, dict(vector_type="TEXTURE", translation=(0.3, 0.2, 0), rotation=(0, 0, 0.5), scale=(0.7, 1.2, 1))
    ),
    "image sequence without its first frame": _sequence,
    "image with alpha, color": lambda stage, tree: picture(stage, tree, image=_with_alpha(stage)).outputs[0],
    "image with alpha, alpha": lambda stage, tree: picture(stage, tree, image=_with_alpha(stage)).outputs[1],
    "extension repeat": extension("REPEAT"),
    "extension extend": extension("EXTEND"),
    "extension clip": extension("CLIP"),
    "extension mirror": extension("MIRROR"),
    "Mapping, texture": lambda stage, tree: picture(stage, tree, _mapping(stage, tree, "TEXTURE")).outputs[0],
    "RGB Curves": _through(_curves),
    "Mix Color, mix": _through(lambda tree, color: _mix_color(tree, color, "MIX")),
    "Mix Color, multiply": _through(lambda tree, color: _mix_color(tree, color, "MULTIPLY")),
    "Mix Color, screen": _through(lambda tree, color: _mix_color(tree, color, "SCREEN")),
    "Math": _through(_math),
    "ColorRamp": _through(ramp),
    "Invert Color": _through(lambda tree, color: node(tree, "Invert", Color=color).outputs[0]),
    "Gamma": _through(lambda tree, color: node(tree, "Gamma", Color=color, Gamma=2.0).outputs[0]),
    "Hue/Saturation/Value": _through(
        lambda tree, color: node(tree, "HueSaturation", Color=color, Hue=0.7, Value=0.8).outputs[0]
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


def _vertex_colors(stage, domain, kind, attribute_node):
    def source(stage, tree):
        named = {"layer_name": "paint"} if attribute_node == "VertexColor" else {"attribute_name": "paint"}
        return node(tree, attribute_node, **named).outputs["Color"]

    data = grid(stage, painted(stage, source), 8).data
    layer = data.color_attributes.new("paint", kind, domain)
    colors = np.ones((len(layer.data), 4), np.float32)
    colors[:, :3] = 0.1 + 0.8 * np.random.default_rng(6).random((len(layer.data), 3))
    layer.data.foreach_set("color", colors.ravel())


def _alpha_cut(stage, color=False, between=None):
    def source(stage, tree):
        return node(tree, "TexImage", image=_with_alpha(stage)).outputs["Alpha"]

    material = painted(stage, source, "Alpha", PRINCIPLED, Base_Color=TAN, Roughness=1.0)
    if color:
        inputs = shader_of(material.node_tree).inputs
        texture = inputs["Alpha"].links[0].from_node
        shown = texture.outputs["Color"]
        if between:
            shown = node(material.node_tree, between, Color=shown).outputs[0]
        material.node_tree.links.new(shown, inputs["Base Color"])
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


def _missing_image(stage, tree):
    lost = bpy.data.images.new("lost", 4, 4)
    lost.source, lost.filepath = "FILE", os.path.join(tempfile.gettempdir(), "nowhere", "lost.png")
    lost.reload()
    return node(tree, "TexImage", image=lost).outputs[0]


def _missing_alpha(stage):
    """Its pink is a number, too."""
    material = painted(stage, _missing_image, "Alpha", PRINCIPLED, Base_Color=TAN, Roughness=0.5)
    stage.plane(1.6, material, "pane", (0, 0, 0.5))
    backdrop(stage)


def _gray_tiles(stage, tree):
    """Numbers from 0.15 to 0.95."""
    return node(tree, "TexImage", image=tiles(stage, "Non-Color")).outputs[0]


def _textured(socket, shape=tilted, **values):
    def make(stage):
        values_here = {"Base_Color": TAN, "Roughness": 0.5, **values}
        shape(stage, painted(stage, _gray_tiles, socket, PRINCIPLED, **values_here))

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
        color = node(tree, "TexImage", image=image).outputs[0]
        return node(tree, "NormalMap", space=space, Color=color, Strength=strength).outputs[0]

    return source


def _normal_on(source, shape, shader=DIFFUSE, **values):
    return lambda stage: shape(stage, painted(stage, source, "Normal", shader, Color=TAN, **values))


MAPPED = {
    "UV map by name": _uv_map,
    "two UV maps in one material": _two_uv_maps,
    "vertex colors, Color Attribute": lambda s: _vertex_colors(s, "POINT", "FLOAT_COLOR", "VertexColor"),
    "vertex colors, Attribute, corners": lambda s: _vertex_colors(s, "CORNER", "BYTE_COLOR", "Attribute"),
    "image alpha on Principled Alpha": _alpha_cut,
    "image color and alpha on Principled": lambda stage: _alpha_cut(stage, color=True),
    "image color through Invert Color, and alpha": lambda stage: _alpha_cut(stage, True, "Invert"),
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
        _bump(_height, Strength=0.7, Distance=0.1), tilted, GLOSSY, Roughness=0.4
    ),
    "Normal Map, tangent space": _normal_on(_normal_map("TANGENT"), tilted),
    "Normal Map, tangent space, strength 0.5": _normal_on(_normal_map("TANGENT", 0.5), ball),
    "Normal Map, object space": _normal_on(_normal_map("OBJECT"), tilted),
}

PROCEDURAL = {
    "Noise Texture": lambda tree, at: ramp(tree, node(tree, "TexNoise", Vector=at, Scale=4.0).outputs[0]),
    "Voronoi Texture": lambda tree, at: node(tree, "TexVoronoi", Vector=at, Scale=5.0).outputs["Color"],
    "Checker Texture": lambda tree, at: node(
        tree, "TexChecker", Vector=at, Scale=5.0, Color1=BLUE, Color2=WHITE
    ).outputs[0],
    "Brick Texture": lambda tree, at: node(
        tree, "TexBrick", Vector=at, Scale=3.0, Color1=TAN, Color2=BLUE, Mortar=WHITE
    ).outputs[0],
    "Wave Texture": lambda tree, at: ramp(
        tree, node(tree, "TexWave", Vector=at, Scale=2.0, Distortion=3.0).outputs["Factor"]
    ),
}


def _sheet(source):
    return lit(lambda stage: tilted(stage, painted(stage, source)))


def _placed(kind, space):
    """A procedural texture by some coordinates."""
    shape = {"Generated": ball, "Object": cube, "UV": tilted}[space]

    def source(stage, tree):
        return kind(tree, node(tree, "TexCoord").outputs[space])

    return lit(lambda stage: shape(stage, painted(stage, source)))


FEATURES = [
    *(Feature(name, "textures", _sheet(source), MIDDLE) for name, source in PICTURES.items()),
    *(Feature(name, "textures", lit(make), MIDDLE) for name, make in MAPPED.items()),
    *(
        Feature(f"{name}, {space}", "textures", _placed(kind, space), MIDDLE)
        for (name, kind), space in itertools.product(PROCEDURAL.items(), ("Generated", "Object", "UV"))
    ),
    Feature("missing image", "textures", _sheet(_missing_image), MIDDLE, notes=frozenset({"Image file"})),
    Feature(
        "missing image in alpha",
        "textures",
        lit(_missing_alpha),
        MIDDLE,
        depth=8,
        notes=frozenset({"Image file"}),
    ),
]
