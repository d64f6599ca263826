"""Light, objects and nodes that the scenes share."""

from typing import Any

import bpy
import numpy as np

from ..stage import added

TAN = (0.6, 0.3, 0.15, 1)
WHITE = (0.8, 0.8, 0.8, 1)
BLUE = (0.1, 0.3, 0.8, 1)

DIFFUSE = "ShaderNodeBsdfDiffuse"
PRINCIPLED = "ShaderNodeBsdfPrincipled"
EMISSION = "ShaderNodeEmission"
TRANSPARENT = "ShaderNodeBsdfTransparent"
GLOSSY = "ShaderNodeBsdfAnisotropic"
GLASS = "ShaderNodeBsdfGlass"


def studio(stage, world=0.15):
    """An emitting panel at the upper right, beside the view, and a dim world."""
    panel = stage.plane(1.6, stage.material(EMISSION, "panel", Strength=8.0), "panel", (2, 1, 2.5))
    panel.rotation_euler = (-0.3, 0.8, 0)
    stage.world((1.0, 1.1, 1.3), world)


def backdrop(stage, depth=-1.4):
    """A glowing wall of colored tiles behind the object."""
    tiles = 0.1 + 0.9 * np.random.default_rng(3).random((6, 6, 3))
    image = stage.image(np.kron(tiles, np.ones((16, 16, 1))), "tiles", True, "Linear Rec.709")
    glow = stage.material(EMISSION, "backdrop")
    stage.texture(glow, image, "Color").interpolation = "Closest"
    stage.plane(6, glow, "backdrop", (0, 0, depth))


def floor(stage, depth=-0.9, color=WHITE):
    return stage.plane(8, stage.material(DIFFUSE, "floor", Color=color), "floor", (0, 0, depth))


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


def lit(make):
    """A builder that sets up the studio after ``make(stage)``."""

    def build(stage):
        make(stage)
        studio(stage)

    return build


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


def tiles(stage, space="Linear Rec.709", float_buffer=True, count=4, size=64):
    """An image of colored tiles, none of them black."""
    colors = 0.15 + 0.8 * np.random.default_rng(1).random((count, count, 3))
    pixels = np.kron(colors, np.ones((size // count, size // count, 1)))
    return stage.image(pixels, "tiles", float_buffer, space)


def picture(stage, tree, vector=None, **settings):
    """An Image Texture of `tiles`."""
    made = node(tree, "TexImage", **{"image": tiles(stage), **settings})
    if vector is not None:
        tree.links.new(vector, made.inputs["Vector"])
    return made


def ramp(tree, factor, middle=(0.9, 0.5, 0.1, 1)):
    made = node(tree, "ValToRGB", Factor=factor)
    made.color_ramp.elements[0].color, made.color_ramp.elements[1].color = BLUE, WHITE
    made.color_ramp.elements.new(0.45).color = middle
    return made.outputs[0]
