"""Demo scenes, built by code: objects to focus on at several depths."""

import math
from typing import Any

import numpy as np

from ..engine import InvalidInput

DEMOS = {
    "planes": "two textured, luminous planes at 0.5 m and 2 m",
    "suzanne": "Suzanne at 0.5 m, objects at 1 m and a textured wall at 4 m, lamp-lit",
    "box": "a closed, colored box with one lamp, lit mostly by light from its walls",
}

FIELD_OF_VIEW = math.radians(38)

# Distances of objects from the camera, meters.
FOCUS = {"planes": (0.5, 2.0), "suzanne": (0.5, 1.0, 4.0), "box": (0.7, 1.35, 1.8)}


def build(name):
    """Replace the contents of the current Blender file with a demo scene.

    Parameters
    ----------
    name : str
        One of `DEMOS`.

    Raises
    ------
    InvalidInput
        If there is no such demo.
    """
    _check(name)
    _clear()
    import bpy

    _fill(bpy.context.scene, name)


def add(name):
    """Add a demo scene to the current Blender file, and keep its scenes and data.

    Parameters
    ----------
    name : str
        One of `DEMOS`.

    Returns
    -------
    bpy.types.Scene
        The new scene, which no window shows yet.

    Raises
    ------
    InvalidInput
        If there is no such demo.
    """
    _check(name)
    import bpy

    scene = bpy.data.scenes.new(f"HoloPath {name.title()}")
    _fill(scene, name)
    return scene


def _check(name):
    if name not in DEMOS:
        raise InvalidInput(f"There is no demo scene '{name}': choose one of {', '.join(DEMOS)}.")


def _fill(scene, name):
    """Build a demo in an empty scene, without operators, so that the selection does not matter."""
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 1.0
    scene.render.resolution_x = scene.render.resolution_y = 512
    scene.view_settings.view_transform = "Standard"
    _camera(scene)
    {"planes": _planes, "suzanne": _suzanne, "box": _box}[name](scene)
    scene.view_layers[0].update()


# -- scenes. The camera is at the origin and looks along +y; z is up. Lengths are in meters.


def _planes(scene):
    """Build two planes, of which the near one hides the left part of the far one."""
    _world(scene, (0.0, 0.0, 0.0))
    near = _emissive("near", _star_chart(1024, 32, (0.02, 0.02, 0.05), (1.0, 0.75, 0.25)))
    far = _emissive("far", _checker_chart(1024, 32, (0.05, 0.15, 0.6), (0.7, 0.9, 1.0)))
    _upright(scene, "Near plane", near, (-0.075, 0.5, 0.0), 0.15, 0.24)
    _upright(scene, "Far plane", far, (0.0, 2.0, 0.0), 1.6, 1.6)


def _suzanne(scene):
    _world(scene, (0.10, 0.13, 0.18))
    _light(scene, "Key lamp", 30.0, (-0.9, -0.2, 1.3), (0.05, 0.9, -0.1), 0.4, (1.0, 0.93, 0.82))
    _light(scene, "Wall lamp", 90.0, (1.6, 2.2, 2.2), (0.0, 4.0, 0.4), 0.6, (0.85, 0.92, 1.0))

    floor = -0.22
    tiles = _surface("floor", _checker_chart(2048, 64, (0.10, 0.07, 0.05), (0.75, 0.66, 0.52)), 0.7)
    _level(scene, "Floor", tiles, (0.0, 2.3, floor), 5.0, 3.6)
    wall = _surface("wall", _wall_chart(1024), 0.9)
    _upright(scene, "Wall, 4 m", wall, (0.0, 4.0, 0.3), 4.0, 4.0)

    _suzanne_on_pedestal(scene, floor)
    stripes = _surface("stripes", _stripes(1024, 24, (0.85, 0.10, 0.06), (0.95, 0.92, 0.85)), 0.35)
    _sphere(scene, "Ball, 1 m", stripes, (0.215, 1.0, floor + 0.11), 0.11)
    dice = _surface("dice", _star_chart(512, 12, (0.03, 0.16, 0.06), (0.45, 0.95, 0.35)), 0.6)
    _cube(scene, "Cube, 1.1 m", dice, (-0.26, 1.1, floor + 0.1), 0.2, 0.5)
    _ring(
        scene, "Ring, 1.4 m", _surface("ring", _stripes(1024, 40, (0.95, 0.62, 0.05), (0.12, 0.05, 0.3)), 0.5)
    )
    _text(scene, "Sign, 1 m", "1 m", (0.052, 0.9, floor), 0.05)
    _text(scene, "Sign, 2 m", "2 m", (0.115, 2.0, floor), 0.11)


