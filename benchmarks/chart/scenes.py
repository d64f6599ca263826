"""The chart's nine scenes, each with what its surfaces ask of a method, and hills of any number of triangles."""

import math
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holopath_addon import engine

from ..scenes import FOV, Scenes
from .photograph import photograph
from .portrait import portrait

WIDE = math.radians(36)


@dataclass(frozen=True)
class Scene:
    """A scene of the chart.

    Attributes
    ----------
    what : str
        In a few words.
    build : callable
        ``build(Scenes(), pixels)`` gives the scene and its `engine.Camera`.
    foci : (float, float, float)
        World depths of what stands in front, in the middle and at the back, meters.
    asks : frozenset of str
        Of 'mirrors', 'glass', 'gloss' and 'indirect': light that pictures with one depth a pixel cannot hold.
    """

    what: str
    build: Callable
    foci: tuple
    asks: frozenset = frozenset()

    @property
    def shiny(self):
        """Whether there are mirrors, glass or gloss."""
        return bool(self.asks & {"mirrors", "glass", "gloss"})


def _seen(make, fov=FOV):
    """`Scene.build` of a scene whose camera is at the origin."""
    return lambda s, pixels: (make(s), engine.Camera(np.eye(4), fov))


def _lamp(s, place, target, size, radiance):
    """A square lamp; large ones where mirrors and glass throw its light on surfaces, which paths find by chance."""
    to_world = s.T().look_at(origin=place, target=target, up=[0, 1, 0]).scale(size)
    return {"type": "rectangle", "to_world": to_world, **s.emissive(s.gray(radiance))}


def _color(red, green, blue):
    return {"type": "rgb", "value": [red, green, blue]}


def suzanne(s, pixels):
    """The demo scene, by the exporter; needs bpy."""
    os.environ.setdefault("BLENDER_USER_RESOURCES", tempfile.mkdtemp(prefix="holopath-chart-"))
    from holopath_addon.cli.sources import open_source

    loaded = open_source("demo:suzanne").load(pixels, pixels)
    return loaded.scene, loaded.camera


def mirror(s):
    """Bricks before a mirror and bricks beside the view, which are seen in it; behind these a picture."""
    bricks = {}
    places = [
        (-0.06, -0.07, -0.62, (0.7, 0.05, 0.03), 20),
        (-0.07, -0.03, -0.64, (0.9, 0.7, 0.05), -15),
        (0.055, -0.09, -0.80, (0.05, 0.25, 0.7), 40),
        (0.26, -0.08, -1.10, (0.1, 0.5, 0.1), 65),
        (0.27, -0.03, -1.12, (0.8, 0.8, 0.75), 40),
        (0.40, -0.09, -0.98, (0.8, 0.35, 0.05), 10),
    ]
    for number, (x, y, z, dye, turn) in enumerate(places):
        bricks |= _brick(s, f"brick_{number}", np.array([x, y, z]), s.diffuse(_color(*dye)), turn)
    behind = s.T().translate([0.9, 0, -0.6]).rotate([0, 1, 0], -70).scale([0.9, 0.5, 1])
    return s.scene(
        mirror=s.plane(1.2, {"bsdf": {"type": "conductor"}}, slant=35),
        picture={"type": "rectangle", "to_world": behind, **s.diffuse(s.texture(256, 5))},
        table=s.box([-1, -0.16, -1.6], [1.2, -0.13, -0.5], s.diffuse(s.texture(128, 6, 0.2, 0.7))),
        lamp=_lamp(s, [-1.0, 1.5, 1], [0.2, 0, -1], 1.2, 3.0),
        sky={"type": "constant", "radiance": s.gray(0.3)},
        **bricks,
    )


def _brick(s, name, foot, surface, turn, half=(0.036, 0.018, 0.02)):
    """A toy brick with two rows of studs."""
    half = np.array(half)
    shapes = {name: s.box(foot - half, foot + half, surface, turn)}
    angle = math.radians(turn)
    for number, (u, v) in enumerate((u, v) for u in (-0.5, 0.5) for v in (-0.5, 0.5)):
        x, z = u * half[0], v * half[2]
        top = foot + [
            x * math.cos(angle) + z * math.sin(angle),
            half[1],
            z * math.cos(angle) - x * math.sin(angle),
        ]
        stud = s.turned([0.007, 0.007, 0.0], [0.0, 0.007, 0.0071], top, surface, 24)
        shapes[f"{name}_stud_{number}"] = stud
    return shapes


def glass(s):
    """A glass ball before a staircase that leads away and up to a wall."""
    steps = {
        f"step_{k}": s.box(
            [-0.6, -0.4, -0.95 - 0.13 * k],
            [0.6, -0.2 + 0.045 * k, -0.82 - 0.13 * k],
            s.diffuse(s.texture(128, 30 + k, 0.1 + 0.05 * (k % 2), 0.9, contrast=2)),
        )
        for k in range(9)
    }
    return s.scene(
        ball={"type": "sphere", "center": [0, -0.02, -0.6], "radius": 0.05, "bsdf": {"type": "dielectric"}},
        wall=s.plane(2.05, s.diffuse(s.texture(256, 1))),
        lamp=_lamp(s, [1.2, 2, 0.6], [0, 0, -1.4], 1.2, 3.0),
        **steps,
    )


