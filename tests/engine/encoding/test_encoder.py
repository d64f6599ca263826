"""Phase-only encoding."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.encoding import double_phase, phase_hologram
from holopath_addon.engine.waves.modulator import grey_levels


@pytest.fixture(scope="module")
def field():
    """A smooth complex field of two frames and two colours, of odd and unequal sides."""
    rng = np.random.default_rng(1)
    shape = (45, 64)
    noise = rng.normal(size=(2, 2, *shape)) + 1j * rng.normal(size=(2, 2, *shape))
    fy, fx = (np.fft.fftfreq(n) for n in shape)
    band = np.hypot(fx[None, :], fy[:, None]) < 0.1
    data = np.fft.ifft2(np.fft.fft2(noise) * band).astype(np.complex64)
    hologram = engine.Hologram(64, 45, 8e-6, (640e-9, 500e-9), depth_far=1e-3, depth_near=1.5e-3)
    return engine.WaveField(data, hologram, engine.Camera(np.eye(4), fov_x=0.6), 0.5)


def test_what_passes_the_pupil_is_the_field(field):
    """A checkerboard's two phases average to the field: low frequencies of exp(i phase) are those of U / gain."""
    phase = engine.encode(field, "dpac")
    assert phase.data.dtype == np.float32 and phase.data.shape == field.data.shape
    assert phase.data.min() >= 0 and phase.data.max() < 2 * math.pi
    fy, fx = (np.fft.fftfreq(n) for n in field.data.shape[-2:])
    band = np.hypot(fx[None, :], fy[:, None]) < 0.12
    passed = np.fft.ifft2(np.fft.fft2(phase.field().data) * band)
    error = np.linalg.norm(passed - field.data) / np.linalg.norm(field.data)
    assert error < 0.12  # of slowly varying fields; every second pixel is half a pixel away
    arg_only = np.exp(1j * np.angle(field.data))
    arg_only = np.fft.ifft2(np.fft.fft2(arg_only) * band)
    scale = np.vdot(arg_only, field.data) / np.vdot(arg_only, arg_only)
    assert error < 0.4 * np.linalg.norm(scale * arg_only - field.data) / np.linalg.norm(field.data)


def test_frames_share_a_gain(field):
    """Brightness between frames is kept."""
    dim = field.data.copy()
    dim[1] *= 0.5
    dimmed = engine.encode(engine.WaveField(dim, field.hologram, field.camera, field.near), "dpac")
    waves = dimmed.field().data
    seen = [np.abs(np.fft.fft2(w)[0, :4, :4]).sum() for w in waves[:, 0:1]]
    whole = [np.abs(np.fft.fft2(w)[0, :4, :4]).sum() for w in dim[:, 0:1]]
    assert seen[1] / seen[0] == pytest.approx(whole[1] / whole[0], rel=0.15)


def test_double_phase_is_exact_in_pairs():
    wave = np.full((4, 4), 0.6 * np.exp(0.3j), np.complex64)
    pairs = np.exp(1j * double_phase.double_phase(wave).astype(float))
    np.testing.assert_allclose((pairs[:, ::2] + pairs[:, 1::2]) / 2, wave[:, ::2], atol=1e-6)


def test_grey_levels(field):
    phase = engine.encode(field, "dpac")
    for bits in (1, 8, 10):
        levels = grey_levels(phase.data, bits)
        assert levels.min() >= 0 and levels.max() < 2**bits
        turns = np.abs(levels / 2**bits - phase.data / (2 * math.pi))
        assert np.minimum(turns, 1 - turns).max() <= 0.5 / 2**bits + 1e-6


def test_a_colour_that_is_black(field):
    """A red scene has a hologram, and so has the black frame of an animation: no light is sent in."""
    data = field.data.copy()
    data[:, 1] = 0
    phase = engine.encode(engine.WaveField(data, field.hologram, field.camera, field.near), "dpac")
    assert phase.gains[1] == 0 and np.isfinite(phase.data).all() and not phase.field().data[:, 1].any()
    np.testing.assert_array_equal(phase.data[:, 0], engine.encode(field, "dpac").data[:, 0])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_cannot_be_encoded(field, value):
    bad = engine.WaveField(np.full_like(field.data, value), field.hologram, field.camera, field.near)
    with pytest.raises(engine.InvalidInput, match="not finite"):
        engine.encode(bad)
    with pytest.raises(engine.InvalidInput, match="dpac"):
        engine.encode(field, "magic")


def test_cancelled(field):
    def stop(done, message):
        raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        engine.encode(field, "dpac", stop)


def test_round_trip(field, tmp_path):
    import mitsuba as mi

    phase = engine.encode(field, "dpac")
    phase.save(tmp_path / "hologram")
    names = {path.name for path in (tmp_path / "hologram").iterdir()}
    pictures = {f"frame_00{m}_{nm}nm.png" for m in (0, 1) for nm in (640, 500)}
    assert names == {"phase.npy", "meta.json"} | pictures
    stored = engine.PhaseHologram.load(tmp_path / "hologram")
    np.testing.assert_array_equal(stored.data, phase.data)
    assert (stored.hologram, stored.near, stored.method, stored.gains) == (
        phase.hologram,
        phase.near,
        phase.method,
        phase.gains,
    )
    shown = np.asarray(mi.Bitmap(str(tmp_path / "hologram" / "frame_001_500nm.png")))
    np.testing.assert_array_equal(np.squeeze(shown), grey_levels(phase.data[1, 1]))

    (tmp_path / "hologram" / "phase.npy").write_bytes(b"no")
    with pytest.raises(engine.InvalidInput, match="damaged"):
        engine.PhaseHologram.load(tmp_path / "hologram")
    with pytest.raises(engine.InvalidInput, match="holds no hologram"):
        engine.PhaseHologram.load(tmp_path)
    field.save(tmp_path / "wavefield")
    with pytest.raises(engine.InvalidInput, match="something other"):
        phase.save(tmp_path / "wavefield")
    assert (tmp_path / "wavefield" / "field.npy").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "diary.txt").write_text("mine")
    with pytest.raises(engine.InvalidInput, match="something other"):
        phase.save(tmp_path / "other")
    assert (tmp_path / "other" / "diary.txt").read_text() == "mine"


def test_close_wavelengths_have_files_of_their_own():
    assert phase_hologram.picture_names(3, (640.2e-9, 640.4e-9)) == [
        "frame_003_640.2nm.png",
        "frame_003_640.4nm.png",
    ]


def test_refocusing_in_two_threads(field):
    """Distances that need grids of other sizes, at once: as in one thread."""
    from concurrent.futures import ThreadPoolExecutor

    refocuser, focus = engine.Refocuser(field), [0.05, 0.5, 3.0, math.inf] * 6
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda depth: refocuser([depth])[0], focus))
    for depth, image in zip(focus, found, strict=True):
        expected = engine.reconstruct(field, [depth])[0]
        np.testing.assert_allclose(image, expected, rtol=1e-5, atol=1e-6 * expected.max())
