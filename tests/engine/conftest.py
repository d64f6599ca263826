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
    """256 x 256, 8 µm, one wavelength, a volume of 5 mm near the SLM that fits so small an aperture."""
    from holopath_addon.engine import Hologram

    return Hologram(256, 256, 8e-6, (GREEN,), depth_far=1e-3, depth_near=6e-3)
