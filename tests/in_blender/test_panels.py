"""All that HoloPath draws, in a window of a real Blender: needs a display, or a HOLOPATH_BLENDER that brings one."""

import json
import re
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("panels.py")
# of Python, and of Blender where a layout asks for what there is not
COMPLAINT = re.compile(r"Traceback|Error\b|error:|not found|unknown|pyrna|rna_ui|uiItem", re.IGNORECASE)
STATES = [
    "nothing rendered",
    "Mitsuba unavailable",
    "drafting",
    "a draft",
    "the draft stays",
    "rendered",
    "no camera",
    "estimated, point",
    "estimated, auto",
    "rendering",
    "canceling",
    "canceled",
    "rendered again",
    "playing",
    "an error",
    "baking",
    "baked",
    "rendered with baked light",
    "encoding",
    "encoded",
    "encoded, refocused",
    "opening the device",
    "streaming",
    "device lost",
    "stopped",
    "device refused",
    "streaming, virtual",
    "another scene",
]

pytestmark = [pytest.mark.blender, pytest.mark.slow]


@pytest.fixture(scope="module")
def walk(blender, tmp_path_factory):
    """Results of the script, and all output of Blender."""
    target = tmp_path_factory.mktemp("panels") / "result.json"
    size = "--window-geometry", 0, 0, 1600, 1000
    words = ["--enable-event-simulate", "--python-exit-code", "3", *size, "--python", SCRIPT, "--", target]
    status, output = blender(*words)
    assert target.exists(), output
    result = json.loads(target.read_text(encoding="utf-8"))
    assert "error" not in result, f"{result}\n{output}"
    assert status == 0, output
    return result, output


def test_every_panel_in_every_state(walk):
    """Each panel, menu, popover and list, and the overlay, is drawn in each state, and nothing complains."""
    result, output = walk
    assert [state for state in result["states"] if not state.startswith("settings")] == STATES
    assert result["broken"] == []
    complaints = [line for line in output.splitlines() if COMPLAINT.search(line)]
    assert complaints == [], output


def test_progress_of_a_whole_render(walk):
    """There at once, never backwards, and a way to cancel all the time."""
    result, _ = walk
    rows, status = result["rows"], result["status"]
    # half a second on two cores, 0.7 beside three other suites; a thread that imports Mitsuba would hold it for seconds
    assert result["on_screen"] < 1.5 and status[0][0] < 1.5
    assert all(len(progress) == 1 for _, progress, _ in rows)
    assert all(buttons == ["holopath.cancel", "holopath.match_output"] for _, _, buttons in rows)
    factors = [progress["factor"] for _, (progress,), _ in rows]
    for shares in (factors, result["reports"]):
        assert shares == sorted(shares) and shares[0] == 0
    assert result["reports"][-1] == 1
    messages = [text for _, text in status if text is not None]
    assert status[-1][1] is None
    for texts, form in (
        ([progress["text"] for _, (progress,), _ in rows], r"(?:(\d+)%,? )?\w.*"),
        (messages, r"HoloPath: (?:(\d+)%,? )?\w.* \(Esc cancels\)"),
    ):
        shares = [int(re.fullmatch(form, text)[1] or 0) for text in texts]
        assert shares == sorted(shares)