def _box(scene):
    """Build a room around the camera, 0.9 m wide. Its lamp faces the ceiling, so that most light is indirect."""
    _world(scene, (0.0, 0.0, 0.0))
    half, back, front = 0.45, -0.3, 1.8
    depth, middle = front - back, (front + back) / 2
    white = (0.75, 0.75, 0.75)
    red = _surface("red", _checker_chart(512, 28, (0.30, 0.03, 0.03), (0.75, 0.08, 0.06)))
    green = _surface("green", _checker_chart(512, 28, (0.03, 0.22, 0.04), (0.08, 0.60, 0.12)))
    checked = _surface("checked", _checker_chart(512, 14, (0.35, 0.35, 0.35), white))
    plain = _surface("plain", np.broadcast_to(np.array(white), (4, 4, 3)))
    _level(scene, "Floor", checked, (0, middle, -half), 2 * half, depth)
    _level(scene, "Ceiling", plain, (0, middle, half), 2 * half, depth)
    _upright(scene, "Back", checked, (0, front, 0), 2 * half, 2 * half)
    _upright(scene, "Front", plain, (0, back, 0), 2 * half, 2 * half)
    for name, material, x in (("Left", red, -half), ("Right", green, half)):
        side = _upright(scene, name, material, (x, middle, 0), depth, 2 * half)
        side.rotation_euler = (math.pi / 2, 0, math.pi / 2)
    _light(scene, "Lamp", 12.0, (0, 1.0, 0.15), (0, 1.0, 1.0), 0.25, (1, 0.95, 0.85))
    chart = _surface("chart", _star_chart(512, 16, (0.05, 0.05, 0.08), (0.9, 0.85, 0.3)))
    blue = _surface("blue", _stripes(512, 16, (0.05, 0.12, 0.7), white), 0.5)
    for name, material, x, y, top, turn in (
        ("Near", chart, -0.12, 0.7, -0.08, 0.5),
        ("Far", checked, 0.2, 1.35, -0.02, -0.3),
    ):
        block = _cube(scene, f"{name} block", material, (x, y, (top - half) / 2), 0.2, turn)
        block.scale = (1, 1, (top + half) / 0.2)
        _sphere(scene, f"{name} ball", blue, (x, y, top + 0.08), 0.08)


def _suzanne_on_pedestal(scene, floor):
    import bmesh
    from mathutils import Matrix

    skin = _surface("suzanne", _harlequin(1024, 20), 0.4)
    half = Matrix.Scale(0.075, 4)
    monkey = _primitive(scene, "Suzanne, 0.5 m", skin, bmesh.ops.create_monkey, matrix=half)
    monkey.location, monkey.rotation_euler = (-0.045, 0.5, -0.005), (-0.1, 0.0, 0.45)
    monkey.data.shade_smooth()
    levels = monkey.modifiers.new("Subdivision", "SUBSURF")
    levels.levels = levels.render_levels = 2
    rings = _surface(
        "pedestal", _stripes(512, 26, (0.04, 0.05, 0.08), (0.8, 0.8, 0.85), horizontal=True), 0.5
    )
    pedestal = _primitive(
        scene, "Pedestal, 0.5 m", rings, bmesh.ops.create_cone,
        cap_ends=True, segments=96, radius1=0.045, radius2=0.045, depth=0.3,
    )  # fmt: skip
    pedestal.location = (-0.045, 0.5, -0.082 - 0.15)


# -- objects


def _upright(scene, name, material, center, width, height):
    """Add a rectangle that faces the camera (-y)."""
    return _rectangle(scene, name, material, center, width, height, (math.pi / 2, 0, 0))


def _level(scene, name, material, center, width, length):
    return _rectangle(scene, name, material, center, width, length, (0, 0, 0))


