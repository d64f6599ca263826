"""How fast a machine is."""

import json
import os

import pytest

from holopath_addon.engine.planning import machine


def anew(folder):
    """As another process finds it."""
    machine._slowness.cache_clear()
    return machine.slowness(folder)


def test_the_machine_s_speed_is_kept(tmp_path, monkeypatch):
    found = anew(tmp_path)
    assert 0.05 < found < 50
    with monkeypatch.context() as patched:
        patched.delattr(machine, "_work")
        assert anew(tmp_path) == found
    for damaged in ("", "[]", '{"made_with": "another", "slowness": 1}'):
        (tmp_path / machine.FILE).write_text(damaged)
        assert anew(tmp_path) != 1
    assert [file.name for file in tmp_path.iterdir()] == [machine.FILE]
    machine._slowness.cache_clear()


def test_a_machine_that_was_busy_is_measured_again(tmp_path, monkeypatch):
    file, usual = tmp_path / machine.FILE, machine.USUAL
    monkeypatch.setattr(machine, "_work", lambda: None)
    for taken, age, expected in ((5, 0, 5), (1, 1, 5), (1, machine.KEPT, 1), (3, machine.KEPT, 1)):
        monkeypatch.setattr(machine, "_seconds", lambda taken=taken: taken * usual)
        if age:
            os.utime(file, (file.stat().st_mtime - age,) * 2)
        assert anew(tmp_path) == pytest.approx(expected)
        assert json.loads(file.read_text())["slowness"] == pytest.approx(expected)
    machine._slowness.cache_clear()
