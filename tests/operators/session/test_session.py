"""Files that are opened, and the end of the session."""

import bpy
import pytest

from holopath_addon import engine
from holopath_addon.operators import session
from holopath_addon.operators.jobs import Job
from tests.patience import NEVER


def test_another_file_forgets(scene):
    bpy.ops.holopath.render_hologram()
    assert session.current.field is not None
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert session.current.field is None and session.current.plan is None


def test_a_file_that_cannot_be_opened_loses_nothing(scene, tmp_path):
    bpy.ops.holopath.render_hologram()
    field, broken = session.current.field, tmp_path / "broken.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(broken), copy=True, compress=False)
    broken.write_bytes(broken.read_bytes()[:4000])
    with pytest.raises(RuntimeError):
        bpy.ops.wm.open_mainfile(filepath=str(broken))
    assert session.current.field is field and session.current.task is not None


def test_opening_a_file_cancels(scene):
    task = session.prepare(bpy.context.evaluated_depsgraph_get(), scene.holopath)

    def forever(progress):
        while True:
            task.compute(progress)

    job = session.current.job = Job(forever)
    job.start()
    assert session.running()
    assert not bpy.ops.holopath.render_hologram.poll()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert job.wait(NEVER) and isinstance(job.error, engine.Cancelled)
    assert session.current.job is None


def test_ending_takes_back_what_an_operator_changed(scene):
    undone = []

    def undo():
        undone.append(True)

    session.current.restore_window = undo
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert undone == [True] and session.current.restore_window is None
    session.current.restore_window = undo
    session.detach()
    assert bpy.app.timers.is_registered(undo) and session.current.restore_window is None
    bpy.app.timers.unregister(undo)
