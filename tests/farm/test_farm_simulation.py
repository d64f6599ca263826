"""`python -m benchmarks farm`: the simulated units are the engine's, and its arithmetic where the answer is known."""

import json
from dataclasses import asdict

import pytest

from benchmarks import farm
from benchmarks.farm_operations import rules
from benchmarks.farm_simulation import Dask, Folder, Rules, Step, simulate
from holopath_addon import engine
from holopath_addon.farm import work
from holopath_addon.farm.parts import StillParts

EVERYTHING = Folder("as much as one likes", 1e30, 1e30)
IDEAL = Dask(0.0, 0.0)


def alike(count, kind="frame", needs=(), **costs):
    return [Step(f"{kind}_{n}", kind, needs=needs, **costs) for n in range(count)]


def names(steps):
    return tuple(step.name for step in steps)


@pytest.mark.parametrize("count", [1, 5, 40])
def test_units_are_those_of_a_still_in_parts(tmp_path, count):
    hologram = engine.Hologram(64, 64, 8e-6, (640e-9, 516.5e-9, 455.4e-9))
    settings = engine.Settings(frames=8, method="full")
    parts = StillParts(tmp_path / "still", count, hologram, settings, "job", "none", None, None)
    units = parts.units.values()
    rows = [[n, name, 1.0, 2, 3, 4] for n in (2, 1) for name in parts.units]
    found = {
        "hologram": json.dumps(hologram.to_dict()),
        "settings": json.dumps(asdict(settings)),
        "units": rows,
    }
    assert [(step.name, step.needs) for step in farm.still(found, count)] == [
        (unit.name, unit.needs) for unit in units
    ]


def test_questions_that_were_not_asked_are_left_out():
    hologram = engine.Hologram(64, 64, 8e-6, (640e-9,))
    settings = engine.Settings(frames=1, method="full")
    kinds = ["prepared", "asked-1-1", "told-1", "asked-2-1", "told-2", "traced-1", "gathered-1", "joined"]
    found = {
        "hologram": json.dumps(hologram.to_dict()),
        "settings": json.dumps(asdict(settings)),
        "units": [[n, kind, 1.0, 2, 3, 4] for n in (2, 1) for kind in kinds],
    }
    steps = {step.name: step.needs for step in farm.still(found, 2)}
    assert len(steps) == 11 and "told-5-of-2" not in steps
    assert steps["traced-2-of-2"] == ("told-2-of-2",)
    assert steps["asked-2-1-of-2"] == ("told-1-of-2",)


def test_what_divides_and_what_does_not():
    """Of units that take 1 s each and 12 s together, the first of a process 3 s more."""
    rows = [
        [count, f"traced-{n}-of-{count}", 1 + 12 / count + 3 * (n == 0), 0, 0, 0]
        for count in (6, 2)
        for n in range(count)
    ]
    cost = farm._cost(rows, "traced", 4, 1.0)
    assert cost["seconds"] == pytest.approx(4.0) and cost["first_seconds"] == pytest.approx(3.0)
    assert farm._cost(rows, "traced", 4, 2.0)["seconds"] == pytest.approx(7.0)


@pytest.mark.parametrize(("workers", "seconds"), [(1, 83), (4, 23), (8, 13), (100, 13)])
@pytest.mark.parametrize("dask", [None, IDEAL])
def test_what_does_not_depend_on_each_other(workers, seconds, dask):
    result = simulate(alike(8, seconds=10.0), workers, EVERYTHING, Rules(), 3.0, dask)
    assert result.seconds == pytest.approx(seconds, abs=0.0 if dask else work.HURRY)
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
    """In a folder with 64 and with 128 others, which hold a unit each."""
    found = rules()
    assert found.join < 50 and found.leave < 300 and found.look <= 4
    assert max(found.join_each, found.leave_each, found.visit_each, found.look_held, found.look_waiting) < 0.5
