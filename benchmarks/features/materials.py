"""Shaders: every input of the Principled BSDF, the other BSDFs, and nodes that mix them."""

from typing import Any

import bpy

from .feature import BALL, BOUND, MIDDLE, Feature
from .staging import (
    BLUE,
    DIFFUSE,
    EMISSION,
    GLASS,
    GLOSSY,
    PRINCIPLED,
    TAN,
    TRANSPARENT,
    WHITE,
    backdrop,
    ball,
    lit,
    node,
    shader_of,
    studio,
    surface,
    tan,
    tilted,
)

# Principled inputs that are varied one at a time: the other inputs, and the values.
_TINT = (0.9, 0.4, 0.2, 1)
_METAL = dict(Metallic=1.0, Roughness=0.4)
_DARK = dict(Base_Color=(0.05, 0.05, 0.05, 1), Roughness=0.3)
PRINCIPLED_INPUTS = (
    ("Metallic", {}, (0.0, 0.5, 1.0)),
    ("Roughness", {}, (0.0, 0.1, 0.3, 1.0)),
    ("Roughness", dict(Metallic=1.0), (0.0, 0.1, 0.3, 1.0)),
    ("IOR", dict(Roughness=0.3), (0.0, 1.1, 1.8, 2.5)),
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


_REFRACTION = "ShaderNodeBsdfRefraction"
CLEAR = (GLASS, _REFRACTION)
SHADERS = {
    "Diffuse BSDF": (DIFFUSE, dict(Color=TAN)),
    "Diffuse BSDF roughness 0.5": (DIFFUSE, dict(Color=TAN, Roughness=0.5)),
    "Diffuse BSDF roughness 1": (DIFFUSE, dict(Color=TAN, Roughness=1.0)),
    "Glossy BSDF roughness 0": (GLOSSY, dict(Color=TAN, Roughness=0.0)),
    "Glossy BSDF roughness 0.1": (GLOSSY, dict(Color=TAN, Roughness=0.1)),
    "Glossy BSDF roughness 0.4": (GLOSSY, dict(Color=TAN, Roughness=0.4)),
    "Glossy BSDF roughness 1": (GLOSSY, dict(Color=TAN, Roughness=1.0)),
    "Glossy BSDF anisotropy 0.7": (GLOSSY, dict(Color=TAN, Roughness=0.4, Anisotropy=0.7)),
    "Glass BSDF roughness 0": (GLASS, dict(Color=WHITE, Roughness=0.0)),
    "Glass BSDF roughness 0.3": (GLASS, dict(Color=WHITE, Roughness=0.3)),
    "Glass BSDF roughness 1": (GLASS, dict(Color=WHITE, Roughness=1.0)),
    "Glass BSDF IOR 1.2, tinted": (GLASS, dict(Color=TAN, Roughness=0.0, IOR=1.2)),
    "Refraction BSDF roughness 0": (_REFRACTION, dict(Color=WHITE, Roughness=0.0, IOR=1.4)),
    "Refraction BSDF roughness 0.3": (_REFRACTION, dict(Color=WHITE, Roughness=0.3, IOR=1.4)),
    "Emission": (EMISSION, dict(Color=TAN, Strength=2.0)),
}


SHADERS_APPROXIMATE = {
    "Glass BSDF roughness 1": dict(bound=0.1, reason=_WIDE),
    "Glossy BSDF anisotropy 0.7": dict(notes=frozenset({_AXIS[0]})),
}


def _mixed_with_transparent(stage):
    material = tan(stage)
    stage.mix(material, TRANSPARENT, 0.4)
    return material


def _only_volume(stage):
    """A material whose output has a volume and no surface: what lies behind it is seen, as through air."""
    material = stage.material(TRANSPARENT)
    tree = material.node_tree
    output = next(n for n in tree.nodes if n.bl_idname.startswith("ShaderNodeOutput"))
    tree.links.remove(output.inputs["Surface"].links[0])
    tree.links.new(node(tree, "VolumeAbsorption", Density=0.0).outputs[0], output.inputs["Volume"])
    return material


PANES = {
    "Transparent BSDF": lambda stage: stage.material(TRANSPARENT, Color=(1, 1, 1, 1)),
    "Transparent BSDF gray": lambda stage: stage.material(TRANSPARENT, Color=(0.5, 0.5, 0.5, 1)),
    "Transparent BSDF tinted": lambda stage: stage.material(TRANSPARENT, Color=(0.9, 0.4, 0.2, 1)),
    "Mix with Transparent": _mixed_with_transparent,
    "single sheet of Glass": lambda stage: stage.material(GLASS, Color=WHITE, Roughness=0.0),
    "single sheet of Principled, transmission 1": lambda stage: stage.material(
        PRINCIPLED, Base_Color=WHITE, Roughness=0.2, Transmission_Weight=1.0
    ),
}


def _mix(stage):
    material = tan(stage)
    _, gloss = stage.mix(material, GLOSSY, 0.3)
    gloss.inputs["Roughness"].default_value = 0.3
    return material


def _by_angle(kind, output, **values):
    """Gloss over a matt surface by a Fresnel or Layer Weight node."""

    def make(stage):
        material = tan(stage)
        tree = material.node_tree
        mix, gloss = stage.mix(material, GLOSSY)
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
    """A Diffuse BSDF inside a group inside a group, its color from outside."""
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


def _principled_under_lamp(stage):
    ball(stage, stage.material(PRINCIPLED, Base_Color=TAN, Roughness=0.4))
    stage.lamp("AREA", 100, (1.5, 1, 3), (-0.3, 0.45, 0), size=1.0)
    stage.world((1, 1, 1), 0.1)


def _principled(name, common, value, behind=None, bound=BOUND, reason="", notes=frozenset()):
    socket = {"Transmission roughness": "Roughness", "Transmission IOR": "IOR"}.get(name, name)
    values = {"Base_Color": TAN, "Roughness": 0.5, **common, socket.replace(" ", "_"): value}

    def build(stage):
        ball(stage, stage.material(PRINCIPLED, **values))
        studio(stage)
        if behind:
            behind(stage)

    shown = "tinted" if isinstance(value, tuple) else f"{value:g}"
    besides = {k: v for k, v in common.items() if not isinstance(v, tuple)}
    besides = "".join(f", {k.replace('_', ' ').lower()} {v:g}" for k, v in besides.items())
    label = f"Principled {name} {shown}{besides}"
    return Feature(label, "materials", build, BALL, bound, reason, notes, depth=8 if behind else 6)


def _shaded(kind, values):
    def build(stage):
        ball(stage, stage.material(kind, **values))
        studio(stage)
        if kind in CLEAR:
            backdrop(stage)

    return build


def _pane(make):
    def build(stage):
        stage.plane(1.6, make(stage), "pane", (0, 0, 0.5))
        backdrop(stage)

    return lit(build)


def _worn(make):
    return lit(lambda stage: ball(stage, make(stage)))


FEATURES = [
    *(_principled(name, common, value) for name, common, values in PRINCIPLED_INPUTS for value in values),
    *(
        _principled(name, common, value, backdrop)
        for name, common, values in PRINCIPLED_CLEAR
        for value in values
    ),
    *(
        _principled(name, common, value, None, bound, reason, frozenset({note}))
        for name, common, values, bound, (note, reason) in PRINCIPLED_APPROXIMATE
        for value in values
    ),
    _principled("Transmission roughness", dict(Transmission_Weight=1.0), 1.0, backdrop, 0.1, _WIDE),
    *(
        Feature(
            name,
            "materials",
            _shaded(kind, values),
            depth=8 if kind in CLEAR else 6,
            **SHADERS_APPROXIMATE.get(name, {}),
        )
        for name, (kind, values) in SHADERS.items()
    ),
    *(Feature(name, "materials", _pane(make), MIDDLE, depth=8) for name, make in PANES.items()),
    Feature("volume alone", "materials", _pane(_only_volume), MIDDLE, depth=8, notes=frozenset({"Volume"})),
    *(Feature(name, "materials", _worn(make)) for name, make in NODES.items()),
    Feature("Translucent BSDF", "materials", lit(_translucent), MIDDLE),
    Feature("Principled under an area lamp", "materials", _principled_under_lamp),
]
