"""Calibrations, correction maps and responses that are damaged: read, or refused by a sentence that names the file."""

import json
import os
import random
from contextlib import suppress

import numpy as np
import pytest

from holopath_addon import cli, engine, slm
from holopath_addon.engine.scene import variants
from holopath_addon.slm.calibration import measured_levels
from tests.engine.encoding.fields import GREEN, smooth, wave_field

WHOLE = {
    "format": "HoloPath SLM calibration",
    "format_version": 1,
    "device": "some SLM",
    "bits": 4,
    "size": [6, 4],
    "flip_x": False,
    "flip_y": True,
    "shift": [1, 0],
    "responses": [
        {"wavelength_nm": 640.0, "range": 0.9},
        {"wavelength_nm": 516.5, "curve": [[0, 0.0], [7, 2], [15, 6.1]]},
    ],
    "correction": {"file": "map.npy", "wavelength_nm": 640.0},
}
ODD = [None, True, -1, 0, 3.5, 1e300, 10**400, float("nan"), float("inf"), "", "8", "a\nb. C", [], {}, [[]]]
ODD_WORDS = ["nan", "-inf", "1e400", "1e30", "pi", "0,4", "[0]", "x" * 999, "\0"]
BYTES = [b"\xff" * 8, b"\0" * 8, b"[" * 5000, b"9" * 400, b"NaN", b"1e999", b"'\n\n"]
ODD_MAPS = [
    np.zeros((4, 6), complex),
    np.full((4, 6), 1e30),
    np.full((4, 6), np.nan),
    np.zeros(()),
    np.zeros((0, 6)),
    np.zeros((4, 6, 3)),
    np.full((4, 6), "1"),
    np.zeros((4, 6), "M8[s]"),
    np.zeros((4, 6), [("a", "f4")]),
    np.zeros((6, 4)),
]


def whole_files(folder):
    """Contents by name."""
    np.save(folder / "map.npy", np.linspace(-3, 9, 24, dtype=np.float32).reshape(4, 6))
    variants.bitmaps().Bitmap(np.arange(24, dtype=np.uint8).reshape(4, 6)).write(str(folder / "map.png"))
    (folder / "npy.json").write_text(json.dumps(WHOLE, indent=1))
    (folder / "png.json").write_text(json.dumps(WHOLE).replace("map.npy", "map.png"))
    (folder / "levels.txt").write_text("\n".join(str(0.4 * n) for n in range(16)))
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def other_bytes(rng, data):
    """A file cut, overwritten, mixed up, or in another encoding."""
    data, at, other = bytearray(data), rng.randrange(len(data)), rng.randrange(len(data))
    way = rng.randrange(5)
    if way == 0:
        return data[:at]
    if way == 1:
        for _ in range(rng.randrange(1, 12)):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif way == 2:
        data[at : at + 16] = data[other : other + 16]
    elif way == 3:
        data[at : at + 8] = rng.choice(BYTES)
    else:
        return data.decode("latin-1").encode(rng.choice(["utf-16", "utf-32-be", "utf-7", "utf-8"]))
    return data


def other_values(rng, described):
    """A JSON text with a value of another kind somewhere, or without it."""
    described = place = json.loads(described)
    while True:
        key = rng.choice(list(place) if isinstance(place, dict) else range(len(place)))
        if isinstance(place[key], (dict, list)) and rng.random() < 0.7:
            place = place[key]
        elif rng.random() < 0.2:
            del place[key]
            return json.dumps(described).encode()
        else:
            place[key] = rng.choice(ODD)
            return json.dumps(described).encode()


def damage(rng, path):
    """Damage a file that is whole."""
    if path.suffix == ".png" or rng.random() < 0.5:
        path.write_bytes(other_bytes(rng, path.read_bytes()))
    elif path.suffix == ".json":
        path.write_bytes(other_values(rng, path.read_bytes()))
    elif path.suffix == ".npy":
        np.save(path, rng.choice(ODD_MAPS))
    else:
        words = path.read_text().split()
        words[rng.randrange(len(words))] = rng.choice(ODD_WORDS)
        path.write_text("\n".join(words[: rng.choice([0, 1, 16])]))


