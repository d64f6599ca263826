"""Every feature of the exporter against Cycles, and scenes of several at random: `benchmarks exporter`'s table."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks import exporter  # noqa: E402
from benchmarks.features import EVERYWHERE, FEATURES, box, random_scene  # noqa: E402
from benchmarks.stage import Stage  # noqa: E402

# These take every branch of the exporter that any feature takes, together with test_lights, test_materials,
# test_baking, test_images and test_instances, and show each group's shading. The others are slow.
EVERY_DAY = """
area lamp on a polished ball | Bump from an image | clip end before an object | custom normals
depth of field ignored | extension clip | film transparent | hair curves | hair particles | HDRI, turned
hidden and excluded | image with alpha, color | light nodes, IES | Mapping, texture | material slots | mesh
metaball | missing image | Mix Shader by Fresnel | Mix Shader by Layer Weight, Facing | negative scale
node group | Noise Texture, UV | Normal Map, tangent space | NURBS surface | point lamp on a rough metal
Principled Coat Roughness 0.3, coat weight 1 | Principled Coat Weight 1, metallic 1, roughness 0.4
Principled IOR 2.5, roughness 0.3 | Principled Sheen Weight 0.5 | Principled Specular IOR Level 0, roughness 0.3
Principled Specular Tint tinted, roughness 0.3, ior 2 | Principled Subsurface Weight 0.5, subsurface scale 0.1
Principled Thin Film Thickness 300, roughness 0.2 | Refraction BSDF roughness 0.3 | reroute and muted node
sensor fit auto, wide | sheared by a parent | shift | single sheet of Glass | smooth by angle
textured Emission Strength | textured Roughness | turned and scaled camera | two UV maps in one material
unit scale 0.01 | world, mix of Backgrounds
"""
EVERY_DAY = set(EVERY_DAY.strip().replace("\n", " | ").split(" | "))


@pytest.mark.parametrize(
    "feature",
    [pytest.param(f, id=f.name, marks=() if f.name in EVERY_DAY else pytest.mark.slow) for f in FEATURES],
)
def test_as_in_cycles(feature, request):
    if feature.group == "world" and not feature.name.endswith(", sun disc"):  # which needs the whole size
        request.getfixturevalue("small_worlds")
    result = exporter.compare(feature, counts=(32, 128, exporter.SPP))
    assert result.over == [], f"{result.differences}, notes: {[str(note) for note in result.notes]}"
    assert result.unexpected == set()
    assert result.noise < 0.015 * math.sqrt(exporter.SPP / result.spp)


def test_features_have_names_of_their_own_and_reasons():
    names = {feature.name for feature in FEATURES}
    assert len(names) == len(FEATURES) and names >= EVERY_DAY
    for feature in FEATURES:
        assert feature.bound <= exporter.BOUND or feature.reason
        assert all(side % exporter.BLOCK == 0 for side in feature.resolution)


def test_the_measure():
    """Ours 10 % bright in the left half, and noise of a known size."""
    rng = np.random.default_rng(0)
    theirs = np.full((2, 48, 48, 3), 2.0)
    ours = theirs.copy()
    ours[:, :, :24] *= 1.1
    halves = {"left": box(-1, 0, -1, 1), "right": box(0, 1, -1, 1)}
    differences, noise, brightness = exporter._apart(ours, theirs, halves)
    assert differences == pytest.approx({"left": 0.1, "right": 0})
    assert (noise, brightness) == pytest.approx((0, 1.05))
    noisy = theirs + 0.6 * rng.normal(size=theirs.shape)
    differences, noise, _ = exporter._apart(noisy, theirs, EVERYWHERE)
    # the mean of two halves of 36 pixels, and the mean size of a normal number
    expected = 0.3 / np.sqrt(2 * 36) * np.sqrt(2 / np.pi)
    assert noise == pytest.approx(expected, rel=0.2)
    assert differences["picture"] == pytest.approx(expected, rel=0.2)


def test_scenes_at_random_repeat():
    def contents(seed):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        stage = Stage()
        random_scene(stage, seed)
        bpy.context.view_layer.update()
        return [(o.name, *np.ravel(o.matrix_world)) for o in stage.scene.objects]

    assert contents(3) == contents(3)
    assert contents(3) != contents(4)
