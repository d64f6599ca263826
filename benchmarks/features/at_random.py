"""Scenes of several features at random."""

import math

import bpy
import numpy as np
from mathutils import Vector

from ..stage import added
from .feature import EVERYWHERE, Feature
from .geometry import curve
from .staging import (
    DIFFUSE,
    EMISSION,
    GLASS,
    GLOSSY,
    PRINCIPLED,
    ball,
    cube,
    cylinder,
    floor,
    monkey,
    node,
    painted,
    shader_of,
    text,
)
from .textures import PROCEDURAL, extension
from .world import hdri


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
    floor(stage, color=_random_color(rng))
    for number in range(rng.integers(3, 6)):
        _random_object(stage, rng, _random_material(stage, rng, sharp=not lamps), number)
    if lamps:
        for _ in range(rng.integers(1, 4)):
            _random_lamp(stage, rng)
    else:
        panel = stage.plane(1.5, stage.material(EMISSION, "panel", Strength=6.0), "panel", (1.5, 1.5, 4))
        panel.rotation_euler = (-0.4, 0.4, 0)
    tree = stage.world(_random_color(rng)[:3], rng.uniform(0.1, 0.5)).node_tree
    if rng.random() < 0.5:
        background = shader_of(tree)
        hdri(tuple(rng.uniform(-1, 1, 3)))(stage, tree, background)
        background.inputs["Strength"].default_value = rng.uniform(0.2, 0.8)
    around, height = rng.uniform(0, 2 * math.pi), rng.uniform(2.0, 3.5)
    place = np.array([2.4 * math.cos(around), 2.4 * math.sin(around), height])
    stage.camera.location = place
    stage.camera.rotation_euler = Vector(-place).to_track_quat("-Z", "Y").to_euler()
    data = stage.camera.data
    data.sensor_fit = str(rng.choice(["AUTO", "HORIZONTAL", "VERTICAL"]))
    data.lens, data.shift_x, data.shift_y = rng.uniform(25, 45), *rng.uniform(-0.1, 0.1, 2)


def _random_color(rng):
    return (*rng.uniform(0.1, 0.9, 3), 1)


def _random_material(stage, rng, sharp):
    kind = rng.choice(["diffuse", "plastic", "metal", "glossy", "mix", "image", "noise", "glow", "glass"])
    rough = rng.uniform(0.3, 0.6)
    color = _random_color(rng)
    if kind == "diffuse" or (kind == "glass" and not sharp):
        return stage.material(DIFFUSE, Color=color, Roughness=rng.choice([0.0, 0.5]))
    if kind == "plastic":
        return stage.material(PRINCIPLED, Base_Color=color, Roughness=rough, IOR=rng.uniform(1.3, 1.8))
    if kind == "metal":
        return stage.material(PRINCIPLED, Base_Color=color, Metallic=1.0, Roughness=0.0 if sharp else rough)
    if kind == "glossy":
        return stage.material(GLOSSY, Color=color, Roughness=rough)
    if kind == "mix":
        material = stage.material(DIFFUSE, Color=color)
        _, gloss = stage.mix(material, GLOSSY, rng.uniform(0.2, 0.8))
        gloss.inputs["Roughness"].default_value = rough
        return material
    if kind == "image":
        return painted(stage, extension("MIRROR"), "Base Color", PRINCIPLED, Roughness=rough)
    if kind == "noise":
        return painted(stage, lambda s, tree: PROCEDURAL["Noise Texture"](tree, _object_space(tree)))
    if kind == "glow":
        return stage.material(EMISSION, Color=color, Strength=rng.uniform(0.5, 2))
    return stage.material(GLASS, Color=color, Roughness=0.0, IOR=rng.uniform(1.2, 1.6))


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
        curve(stage, material)
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
    stage.lamp(kind, energy, place, (x, y, 0), color=_random_color(rng)[:3], **values)


def _seeded(seed):
    return lambda stage: random_scene(stage, seed)


FEATURES = [Feature(f"random {seed}", "random", _seeded(seed), EVERYWHERE, depth=8) for seed in range(10)]
