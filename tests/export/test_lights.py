"""Lamps and world against Cycles."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

DIFFUSE = "ShaderNodeBsdfDiffuse"


def floor(stage, size=6.0):
    return stage.plane(size, stage.material(DIFFUSE, Color=(0.8, 0.5, 0.2, 1)))


@pytest.mark.parametrize(
    "kind, values",
    [
        ("POINT", dict(shadow_soft_size=0.0)),
        ("POINT", dict(shadow_soft_size=0.1, color=(1, 0.5, 0.1))),
        ("POINT", dict(use_temperature=True, temperature=3000)),
        ("POINT", dict(normalize=False, shadow_soft_size=0.1)),
        ("AREA", dict(size=1.0)),
        ("AREA", dict(size=1.0, size_y=0.5, shape="RECTANGLE", rotation=(0.6, 0, 0))),
        ("AREA", dict(size=0.8, shape="DISK", rotation=(0, 0.5, 0.3))),
        ("AREA", dict(size=1.0, size_y=2.0, shape="ELLIPSE")),
        ("AREA", dict(size=0.3, spread=1.5)),
        ("AREA", dict(size=0.7, normalize=False)),
        ("SUN", dict(angle=0.0, rotation=(0.5, 0.2, 0))),
        ("SUN", dict(angle=0.5, rotation=(0.5, 0.2, 0))),
        ("SUN", dict(angle=0.5, normalize=False)),
        ("SPOT", dict(shadow_soft_size=0.0, spot_size=1.0, spot_blend=1.0)),
        ("SPOT", dict(shadow_soft_size=0.1, spot_size=0.9, spot_blend=0.15, rotation=(0.2, 0, 0))),
    ],
)
def test_lamps_are_as_bright_as_in_cycles(stage, kind, values):
    if "normalize" in values and not hasattr(bpy.types.Light, "normalize"):
        pytest.skip("this Blender's lamps are always normalised")
    floor(stage)
    stage.lamp(kind, **values)
    ours, theirs = stage.mitsuba(), stage.cycles()
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.015)
    coarse = lambda image: image.reshape(8, 4, 8, 4, 3).mean((1, 3))  # noqa: E731
    assert coarse(ours) == pytest.approx(coarse(theirs), rel=0.04, abs=0.01 * theirs.max())


def test_scaled_area_lamp(stage):
    floor(stage)
    stage.lamp("AREA").scale = (3, 0.5, 1)
    assert stage.ratio() == pytest.approx(np.ones(3), abs=0.015)


def test_area_lamps_shine_one_way_and_are_not_seen(stage):
    floor(stage)
    lamp = stage.lamp("AREA", 100, (0, 0, 2), (math.pi, 0, 0))
    assert stage.mitsuba().max() == 0
    lamp.rotation_euler = (0, 0, 0)
    bpy.context.view_layer.update()
    ours = stage.mitsuba()
    assert ours.min() > 0
    assert ours == pytest.approx(stage.cycles(), rel=0.1)
    import mitsuba as mi

    hit = stage.export().scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, 4), mi.Vector3f(0, 0, -1)))
    assert float(hit.t[0]) == pytest.approx(4)


def test_shadows_are_soft_as_in_cycles(stage):
    floor(stage)
    stage.plane(0.5, stage.material(DIFFUSE, "blocker", Color=(0, 0, 0, 1)), "blocker", (0.3, 0, 0.5))
    stage.lamp("AREA", 100, (-1.5, 0, 2.5), (0, -0.54, 0), size=0.6)
    ours, theirs = (render(spp=1024) for render in (stage.mitsuba, stage.cycles))
    assert np.abs(ours - theirs).mean() < 0.015 * theirs.mean()


def test_unit_scale_keeps_the_picture(stage):
    floor(stage)
    stage.lamp("POINT", shadow_soft_size=0.1)
    stage.lamp("AREA", location=(1, 0, 2), size=0.5)
    stage.lamp("SUN")
    stage.lamp("SPOT", location=(-1, 0, 2))
    before = stage.mitsuba().mean((0, 1))
    stage.scene.unit_settings.scale_length = 0.1
    assert stage.mitsuba().mean((0, 1)) == pytest.approx(before, rel=0.01)


def test_world_colour(stage):
    floor(stage, 1)
    stage.world((0.2, 0.4, 0.6), 1.5)
    image = stage.mitsuba()
    assert image[0, 0] == pytest.approx((0.3, 0.6, 0.9), rel=1e-3)
    assert stage.ratio() == pytest.approx(np.ones(3), abs=0.005)


@pytest.mark.parametrize("rotation", [None, (0, 0, 0.7), (0.4, -0.3, 1.1)])
@pytest.mark.parametrize("vector_type", ["POINT", "TEXTURE"])
def test_environment_is_oriented_as_in_cycles(stage, rotation, vector_type):
    if rotation is None and vector_type == "TEXTURE":
        pytest.skip("same as without mapping")
    rng = np.random.default_rng(5)
    pixels = np.kron(rng.random((8, 16, 3)), np.ones((8, 8, 1)))
    image = stage.image(pixels, float_buffer=True, space="Linear Rec.709")
    tree = stage.world().node_tree
    background = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBackground")
    background.inputs["Strength"].default_value = 2.0
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    if rotation:
        mapping = tree.nodes.new("ShaderNodeMapping")
        mapping.vector_type = vector_type
        mapping.inputs["Rotation"].default_value = rotation
        tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    stage.camera.rotation_euler = (1.2, 0.1, 0.5)
    stage.camera.data.lens = 18
    ours, theirs = stage.mitsuba(spp=64), stage.cycles(spp=64)
    assert theirs.std() > 0.3
    assert np.abs(ours - theirs).mean() < 0.03
    assert stage.export().notes == []


def test_world_nodes_beyond_that_are_noted(stage):
    floor(stage)
    tree = stage.world().node_tree
    background = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBackground")
    tree.links.new(tree.nodes.new("ShaderNodeTexSky").outputs[0], background.inputs["Color"])
    assert [n.object for n in stage.export().notes] == ["world"]


def test_darkness_is_noted(stage):
    floor(stage)
    assert [n.feature for n in stage.export().notes] == ["No light, emission or world colour"]
