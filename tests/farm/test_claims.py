"""Claims in a shared folder: one holder, whatever dies, and no trace at the end."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from holopath_addon.farm import claims, processes
from holopath_addon.farm.claims import Claim, Claims
from tests.patience import NEVER, SOON

ROOT = Path(__file__).parents[2]


def start(code, *words):
    """A Python process of its own."""
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, words)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )


HOLDS = """
import sys, time
from holopath_addon.farm.claims import Claims
with Claims(sys.argv[1], "tag") as claims, claims.claim("unit") as held:
    print(held, flush=True)
    time.sleep(60)
"""

# As often as it is told, take a claim for a moment in which nobody else may hold it, and be killed now and then.
TAKES = """
import os, random, signal, sys, time
from holopath_addon.farm.claims import Claims
folder, count, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
random.seed(seed)
with Claims(folder, "tag") as claims:
    for turn in range(count):
        with claims.wait("unit"):
            os.close(os.open(f"{folder}/alone", os.O_CREAT | os.O_EXCL))
            os.unlink(f"{folder}/alone")
            if turn == count - 1 and seed:
                os.kill(os.getpid(), signal.SIGKILL)
"""


def of_elsewhere(folder, name="unit", tag="tag"):
    """A claim by a process of another machine."""
    file = folder / claims.FOLDER / name
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(asdict(Claim("elsewhere", "elsewhere 1", 1, "1", tag, "0"))))
    return file


def test_one_holds_and_the_other_does_not(tmp_path):
    with Claims(tmp_path, "tag") as first, Claims(tmp_path, "tag") as second:
        with first.claim("unit") as held, second.claim("unit") as too:
            assert held and not too
            assert second.holder("unit").pid == os.getpid()
        with second.claim("unit") as held:
            assert held
        assert first.holder("unit") is None
    assert os.listdir(tmp_path) == []


def test_a_claim_is_given_back_when_the_work_fails(tmp_path):
    with Claims(tmp_path, "tag") as mine:
        with pytest.raises(KeyboardInterrupt), mine.claim("unit"):
            raise KeyboardInterrupt
        assert mine.holder("unit") is None
    assert os.listdir(tmp_path) == []


def test_a_killed_process_is_noticed_at_once(tmp_path):
    other = start(HOLDS, tmp_path)
    assert other.stdout.readline() == "True\n"
    with Claims(tmp_path, "tag") as mine:
        with mine.claim("unit") as held:
            assert not held
        other.send_signal(signal.SIGKILL)  # not waited for: a zombie runs no more
        deadline = time.monotonic() + SOON
        while mine.holder("unit") is not None and time.monotonic() < deadline:
            time.sleep(0.01)
        with mine.claim("unit") as held:
            assert held
    other.communicate()
    assert os.listdir(tmp_path) == []


def test_a_process_number_that_is_used_again_is_another_process(tmp_path):
    file = of_elsewhere(tmp_path)
    claim = Claim("here", processes.place(), os.getpid(), "long ago", "tag", "0")
    file.write_text(json.dumps(asdict(claim)))
    with Claims(tmp_path, "tag") as mine:
        assert mine.holder("unit") is None
        file.write_text(json.dumps(asdict(replace(claim, started=processes.start_time(os.getpid())))))
        assert mine.holder("unit") is not None
        file.unlink()


def test_a_process_of_another_machine_is_gone_when_its_heart_stops(tmp_path):
    file = of_elsewhere(tmp_path)
    with Claims(tmp_path, "tag") as mine:
        with mine.claim("unit") as held:
            assert not held
        os.utime(file, (time.time() - claims.STALE_AFTER + 10,) * 2)
        with mine.claim("unit") as held:
            assert not held
        os.utime(file, (time.time() - claims.STALE_AFTER - 10,) * 2)
        with mine.claim("unit") as held:
            assert held
    assert os.listdir(tmp_path) == []


def test_only_the_clock_of_the_file_server_counts(tmp_path, monkeypatch):
    of_elsewhere(tmp_path)
    monkeypatch.setattr(time, "time", lambda: 4e9)
    with Claims(tmp_path, "tag") as mine, mine.claim("unit") as held:
        assert not held


def test_an_empty_claim_is_one_that_is_being_made(tmp_path):
    file = of_elsewhere(tmp_path)
    file.write_text("")
    with Claims(tmp_path, "tag") as mine:
        assert mine.holder("unit") == Claim()
        os.utime(file, (time.time() - claims.STALE_AFTER - 10,) * 2)
        with mine.claim("unit") as held:
            assert held


def test_the_heart_beats_and_notices_a_claim_that_was_taken_over(tmp_path, monkeypatch):
    monkeypatch.setattr(claims, "TOUCH_INTERVAL", 0.02)
    with Claims(tmp_path, "tag") as mine:
        with mine.claim("unit") as held:
            file = tmp_path / claims.FOLDER / "unit"
            assert held and not mine.is_lost("unit")
            os.utime(file, (0, 0))
            time.sleep(0.2)
            assert file.stat().st_mtime > 0
            of_elsewhere(tmp_path)
            os.utime(file, (0, 0))
            time.sleep(0.2)
            assert mine.is_lost("unit") and file.stat().st_mtime == 0
            os.utime(file)
    assert json.loads(file.read_text())["host"] == "elsewhere"  # not ours to give back


def test_of_two_that_find_a_stale_claim_at_once_one_takes_it_over(tmp_path, monkeypatch):
    file = of_elsewhere(tmp_path)
    os.utime(file, (0, 0))
    with Claims(tmp_path, "tag") as slow, Claims(tmp_path, "tag") as quick:
        left, taken = slow._seconds_alive, quick.claim("unit")

        def overtaken(*found):
            monkeypatch.setattr(slow, "_seconds_alive", left)
            output = left(*found)
            assert taken.__enter__()
            return output

        monkeypatch.setattr(slow, "_seconds_alive", overtaken)
        with slow.claim("unit") as held:
            assert not held and not quick.is_lost("unit")
        taken.__exit__(None, None, None)
    assert os.listdir(tmp_path) == []


def test_holders(tmp_path):
    of_elsewhere(tmp_path, "frame_0003", "another")
    of_elsewhere(tmp_path, "frame_0004", "tag")
    old = of_elsewhere(tmp_path, "frame_0005", "another")
    os.utime(old, (0, 0))
    with Claims(tmp_path, "tag") as mine:
        found = {name: claim for name, claim in mine.holders().items() if name[0] != "."}
        assert {name: claim.tag for name, claim in found.items()} == {
            "frame_0003": "another",
            "frame_0004": "tag",
        }
        assert found["frame_0003"].host == "elsewhere"
        assert [claim.tag for name, claim in mine.holders().items() if name[0] == "."] == ["tag"]


def test_of_many_that_are_killed_one_holds_it_at_a_time(tmp_path):
    """Each dies in the end while it holds the claim, which all others then find stale at once."""
    rivals = [start(TAKES, tmp_path, 100, seed) for seed in range(6)]
    for rival in rivals:
        rival.communicate(timeout=NEVER)
    assert [rival.returncode for rival in rivals] == [0, *[-signal.SIGKILL] * 5]
    with Claims(tmp_path, "tag"):
        pass
    assert os.listdir(tmp_path) == []


def test_interrupts_wait_for_the_end_of_the_outermost_block():
    done = []
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), processes.uninterrupted():
            with processes.uninterrupted():
                signal.raise_signal(signal.SIGINT)
                done.append("inner")
            done.append("outer")
    finally:
        signal.signal(signal.SIGINT, before)
    assert done == ["inner", "outer"]
