"""Worlds: colors, pictures, skies and nodes that mix them, and what the film does to them."""

import numpy as np

from .feature import EVERYWHERE, Feature
from .staging import PRINCIPLED, ball, node, ramp, shader_of, surface, tan


def _outdoors(stage):
    """A rough and a shiny ball, seen from the side with the horizon behind them."""
    ball(stage, tan(stage), 0.7, (-0.7, 0, 0), "rough")
    ball(stage, stage.material(PRINCIPLED, Metallic=1.0, Roughness=0.3), 0.7, (0.7, 0, 0), "shiny")
    stage.camera.location, stage.camera.rotation_euler = (0.5, -4.2, 0.8), (1.38, 0, 0.12)
    stage.camera.data.lens = 40


def _color(stage, tree, background):
    background.inputs["Color"].default_value = (0.2, 0.4, 0.6, 1)
    background.inputs["Strength"].default_value = 1.5


def hdri(rotation=None, kind="POINT"):
    def wire(stage, tree, background):
        pixels = 0.1 + np.random.default_rng(5).random((8, 16, 3)) ** 2
        image = stage.image(np.kron(pixels, np.ones((8, 8, 1))), "sky", True, "Linear Rec.709")
        texture = node(tree, "TexEnvironment", image=image)
        background.inputs["Strength"].default_value = 1.5
        tree.links.new(texture.outputs[0], background.inputs["Color"])
        if rotation:
            at = node(tree, "TexCoord").outputs["Generated"]
            mapping = node(tree, "Mapping", vector_type=kind, Vector=at, Rotation=rotation)
            tree.links.new(mapping.outputs[0], texture.inputs["Vector"])

    return wire


def _hdri_through_nodes(stage, tree, background):
    hdri((0, 0, 0.7))(stage, tree, background)
    color = background.inputs["Color"].links[0].from_socket
    tinted = node(tree, "Mix", data_type="RGBA", blend_type="MULTIPLY", Factor_Float=1.0)
    tree.links.new(color, tinted.inputs[6])
    tinted.inputs[7].default_value = (1, 0.7, 0.4, 1)
    tree.links.new(tinted.outputs[2], background.inputs["Color"])


def _sky(kind, disc=False, **values):
    def wire(stage, tree, background):
        strength = 0.5 if kind in ("PREETHAM", "HOSEK_WILKIE") else 0.05
        background.inputs["Strength"].default_value = strength
        sky = node(tree, "TexSky", sky_type=kind, **values)
        if kind in ("PREETHAM", "HOSEK_WILKIE"):
            sky.sun_direction = (0.5, -0.5, 0.7)
        else:
            sky.sun_disc, sky.sun_elevation, sky.sun_rotation = disc, 0.7, 2.5
        tree.links.new(sky.outputs[0], background.inputs["Color"])

    return wire


def _mixed_worlds(stage, tree, background):
    """Two Backgrounds, mixed by height."""
    background.inputs["Color"].default_value = (0.5, 0.3, 0.1, 1)
    other = node(tree, "Background", Color=(0.2, 0.4, 0.9, 1))
    height = node(tree, "SeparateXYZ", Vector=node(tree, "TexCoord").outputs["Generated"]).outputs["Z"]
    factor = node(tree, "MapRange", Value=height, From_Min=-1.0).outputs[0]
    mix = node(tree, "MixShader")
    for socket, source in zip(mix.inputs, (factor, background.outputs[0], other.outputs[0]), strict=True):
        tree.links.new(source, socket)
    surface(stage, tree, mix.outputs[0])


def _gradient(stage, tree, background):
    at = node(tree, "TexCoord").outputs["Generated"]
    height = node(tree, "SeparateXYZ", Vector=at).outputs["Z"]
    tree.links.new(ramp(tree, height), background.inputs["Color"])


def _blackbody_world(stage, tree, background):
    tree.links.new(node(tree, "Blackbody", Temperature=4000.0).outputs[0], background.inputs["Color"])


WORLDS = {
    "world color": _color,
    "HDRI": hdri(),
    "HDRI, turned": hdri((0.4, -0.3, 1.1)),
    "HDRI, turned, texture mapping": hdri((0.4, -0.3, 1.1), "TEXTURE"),
    "HDRI, tinted": _hdri_through_nodes,
    "sky, single scattering": _sky("SINGLE_SCATTERING"),
    "sky, single scattering, sun disc": _sky("SINGLE_SCATTERING", True),
    "sky, single scattering, large sun disc": _sky("SINGLE_SCATTERING", True, sun_size=0.2),
    "sky, multiple scattering": _sky("MULTIPLE_SCATTERING"),
    "sky, multiple scattering, sun disc": _sky("MULTIPLE_SCATTERING", True),
    "sky, Preetham": _sky("PREETHAM"),
    "sky, Hosek and Wilkie": _sky("HOSEK_WILKIE"),
    "world, ColorRamp of height": _gradient,
    "world, mix of Backgrounds": _mixed_worlds,
    "world, Blackbody": _blackbody_world,
}


def _under(wire):
    def build(stage):
        made = stage.world((1, 1, 1), 1.0)
        wire(stage, made.node_tree, shader_of(made.node_tree))
        _outdoors(stage)

    return build


def _clear(stage):
    _outdoors(stage)
    stage.world((0.5, 0.6, 0.8), 1.0)
    stage.scene.render.film_transparent = True


def _exposed(stage):
    _outdoors(stage)
    stage.world((0.5, 0.6, 0.8), 1.0)
    stage.scene.view_settings.exposure, stage.scene.cycles.film_exposure = 2.0, 3.0


def _unexposed(stage):
    stage.scene.cycles.film_exposure = 1.0


FEATURES = [
    *(Feature(name, "world", _under(wire), EVERYWHERE) for name, wire in WORLDS.items()),
    Feature("film transparent", "world", _clear, EVERYWHERE),
    Feature(
        "exposure is not baked in",
        "world",
        _exposed,
        EVERYWHERE,
        notes=frozenset({"Film Exposure"}),
        reference=_unexposed,
    ),
]
