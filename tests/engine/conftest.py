"""Fixtures of the physics tests: scenes, and the camera and display that look at them."""

import numpy as np
import pytest

from benchmarks.scenes import FOV, GREEN, Scenes


@pytest.fixture(scope="session")
def build(backend):
    """Builders of small scenes; metres."""
    return Scenes()


@pytest.fixture
def camera():
    from holopath_addon.engine import Camera

    return Camera(np.eye(4), FOV)


@pytest.fixture
def small():
    """128 x 128, 8 µm, one wavelength, a volume of 2.5 mm near the SLM that fits so small an aperture.

    Twice the pixels with twice the volume have the same pupil and cost sixteen times as much.
    """
    from holopath_addon.engine import Hologram

    return Hologram(128, 128, 8e-6, (GREEN,), depth_far=0.5e-3, depth_near=3e-3)
