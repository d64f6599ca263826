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
    result = json.loads(killed.read_text("utf-8"))
    assert result["before"] == result["after"] == [True, str(tmp_path / "scene.blend")], (
        "the file is as it was"
    )
    end = time.monotonic() + NEVER
    while processes.start_time(result["pid"]):
        assert time.monotonic() < end, "a hidden process goes on"
        time.sleep(0.1)
    before = fields(out)
    assert sorted(before) in (ALL[:2], ALL[:3])
    assert sorted(file.name for file in out.iterdir()) == [*sorted(before), "job.json", "light"]

    status, output = blender("--python-exit-code", "3", "--python", SCRIPT, "--", tmp_path)
    result = json.loads((tmp_path / "RESULT.json").read_text("utf-8"))
    assert "error" not in result and status == 0, (result, output)
    after = fields(out)
    assert sorted(after) == ALL and before.items() <= after.items()
    assert result["first"] == sorted(result["first"]) and result["ended"] == ["", 4, False]
    assert result["twice"] is False and result["longest"] < result["seconds"] / 2, "the window waits"
    assert result["again"][:2] == ["", 4] and "0 frames in" in result["again"][2]
    assert result["canceled"] == ["", True]
    assert sorted(file.name for file in out.iterdir()) == [*ALL, "job.json", "light"]
