"""Every feature of the exporter against Cycles, and scenes of several at random: `benchmarks exporter`'s table."""

import math
import re

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks import exporter  # noqa: E402
from benchmarks.features import EVERYWHERE, FEATURES, box, random_scene  # noqa: E402
from benchmarks.stage import Stage  # noqa: E402


def between():
    """Names of features whose like are compared every day: between two that differ from them by numbers alone, or by
    coordinates or the sensor's shape, of which one of each kind is enough.
    """
    alike = {}
    for feature in FEATURES:
        alike.setdefault(re.sub(r"[\d.]+", "#", feature.name), []).append(feature.name)
    same = re.compile(
        "(Voronoi|Checker|Brick|Wave) Texture, (Object|UV)|sensor fit (horizontal|vertical), square"
    )
    return {n for names in alike.values() for n in names[1:-1]} | {
        f.name for f in FEATURES if same.fullmatch(f.name)
    }


@pytest.mark.parametrize(
    "feature",
    [pytest.param(f, id=f.name, marks=pytest.mark.slow if f.name in between() else ()) for f in FEATURES],
)
def test_as_in_cycles(feature, request):
    if feature.group == "world" and not feature.name.endswith(", sun disc"):  # which needs the whole size
        request.getfixturevalue("small_worlds")
    result = exporter.compare(feature, counts=(32, 128, exporter.SPP))
    assert result.over == [], f"{result.differences}, notes: {[str(note) for note in result.notes]}"
    assert result.unexpected == set()
    assert result.noise < 0.015 * math.sqrt(exporter.SPP / result.spp)


def test_features_have_names_of_their_own_and_reasons():
    assert len({feature.name for feature in FEATURES}) == len(FEATURES)
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
