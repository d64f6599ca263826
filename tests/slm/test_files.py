"""Pictures as files: exact, and all of them or none."""

import errno
import json
import math
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.scene import variants
from holopath_addon.slm import Calibration, FilesDriver, Picture, Sequence, stream, streaming
from tests.patience import NEVER, SOON
from tests.slm.refusals import refused


def made(bits=8, packing="time", frames=3, size=(6, 5), seed=1, **options):
    """A sequence, and the levels of its frames: any there are."""
    width, height = size
    levels = np.random.default_rng(seed).integers(0, 2**bits, (frames, height, width))
    grid = engine.Hologram(width, height, 8e-6, (516.5e-9,), depth_far=1e-3, depth_near=2e-3)
    data = (levels * (2 * math.pi / 2**bits)).astype(np.float32)[:, None]
    hologram = engine.PhaseHologram(data, grid, engine.Camera(np.eye(4), 0.5), 0.5, "dpac", (1.0,))
    return Sequence([hologram], Calibration(bits=bits), packing, **options), levels


def read(path):
    """A picture's pixels as they are stored."""
    mi = variants.bitmaps()
    return np.array(mi.Bitmap(str(path)))


def said_of(folder):
    return json.loads((folder / "pictures.json").read_text())


@pytest.mark.parametrize("bits", [1, 4, 8])
def test_pictures(bits, tmp_path):
    sequence, levels = made(bits, size=(64, 48))
    counts = stream(sequence, FilesDriver(tmp_path / "out"), loops=2)
    assert counts.shown == 6
    names = [f"picture_{n:06d}.png" for n in range(6)]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [*names, "pictures.json"]
    for n, name in enumerate(names):
        pixels = read(tmp_path / "out" / name)
        assert pixels.dtype == np.uint8
        np.testing.assert_array_equal(pixels, levels[n % 3])
    assert said_of(tmp_path / "out") == {
        "format": "HoloPath pictures",
        "pictures": 6,
        "width": 64,
        "height": 48,
        "channels": 1,
        "bytes_per_level": 1,
        "rate_hz": None,
        "parts": [[[0, 0]], [[1, 0]], [[2, 0]]] * 2,
    }


def test_pictures_in_color(tmp_path):
    """Green is shown first, then blue, then red."""
    sequence, levels = made(packing="color", order="GBR")
    stream(sequence, FilesDriver(tmp_path / "out"))
    pixels = read(tmp_path / "out" / "picture_000000.png")
    np.testing.assert_array_equal(pixels, np.stack([levels[2], levels[0], levels[1]], axis=-1))
    assert said_of(tmp_path / "out")["channels"] == 3
    assert said_of(tmp_path / "out")["parts"] == [[[0, 0], [1, 0], [2, 0]]]


def test_pictures_of_bits(tmp_path):
    sequence, levels = made(1, "bits", frames=24)
    stream(sequence, FilesDriver(tmp_path / "out"))
    pixels = read(tmp_path / "out" / "picture_000000.png")
    for channel in range(3):
        expected = sum(levels[8 * channel + bit] << bit for bit in range(8))
        np.testing.assert_array_equal(pixels[..., channel], expected)


def test_pictures_of_bits_of_channels(tmp_path):
    """12 bits, the lowest four in green."""
    sequence, levels = made(12, "R7-0,G3-0")
    stream(sequence, FilesDriver(tmp_path / "out"))
    for number, level in enumerate(levels):
        pixels = read(tmp_path / "out" / f"picture_{number:06d}.png")
        np.testing.assert_array_equal(pixels, np.stack([level >> 4, level & 15, 0 * level], -1))


@pytest.mark.parametrize("bits", [8, 10, 16])
def test_raw(bits, tmp_path):
    """One after the other, row by row; of more than 8 bits the low byte comes first."""
    sequence, levels = made(bits)
    stream(sequence, FilesDriver(tmp_path / "out", "raw"))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["pictures.json", "pictures.raw"]
    data = (tmp_path / "out" / "pictures.raw").read_bytes()
    numbers = [int(level) for level in levels.flat]
    assert data == (bytes(numbers) if bits == 8 else struct.pack(f"<{len(numbers)}H", *numbers))
    described = said_of(tmp_path / "out")
    assert (described["pictures"], described["width"], described["height"], described["channels"]) == (
        3,
        6,
        5,
        1,
    )
    assert described["bytes_per_level"] == (1 if bits == 8 else 2)
    assert described["pictures"] * described["width"] * described["height"] * described[
        "bytes_per_level"
    ] == len(data)


def test_raw_in_color(tmp_path):
    sequence, levels = made(packing="color", order="BGR")
    stream(sequence, FilesDriver(tmp_path / "out", "raw"))
    data = (tmp_path / "out" / "pictures.raw").read_bytes()
    expected = [int(levels[frame][y, x]) for y, x in np.ndindex(5, 6) for frame in (2, 1, 0)]
    assert data == bytes(expected) and said_of(tmp_path / "out")["channels"] == 3