def tea(s):
    """A varnished tea set on a lacquered table, before a papered wall, under two lamps."""
    up = np.linspace(0, 1, 33)
    belly = 0.012 + 0.062 * np.sin(np.pi * up**0.9) ** 0.8
    lid = 0.034 * np.sqrt(np.maximum(1 - up**2, 0))
    cup = 0.018 + 0.022 * up**0.5
    knob = 0.009 * np.sin(np.pi * np.clip(up, 0.05, 1))
    blue = s.texture(128, 41, np.float32([0.02, 0.05, 0.3]), np.float32([0.85, 0.85, 0.8]), 2, 1)
    red = s.texture(64, 42, np.float32([0.4, 0.03, 0.02]), np.float32([0.85, 0.7, 0.5]), 2, 1)
    wood = s.texture(256, 43, np.float32([0.12, 0.06, 0.03]), np.float32([0.45, 0.28, 0.14]), 2, 1)

    def glazed(reflectance, alpha):
        varnish = {"type": "roughplastic", "distribution": "ggx", "diffuse_reflectance": reflectance}
        return {"bsdf": {"type": "twosided", "bsdf": varnish | {"alpha": alpha}}}

    foot, china = -0.12, glazed(blue, 0.08)
    pot, near, far = np.array([0.03, foot, -0.85]), [-0.065, foot, -0.6], [0.13, foot, -1.15]

    def saucer(center, surface):
        return s.turned([0.0, 0.03, 0.052], [0.002, 0.003, 0.011], center, surface)

    def lifted(center, height):
        return np.add(center, [0, height, 0])

    return s.scene(
        table=s.box([-0.8, foot - 0.03, -1.7], [0.8, foot, -0.4], glazed(wood, 0.15)),
        wall=s.plane(1.7, s.diffuse(s.texture(256, 44, 0.3, 0.9))),
        pot=s.turned(belly, 0.13 * up, pot, china, 64),
        lid=s.turned(lid, 0.12 + 0.024 * up, pot, glazed(red, 0.05), 48),
        knob=s.turned(knob, 0.142 + 0.02 * up, pot, glazed(red, 0.05), 32),
        near_saucer=saucer(near, glazed(red, 0.08)),
        near_cup=s.turned(cup, 0.005 + 0.045 * up, near, china, 48),
        far_saucer=saucer(far, china),
        far_cup=s.turned(cup, 0.005 + 0.045 * up, far, glazed(red, 0.08), 48),
        bowl=s.ball(0.035, lifted([-0.14, foot, -1.1], 0.035), glazed(_color(0.1, 0.35, 0.15), 0.03)),
        lamp=_lamp(s, [0.5, 0.9, -0.3], [0, 0, -0.9], 0.15, 30.0),
        window=_lamp(s, [-1.2, 0.8, 0.2], [0, 0, -1], 0.4, 8.0),
    )


def room(s, triangles=2_000_000):
    """The study with a deep carpet of as many triangles."""
    side = round(math.sqrt(triangles / 2))
    v, u = np.mgrid[0 : side + 1, 0 : side + 1] / side
    pile = 0.004 * np.sin(400 * u) * np.sin(600 * v)
    vertices = np.stack([-0.8 + 1.3 * u, -0.93 + pile, -1.6 - 2.0 * v], axis=-1)
    return s.room(pile=s.mesh(vertices, s.diffuse(s.texture(64, 15, contrast=2))))


def hills(s, triangles):
    """A slope of hills from 0.6 to 1.8 m, of as many triangles; nothing else, so that only their number changes."""
    side = round(math.sqrt(triangles / 2))
    v, u = np.mgrid[0 : side + 1, 0 : side + 1] / side
    depth = 1 / (1 / 0.6 + (1 / 1.8 - 1 / 0.6) * v)
    depth += 0.02 * depth * np.sin(40 * u) * np.sin(30 * v)
    half = 1.2 * math.tan(FOV / 2) * depth
    vertices = np.stack([(2 * u - 1) * half, (2 * v - 1) * half, -depth], axis=-1)
    return s.scene(
        hills=s.mesh(vertices, s.diffuse(s.texture(256, 4, contrast=2))),
        lamp=_lamp(s, [0.8, 1.5, 0.8], [0, 0, -1], 0.4, 20.0),
    )


SCENES = {
    "planes": Scene("three shining textured planes", _seen(lambda s: s.three_planes()), (0.5, 1.0, 2.0)),
    "suzanne": Scene("Suzanne in a room", suzanne, (0.5, 1.0, 4.0)),
    "mirror": Scene("toy bricks in a mirror", _seen(mirror), (0.62, 1.1, 2.1), frozenset({"mirrors"})),
    "glass": Scene("a glass ball before a staircase", _seen(glass), (0.6, 1.0, 2.0), frozenset({"glass"})),
    "tea": Scene("a varnished tea set", _seen(tea), (0.58, 0.85, 1.7), frozenset({"gloss"})),
    "box": Scene(
        "a closed box, all light indirect",
        _seen(lambda s: s.closed_box()),
        (0.87, 1.25, 2.0),
        frozenset({"indirect"}),
    ),
    "room": Scene(
        "a study with a carpet of 2 million triangles",
        _seen(room, WIDE),
        (0.8, 1.5, 4.0),
        frozenset({"mirrors", "glass", "gloss", "indirect"}),
    ),
    "portrait": Scene("a head with hair in soft light", _seen(portrait), (0.65, 0.72, 2.2)),
    "photograph": Scene("a photograph with depth", photograph, (0.7, 1.6, 8.0)),
}
TRIANGLES = (2_000, 20_000, 200_000, 2_000_000)


def built(name, pixels):
    """The scene of a name in `SCENES`, or of ``hills N`` with N triangles, and its camera."""
    if name.startswith("hills "):
        return _seen(lambda s: hills(s, int(name.split()[1])))(Scenes(), pixels)
    return SCENES[name].build(Scenes(), pixels)
