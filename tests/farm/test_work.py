"""Work that is shared: all is made, by somebody, and nothing twice at once."""

import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import asdict
from pathlib import Path

import pytest

from holopath_addon.engine import InvalidInput
from holopath_addon.farm import claims, work
from holopath_addon.farm.claims import Claim
from holopath_addon.farm.units import Unit
from holopath_addon.farm.work import work_off
from tests.patience import NEVER

ROOT = Path(__file__).parents[2]


class Made:
    """Units that write files, and the order in which they did."""

    def __init__(self, folder):
        self.folder, self.names, self.output = folder, [], []

    def unit(self, name, needs=(), fails=None, prepares=False):
        def make(progress):
            progress(0.5, f"Making {name}")
            self.names.append(name)
            if fails:
                raise fails
            (self.folder / name).write_text(name)

        return Unit(name, make, (self.folder / name).exists, needs, prepares=prepares)

    def off(self, *units, progress=lambda done, message: None):
        work_off(self.folder, units, "tag", progress, self.output.append)


@pytest.fixture
def made(tmp_path, monkeypatch):
    monkeypatch.setattr(work, "POLL", 0.02)
    return Made(tmp_path)


def test_what_is_there_is_not_made_again(made):
    (made.folder / "b").write_text("b")
    made.off(*map(made.unit, "abc"))
    assert made.names == ["a", "c"] and made.output == ["b: done before, skipped"]
    assert sorted(os.listdir(made.folder)) == ["a", "b", "c"]


def test_what_is_needed_is_made_first(made):
    made.off(
        made.unit("end", ("left", "right")),
        made.unit("left", ("begin",)),
        made.unit("right", ("begin",)),
        made.unit("begin"),
    )
    assert made.names == ["begin", "left", "right", "end"]


def test_progress_goes_on_over_all(made):
    output = []
    made.off(*map(made.unit, "ab"), progress=lambda done, message: output.append((done, message)))
    assert output == [(0.25, "Making a"), (0.75, "Making b")]


def test_what_prepares_is_not_counted(made):
    output = []
    light = made.unit("light", prepares=True)
    units = light, *(made.unit(name, ("light",)) for name in "ab")
    made.off(*units, progress=lambda done, message: output.append((done, message)))
    assert output == [(0.0, "Making light"), (0.25, "Making a"), (0.75, "Making b")]
    made.off(*units)
    assert made.output == ["a: done before, skipped", "b: done before, skipped"]
    (made.folder / "light").unlink()
    made.off(light, progress=lambda done, message: output.append((done, message)))  # as a worker does
    assert output[3:] == [(0.5, "Making light")]


def test_what_fails_is_given_back(made):
    with pytest.raises(InvalidInput, match="wrong"):
        made.off(made.unit("a"), made.unit("b", fails=InvalidInput("wrong")), made.unit("c"))
    assert sorted(os.listdir(made.folder)) == ["a"]


def hold(folder, name):
    """Another machine's claim."""
    file = folder / claims.FOLDER / name
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(asdict(Claim("elsewhere", "elsewhere 1", 1, "1", "tag", "0"))))
    return file


def test_what_others_make_is_waited_for(made):
    file = hold(made.folder, "a")

    def finish():
        time.sleep(0.3)
        (made.folder / "a").write_text("a")
        file.unlink()

    other = threading.Thread(target=finish)
    other.start()
    made.off(*map(made.unit, "ab"))
    other.join()
    assert made.names == ["b"] and made.output == ["a: done by another process"]


def test_what_a_process_of_another_machine_left_is_taken_over(made, monkeypatch):
    monkeypatch.setattr(claims, "STALE_AFTER", 0.5)
    hold(made.folder, "a")
    made.off(*map(made.unit, "ab"))
    assert made.names == ["b", "a"]
    assert sorted(os.listdir(made.folder)) == ["a", "b"]


def test_what_killed_processes_left_is_swept_or_put_back(made):
    (made.folder / ".a.part-x").mkdir()
    (made.folder / ".a.part-x" / "half").write_text("half")
    (made.folder / ".b.old-x").mkdir()
    (made.folder / ".b.old-x" / "b").write_text("before")
    (made.folder / ".c.old-x").mkdir()
    (made.folder / ".c.old-x" / "c").write_text("before")
    (made.folder / "c").write_text("after")
    (made.folder / ".other.part-x").mkdir()
    made.off(*map(made.unit, "abc"))
    assert made.names == ["a"]
    assert (made.folder / "b").read_text() == "before" and (made.folder / "c").read_text() == "after"
    assert sorted(os.listdir(made.folder)) == [".other.part-x", "a", "b", "c"]


def test_a_slow_process_whose_work_was_taken_over_goes_on(made):
    """Taken for gone, it finds what it was writing swept away."""
    second = made.unit("b")

    def make(progress):
        file = hold(made.folder, "a")
        (made.folder / "a").write_text("by the other")
        file.unlink()
        raise FileNotFoundError(2, "No such file", "a")

    made.off(Unit("a", make, (made.folder / "a").exists), second)
    assert (made.folder / "a").read_text() == "by the other" and made.names == ["b"]

    with pytest.raises(OSError, match="full"):
        made.off(made.unit("c", fails=OSError(28, "full")))


def test_what_was_there_of_another_job_is_made_anew(made):
    """A file with a unit's name means nothing, unless it appeared during the work."""
    (made.folder / "a").write_text("of another job")
    made.off(Unit("a", made.unit("a").make, lambda: (made.folder / "a").read_text() == "a"))
    assert (made.folder / "a").read_text() == "a"


def test_what_another_process_made_meanwhile_is_not_looked_into(made):
    file, request = hold(made.folder, "a"), []

    def finish():
        (made.folder / "a").write_text("a")
        file.unlink()

    threading.Timer(0.2, finish).start()
    made.off(Unit("a", made.unit("a").make, lambda: request.append("a")))
    assert made.names == [] and request == [] and made.output == ["a: done by another process"]


def test_in_a_crowd_each_begins_elsewhere(made):
    units = [made.unit(f"u{n}") for n in range(9)]
    assert work.in_turn(units, set()) == units
    orders = [[unit.name for unit in work.in_turn(units, {"u0", "u4"})] for _ in range(200)]
    assert {tuple(order[5:]) for order in orders} == {("u7", "u8", "u0", "u4")}
    assert {order[0] for order in orders} == {"u1", "u2", "u3", "u5", "u6"}


def test_a_crowd_looks_as_often_as_a_hundred_processes():
    assert 0.7 < work.pause(2) < 1.3 and 0.7 < work.pause(300) < 1.3
    assert 7 < work.pause(3000) < 13


SHARES = """
import sys, time
from pathlib import Path
from holopath_addon.farm.units import Unit
from holopath_addon.farm.work import work_off
folder = Path(sys.argv[1])
def unit(name):
    def make(progress):
        with open(folder / f"{name}.made", "x"):
            time.sleep(0.01)
    return Unit(name, make, (folder / f"{name}.made").exists)
work_off(folder, [unit(f"u{n:02d}") for n in range(40)], "tag", lambda *_: None, lambda text: None)
"""


def test_processes_share_and_make_nothing_twice(tmp_path):
    """Make a unit's file, which fails if it exists."""
    words = [sys.executable, "-c", SHARES, str(tmp_path)]
    others = [subprocess.Popen(words, cwd=ROOT, stderr=subprocess.PIPE, text=True) for _ in range(4)]
    for other in others:
        _, error = other.communicate(timeout=NEVER)
        assert other.returncode == 0, error
    assert sorted(os.listdir(tmp_path)) == [f"u{n:02d}.made" for n in range(40)]
