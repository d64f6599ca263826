"""Fixtures of the tests of other people's methods: scenes, and the camera that looks at them."""

import numpy as np
import pytest

from benchmarks.scenes import FOV, Scenes
from holopath_addon import engine


@pytest.fixture(scope="module", autouse=True)
def alone(one_thread):
    """No test here has Mitsuba read or write an OpenEXR file."""


@pytest.fixture(scope="session")
def build(backend):
    """Builders of small scenes; metres."""
    return Scenes()


@pytest.fixture
def camera():
    """At the origin, looking along -z."""
    return engine.Camera(np.eye(4), FOV)
