"""Conversion of Blender's lights to the engine's (`engine.scene.lamps`), which are invisible, too."""

import math

import numpy as np

from .shading import baking
from .shading.blackbody import blackbody_color
from .shading.node_graph import Pin, follow, output_node, upstream
from .shading.textures import effect_beside_surfaces

PROFILE = 512, 256  # directions of a lamp's nodes
# What nodes read of a lamp is that of a stand-in.
_OF_STAND_IN = {
    "ObjectInfo": "of a white object at the world's origin, not of the light: set the light's own color",
    ("NewGeometry", "Position"): "reads the world's origin, not where the light is",
    "LightPath": "the light is the same for all kinds of rays",
}
FALLOFFS = {"Quadratic": 0, "Linear": 1, "Constant": 2}  # power of the distance on top of 1 / distance^2


def export_lamp(light, matrix, name, scale, notes, profile=None):
    """Convert a light to one Mitsuba emitter.

    Powers are scaled so that a scene renders the same for any `scale`.

    Parameters
    ----------
    light : bpy.types.Light
        Evaluated lamp data.
    matrix : array, shape (4, 4)
        Object to world, Blender units.
    name : str
        Object name, for notes.
    scale : float
        Meters a Blender unit.
    notes : Notes
    profile : array, shape (v, u, 3), optional
        What the lamp's node tree emits over directions in its own frame, as `engine.scene.lamps` has it, in place of
        the tree; for trees of which `emission_varies`.

    Returns
    -------
    dict or None
        For `mitsuba.load_dict`; None where the lamp sends no light.
    """
    import mitsuba as mi

    color = np.array(light.color, float) * light.energy * 2 ** getattr(light, "exposure", 0.0)
    if getattr(light, "use_temperature", False):
        color = color * np.array(light.temperature_color)
    falloff = 0
    if profile is None:
        emission, falloff, ignored = _emission(light)
        color = color * emission
        for feature in ignored:
            notes.add(name, feature, "ignored")
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or lengths.min() < 1e-20:
        notes.add(name, "Lamp with a degenerate transform", "left out")
        return None
    if np.any(color < 0):
        notes.add(name, "Negative light", "ignored")
    emitter = {"POINT": _point, "SPOT": _spot, "SUN": _sun, "AREA": _area}[light.type](
        light, np.maximum(color, 0), lengths, scale
    )
    cycles = getattr(light, "cycles", None)  # which is not there where Blender's add-on for Cycles is off
    # a portal emits nothing: it only guides the samples of the world in Cycles
    is_portal = light.type == "AREA" and getattr(cycles, "is_portal", False)
    if emitter is None or is_portal or not np.any(color > 0):
        return None
    if not light.use_shadow:
        notes.add(name, "Light without shadow", "casts shadows")
    if cycles and cycles.max_bounces < cycles.bl_rna.properties["max_bounces"].default:
        notes.add(name, "Max Bounces of a light", "ignored")
    placed = np.array(matrix, float)
    placed[:3, 3] *= scale
    emitter["to_world"] = mi.ScalarTransform4f(placed)
    if profile is not None:
        emitter["profile"] = mi.TensorXf(np.asarray(profile, np.float32))
    if falloff and light.type != "SUN":
        emitter["falloff"] = falloff
        emitter["unit"] = scale
    return emitter


def read_profile(light, name, frame, notes):
    """Emission of a light's nodes by direction, which Cycles evaluates.

    Parameters
    ----------
    light : bpy.types.Light
    name : str
        Object name, for notes.
    frame : int
        Of the animation.
    notes : Notes

    Returns
    -------
    array, shape (v, u, 3), or None
        See `export_lamp`; None where it cannot be known.
    """
    try:
        profile = baking.bake_lamp(light, *PROFILE, frame)
    except baking.BakingFailed as error:
        notes.add(name, "Light nodes", f"not baked, {error}")
        return None
    for source in upstream(Pin(output_node(light.node_tree).inputs["Surface"])):
        kind = source.node.bl_idname.removeprefix("ShaderNode")
        effect = (
            _OF_STAND_IN.get(kind)
            or _OF_STAND_IN.get((kind, source.socket.name))
            or effect_beside_surfaces(source)
        )
        if effect:
            notes.add(name, f"{source.node.bl_label} node", effect)
    mean = profile.mean((0, 1), float, keepdims=True)
    if np.abs(profile - mean).max() <= 2e-3 * mean.max():
        return mean
    how = ", not over its face: use an emitting mesh for a picture on it" if light.type == "AREA" else ""
    notes.add(name, "Light nodes", f"baked by direction, as they are one unit away{how}")
    if light.type == "SUN":
        return profile[-1:].mean((0, 1), float, keepdims=True)  # of straight on, where alone it shines
    return profile


