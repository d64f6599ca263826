"""A few values of each sweep over displays and effort, and what is special to an edge."""

import numpy as np
import pytest

from benchmarks.stability import displays
from benchmarks.stability.displays import SWEEPS
from benchmarks.stability.sweep import faults, walk
from holopath_addon import engine
from holopath_addon.engine import memory
from holopath_addon.engine.waves import propagation

BY_NAME = {sweep.name: sweep for sweep in SWEEPS}
QUICK = {sweep.name for sweep in SWEEPS if sweep.quick}


@pytest.fixture(autouse=True)
def mitsuba(backend):
    """All sweeps need a backend."""


def few(name):
    """Figures of a sweep's quick values, without faults."""
    sweep = BY_NAME[name]
    rows = walk(sweep, sweep.quick)
    assert faults(sweep, rows) == []
    return [figures for _, figures in rows]


SPECIAL = {
    "pitch, volume kept",
    "propagation",
    "distance, whole picture",
    "frames, random fields",
    "rays",
    "target's scale",
    "bits",
    "memory",
    "memory over distance",
    "memory in use",
}


# And what keeps the promise by default.
SLOW = {
    "texels": "test_radiance_cache: holograms of baked light",
    "frames, phases": "test_phases: few frames",
    "randomness": "test_smooth_phases: brightness of planes, slopes and depths",
    "frames, designed fields": "test_phase_fields: the first frames alone are better than random ones",
    "rays, paper's estimator": "test_rendering: paper's estimator",
    "distance": "a picture too far for the aperture, here; test_rendering: points refocus at their depth",
    "wavelength": "test_rendering: each wavelength shows its channel",
    "pitch": "size, here; test_slabs",
    "encoder's rate": "test_descent: longest steps",
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in SLOW else ()) for n in sorted(QUICK - SPECIAL)]
)
def test_no_step(name, monkeypatch):
    monkeypatch.setattr(displays, "QUIET_SPP", 128)  # steps of a decibel show
    for figures in few(name):
        assert "refused" not in figures
        if "brightness" in figures:
            assert figures["brightness"] == pytest.approx(1, abs=0.05)


def test_fine_pixels_and_a_deep_volume():
    """Which one plane alone could not reach: two flat pictures have a plane each."""
    for figures in few("pitch, volume kept"):
        assert "aperture" in figures["warned"] and figures["rays"] < 100


@pytest.mark.oracle
def test_propagation_through_the_critical_distance():
    pytest.importorskip("torchoptics")
    assert all(figures["error"] < 1e-3 for figures in few("propagation"))


@pytest.mark.parametrize("size", [(17, 31), (509, 251), (2160, 3840)])
def test_propagation_on_any_grid(size):
    """What a small grid makes of a spot, a large or odd one does too."""
    spot = displays.speckle(13)
    small = propagation.propagate(np.pad(spot, 48), displays.PITCH, displays.GREEN, 3e-3)
    field = np.zeros(size, np.complex64)
    top, left = ((n - 13) // 2 for n in size)
    field[top : top + 13, left : left + 13] = spot
    there = propagation.propagate(field, displays.PITCH, displays.GREEN, 3e-3)
    rows, columns = (min(n, 101) for n in size)
    ours = there[(size[0] - rows) // 2 :, (size[1] - columns) // 2 :][:rows, :columns]
    truth = small[48 - top if size[0] < 101 else 4 :, 48 - left if size[1] < 101 else 4 :][:rows, :columns]
    assert np.linalg.norm(ours - truth) < 0.02 * np.linalg.norm(small)


def test_a_picture_too_far_for_the_aperture():
    near, far = few("distance, whole picture")
    assert "warned" not in near and "aperture" in far["warned"]
    assert far["brightness"] == pytest.approx(1, abs=0.05)


@pytest.mark.slow
def test_speckle_of_random_fields():  # test_rendering: speckle contrast falls as the root of the frames
    for figures in few("frames, random fields"):
        assert figures["speckle"] == pytest.approx(1, abs=0.05)
        assert figures["brightness"] == pytest.approx(1, abs=0.05)


@pytest.mark.slow
def test_fewer_and_more_rays_than_needed():  # test_planner: too few rays are warned of
    few_rays, enough, more = few("rays")
    assert "fewer than" in few_rays["warned"] and few_rays["psnr of few"] < enough["psnr"] - 3
    assert "fewer than" not in enough.get("warned", "")
    assert more.pop("warned", "") == enough.pop("warned", "")
    assert more == pytest.approx(enough, rel=1e-6)  # graphics cards add up in any order


@pytest.mark.slow
def test_the_scale_of_what_is_encoded():  # test_encoder: how bright the field is does not matter
    for figures in few("target's scale"):
        for name in ("dpac", "sgd", "joint"):
            assert figures[f"{name} brightness"] == pytest.approx(1, abs=0.05)


def test_few_bits():
    for figures in few("bits"):
        assert figures["efficiency"] == pytest.approx(1, abs=0.02)
        assert figures["off levels"] < 0.01
        assert figures["psnr"] > figures["psnr when rounded"] - 0.05


def test_what_does_not_fit_into_memory(monkeypatch):
    monkeypatch.setattr(memory, "installed", lambda: 16 << 30)
    monkeypatch.setattr(memory, "available", lambda: 5 << 29)
    small, large, largest = few("memory")
    assert "warned" not in small
    assert "this machine has 17.2 GB" in large["refused"]
    assert "67 megapixels" in largest["refused"]
    assert "2.68 GB are free" in displays.memory(4)["warned"]
    near, far = few("memory over distance")
    assert "refused" not in near and "nearer to the SLM" in far["refused"]


def test_refocusing_beyond_memory_is_refused(monkeypatch):
    field, _ = displays.encoded()
    monkeypatch.setattr(memory, "installed", lambda: 1 << 18)
    with pytest.raises(engine.InvalidInput, match="from the SLM needs about"):
        engine.reconstruct(field, [1.0])


def test_memory_is_known():
    assert 1 << 28 < memory.available() <= memory.installed()


def test_the_plan_is_an_upper_bound_of_memory():
    assert few("memory in use")[0]["used"] < 1


def test_more_frames_than_a_set_are_not_worse():
    """Contrast of an even plane over the sum of the sets' own."""
    from holopath_addon.engine.waves.phase_fields import designed_phasors

    def contrast(frames):
        field = designed_phasors(frames)
        space = propagation.FreeSpace(field.shape[-2:], displays.PITCH, displays.GREEN)(3e-3)
        mean = sum(np.abs(np.fft.ifft2(np.fft.fft2(frame) * space)) ** 2 for frame in field)
        return mean.std() / mean.mean()

    values = [contrast(frames) for frames in (3, 4, 8, 9, 16, 19, 20, 24, 25, 32, 48)]
    for before, after in zip(values[:-1], values[1:], strict=True):
        assert after < before + 0.04


@pytest.mark.dense
@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_whole_sweeps(name):
    assert faults(BY_NAME[name], walk(BY_NAME[name])) == []
