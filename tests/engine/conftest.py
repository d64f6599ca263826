"""Fixtures of the physics tests: scenes, and the camera and display that look at them."""

import numpy as np
import pytest

from benchmarks.scenes import FOV, GREEN, Scenes
from holopath_addon.engine.waves.supervision import FramePool


@pytest.fixture(scope="module", autouse=True)
def alone(one_thread):
    """No test here has Mitsuba read or write an OpenEXR file."""


@pytest.fixture(scope="session")
def build(backend):
    """Builders of small scenes; meters."""
    return Scenes()


@pytest.fixture
def pool():
    """Threads that take frames side by side."""
    with FramePool() as pool:
        yield pool


LIBRARIES = "array_api_strict", pytest.param("torch", marks=pytest.mark.oracle)


@pytest.fixture(params=LIBRARIES)
def other_library(request):
    """A library of arrays beside NumPy, whose `asarray` makes its own of NumPy's; one has nothing but the standard."""
    return found(request.param)


@pytest.fixture(params=["numpy", *LIBRARIES])
def library(request):
    """NumPy, or another library of arrays."""
    return np if request.param == "numpy" else found(request.param)


@pytest.fixture
def as_on_a_card(other_library, monkeypatch):
    """``as_on_a_card(free)``: another library computes waves, in a card's memory, as it seems, with so much free."""
    from holopath_addon.engine.planning import machine, planner
    from holopath_addon.engine.waves import libraries

    name = other_library.__name__
    monkeypatch.setitem(libraries.ON_CARDS, name, "The Library")
    monkeypatch.setattr(libraries, "_problem", lambda name, device: "")
    monkeypatch.setenv(libraries.VARIABLE, name)

    def free(count):
        def on_card(array):
            return None if isinstance(array, np.ndarray) else (count, count)

        for module in (machine, planner):
            monkeypatch.setattr(module, "on_card", on_card)

    return free


def found(library):
    pytest.importorskip("array_api_compat")
    return pytest.importorskip(library)


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


@pytest.fixture(scope="module")
def field():
    """A smooth complex field of two frames and two colors, of odd and unequal sides."""
    rng = np.random.default_rng(1)
    shape = (45, 64)
    noise = rng.normal(size=(2, 2, *shape)) + 1j * rng.normal(size=(2, 2, *shape))
    fy, fx = (np.fft.fftfreq(n) for n in shape)
    band = np.hypot(fx[None, :], fy[:, None]) < 0.1
    data = np.fft.ifft2(np.fft.fft2(noise) * band).astype(np.complex64)
    from holopath_addon import engine

    hologram = engine.Hologram(64, 45, 8e-6, (640e-9, 500e-9), depth_far=1e-3, depth_near=1.5e-3)
    return engine.WaveField(data, hologram, engine.Camera(np.eye(4), fov_x=0.6), 0.5)
