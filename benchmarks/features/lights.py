"""Lamps of every kind, their nodes, and surfaces that emit."""

import math

import bpy
import numpy as np

from .feature import EVERYWHERE, Feature
from .staging import EMISSION, PRINCIPLED, TAN, ball, floor, node, shader_of, tan, tiles

_AIMED = dict(location=(1.2, 0.8, 2.2), rotation=(-0.3, 0.5, 0))


def _set(stage, material=None):
    """A floor with a ball on it."""
    ball(stage, material or tan(stage), 0.6, (-0.2, -0.1, -0.3))
    floor(stage)
    stage.world((1, 1, 1), 0.05)


LAMPS = {
    "point, radius 0": ("POINT", dict(shadow_soft_size=0.0)),
    "point, radius 0.3": ("POINT", dict(shadow_soft_size=0.3)),
    "point, colored": ("POINT", dict(shadow_soft_size=0.1, color=(1, 0.5, 0.1))),
    "point, temperature 3000 K": (
        "POINT",
        dict(shadow_soft_size=0.1, use_temperature=True, temperature=3000),
    ),
    "point, exposure 1": ("POINT", dict(shadow_soft_size=0.1, exposure=1.0)),
    "point, not normalized": ("POINT", dict(shadow_soft_size=0.3, normalize=False)),
    "spot, sharp": ("SPOT", dict(shadow_soft_size=0.0, spot_size=0.8, spot_blend=0.0)),
    "spot, blended": ("SPOT", dict(shadow_soft_size=0.1, spot_size=1.2, spot_blend=0.6)),
    "spot, large": ("SPOT", dict(shadow_soft_size=0.4, spot_size=1.0, spot_blend=0.2)),
    "area, square": ("AREA", dict(size=1.0)),
    "area, rectangle": ("AREA", dict(shape="RECTANGLE", size=1.6, size_y=0.4)),
    "area, disk": ("AREA", dict(shape="DISK", size=1.0)),
    "area, ellipse": ("AREA", dict(shape="ELLIPSE", size=1.6, size_y=0.5)),
    "area, spread 60 degrees": ("AREA", dict(size=0.6, spread=math.radians(60))),
    "area, not normalized": ("AREA", dict(size=1.0, normalize=False, energy=20.0)),
    "sun, angle 0": ("SUN", dict(angle=0.0)),
    "sun, angle 20 degrees": ("SUN", dict(angle=math.radians(20))),
    "sun, not normalized": ("SUN", dict(angle=math.radians(20), normalize=False)),
}


ON_METAL = {"POINT": dict(shadow_soft_size=0.3), "AREA": dict(size=1.0), "SUN": dict(angle=0.3)}


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


def _lamp(kind, values, metal=False):
    def build(stage):
        stage.lamp(kind, **{"energy": 3.0 if kind == "SUN" else 60.0, **_AIMED, **values})
        rough = dict(Base_Color=TAN, Metallic=1.0, Roughness=0.35)
        _set(stage, stage.material(PRINCIPLED, **rough) if metal else None)

    return build


def _lamp_with_nodes(wire):
    def build(stage):
        lamp = stage.lamp("POINT", 60.0, shadow_soft_size=0.2, **_AIMED)
        lamp.data.use_nodes = True
        wire(stage, lamp.data.node_tree, shader_of(lamp.data.node_tree))
        _set(stage)

    return build


FEATURES = [
    *(Feature(name, "lights", _lamp(*lamp), EVERYWHERE) for name, lamp in LAMPS.items()),
    *(Feature(name, "lights", _lamp_with_nodes(wire), EVERYWHERE) for name, wire in LAMP_NODES.items()),
    *(
        Feature(f"{kind.lower()} lamp on a rough metal", "lights", _lamp(kind, size, metal=True), EVERYWHERE)
        for kind, size in ON_METAL.items()
    ),
    Feature(
        "area lamp on a polished ball",
        "lights",
        _lamp_mirrored,
        bound=0.1,
        reason="lamps do not show in mirrors",
        notes=frozenset({"Lamps mirrored in or shining through a smooth or transparent surface"}),
    ),
    Feature("emitting mesh, strength 20", "lights", _emitting_mesh, EVERYWHERE),
    Feature("emitting mesh, textured", "lights", _emitting_texture, EVERYWHERE),
]