def emission_varies(light):
    """Whether a light's node tree is not constant, so that `export_lamp` needs a profile."""
    return bool(_emission(light)[2])


def _emission(light):
    """Color times strength of the node tree, its falloff, and its parts that are not constant."""
    color, falloff, ignored = np.ones(3), 0, []
    if not light.use_nodes or light.node_tree is None:
        return color, falloff, ignored
    output = output_node(light.node_tree)
    source = follow(Pin(output.inputs["Surface"])) if output else None
    if source is None or not source.socket.is_output or source.node.mute:
        return np.zeros(3), falloff, ignored
    if source.node.bl_idname != "ShaderNodeEmission":
        return color, falloff, ["Light nodes"]
    for socket_name in ("Color", "Strength"):
        value = follow(source.input(socket_name))
        kelvin = _constant_input(value, "ShaderNodeBlackbody", "Temperature")
        strength = _constant_input(value, "ShaderNodeLightFalloff", "Strength")
        if not value.socket.is_output:
            plain = value.socket.default_value
            color = color * (np.array(plain)[:3] if socket_name == "Color" else plain)
        elif kelvin is not None and socket_name == "Color":
            color = color * blackbody_color(kelvin)
        elif strength is not None and _constant_input(value, "ShaderNodeLightFalloff", "Smooth") == 0:
            color = color * strength
            falloff = FALLOFFS[value.socket.name]
        else:
            ignored.append(f"Node on the light's {socket_name}")
    return color, falloff, ignored


def _constant_input(source, node, name):
    """Value of an input of the node that feeds a socket, if the node has this type and the value is constant."""
    if not source.socket.is_output or source.node.bl_idname != node:
        return None
    value = follow(source.input(name))
    return None if value.socket.is_output else value.socket.default_value


def _point(light, color, lengths, scale):
    radius = light.shadow_soft_size
    # radiance = power / (pi area) of a sphere; without a size, power / 4 pi is the intensity
    intensity = color / (4 * math.pi)
    if not getattr(light, "normalize", True):
        intensity = color * (radius**2 if radius > 0 else 1 / math.pi)
    return {
        "type": "point_lamp",
        "intensity": _rgb(intensity * scale**2),
        "radius": radius * scale,
        "sphere": not getattr(light, "use_soft_falloff", True),
    }


def _spot(light, color, lengths, scale):
    return _point(light, color, lengths, scale) | {"cone": light.spot_size / 2, "blend": light.spot_blend}


def _area(light, color, lengths, scale):
    width = light.size * lengths[0]
    height = (light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size) * lengths[1]
    round = light.shape in ("DISK", "ELLIPSE")
    area = width * height * (math.pi / 4 if round else 1)
    if area == 0:
        return None
    return {
        "type": "area_lamp",
        "radiance": _rgb(color / math.pi / (area if getattr(light, "normalize", True) else 1)),
        "width": width * scale,
        "height": height * scale,
        "round": round,
        "spread": light.spread,
    }


def _sun(light, color, lengths, scale):
    half = light.angle / 2
    if half > 0:
        # radiance times solid angle; a floor that faces the sun receives radiance times pi sin^2
        radiance = color / (math.pi * math.sin(half) ** 2) if getattr(light, "normalize", True) else color
        color = radiance * 4 * math.pi * math.sin(half / 2) ** 2
    return {"type": "sun_lamp", "irradiance": _rgb(color), "radius": half}


def _rgb(color):
    return [float(v) for v in color]