def _rectangle(scene, name, material, center, width, height, rotation):
    import bpy

    x, y = width / 2, height / 2
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], [], [(0, 1, 2, 3)])
    uv = 0.5 + np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / max(width, height)
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", uv.astype(np.float32).ravel())
    mesh.materials.append(material)
    rectangle = _link(scene, bpy.data.objects.new(name, mesh))
    rectangle.location, rectangle.rotation_euler = center, rotation
    return rectangle


def _sphere(scene, name, material, center, radius):
    """Add a ball. Blender's own orders its vertices differently each time, so that baked light would not be reused."""
    import bpy

    around, rings = 96, 48
    turn, rise = 2 * math.pi * np.arange(around) / around, math.pi * np.arange(1, rings) / rings
    across = radius * np.sin(rise)[:, None]
    belts = [across * np.cos(turn), across * np.sin(turn), -radius * np.cos(rise)[:, None] + 0 * turn]
    poles = [(0, 0, -radius), (0, 0, radius)]

    def number(ring, place):
        return ring // rings if ring in (0, rings) else 2 + (ring - 1) * around + place % around

    faces = []
    for ring in range(rings):
        for place in range(around):
            corners: list = [(ring, place), (ring, place + 1), (ring + 1, place + 1), (ring + 1, place)]
            if ring == 0:
                corners[:2] = [(0, place + 0.5)]
            elif ring == rings - 1:
                corners[2:] = [(rings, place + 0.5)]
            faces.append(corners)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(
        [*poles, *np.stack(belts, -1).reshape(-1, 3).tolist()],
        [],
        [[number(*corner) for corner in corners] for corners in faces],
    )
    uv = [(0.5 + place / around, ring / rings) for corners in faces for ring, place in corners]
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.array(uv, np.float32).ravel())
    mesh.shade_smooth()
    mesh.materials.append(material)
    ball = _link(scene, bpy.data.objects.new(name, mesh))
    ball.location, ball.rotation_euler = center, (0.5, 0.4, 0)
    return ball


def _cube(scene, name, material, center, size, turn):
    import bmesh

    cube = _primitive(scene, name, material, bmesh.ops.create_cube, size=size)
    cube.location, cube.rotation_euler = center, (0, 0, turn)
    faces = np.tile(np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32), (6, 1))
    cube.data.uv_layers.active.uv.foreach_set("vector", faces.ravel())
    return cube


def _primitive(scene, name, material, make, **form):
    """Add one of Blender's own shapes: `make` is the operation of bmesh, `form` its arguments."""
    import bmesh
    import bpy

    shape = bmesh.new()
    shape.loops.layers.uv.new("UVMap")
    make(shape, calc_uvs=True, **form)
    mesh = bpy.data.meshes.new(name)
    shape.to_mesh(mesh)
    shape.free()
    mesh.materials.append(material)
    return _link(scene, bpy.data.objects.new(name, mesh))


def _ring(scene, name, material):
    """Add a torus about its z axis, with `around` vertices the long way and `across` the short way."""
    import bpy

    long, short, around, across = 0.1, 0.032, 96, 32
    turn, tilt = np.meshgrid(*(2 * math.pi * np.arange(n) / n for n in (around, across)), indexing="ij")
    radius = long + short * np.cos(tilt)
    corners = np.stack([radius * np.cos(turn), radius * np.sin(turn), short * np.sin(tilt)], -1)
    places = [(i, j) for i in range(around) for j in range(across)]
    faces = [[(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)] for i, j in places]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(
        corners.reshape(-1, 3).tolist(),
        [],
        [[i % around * across + j % across for i, j in face] for face in faces],
    )
    uv = 0.5 + np.array(faces).reshape(-1, 2) / (around, across)
    uv -= uv.reshape(-1, 4, 2).min(1).repeat(4, axis=0).astype(int)  # each face lies whole in the image
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", uv.astype(np.float32).ravel())
    mesh.shade_smooth()
    mesh.materials.append(material)
    ring = _link(scene, bpy.data.objects.new(name, mesh))
    ring.location, ring.rotation_euler = (-0.02, 1.4, 0.12), (1.2, 0.3, 0)
    return ring


