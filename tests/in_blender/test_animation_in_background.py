"""An animation that Blender's window has rendered in the background, and that outlasts Blender."""

import json
import time
from pathlib import Path

import pytest

from holopath_addon.farm import processes
from tests.patience import NEVER

SCRIPT = Path(__file__).with_name("animation.py")
ALL = ["frame_0001", "frame_0002", "frame_0003", "frame_0004"]

pytestmark = [pytest.mark.blender, pytest.mark.slow]


def fields(folder):
    return {file.parents[1].name: file.stat().st_mtime_ns for file in folder.rglob("field.npy")}


def test_goes_on_after_blender_was_killed(blender, tmp_path):
    """Its process ends with Blender, and leaves whole frames alone; the button makes the others."""
    out = tmp_path / "holopath"
    status, output = blender("--python-exit-code", "3", "--python", SCRIPT, "--", tmp_path)
    killed = tmp_path / "killed.json"
    assert status != 0 and killed.exists(), (output, list(tmp_path.glob("RESULT.json")))
    told = json.loads(killed.read_text("utf-8"))
    assert told["before"] == told["after"] == [True, str(tmp_path / "scene.blend")], "the file is as it was"
    end = time.monotonic() + NEVER
    while processes.start_time(told["pid"]):
        assert time.monotonic() < end, "a hidden process goes on"
        time.sleep(0.1)
    before = fields(out)
    assert sorted(before) in (ALL[:2], ALL[:3])
    assert sorted(file.name for file in out.iterdir()) == [*sorted(before), "job.json", "light"]

    status, output = blender("--python-exit-code", "3", "--python", SCRIPT, "--", tmp_path)
    told = json.loads((tmp_path / "RESULT.json").read_text("utf-8"))
    assert "error" not in told and status == 0, (told, output)
    after = fields(out)
    assert sorted(after) == ALL and before.items() <= after.items()
    assert told["first"] == sorted(told["first"]) and told["ended"] == ["", 4, False]
    assert told["twice"] is False and told["longest"] < told["seconds"] / 2, "the window waits"
    assert told["again"][:2] == ["", 4] and "0 frames in" in told["again"][2]
    assert told["canceled"] == ["", True]
    assert sorted(file.name for file in out.iterdir()) == [*ALL, "job.json", "light"]
