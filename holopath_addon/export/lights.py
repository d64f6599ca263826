"""Blender's lamps and world to Mitsuba emitters.

Blender's lamps are seen neither by the camera nor by other light: nothing hides behind them. A Mitsuba
emitter with a shape would be in view, would shade, and would get a depth of its own in the hologram. So a
lamp with a size becomes a cluster of point-like emitters spread evenly over it, enough of them that soft
shadows show no steps.
"""

import math

import numpy as np

from .node_graph import Pin, follow, output_node
from .textures import ImageValue

CLUSTER = 256
SUN_CLUSTER = 64
# The cosine and spread of an area lamp live in a texture over the tangent of the angle, up to this angle.
WIDEST_DEG = 86.0
PROFILE_RESOLUTION = 512


def export_lamp(light, matrix, name, scale, notes):
    """Turn a lamp into Mitsuba emitters.

    Radiant intensities are scaled so that a scene renders the same for any `scale`.

    Parameters
    ----------
    light : bpy.types.Light
        Evaluated lamp data.
    matrix : array, shape (4, 4)
        Object to world, Blender units.
    name : str
        Object name, for notes.
    scale : float
        Metres a Blender unit.
    notes : Notes

    Returns
    -------
    list of dict
        For `mitsuba.load_dict`; all of them share one lamp's worth of light samples.
    """
    colour = _colour(light, name, notes)
    if not np.any(colour > 0):
        if np.any(colour < 0):
            notes.add(name, "Negative light", "ignored")
        return []
    if not light.use_shadow:
        notes.add(name, "Light without shadow", "casts shadows")
    if any(getattr(light, f"{ray}_factor", 1.0) != 1.0 for ray in ("diffuse", "specular", "transmission")):
        notes.add(name, "Diffuse, glossy or transmission factor of a light", "ignored")
    linear = matrix[:3, :3]
    position = matrix[:3, 3] * scale
    emitters = {"POINT": _point, "SPOT": _spot, "SUN": _sun, "AREA": _area}[light.type](
        light, colour, linear, position, scale, name, notes
    )
    for emitter in emitters:
        emitter["sampling_weight"] = 1 / len(emitters)
    return emitters


def _colour(light, name, notes):
    """Colour times power, shape (3,); W, or W/m² for the sun."""
    colour = np.array(light.color, float) * light.energy * 2 ** getattr(light, "exposure", 0.0)
    if getattr(light, "use_temperature", False):
        colour = colour * np.array(light.temperature_color)
    if not light.use_nodes or light.node_tree is None:
        return colour
    output = output_node(light.node_tree)
    source = follow(Pin(output.inputs["Surface"])) if output else None
    if source is None or not source.socket.is_output or source.node.bl_idname != "ShaderNodeEmission":
        notes.add(name, "Light nodes", "ignored")
        return colour
    for socket_name in ("Color", "Strength"):
        value = follow(source.input(socket_name))
        if value.socket.is_output:
            notes.add(name, f"Node on the light's {socket_name}", "ignored")
        else:
            plain = value.socket.default_value
            colour = colour * (np.array(plain)[:3] if socket_name == "Color" else plain)
    return colour


def _point(light, colour, linear, position, scale, name, notes):
    radius = light.shadow_soft_size * scale
    intensity = colour * _intensity_per_watt(light, radius, scale)
    offsets = _ball(CLUSTER) * radius if radius > 0 else np.zeros((1, 3))
    return [
        {
            "type": "point",
            "position": [float(v) for v in position + offset],
            "intensity": _rgb(intensity / len(offsets)),
        }
        for offset in offsets
    ]


def _intensity_per_watt(light, radius, scale):
    if getattr(light, "normalize", True):
        return scale**2 / (4 * math.pi)
    return radius**2  # the power is that of a unit sphere's surface


def _spot(light, colour, linear, position, scale, name, notes):
    import mitsuba as mi

    radius = light.shadow_soft_size * scale
    intensity = colour * _intensity_per_watt(light, radius, scale)
    half = min(light.spot_size / 2, math.radians(WIDEST_DEG))
    if half < light.spot_size / 2 - 1e-6:
        notes.add(name, "Spot wider than 172 degrees", "cut to 172 degrees")
    lengths = np.linalg.norm(linear, axis=0)
    if lengths.max() > 1.001 * lengths.min():
        notes.add(name, "Spot with unequal scale (elliptic cone)", "round cone")
    cos_half = math.cos(half)
    smooth = (1 - cos_half) * light.spot_blend

    def profile(cos):
        t = np.clip((cos - cos_half) / smooth, 0, 1) if smooth > 0 else (cos >= cos_half).astype(float)
        return t * t * (3 - 2 * t)

    texture = _profile_texture(profile, half)
    rotation = _looking_down(linear)
    offsets = _ball(CLUSTER) * radius if radius > 0 else np.zeros((1, 3))
    return [
        _spot_emitter(mi, position + offset, rotation, intensity / len(offsets), half, texture)
        for offset in offsets
    ]