def _text(scene, name, text, location, size):
    import bpy

    curve: Any = bpy.data.curves.new(name, "FONT")  # a TextCurve
    curve.body, curve.size, curve.extrude = text, size, 0.06 * size
    curve.align_x = "CENTER"
    curve.materials.append(_surface(name, np.broadcast_to(np.array((0.95, 0.95, 0.9)), (4, 4, 3)), 0.6))
    sign = _link(scene, bpy.data.objects.new(name, curve))
    sign.location, sign.rotation_euler = location, (math.pi / 2, 0, 0)
    return sign


def _camera(scene):
    import bpy

    data = bpy.data.cameras.new("Hologram camera")
    data.lens = 0.5 * data.sensor_width / math.tan(FIELD_OF_VIEW / 2)
    data.clip_start, data.display_size = 0.01, 0.1
    camera = _link(scene, bpy.data.objects.new("Hologram camera", data))
    camera.rotation_euler = (math.pi / 2, 0, 0)
    scene.camera = camera


def _light(scene, name, power, location, target, size, color):
    """Add a square area light at `location` that faces `target`."""
    import bpy
    from mathutils import Vector

    data: Any = bpy.data.lights.new(name, "AREA")  # an AreaLight
    data.energy, data.size, data.color = power, size, color
    light = _link(scene, bpy.data.objects.new(name, data))
    light.location = location
    direction = Vector(target) - Vector(location)
    light.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()


def _world(scene, color):
    import bpy

    from ..export.shading.node_graph import tree_of

    world = bpy.data.worlds.new("World")
    scene.world = world
    world.color = color
    background = next(node for node in tree_of(world).nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Color"].default_value = (*color, 1.0)


def _link(scene, obj):
    scene.collection.objects.link(obj)
    return obj


def _clear():
    """Empty the file: remove its objects, their data, and every other scene."""
    import bpy

    kept = bpy.context.scene
    assert kept is not None  # every file has one
    for scene in list(bpy.data.scenes):
        if scene != kept:
            bpy.data.scenes.remove(scene)
    every: tuple[Any, ...] = (
        bpy.data.objects, bpy.data.collections, bpy.data.meshes, bpy.data.curves, bpy.data.lights,
        bpy.data.cameras, bpy.data.materials, bpy.data.images, bpy.data.worlds,
    )  # fmt: skip
    for blocks in every:
        for block in list(blocks):
            blocks.remove(block)
    kept.cursor.location = (0, 0, 0)


# -- materials


def _emissive(name, pixels):
    material, tree, output, texture = _textured(name, pixels)
    shader = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(texture.outputs["Color"], shader.inputs["Color"])
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def _surface(name, pixels, roughness=None):
    """Principled material of a roughness; None: plain diffuse."""
    material, tree, output, texture = _textured(name, pixels)
    if roughness is None:
        shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    else:
        shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
        shader.inputs["Roughness"].default_value = roughness
    tree.links.new(texture.outputs["Color"], shader.inputs[0])
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def _textured(name, pixels):
    """Material with an image of linear colors, shape (y, x, 3), row 0 at the top, packed into the file."""
    import bpy

    from ..export.shading.node_graph import tree_of

    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height)
    encoded = np.where(
        pixels <= 0.0031308, 12.92 * pixels, 1.055 * np.maximum(pixels, 0) ** (1 / 2.4) - 0.055
    )
    full = np.ones((height, width, 4), np.float32)
    full[..., :3] = encoded[::-1]
    # pyrefly: ignore[missing-attribute]  # in Blender's stubs an array of numbers is one
    image.pixels.foreach_set(full.ravel())
    image.update()
    image.pack()
    material = bpy.data.materials.new(name)
    material.diffuse_color = (*pixels.mean((0, 1)), 1.0)
    tree = tree_of(material)
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    return material, tree, output, texture


# -- patterns: linear colors, shape (y, x, 3), row 0 at the top


def _grid(size):
    centers = (np.arange(size) + 0.5) / size
    return np.meshgrid(centers, centers)


def _blend(mask, first, second):
    mask = np.asarray(mask, np.float32)[..., None]
    return mask * np.array(second, np.float32) + (1 - mask) * np.array(first, np.float32)


