"""Operators that make way for Blender's auto-save; tests/in_blender/streaming.py has it in a window."""

import types

import pytest

from holopath_addon.operators import long_modal


class Watching(long_modal.LongModal):
    """An operator, as far as Blender is not needed."""

    bl_idname = "holopath.watching"


@pytest.fixture
def clock(monkeypatch):
    """Seconds now, in a list. The file is changed, and to be saved every two minutes."""
    now = [1000.0]
    paths = types.SimpleNamespace(use_auto_save_temporary_files=True, auto_save_time=2)
    window_manager = types.SimpleNamespace(modal_handler_add=lambda operator: None)
    timers = []
    register = types.SimpleNamespace(register=lambda function, first_interval: timers.append(function))
    fake = types.SimpleNamespace(
        app=types.SimpleNamespace(timers=register),
        context=types.SimpleNamespace(preferences=types.SimpleNamespace(filepaths=paths), window=None),
        dragging=False,
        data=types.SimpleNamespace(is_dirty=True, window_managers=[window_manager]),
    )
    monkeypatch.setattr(long_modal, "bpy", fake)
    monkeypatch.setattr(long_modal, "time", types.SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(long_modal, "_paused", {})
    monkeypatch.setattr(long_modal, "dragging", lambda: fake.dragging)
    return types.SimpleNamespace(now=now, paths=paths, data=fake.data, timers=timers, blender=fake)


def test_another_operator_goes_on(clock):
    first = Watching()
    first.job = "a render"
    assert first.become_modal() == {"RUNNING_MODAL"}
    clock.now[0] += 119
    assert not first.make_way() and not long_modal.is_paused(Watching) and not Watching().resume()
    clock.now[0] += 2
    assert first.make_way() and long_modal.is_paused(Watching) and len(clock.timers) == 1
    second = Watching()
    assert second.resume() and second.job == "a render" and not long_modal.is_paused(Watching)
    second.become_modal()
    assert not second.make_way()
    clock.timers[0]()  # too late: it invokes nothing
    clock.now[0] += 121
    assert second.make_way()


def test_it_makes_no_way_in_vain(clock):
    """Where nothing has changed, the preferences want no auto-save, or something is dragged."""
    operator = Watching()
    operator.become_modal()
    clock.now[0] += 1000
    clock.data.is_dirty = False
    assert not operator.make_way()
    clock.data.is_dirty, clock.paths.use_auto_save_temporary_files = True, False
    assert not operator.make_way()
    clock.paths.use_auto_save_temporary_files, clock.blender.dragging = True, True
    assert not operator.make_way()
    clock.blender.dragging = False
    assert operator.make_way()
    long_modal.forget_paused()  # a file is opened
    assert not Watching().resume()
