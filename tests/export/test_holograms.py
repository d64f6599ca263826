"""Blender materials as holograms, against Mitsuba's thin-lens picture of the same export."""

import numpy as np
import pytest

from holopath_addon import engine

PRINCIPLED = "ShaderNodeBsdfPrincipled"
GREEN = 516.5e-9


@pytest.mark.parametrize(
    ("node", "values"),
    [
        pytest.param(PRINCIPLED, {"Roughness": 0.0, "Metallic": 0.0}, marks=pytest.mark.slow),
        pytest.param(PRINCIPLED, {"Roughness": 0.0, "Metallic": 0.5}, marks=pytest.mark.slow),
        pytest.param(PRINCIPLED, {"Roughness": 0.0, "Metallic": 1.0}, marks=pytest.mark.slow),
        (PRINCIPLED, {"Roughness": 0.0, "Transmission_Weight": 1.0}),
        pytest.param(PRINCIPLED, {"Roughness": 0.0, "Transmission_Weight": 0.5}, marks=pytest.mark.slow),
        pytest.param(PRINCIPLED, {"Roughness": 0.3, "Metallic": 1.0}, marks=pytest.mark.slow),
        pytest.param(PRINCIPLED, {"Roughness": 0.5}, marks=pytest.mark.slow),
        pytest.param(PRINCIPLED, {"Roughness": 1.0, "Transmission_Weight": 0.5}, marks=pytest.mark.slow),
        pytest.param(PRINCIPLED, {"Roughness": 0.4, "Coat_Weight": 1.0}, marks=pytest.mark.slow),
        pytest.param(PRINCIPLED, {"Roughness": 0.0, "Alpha": 0.5}, marks=pytest.mark.slow),
        pytest.param(PRINCIPLED, {"Roughness": 0.8, "Alpha": 0.5}, marks=pytest.mark.slow),
        pytest.param("ShaderNodeBsdfGlass", {"Roughness": 0.0}, marks=pytest.mark.slow),
        pytest.param("ShaderNodeBsdfGlass", {"Roughness": 0.3}, marks=pytest.mark.slow),
        pytest.param("ShaderNodeBsdfAnisotropic", {"Roughness": 0.1}, marks=pytest.mark.slow),
        pytest.param("ShaderNodeBsdfDiffuse", {}, marks=pytest.mark.slow),
        pytest.param("ShaderNodeEmission", {"Strength": 0.7}, marks=pytest.mark.slow),
    ],
)
def test_a_ball_of_each_material(stage, node, values):
    """A ball before a wall with a bright panel behind the viewer: brightness, and finite everywhere.

    What the exporter makes of each material, test_features compares with Cycles.
    """
    stage.sphere(0.35, stage.material(node, **values))
    stage.plane(6, stage.material("ShaderNodeBsdfDiffuse", Color=(0.4, 0.6, 0.5, 1)), "wall", (0, 0, -1.5))
    panel = stage.plane(2, stage.material("ShaderNodeEmission", Strength=4.0), "panel", (1.5, 1, 6))
    panel.rotation_euler = (np.pi - 0.2, 0.3, 0)
    stage.world((0.3, 0.3, 0.3))
    exported = stage.export((96, 96))
    hologram = engine.Hologram(96, 96, 8e-6, (GREEN,), 0.3e-3, 1.8e-3)
    field = engine.render(
        exported.scene, exported.camera, hologram, engine.Settings(frames=8, quality="preview")
    )
    assert np.isfinite(field.data).all()
    focus = [3.8, 5.5]
    truth = engine.reference(exported.scene, exported.camera, hologram, focus, spp=32, near=field.near)
    for picture, reference in zip(engine.reconstruct(field, focus), truth, strict=True):
        inner = slice(10, -10)
        assert picture[inner, inner].mean() / reference[inner, inner].mean() == pytest.approx(1, abs=0.03)


def test_mixed_shaders(stage):
    """Half mirror, half matt."""
    material = stage.material("ShaderNodeBsdfDiffuse", Color=(0.7, 0.5, 0.3, 1))
    _, mirror = stage.mix(material, "ShaderNodeBsdfAnisotropic", 0.5)
    mirror.inputs["Roughness"].default_value = 0.0
    stage.sphere(0.35, material)
    stage.world((0.5, 0.5, 0.5))
    exported = stage.export((96, 96))
    hologram = engine.Hologram(96, 96, 8e-6, (GREEN,), 0.3e-3, 1.8e-3)
    plan = engine.plan(exported.scene, exported.camera, hologram)
    assert plan.chain and plan.splits
    field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=8), plan)
    (truth,) = engine.reference(exported.scene, exported.camera, hologram, [3.8], spp=32, near=field.near)
    (picture,) = engine.reconstruct(field, [3.8])
    assert picture[10:-10, 10:-10].mean() / truth[10:-10, 10:-10].mean() == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(
    "roughness, metallic",
    [
        pytest.param(0.6, 0.0, marks=pytest.mark.slow),
        (0.3, 1.0),
        pytest.param(0.0, 1.0, marks=pytest.mark.slow),
    ],
)
def test_bumps_and_procedural_textures(stage, roughness, metallic):
    """A ball whose color and bumps are noise, matt, glossy and polished."""
    material = stage.material(PRINCIPLED, Roughness=roughness, Metallic=metallic)
    tree = material.node_tree
    principled = next(n for n in tree.nodes if n.bl_idname == PRINCIPLED)
    noise, bump = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeBump")
    noise.inputs["Scale"].default_value = 2.0
    bump.inputs["Distance"].default_value, bump.inputs["Strength"].default_value = 0.1, 0.5
    tree.links.new(noise.outputs["Color"], principled.inputs["Base Color"])
    tree.links.new(noise.outputs[0], bump.inputs["Height"])
    tree.links.new(bump.outputs[0], principled.inputs["Normal"])
    stage.sphere(0.35, material)
    stage.plane(6, stage.material("ShaderNodeBsdfDiffuse", Color=(0.4, 0.6, 0.5, 1)), "wall", (0, 0, -1.5))
    stage.lamp("AREA", 40, (1.5, 1, 3), (0, 0.45, 0.4))
    stage.world((0.3, 0.3, 0.3))
    exported = stage.export((96, 96))
    hologram = engine.Hologram(96, 96, 8e-6, (GREEN,), 0.3e-3, 1.8e-3)
    field = engine.render(
        exported.scene, exported.camera, hologram, engine.Settings(frames=8, quality="preview")
    )
    assert np.isfinite(field.data).all()
    focus = [3.8, 5.5]
    truth = engine.reference(exported.scene, exported.camera, hologram, focus, spp=32, near=field.near)
    inner = slice(10, -10)
    for picture, reference in zip(engine.reconstruct(field, focus), truth, strict=True):
        assert picture[inner, inner].mean() / reference[inner, inner].mean() == pytest.approx(1, abs=0.03)