def _tint(pixels, x, y):
    """Vary the color slowly, so that no two places look alike."""
    waves = [
        0.5 + 0.5 * np.cos(2 * math.pi * (x * a + y * b + c))
        for a, b, c in ((1, 0.3, 0), (0.4, 1, 0.4), (0.7, -1, 0.7))
    ]
    return pixels * (0.55 + 0.45 * np.stack(waves, axis=-1))


def _checker_chart(size, tiles, first, second):
    """Checker tiles, of which every fourth row has smaller ones."""
    x, y = _grid(size)
    fine = (np.floor(y * tiles) % 4 == 1).astype(int) + 1
    mask = (np.floor(x * tiles * fine) + np.floor(y * tiles * fine)) % 2
    return _tint(_blend(mask, first, second), x, y)


def _stripes(size, count, first, second, horizontal=False):
    x, y = _grid(size)
    along, across = (y, x) if horizontal else (x, y)
    mask = np.floor(along * count) % 2
    fine = (np.floor(across * 8) % 4 == 2) * (np.floor(along * count * 3) % 2)
    return _tint(_blend(np.maximum(mask * (np.floor(across * 8) % 4 != 2), fine), first, second), x, y)


def _star_chart(size, tiles, first, second):
    """A Siemens star with rings, framed by checker tiles."""
    x, y = _grid(size)
    radius, angle = np.hypot(x - 0.5, y - 0.5), np.arctan2(y - 0.5, x - 0.5)
    star = np.floor(angle / (2 * math.pi) * 48 + 100) % 2
    rings = np.floor(radius * 2 * tiles) % 2
    checker = (np.floor(x * tiles) + np.floor(y * tiles)) % 2
    mask = np.where(radius < 0.16, rings, np.where(radius < 0.38, star, checker))
    return _tint(_blend(mask, first, second), x, y)


def _harlequin(size, tiles):
    """Diamonds in four saturated colors with dark seams."""
    x, y = _grid(size)
    u, v = (x + y) * tiles, (x - y) * tiles
    colors = np.array(
        [(0.9, 0.12, 0.05), (0.95, 0.75, 0.08), (0.05, 0.35, 0.85), (0.85, 0.85, 0.8)], np.float32
    )
    pixels = colors[(np.floor(u) + 2 * np.floor(v)).astype(int) % 4]
    seam = np.minimum(np.abs(u - np.round(u)), np.abs(v - np.round(v))) < 0.07
    return _blend(seam, (0, 0, 0), (1, 1, 1)) * 0.02 + pixels * ~seam[..., None]


def _wall_chart(size):
    """Bricks of varying color, with a row of Siemens stars at eye level."""
    x, y = _grid(size)
    rows, columns = 40, 20
    row = np.floor(y * rows)
    column = np.floor(x * columns + 0.5 * (row % 2))
    joint = (np.abs(y * rows - np.round(y * rows)) < 0.1) | (
        np.abs(x * columns + 0.5 * (row % 2) - np.round(x * columns + 0.5 * (row % 2))) < 0.05
    )
    tone = np.array(
        [(0.62, 0.20, 0.12), (0.45, 0.14, 0.09), (0.75, 0.38, 0.2), (0.55, 0.28, 0.3)], np.float32
    )
    pixels = tone[((row * 7 + column * 3 + (row * column) % 5).astype(int)) % 4]
    pixels = np.where(joint[..., None], np.array((0.82, 0.8, 0.75), np.float32), pixels)
    for center_x, center_y, radius, dark, light in (
        (0.5, 0.445, 0.075, (0.02, 0.05, 0.2), (0.9, 0.95, 1.0)),
        (0.28, 0.37, 0.06, (0.01, 0.12, 0.08), (1.0, 0.95, 0.3)),
        (0.72, 0.37, 0.06, (0.2, 0.02, 0.15), (0.7, 1.0, 0.8)),
    ):
        distance = np.hypot(x - center_x, y - center_y)
        angle = np.arctan2(y - center_y, x - center_x)
        star = _blend(np.floor(angle / (2 * math.pi) * 32 + 100) % 2, dark, light)
        pixels = np.where((distance < radius)[..., None], star, pixels)
    return pixels
