"""Displays that cannot be, and the depth range that one has by itself."""

import math

import pytest

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
    """Small ones have their volume near, where its light reaches the aperture."""

    def ends(width, height, **given):
        hologram = Hologram(width, height, 8e-6, **given)
        return hologram.depth_far, hologram.depth_near

    assert ends(1920, 1080) == (80e-3, 85e-3)
    assert ends(512, 512) == (10e-3, 15e-3)
    assert ends(64, 512) == (pytest.approx(1.25e-3), pytest.approx(1.875e-3))
    assert ends(64, 64, depth_near=9e-3) == (pytest.approx(1.25e-3), 9e-3)
