"""Seconds that are foretold."""

import pytest

from holopath_addon import engine


def test_a_slower_machine_is_foretold_more(build, camera, small, monkeypatch):
    """What the scene itself does not time takes as many times longer; the speed is measured once and kept."""
    from holopath_addon.engine.planning import survey

    times = {}
    for slow in (1.0, 3.0):
        monkeypatch.setattr(survey, "slowness", lambda folder, slow=slow: slow)
        times[slow] = engine.plan(build.two_planes(build.diffuse), camera, small).stages
    for stage in ("kernel tables", "propagation"):
        assert times[3.0][stage] == pytest.approx(3 * times[1.0][stage])
