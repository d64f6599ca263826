"""Seconds that are foretold."""

import pytest

from holopath_addon import engine


def test_a_slower_machine_is_foretold_more(build, camera, small, monkeypatch):
    """What the scene itself does not time takes as many times longer; the speed is measured once and kept."""
    from holopath_addon.engine.planning import survey
    from holopath_addon.engine.planning.machine import Slowness

    times = {}
    for slow in (Slowness(1.0, 1.0, 1.0), Slowness(3.0, 1.0, 5.0)):
        monkeypatch.setattr(survey, "slowness", lambda folder, slow=slow: slow)
        times[slow.core] = engine.plan(build.two_planes(build.diffuse), camera, small).stages
    for stage, longer in (("kernel tables", 3), ("propagation", 5)):
        assert times[3.0][stage] == pytest.approx(longer * times[1.0][stage])


@pytest.mark.parametrize("unit", [0.0, 1e-3, 0.02, 0.5])
def test_launches_are_foretold(backend, monkeypatch, unit):
    """As many as `paced` makes of units that take so long."""
    from holopath_addon.engine import progress
    from holopath_addon.engine.planning import costs

    now = 0.0
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now)
    for units, most in ((1, 4), (7, 4), (40, 4), (300, 64)):
        made = 0
        for part in progress.paced(range(units), most):
            now += unit * len(part)
            made += 1
        monkeypatch.setattr(costs, "units_at_once", lambda most=most: most)
        assert costs.launches(unit * units, units) == pytest.approx(made, rel=0.5, abs=1)


def test_launches_of_many_units_from_the_first(backend, monkeypatch):
    """As many as a card's `Pace` makes of quick units."""
    from holopath_addon.engine.planning import costs
    from holopath_addon.engine.progress import Pace

    monkeypatch.setattr(costs, "units_at_once", lambda: 64)
    for units in (1, 10, 34, 300):
        pace, left, made = Pace(64, 16), units, 0
        while left > 0:
            with pace():
                left -= pace.together
            made += 1
        assert costs.launches(1e-3, units, 16) == pytest.approx(made, rel=0.5, abs=1)
