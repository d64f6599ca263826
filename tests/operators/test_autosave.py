"""Blender's auto-save is written while an operator of ours is modal."""

import bpy
import pytest

from holopath_addon.operators import autosave as module


@pytest.fixture
def clock(monkeypatch, tmp_path):
    """Seconds now, in a list; files go to a folder of the test."""
    now = [1000.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(module, "_last_call", -float("inf"))
    monkeypatch.setattr(module, "autosave_path", lambda: tmp_path / "it_autosave.blend")
    paths = bpy.context.preferences.filepaths
    before = paths.use_auto_save_temporary_files, paths.auto_save_time
    paths.use_auto_save_temporary_files, paths.auto_save_time = True, 2
    yield now
    paths.use_auto_save_temporary_files, paths.auto_save_time = before


def wait(clock, seconds):
    for _ in range(round(seconds)):
        clock[0] += 1
        module.autosave()


def test_it_is_written_when_due(clock, scene, tmp_path):
    file = tmp_path / "it_autosave.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "it.blend"))
    scene["of"] = "the user"
    bpy.ops.ed.undo_push(message="a change")
    assert bpy.data.is_dirty
    wait(clock, 120)
    assert not file.exists()
    wait(clock, 2)
    assert file.exists() and bpy.data.is_dirty and bpy.data.filepath == str(tmp_path / "it.blend")
    with bpy.data.libraries.load(str(file)) as (content, _):
        assert scene.name in content.scenes
    file.unlink()
    wait(clock, 100)
    assert not file.exists()
    wait(clock, 30)
    assert file.exists()


def test_it_is_not_written(clock, scene, tmp_path, monkeypatch):
    """Where nothing has changed, the preferences do not want it, something is dragged, or Blender has just saved."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "it.blend"))
    wait(clock, 300)
    bpy.ops.ed.undo_push(message="a change")
    paths = bpy.context.preferences.filepaths
    paths.use_auto_save_temporary_files = False
    wait(clock, 300)
    paths.use_auto_save_temporary_files = True
    monkeypatch.setattr(module, "dragging", lambda: True)
    wait(clock, 300)
    clock[0] += 1000  # no operator was modal
    wait(clock, 100)
    assert [p.name for p in tmp_path.glob("*autosave*")] == []


def test_its_place_is_that_of_blender(tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a scene.blend"))
    path = module.autosave_path()
    assert path.name.startswith("a scene_") and path.name.endswith("_autosave.blend")
    bpy.ops.wm.read_homefile(use_empty=True)
    assert module.autosave_path().name.split("_")[1:] == ["autosave.blend"]
