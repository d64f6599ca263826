"""RENDERED shading in a window of a real Blender: needs a display, or a HOLOPATH_BLENDER that brings one."""

import json
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("viewport.py")

pytestmark = [pytest.mark.blender, pytest.mark.slow]


def test_viewport(blender, tmp_path):
    target = tmp_path / "result.json"
    size = "--window-geometry", 0, 0, 800, 600
    status, output = blender("--python-exit-code", "3", *size, "--python", SCRIPT, "--", target)
    assert target.exists(), output
    result = json.loads(target.read_text(encoding="utf-8"))
    assert "error" not in result, f"{result}\n{output}"
    assert status == 0, output
    assert "Traceback" not in output
    # what the camera frames, and what the user does to it
    assert result["cube"] == pytest.approx([0.53, 0.42], abs=0.03)
    assert result["raised"] == pytest.approx([0.53, 0.27], abs=0.04)
    assert result["shifted"] == pytest.approx([0.33, 0.27], abs=0.04)
    assert result["undone"] == pytest.approx(result["cube"], abs=0.01)
    assert result["colorful"] > 0.1
    picture, region = result["free"]
    assert picture == region
    # only what matters is read again
    assert result["exports_by_camera"] == result["exports_by_selection"] == result["exports_of_nothing"] == 0
    assert result["exports_by_bake"] <= 2  # Blender evaluates everything again after a bake
    # what cannot be shown is told
    assert "perspective" in result["orthographic"]
    assert "nothing visible" in result["empty"]
    # never two at work, and nothing left
    assert result["views"] == 2
    assert not result["together"]
    assert result["views_after_solid"] == 0
    for moment in ("solid", "loading", "disabling"):
        assert result[f"threads_after_{moment}"] == 0, moment
