"""`python -m benchmarks farm`: its arithmetic where the answer is known, and what a process asks of a folder."""

import pytest

from benchmarks.farm_operations import rules
from benchmarks.farm_simulation import Dask, Folder, Rules, Step, simulate
from holopath_addon.farm import work

EVERYTHING = Folder("as much as one likes", 1e30, 1e30)
IDEAL = Dask(0.0, 0.0)


def alike(count, kind="frame", needs=(), **costs):
    return [Step(f"{kind}_{n}", kind, needs=needs, **costs) for n in range(count)]


def names(steps):
    return tuple(step.name for step in steps)


@pytest.mark.parametrize(("workers", "seconds"), [(1, 83), (4, 23), (8, 13), (100, 13)])
@pytest.mark.parametrize("dask", [None, IDEAL])
def test_what_does_not_depend_on_each_other(workers, seconds, dask):
    result = simulate(alike(8, seconds=10.0), workers, EVERYTHING, Rules(), 3.0, dask)
    assert result.seconds == pytest.approx(seconds, abs=0.0 if dask else work.RETRY)
    assert result.spent["compute"] == pytest.approx(80.0)


def test_what_waits_for_others():
    """Prepared, traced and joined: 10 s, four of 5 s on two workers, 2 s."""
    prepared = alike(1, "prepared", seconds=10.0)
    traced = alike(4, "traced", names(prepared), seconds=5.0)
    steps = [*prepared, *traced, *alike(1, "joined", names(traced), seconds=2.0)]
    assert simulate(steps, 2, EVERYTHING, Rules(), dask=IDEAL).seconds == pytest.approx(22.0)
    processes = simulate(steps, 2, EVERYTHING, Rules())
    assert 22.0 <= processes.seconds < 22.0 + 3 * 1.25  # where one waits it looks once a second
    assert processes.limit == "waits: prepared"


def test_a_folder_has_one_after_the_other():
    """Bytes of all, with no time between; and each asks ten times to begin, at ten a second."""
    frames = alike(8, seconds=1.0, written=100.0)
    assert simulate(frames, 8, Folder("slow", 100.0, 1e30), Rules()).seconds == pytest.approx(9.0)
    result = simulate(alike(3, seconds=100.0), 3, Folder("asked", 1e30, 10.0), Rules(join=10.0))
    assert 103.0 < result.seconds < 106.0  # and the claims


def test_a_scheduler_has_one_after_the_other():
    result = simulate(alike(100, seconds=1.0), 100, EVERYTHING, Rules(), dask=Dask(0.5, 0.0))
    assert result.seconds == pytest.approx(51.0)
    assert result.limit == "scheduler"


def test_what_a_process_asks_for_does_not_grow_with_others():
    """Operations in a folder with 64 and with 128 other processes, which hold a unit each."""
    found = rules()
    assert found.join < 50 and found.leave < 300 and found.look <= 4
    assert max(found.join_each, found.leave_each, found.visit_each, found.look_held, found.look_waiting) < 0.5
