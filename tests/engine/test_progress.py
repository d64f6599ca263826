"""How work is cut for progress to be told."""

import pytest

from holopath_addon.engine import progress


@pytest.mark.parametrize(("most", "sizes"), [(100, [1, 2, 4, 8, 8, 8, 6]), (3, [1, 2, *[3] * 11, 1])])
def test_parts_grow_while_they_are_quick(monkeypatch, most, sizes):
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    parts = []
    for part in progress.paced(range(3, 40), most):
        parts.append(part)
        now[0] += 0.03 * len(part)
    assert [len(part) for part in parts] == sizes
    assert [number for part in parts for number in part] == list(range(3, 40))
