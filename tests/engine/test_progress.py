"""Division of work for progress."""

import pytest

from holopath_addon.engine import progress


@pytest.mark.parametrize(
    ("max_units", "sizes"),
    [(100, [1, 2, 4, 8, 8, 4, 2, *[1] * 8]), (3, [1, 2, *[3] * 5, *[1] * 19])],
)
def test_parts_grow_while_they_are_quick(monkeypatch, max_units, sizes):
    """And get smaller where units take long."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    parts = []
    for part in progress.paced(range(3, 40), max_units):
        parts.append(part)
        now[0] += sum(0.03 if number < 18 else 1 for number in part)
    assert [len(part) for part in parts] == sizes
    assert [number for part in parts for number in part] == list(range(3, 40))
