"""Lossless videos of phases: every level as it is, in order and in time, and all of them or none."""

import json
import subprocess
import sys

import numpy as np
import pytest

from holopath_addon import cli, engine
from holopath_addon.engine.encoding.phase_hologram import color_names
from holopath_addon.slm import Calibration, FilesDriver, Sequence, stream, streaming
from holopath_addon.slm.drivers import video
from tests.slm.refusals import refused

WAVELENGTHS = 640e-9, 516.5e-9, 455.4e-9


def levels_of(holograms, frames, wavelengths, bits=8, size=(34, 21)):
    width, height = size
    shape = holograms, frames, len(wavelengths), height, width
    return np.random.default_rng(3).integers(0, 2**bits, shape)


def film_of(levels, wavelengths=WAVELENGTHS, bits=8):
    """Holograms that show levels."""
    height, width = levels.shape[-2:]
    grid = engine.Hologram(width, height, 8e-6, wavelengths, depth_far=1e-3, depth_near=2e-3)
    phases = (levels * (2 * np.pi / 2**bits)).astype(np.float32)
    camera, gains = engine.Camera(np.eye(4), 0.5), (1.0,) * len(wavelengths)
    return [engine.PhaseHologram(data, grid, camera, 0.5, "dpac", gains) for data in phases]


@pytest.fixture
def program():
    try:
        return video.ffmpeg()
    except engine.BackendUnavailable as error:
        pytest.skip(str(error))


def shown(program, file, size=(34, 21)):
    """All pictures of a video, and its rate."""
    command = [program, "-nostdin", "-i", str(file), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, capture_output=True, check=True)
    described = done.stderr.decode()
    rate = float(described.partition(" fps,")[0].rpartition(" ")[2])
    return np.frombuffer(done.stdout, np.uint8).reshape(-1, *size[::-1], 3), rate


def reports(folder):
    return json.loads((folder / "pictures.json").read_text())["videos"]


def test_a_video_for_each_color(program, tmp_path):
    levels = levels_of(2, 4, WAVELENGTHS)
    sequence = Sequence(film_of(levels), Calibration(bits=8), repeats=3)
    stream(sequence, FilesDriver(tmp_path / "out", "video-per-color", sequence), rate=180.0)
    names = [f"pictures_{name}.mkv" for name in color_names(WAVELENGTHS)]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*names, "pictures.json"}
    for k, name in enumerate(names):
        pictures, rate = shown(program, tmp_path / "out" / name)
        expected = np.tile(levels[:, :, k], (1, 3, 1, 1)).reshape(-1, 21, 34)
        for channel in range(3):
            np.testing.assert_array_equal(pictures[..., channel], expected)
        assert rate == 180 and reports(tmp_path / "out")[name] == {
            "wavelength_nm": pytest.approx(WAVELENGTHS[k] * 1e9),
            "pictures": 24,
            "pictures_of_a_hologram": 12,
            "seconds_of_a_hologram": pytest.approx(12 / 180),
        }


def test_colors_in_the_channels(program, tmp_path):
    """A video of two rounds, with a rate that is not a whole number."""
    levels = levels_of(3, 1, WAVELENGTHS)
    sequence = Sequence(film_of(levels), Calibration(bits=8), "color")
    stream(sequence, FilesDriver(tmp_path / "out", "video", sequence), rate=59.94, loops=2)
    pictures, rate = shown(program, tmp_path / "out" / "pictures.mkv")
    np.testing.assert_array_equal(pictures, np.tile(np.moveaxis(levels[:, 0], 1, -1), (2, 1, 1, 1)))
    assert rate == 59.94 and reports(tmp_path / "out")["pictures.mkv"]["pictures"] == 6


def test_colors_one_after_the_other(program, tmp_path):
    levels = levels_of(2, 2, WAVELENGTHS)
    sequence = Sequence(film_of(levels), Calibration(bits=8))
    stream(sequence, FilesDriver(tmp_path / "out", "video", sequence), rate=60.0)
    pictures, _ = shown(program, tmp_path / "out" / "pictures.mkv")
    np.testing.assert_array_equal(pictures[..., 1], levels.reshape(-1, 21, 34))
    assert reports(tmp_path / "out")["pictures.mkv"]["seconds_of_a_hologram"] == pytest.approx(0.1)


def test_cancelled(program, tmp_path, monkeypatch):
    monkeypatch.setattr(streaming, "PROGRESS_INTERVAL", 0)
    sequence = Sequence(film_of(levels_of(2, 1, WAVELENGTHS)), Calibration(bits=8))

    def stop(counts):
        if counts.shown >= 2:
            raise engine.Cancelled

    driver = FilesDriver(tmp_path / "out", "video-per-color", sequence)
    with pytest.raises(engine.Cancelled):
        stream(sequence, driver, rate=60.0, loops=9, progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_a_program_that_fails(tmp_path, monkeypatch):
    """Its last line is told, whether it ends at once or with the last picture."""
    sequence = Sequence(film_of(levels_of(1, 1, WAVELENGTHS)), Calibration(bits=8))
    popen = subprocess.Popen
    for code in ("", "sys.stdin.buffer.read(); "):
        code = f"import sys; {code}print('first', file=sys.stderr); sys.exit('No space left')"
        monkeypatch.setattr(video, "ffmpeg", lambda: "ffmpeg")
        monkeypatch.setattr(
            video.subprocess,
            "Popen",
            lambda _, code=code, **options: popen([sys.executable, "-c", code], **options),
        )
        with pytest.raises(OSError, match="ffmpeg: No space left"):
            stream(sequence, FilesDriver(tmp_path / "out", "video", sequence), rate=60.0, loops=500)
        monkeypatch.undo()
        assert list(tmp_path.iterdir()) == []


def test_what_a_video_cannot_have(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(video, "ffmpeg", lambda: "ffmpeg")
    sequence = Sequence(film_of(levels_of(1, 1, WAVELENGTHS)), Calibration(bits=8), "color")
    with refused("packing color holds several colors. Choose --kind video, or the packing time"):
        stream(sequence, FilesDriver(tmp_path / "out", "video-per-color", sequence), rate=60.0)
    sequence = Sequence(film_of(levels_of(1, 1, WAVELENGTHS, 10), bits=10), Calibration(bits=10))
    with refused("A video has levels of 8 bits, got 10"):
        stream(sequence, FilesDriver(tmp_path / "out", "video", sequence), rate=60.0)
    with refused("colors and times of a sequence"):
        FilesDriver(tmp_path / "out", "video")
    sequence.holograms[0].save(tmp_path / "hologram")
    words = ["stream", str(tmp_path / "hologram"), "--driver", "files", "--kind", "video"]
    assert cli.main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "A video needs a rate. Give --rate" in capfd.readouterr().err
    monkeypatch.undo()
    monkeypatch.setattr(video.shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert cli.main([*words, "--rate", "60", "--out", str(tmp_path / "out")]) == 1
    assert "Install it, or run `pip install imageio-ffmpeg`, or choose --kind png" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["hologram"]
