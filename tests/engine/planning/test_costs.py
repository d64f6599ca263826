"""Estimates of seconds and memory."""

import pytest

from holopath_addon import engine


def test_a_slower_machine_needs_more_seconds(build, camera, small, monkeypatch):
    """Stages that are not timed in the scene take longer by the machine's slowness."""
    from holopath_addon.engine.planning import survey
    from holopath_addon.engine.planning.machine import Slowness

    times = {}
    for slow in (Slowness(1.0, 1.0, 1.0), Slowness(3.0, 1.0, 5.0)):
        monkeypatch.setattr(survey, "slowness", lambda folder, slow=slow: slow)
        times[slow.core] = engine.plan(build.two_planes(build.diffuse), camera, small).stages
    for stage, longer in (("kernel tables", 3), ("propagation", 5)):
        assert times[3.0][stage] == pytest.approx(longer * times[1.0][stage])


@pytest.mark.parametrize("unit", [0.0, 1e-3, 0.02, 0.5])
def test_launch_count_of_paced_work(backend, monkeypatch, unit):
    """The estimate is the number of launches that `paced` makes."""
    from holopath_addon.engine import progress
    from holopath_addon.engine.planning import costs

    now = 0.0
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now)
    for units, limit in ((1, 4), (7, 4), (40, 4), (300, 64)):
        made = 0
        for part in progress.paced(range(units), limit):
            now += unit * len(part)
            made += 1
        monkeypatch.setattr(costs, "units_at_once", lambda limit=limit: limit)
        assert costs.launch_count(unit * units, units) == pytest.approx(made, rel=0.5, abs=1)


def test_launches_of_many_units_from_the_first(backend, monkeypatch):
    """The estimate is the number of launches that a card's `Pace` makes of quick units."""
    from holopath_addon.engine.planning import costs
    from holopath_addon.engine.progress import Pace

    monkeypatch.setattr(costs, "units_at_once", lambda: 64)
    for units in (1, 10, 34, 300):
        pace, left, made = Pace(64, 16), units, 0
        while left > 0:
            with pace():
                left -= pace.together
            made += 1
        assert costs.launch_count(1e-3, units, 16) == pytest.approx(made, rel=0.5, abs=1)


def test_memory_of_a_card_by_stage(build, camera, as_on_a_card):
    """Each stage needs at least the field, and what is too large is left to the processor."""
    hologram = engine.Hologram(128, 64, 8e-6, (640e-9, 500e-9), depth_far=0.5e-3, depth_near=3e-3)
    scene, settings = build.two_planes(build.emissive), engine.Settings(frames=8, planes=1, max_depth=1)
    field = 8 * 128 * 64 * 2 * 8

    def plan():
        return engine.plan(scene, camera, hologram, settings)

    as_on_a_card(64 << 30)
    large = plan()
    assert list(large.card_memory) == ["wave tracing", "propagation", "reconstruction", *large.phases_memory]
    assert all(needed >= field for needed in large.card_memory.values())
    assert large.card_memory["joint"] > 2 * field + (1 << 30)
    assert "64" not in large.library and large.library != "numpy" and "(all fit)" in str(large)
    as_on_a_card(1 << 30)
    small = plan()
    assert small.library == large.library
    assert f"(left to the processor: {', '.join(large.phases_memory)})" in str(small)
    as_on_a_card(field)
    tiny = plan()
    assert tiny.library == "numpy" and "The Library would need" in str(tiny)
    assert tiny.chunk == 1 << 20 and large.chunk > tiny.chunk


def test_batches_that_go_by_a_card_s_memory(build, camera, as_on_a_card, monkeypatch):
    """Batches take half of the free memory, and the plan names the encodings with smaller ones."""
    from holopath_addon.engine import memory

    monkeypatch.setattr(memory, "CARD_BATCH", 1 << 20)
    hologram = engine.Hologram(256, 256, 8e-6, (500e-9,), depth_far=0.5e-3, depth_near=3e-3)
    scene, settings = build.two_planes(build.emissive), engine.Settings(frames=24, planes=1, max_depth=1)

    def plan(free):
        as_on_a_card(free)
        return engine.plan(scene, camera, hologram, settings)

    large = plan(64 << 30)
    own, step = 8 + 4, 40  # bytes of a pixel of a frame
    steps = large.card_memory["sgd"] * step / (own + step)
    free = int(1.4 * steps)
    small = plan(free)
    assert large.card_memory["sgd"] - small.card_memory["sgd"] == pytest.approx(steps - free // 2)
    assert "sgd" in str(small).split("in smaller batches, which fit: ")[1].split(")")[0]


def test_seconds_of_a_card(build, camera, small, as_on_a_card, monkeypatch):
    """Copies of field and phases to the processor count, and waves that do not fit take the processor's time."""
    from holopath_addon.engine.planning import costs, planner, survey
    from holopath_addon.engine.planning.machine import Slowness

    card, processor = Slowness(1.0, 0.1, 0.01, 2.0), Slowness(1.0, 1.0, 1.0)
    monkeypatch.setattr(survey, "slowness", lambda folder: card)
    monkeypatch.setattr(planner, "slowness", lambda folder, library: processor)
    scene, settings = build.two_planes(build.emissive), engine.Settings(frames=4, planes=1)
    taken = {}
    for free in (64 << 30, 1 << 30, 1 << 10):
        as_on_a_card(free)
        taken[free] = engine.plan(scene, camera, small, settings)
    large, small_card, tiny = taken.values()
    field, pixels = 8 * 128 * 128 * 4, 128 * 128 * 4
    moved = pixels * costs.PROPAGATION_SECONDS
    assert large.stages["propagation"] == pytest.approx(
        0.01 * moved + 2 * costs.COPY_SECONDS_PER_BYTE * field
    )
    assert small_card.stages["propagation"] == large.stages["propagation"]
    assert tiny.stages["propagation"] == pytest.approx(moved)
    assert large.phases["sgd"] == pytest.approx(
        0.01 * pixels * costs.SGD_SECONDS + 2 * costs.COPY_SECONDS_PER_BYTE * field / 2
    )
    assert small_card.phases["sgd"] == tiny.phases["sgd"] == pytest.approx(pixels * costs.SGD_SECONDS)