def use(path):
    """All that is done with such a file."""
    hologram = engine.Hologram(6, 4, 8e-6, (GREEN, 455e-9))
    assert all(np.isfinite(each.phases).all() for each in measured_levels(path, hologram))
    if path.suffix == ".json":
        found = slm.Calibration.load(path)
        if max(found.size or (0, 0)) < 99:
            with suppress(engine.InvalidInput):  # the hologram does not fit
                assert found.levels(np.ones((4, 6)), GREEN).max() < 2**found.bits


def check(count, seed, folder):
    """Damage a file so many times, and see what becomes of it."""
    whole, rng = whole_files(folder), random.Random(seed)
    refused, reports = dict.fromkeys(whole, 0), {"map.npy": "npy.json", "map.png": "png.json"}
    for _ in range(count):
        name = rng.choice(list(whole))
        damage(rng, folder / name)
        named = reports.get(name, name)
        try:
            use(folder / named)
        except engine.InvalidInput as error:
            refused[name] += 1
            text = str(error)
            assert named in text and text.endswith(".") and "\n" not in text and len(text) < 600, text
        assert {path.name for path in folder.iterdir()} == set(whole)
        (folder / name).write_bytes(whole[name])
    assert min(refused.values()) > count / 20, refused


@pytest.mark.filterwarnings("error")
def test_damaged_files(tmp_path):
    check(150, 0, tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_thousand_damaged_files(tmp_path):
    check(1000, 1, tmp_path)


def no_files(folder):
    """Paths at which no file can be read, for one reason or another."""
    (folder / "folder.json").mkdir()
    (folder / "folder.txt").mkdir()
    os.symlink(folder / "loop.json", folder / "loop.json")
    (folder / "file").touch()
    return [
        "none.json",
        "none.txt",
        "folder.json",
        "folder.txt",
        "loop.json",
        "file/in.json",
        f"{'x' * 300}.json",
    ]


def test_no_files(tmp_path):
    for name in no_files(tmp_path):
        with pytest.raises(engine.InvalidInput, match=name) as reports:
            use(tmp_path / name)
        assert "\n" not in str(reports.value)


def test_a_mark_at_the_beginning(tmp_path):
    """Editors on Windows write one."""
    whole_files(tmp_path)
    for name in ("npy.json", "levels.txt"):
        (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + (tmp_path / name).read_bytes())
        use(tmp_path / name)


def test_by_command_line(tmp_path, capsys):
    """Status 2, one line, and nothing is written."""
    folder, bad = tmp_path / "out", tmp_path / "bad"
    field = wave_field(smooth(1), depth_far=1e-3, depth_near=3e-3)
    field.save(folder / "wavefield")
    engine.encode(field, "dpac").save(folder / "hologram")
    bad.mkdir()
    whole_files(bad)
    (bad / "npy.json").write_text(
        json.dumps(WHOLE | {"responses": [{"wavelength_nm": 640, "curve": [[0, 0], [9, 6]]}]})
    )
    (bad / "map.png").write_bytes((bad / "map.png").read_bytes()[:60])
    (bad / "levels.txt").write_text("0 nan")
    before = sorted(tmp_path.rglob("*"))
    stream = ["stream", str(folder), "--driver", "files", "--quiet", "--calibration"]
    encode = [
        "encode",
        str(folder),
        "--method",
        "sgd",
        "--out",
        str(tmp_path / "new"),
        "--quiet",
        "--response",
    ]
    for words, name in (
        (stream, "npy.json"),
        (stream, "png.json"),
        (encode, "npy.json"),
        (encode, "levels.txt"),
    ):
        assert cli.main([*words, str(bad / name)]) == 2
        described = capsys.readouterr().err
        assert name in described and described.count("\n") == 1, described
        assert sorted(tmp_path.rglob("*")) == before