@pytest.mark.parametrize("bits", [8, 10])
def test_raw_whatever_the_order_in_memory(bits, tmp_path):
    """Pictures that are not contiguous, or of the other byte order."""
    levels = np.random.default_rng(2).integers(0, 2**bits, (6, 5)).astype(np.uint8 if bits == 8 else ">u2")
    driver = FilesDriver(tmp_path / "out", "raw")
    driver.open(None, lambda number, what: None)
    driver.show(0, Picture(levels.T, 0, ((0, 0),)))
    driver.close(finish=True)
    numbers = [int(levels[x, y]) for y, x in np.ndindex(5, 6)]
    expected = bytes(numbers) if bits == 8 else struct.pack("<30H", *numbers)
    assert (tmp_path / "out" / "pictures.raw").read_bytes() == expected


def test_the_rate_is_written_not_waited_for(tmp_path):
    """Files have no time: one picture in ten minutes is written as soon as any."""
    sequence, _ = made(frames=2)
    start = time.monotonic()
    counts = stream(sequence, FilesDriver(tmp_path / "out"), rate=1 / NEVER)
    assert said_of(tmp_path / "out")["rate_hz"] == 1 / NEVER and counts.shown == 2
    assert time.monotonic() - start < SOON


def test_an_earlier_sequence_is_replaced(tmp_path):
    stream(made()[0], FilesDriver(tmp_path / "out"), loops=3)
    sequence, levels = made(seed=2)
    stream(sequence, FilesDriver(tmp_path / "out"))
    assert len(list((tmp_path / "out").iterdir())) == 4
    np.testing.assert_array_equal(read(tmp_path / "out" / "picture_000001.png"), levels[1])
    stream(sequence, FilesDriver(tmp_path / "out", "raw"))
    assert len(list((tmp_path / "out").iterdir())) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


# All or none


@pytest.mark.parametrize("kind", ["png", "raw"])
@pytest.mark.parametrize("earlier", [False, True])
def test_cancelled(kind, earlier, tmp_path, monkeypatch):
    """Nothing is left, or what was there before."""
    monkeypatch.setattr(streaming, "PROGRESS_INTERVAL", 0)
    sequence, levels = made()
    if earlier:
        stream(sequence, FilesDriver(tmp_path / "out"))

    def stop(counts):
        if counts.shown >= 2:
            assert any(path.name.startswith(".out") for path in tmp_path.iterdir())
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        stream(made(seed=2)[0], FilesDriver(tmp_path / "out", kind), loops=9, progress=stop)
    assert [path.name for path in tmp_path.iterdir()] == ["out"] * earlier
    if earlier:
        np.testing.assert_array_equal(read(tmp_path / "out" / "picture_000002.png"), levels[2])


@pytest.mark.parametrize("kind", ["png", "raw"])
@pytest.mark.parametrize("what", ["picture", "list"])
def test_disk_full(kind, what, tmp_path, monkeypatch):
    """While pictures are written, or when all are and the list is: nothing is left."""

    def full(*words, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    if what == "list":
        monkeypatch.setattr(Path, "write_text", full)
    else:
        monkeypatch.setattr(FilesDriver, "show", full)
    with pytest.raises(OSError, match="No space") as caught:
        stream(made()[0], FilesDriver(tmp_path / "out", kind))
    assert list(tmp_path.iterdir()) == [] and caught  # also while someone still looks at the error


@pytest.mark.parametrize("name", ["diary.txt", "picture_000000.png"])
def test_foreign_folder(name, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("mine")
    with refused("something other than a sequence of pictures"):
        stream(made()[0], FilesDriver(tmp_path / "out"))
    assert (tmp_path / "out" / name).read_text() == "mine"
    assert [path.name for path in tmp_path.glob("**/*")] == ["out", name]


def test_a_file_in_its_place(tmp_path):
    (tmp_path / "out").write_text("mine")
    with refused("something other"):
        stream(made()[0], FilesDriver(tmp_path / "out"))
    assert (tmp_path / "out").read_text() == "mine"


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(engine.InvalidInput, match="Choose another"):
        stream(made()[0], FilesDriver(tmp_path / "file" / "out"))


def test_ten_bits_as_png(tmp_path):
    """Pictures of 16 bits hold the levels as they are."""
    mi = variants.bitmaps()
    sequence = made(10)[0]
    stream(sequence, FilesDriver(tmp_path / "out"))
    for number in range(len(sequence)):
        levels = np.array(mi.Bitmap(str(tmp_path / "out" / f"picture_{number:06d}.png")))
        assert levels.dtype == np.uint16
        np.testing.assert_array_equal(levels.reshape(levels.shape[:2]), sequence.picture(number).pixels)


def test_kinds():
    with refused("png, raw, video, video-per-color, got tiff"):
        FilesDriver("out", "tiff")


def test_closed_in_any_order(tmp_path):
    """Closing before opening, twice, or without a picture leaves no folder."""
    driver = FilesDriver(tmp_path / "out")
    driver.close()
    driver.close(finish=True)
    driver.open(None, None)
    driver.close(finish=True)
    driver.close(finish=True)
    assert list(tmp_path.iterdir()) == []
    stream(made()[0], driver)
    stream(made()[0], driver)
    assert said_of(tmp_path / "out")["pictures"] == 3