def _area(light, colour, linear, position, scale, name, notes):
    import mitsuba as mi

    wide = light.size
    high = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
    x_axis, y_axis = linear[:, 0] * wide * scale, linear[:, 1] * high * scale
    area = np.linalg.norm(x_axis) * np.linalg.norm(y_axis)
    unit = _low_discrepancy(CLUSTER)
    if light.shape in ("DISK", "ELLIPSE"):
        area *= math.pi / 4
        radius, angle = 0.5 * np.sqrt(unit[:, 0]), 2 * math.pi * unit[:, 1]
        placed = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    else:
        placed = unit - 0.5
    offsets = placed[:, :1] * x_axis + placed[:, 1:] * y_axis
    # radiance = power / (pi area), so the intensity along the axis is power / pi
    intensity = colour * scale**2 / math.pi
    if not getattr(light, "normalize", True):
        intensity = intensity * area / scale**2
    half = min(light.spread / 2, math.radians(WIDEST_DEG))

    def profile(cos):
        if light.spread / 2 > math.radians(89.9):
            return cos
        # the share of a soft box's light that passes a grid of slats at this angle
        limit = math.tan(light.spread / 2)
        tangent = np.sqrt(1 - cos**2) / cos
        return cos * np.maximum(limit - tangent, 0) / (limit - light.spread / 2)

    if half < math.radians(0.5):
        notes.add(name, "Area light spread below 1 degree", "widened to 1 degree")
        half = math.radians(0.5)
    texture = _profile_texture(profile, half)
    rotation = _looking_down(linear)
    return [
        _spot_emitter(mi, position + offset, rotation, intensity / CLUSTER, half, texture)
        for offset in offsets
    ]


def _sun(light, colour, linear, position, scale, name, notes):
    forward = -linear[:, 2] / np.linalg.norm(linear[:, 2])
    half = light.angle / 2
    if half <= 0:
        directions = forward[None]
    else:
        unit = _low_discrepancy(SUN_CLUSTER)
        tangent = math.tan(min(half, math.radians(80))) * np.sqrt(unit[:, 0])
        side = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
        side /= np.linalg.norm(side)
        other = np.cross(forward, side)
        angle = 2 * math.pi * unit[:, 1]
        directions = (
            forward + (tangent * np.cos(angle))[:, None] * side + (tangent * np.sin(angle))[:, None] * other
        )
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    if not getattr(light, "normalize", True):
        colour = colour * math.pi * math.sin(half) ** 2
    irradiance = _rgb(colour / (directions @ forward).sum())
    return [
        {"type": "directional", "direction": [float(v) for v in direction], "irradiance": irradiance}
        for direction in directions
    ]


def _profile_texture(profile, half):
    """Intensity over direction as Mitsuba's spot projects it: linear in the tangent, up to `half`."""
    import mitsuba as mi

    centres = (np.arange(PROFILE_RESOLUTION) + 0.5) / PROFILE_RESOLUTION * 2 - 1
    tangent = math.tan(half) * np.hypot(centres[:, None], centres[None, :])
    values = profile(1 / np.sqrt(1 + tangent**2)).astype(np.float32)
    return mi.load_dict(
        {"type": "bitmap", "data": mi.TensorXf(values[..., None]), "raw": True, "wrap_mode": "clamp"}
    )


def _spot_emitter(mi, position, rotation, intensity, half, texture):
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = rotation, position
    degrees = math.degrees(half)
    return {
        "type": "spot",
        "to_world": mi.ScalarTransform4f(to_world),
        "intensity": _rgb(intensity),
        "cutoff_angle": degrees,
        "beam_width": degrees * (1 - 1e-4),
        "texture": texture,
    }


def _looking_down(linear):
    """Rotation whose +z, where Mitsuba's spot looks, is the lamp's local -z."""
    forward = -linear[:, 2] / np.linalg.norm(linear[:, 2])
    side = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(forward, side), forward], axis=1)


def _low_discrepancy(count):
    """Evenly spread points of the unit square (the R2 sequence), shape (count, 2)."""
    index = np.arange(count)[:, None] + 0.5
    return (index * np.array([0.7548776662466927, 0.5698402909980532])) % 1


