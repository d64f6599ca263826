"""How fast this machine is."""

from holopath_addon.engine.planning import machine


def test_the_machine_s_speed_is_measured_once(tmp_path, monkeypatch):
    machine.slowness.cache_clear()
    found = machine.slowness(tmp_path)
    assert 0.05 < found < 50
    machine.slowness.cache_clear()
    with monkeypatch.context() as patched:
        patched.delattr(machine, "_work")
        assert machine.slowness(tmp_path) == found
    for damaged in ("", "[]", '{"made_with": "another", "slowness": 1}'):
        (tmp_path / machine.FILE).write_text(damaged)
        machine.slowness.cache_clear()
        assert machine.slowness(tmp_path) != 1
    assert [file.name for file in tmp_path.iterdir()] == [machine.FILE]
    machine.slowness.cache_clear()
