"""Displays that cannot be, and the depth range that one has by itself."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine import Hologram, InvalidInput


@pytest.mark.parametrize(
    "change",
    [
        {"width": 0},
        {"pitch": 0},
        {"pitch": math.nan},
        {"wavelengths": ()},
        {"wavelengths": (5e-4,)},
        {"near": -1.0},
        {"depth_far": 85e-3},
        {"depth_mapping": "linear"},
        {"pitch": 0.2e-6},
    ],
)
def test_impossible_displays_are_refused(change):
    with pytest.raises(InvalidInput):
        Hologram(**{"width": 64, "height": 64, "pitch": 8e-6, **change})


def test_depth_ranges_fit_the_display():
    """Small ones have a volume that is less deep, so that its light reaches the aperture."""

    def ends(width, height, **given):
        hologram = Hologram(width, height, 8e-6, **given)
        return hologram.depth_far, hologram.depth_near

    assert ends(1920, 1080) == ends(512, 512) == (-4e-3, 1e-3)
    assert ends(64, 512) == (pytest.approx(-0.5e-3), pytest.approx(0.125e-3))
    assert ends(64, 64, depth_near=9e-3) == (pytest.approx(-0.5e-3), 9e-3)


def test_light_that_the_aperture_loses_is_told():
    """Nothing by default, at any size; at 10 to 15 mm a border of an eighth of the picture."""
    for side in (64, 512, 1080):
        assert Hologram(side, side, 8e-6).lost_light(Hologram(side, side, 8e-6).depth_far) == ""
    assert Hologram(512, 512, 8e-6).lost_light(15e-3) == (
        "Only 88% of the light fits through the SLM's aperture at 15 mm: the outer 76 pixels darken"
    )


@pytest.mark.parametrize(
    ("pitch", "optics"),
    [
        (8e-6, {}),
        ((6.4e-6, 8e-6), {}),
        ((8e-6, 6.9e-6), {}),
        (8e-6, {"color_scale": (1.02,), "color_distance": (0.1e-3,)}),
        (8e-6, {"lens": engine.Lens(0.1)}),
        (8e-6, {"lens": engine.Lens(0.1, share=0.7)}),
    ],
)
@pytest.mark.parametrize("size", [(64, 64), (47, 47)])
def test_a_panel_for_a_picture(pitch, optics, size):
    hologram = engine.Hologram(100, 80, pitch, (516.5e-9,), optics=engine.Optics(**optics))
    width, height = hologram.panel_for(*size)
    picture = replace(hologram, width=width, height=height).picture
    assert (picture.width, picture.height) == size
    assert (width, height) == size or hologram.picture is not hologram


def test_numbers_of_any_type(tmp_path):
    """NumPy's own are written as Python's; what is no number is refused in a sentence."""
    hologram = engine.Hologram(
        np.int64(8), np.int32(6), np.float32(8e-6), np.array([5e-7]), np.float32(-1e-3), np.float64(1e-3)
    )
    camera = engine.Camera(np.eye(4), np.float32(0.5), clip_end=np.float32(3))
    field = engine.WaveField(np.ones((1, 1, 6, 8), np.complex64), hologram, camera, 1.0)
    field.save(tmp_path / "field")
    assert engine.WaveField.load(tmp_path / "field").hologram == hologram
    assert engine.Hologram(8, 6, np.array([8e-6, 9e-6])).pitch == (8e-6, 9e-6)
    settings = engine.Settings(frames=np.int64(3), seed=np.int64(2))
    assert (settings.frames, type(settings.frames)) == (3, int)
    for values, says in (
        ({"width": 8.5}, "Expected whole numbers of pixels, got 8.5 x 6"),
        ({"wavelengths": 5e-7}, "Expected wavelengths as a list of numbers"),
        ({"pitch": "wide"}, "Expected the pixel pitch as a list of numbers"),
    ):
        with pytest.raises(engine.InvalidInput, match=says):
            engine.Hologram(**{"width": 8, "height": 6, "pitch": 8e-6, **values})
    with pytest.raises(engine.InvalidInput, match="clipping range that ends after its start"):
        engine.Camera(np.eye(4), 0.5, clip_start=2.0, clip_end=1.0)