def _ball(count):
    """Points whose projection is an evenly filled unit disk from every side, shape (count, 3).

    Cycles' point lamp is a disk that always faces the point it lights. A density 1/sqrt(1 - r²) in the
    ball projects to a uniform disk.
    """
    index = (np.arange(count) + 0.5) / count
    unit = _low_discrepancy(count)
    radii = np.linspace(0, 1, 4097)
    share = (np.arcsin(radii) - radii * np.sqrt(1 - radii**2)) / (math.pi / 2)
    radius = np.interp(unit[:, 0], share, radii)
    z, angle = 1 - 2 * index, 2 * math.pi * unit[:, 1]
    ring = np.sqrt(1 - z**2)
    return radius[:, None] * np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _rgb(colour):
    return {"type": "rgb", "value": [float(max(v, 0)) for v in np.broadcast_to(colour, 3)]}


def export_world(world, textures, notes):
    """Turn the world into one Mitsuba environment emitter.

    Parameters
    ----------
    world : bpy.types.World or None
    textures : Textures
    notes : Notes

    Returns
    -------
    dict or None
        For `mitsuba.load_dict`; None where the world is black.
    """
    if world is None:
        return None
    colour, strength, rotation = _background(world, textures, notes)
    if not isinstance(colour, ImageValue):
        radiance = np.broadcast_to(np.asarray(colour, float), 3) * strength
        return {"type": "constant", "radiance": _rgb(radiance)} if np.any(radiance > 0) else None
    if strength <= 0:
        return None
    pixels = textures.pixels(colour.image)
    if pixels is None:
        return {"type": "constant", "radiance": _rgb(np.array([1.0, 0.0, 1.0]) * strength)}
    import mitsuba as mi

    # Mitsuba's local y is up and z the middle of the picture: Blender's z and x
    to_world = np.eye(4)
    to_world[:3, :3] = np.linalg.inv(rotation) @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)
    radiance = np.ascontiguousarray(pixels[::-1, :, :3]) * np.float32(strength)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.maximum(radiance, 0)),
        "to_world": mi.ScalarTransform4f(to_world),
    }


def _background(world, textures, notes):
    """Colour or image, strength, and the 3x3 rotation from world directions to the image's."""
    plain = tuple(world.color), 1.0, np.eye(3)
    if world.node_tree is None or not _uses_nodes(world):
        return plain
    output = output_node(world.node_tree)
    if output is None:
        return (0.0, 0.0, 0.0), 0.0, np.eye(3)
    if output.inputs["Volume"].is_linked:
        notes.add(world.name, "World volume", "ignored")
    source = follow(Pin(output.inputs["Surface"]))
    if not source.socket.is_output:
        return (0.0, 0.0, 0.0), 0.0, np.eye(3)
    if source.node.bl_idname not in ("ShaderNodeBackground", "ShaderNodeEmission") or source.node.mute:
        notes.add(
            world.name, f"{source.node.bl_label} node", "not supported: the world's viewport colour is used"
        )
        return plain
    strength = float(np.mean(textures.constant(source.input("Strength"), world.name, 1.0)))
    colour = follow(source.input("Color"))
    if colour.socket.is_output and colour.node.bl_idname == "ShaderNodeTexEnvironment":
        return _environment(colour, strength, world, textures, notes)
    return textures.constant(source.input("Color"), world.name, tuple(world.color)), strength, np.eye(3)


def _environment(source, strength, world, textures, notes):
    node = source.node
    if node.image is None:
        notes.add(world.name, "Environment Texture without an image", "shown in magenta")
        return (1.0, 0.0, 1.0), strength, np.eye(3)
    if node.projection != "EQUIRECTANGULAR":
        notes.add(world.name, f"{node.projection.title()} environment projection", "read as equirectangular")
    rotation = np.eye(3)
    vector = follow(source.input("Vector"))
    if vector.socket.is_output and vector.node.bl_idname == "ShaderNodeMapping":
        rotation = _mapping_rotation(vector, world, textures, notes)
        vector = follow(vector.input("Vector"))
    if vector.socket.is_output and not (
        vector.node.bl_idname == "ShaderNodeTexCoord" and vector.socket.name == "Generated"
    ):
        notes.add(world.name, f"{vector.node.bl_label} node on the environment's direction", "ignored")
    return ImageValue(node.image), strength, rotation


def _mapping_rotation(source, world, textures, notes):
    from mathutils import Euler

    angles = textures.constant(source.input("Rotation"), world.name, (0.0, 0.0, 0.0))
    location = textures.constant(source.input("Location"), world.name, (0.0, 0.0, 0.0))
    scale = textures.constant(source.input("Scale"), world.name, (1.0, 1.0, 1.0))
    if np.ptp(scale) > 1e-6 or scale[0] <= 0 or (np.any(location) and source.node.vector_type != "VECTOR"):
        notes.add(world.name, "Mapping location or unequal scale on the environment", "ignored")
    rotation = np.array(Euler(angles, "XYZ").to_matrix())
    return rotation.T if source.node.vector_type == "TEXTURE" else rotation


def _uses_nodes(world):
    import bpy

    return bpy.app.version >= (5, 0, 0) or world.use_nodes  # always true, and deprecated, since 5.0
