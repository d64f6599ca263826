"""A hologram on the second monitor while a real Blender's window is on the first."""

import json
import os
import shlex
import time

import mss
import numpy as np
import pytest

from tests.in_blender.conftest import BLENDER
from tests.patience import NEVER, SOON
from tests.slm.conftest import x_server  # noqa: F401 (a fixture)

SCRIPT = os.path.join(os.path.dirname(__file__), "streaming.py")
# a command that runs Blender on the display of its environment, where HOLOPATH_BLENDER brings a screen of its own
ON_DISPLAY = shlex.split(os.environ.get("HOLOPATH_BLENDER_ON_DISPLAY", "")) or [BLENDER]

pytestmark = [pytest.mark.blender, pytest.mark.slow]


def screenshot(left):
    with mss.MSS() as screen:
        return np.asarray(screen.grab({"left": left, "top": 0, "width": 1920, "height": 1080}))[..., 2::-1]


def test_streaming(blender, x_server, tmp_path, monkeypatch):  # noqa: F811
    target = tmp_path / "result.json"
    environment = {"DISPLAY": x_server, "LIBGL_ALWAYS_SOFTWARE": "1"}
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    words = ["--window-geometry", "0", "0", "1600", "1000", "--enable-event-simulate", "--python", SCRIPT]
    process = blender.start([*ON_DISPLAY, *words, "--", str(target)], environment)
    try:
        end = time.monotonic() + NEVER
        while not (tmp_path / "result.json.showing").exists():
            assert process.poll() is None and time.monotonic() < end, process.communicate()[0]
            time.sleep(0.1)
        second, first = screenshot(1920), screenshot(0)
        (tmp_path / "result.json.seen").touch()
        output, _ = process.communicate(timeout=NEVER)
    finally:
        blender.end(process)
    assert target.exists(), f"Blender ended with {process.returncode}: {output}"
    result = json.loads(target.read_text(encoding="utf-8"))
    print(json.dumps(result, indent=1))
    assert result["steps"] == ["shown", "reconnected", "stopped", "another file", "disabled"], result["error"]

    phases = np.random.default_rng(9).uniform(0, 2 * np.pi, (1, 1, 480, 640)).astype(np.float32)
    levels = np.zeros((1080, 1920, 1), int)
    levels[300:780, 640:1280, 0] = np.round(phases[0, 0] * (256 / (2 * np.pi))).astype(int) % 256
    np.testing.assert_array_equal(second, np.repeat(levels, 3, 2))
    # Blender's window, 1600 x 1000, is where it was
    assert first.any(axis=2).mean() > 0.7

    assert (
        len(result["monitors"]) == 2 and result["pressed"] == ["RUNNING_MODAL"] and result["twice"] is False
    )
    assert result["gaps"] < SOON and result["opening"] < SOON
    assert result["noticed"] < SOON and "window has crashed" in result["lost"]
    assert result["saved"] == [True, True, 1]  # while it streamed
    assert result["stopping"] < SOON and result["error"] == "" and "1 reconnected" in result["counts"]
    assert result["let_go"] == [True, True] and result["disabled"] == [True, False]
