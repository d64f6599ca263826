"""How work is cut for progress to be told."""

from holopath_addon.engine import progress


def test_parts_grow_while_they_are_quick(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    parts = []
    for part in progress.paced(range(3, 40)):
        parts.append(part)
        now[0] += 0.03 * len(part)
    assert [len(part) for part in parts] == [1, 2, 4, 8, 8, 8, 6]
    assert [number for part in parts for number in part] == list(range(3, 40))
