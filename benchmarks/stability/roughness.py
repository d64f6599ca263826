"""Low roughness, from perfectly smooth surfaces on: mirrors, curved mirrors, panes and coats.

A δ lobe is followed as a chain of rays, a broad lobe is light that leaves the surface itself; between them brightness
and sharpness must pass without a step.
"""

from functools import partial

import numpy as np

from holopath_addon import engine

from ..scenes import FOV, GREEN, Scenes
from .sweep import Sweep

SIDE, FRAMES, SPP = 256, 24, 128
# Mitsuba's alpha, the square of Blender's roughness: 0.3 is a roughness of 0.55
SMALL = (
    0.0,
    0.0005,
    0.001,
    0.002,
    0.003,
    0.004,
    0.005,
    0.0055,
    0.006,
    0.0062,
    0.0065,
    0.007,
    0.008,
    0.01,
    0.012,
    0.015,
    0.02,
    0.025,
    0.03,
)
ALPHAS = (*SMALL, 0.04, 0.05, 0.06, 0.08, 0.1, 0.12, 0.15, 0.18, 0.21, 0.24, 0.27, 0.3)
FOLLOWED = (
    "Narrow lobes are followed as if they were δ, to place their light; broad ones stay on the surface."
)


def figures(scene, focus):
    """PSNR in dB and brightness ratio against Mitsuba's thin-lens camera, focused at a depth in meters."""
    camera = engine.Camera(np.eye(4), FOV)
    far, near = (
        SIDE / 256 * 1e-3,
        SIDE / 256 * 6e-3,
    )  # the aperture cuts the same share of a picture of any size
    border = SIDE // 10
    hologram = engine.Hologram(SIDE, SIDE, 8e-6, (GREEN,), depth_far=far, depth_near=near)
    field = engine.render(scene, camera, hologram, engine.Settings(frames=FRAMES))
    picture = engine.reconstruct(field, [focus])[0]
    truth = engine.reference(scene, camera, hologram, [focus], spp=SPP, near=field.near)[0]
    inner = slice(border, -border)
    ratio = float(picture[inner, inner].mean() / truth[inner, inner].mean())
    return {"psnr": engine.psnr(picture, truth, border), "brightness": ratio}


def metal(alpha, **colors):
    """A metal mirror, rough but for alpha 0."""
    if alpha == 0:
        return {"bsdf": {"type": "conductor", **colors}}
    return {"bsdf": {"type": "roughconductor", "distribution": "ggx", "alpha": alpha, **colors}}


def card(build):
    """A textured strip at 0.5 m: with it the depths in view, and so where they are recorded, hardly change."""
    return build.plane(0.5, build.emissive(build.texture(64, 2)), 0.015, 0.1, x=-0.05)


def beside(build, bsdf, half=0.3):
    """A square at 0.7 m, turned by 45 degrees, and a textured plane 2.3 m to its right: its image lies at 3 m."""
    t = build.T
    turned = t().translate([0, 0, -0.7]).rotate([0, 1, 0], 45).scale(half)
    side = t().translate([2.3, 0, -0.7]).rotate([0, 1, 0], -90).scale(0.75)
    return build.scene(
        square={"type": "rectangle", "to_world": turned, **bsdf},
        side={"type": "rectangle", "to_world": side, **build.emissive(build.texture(128, 1))},
        card=card(build),
    )


def flat_mirror(alpha, focus):
    """A plain mirror."""
    build = Scenes()
    return figures(beside(build, metal(alpha)), focus)


def marked_mirror(alpha, focus):
    """A mirror whose reflectance has a texture."""
    build = Scenes()
    marks = build.texture(64, 3, 0.2, 1.0, contrast=2)
    return figures(beside(build, metal(alpha, specular_reflectance=marks)), focus)


def convex_mirror(alpha, focus):
    """A ball of radius 1 m with its vertex at 1 m; a lamp 1.5 m from it has its image 0.375 m behind it."""
    build = Scenes()
    turn = build.T().translate([0, 0, 0.5]).rotate([0, 1, 0], 180).scale(1.6)
    return figures(
        build.scene(
            ball={"type": "sphere", "center": [0, 0, -2], "radius": 1.0, **metal(alpha)},
            lamp={"type": "rectangle", "to_world": turn, **build.emissive(build.texture(256, 1))},
            card=card(build),
        ),
        focus,
    )


def pane(alpha, focus):
    """A glass slab before a textured wall at 2 m."""
    build = Scenes()
    glass = (
        {"type": "dielectric"}
        if alpha == 0
        else {"type": "roughdielectric", "distribution": "ggx", "alpha": alpha}
    )
    place = build.T().translate([0, 0, -0.7]).rotate([0, 1, 0], 20).scale([0.3, 0.3, 0.05])
    return figures(
        build.scene(
            slab={"type": "cube", "to_world": place, "bsdf": glass | {"int_ior": 1.5, "ext_ior": 1.0}},
            wall=build.plane(2.0, build.emissive(build.texture(256, 1))),
            card=card(build),
        ),
        focus,
    )


def coat(alpha, focus):
    """Plastic of a strong reflection, and a texture below it."""
    build = Scenes()
    color = {"int_ior": 1.9, "diffuse_reflectance": build.texture(64, 3, 0.1, 0.5)}
    plastic = (
        {"type": "plastic"} if alpha == 0 else {"type": "roughplastic", "distribution": "ggx", "alpha": alpha}
    )
    return figures(beside(build, {"bsdf": plastic | color}), focus)


def sweep(name, measure, focus, quick=()):
    """Roughness from a δ lobe on, in a scene that is focused at a depth in meters."""
    return Sweep(
        name,
        "from a δ lobe to a narrow and a broad one",
        "alpha",
        ALPHAS,
        partial(measure, focus=focus),
        FOLLOWED,
        quick,
    )


SWEEPS = [
    sweep("rough mirror, image", flat_mirror, 3.0, (0.0, 0.0005)),
    sweep("rough mirror, surface", marked_mirror, 0.7, (0.0, 0.0005)),
    sweep("rough convex mirror", convex_mirror, 1.375, (0.0, 0.0005)),
    sweep("rough pane", pane, 2.0),
    sweep("rough coat, image", coat, 3.0),
    sweep("rough coat, surface", coat, 0.7),
]
