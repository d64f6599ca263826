"""Baked light, by buttons."""

import bpy
import pytest

from holopath_addon import engine
from holopath_addon.blender import preferences
from holopath_addon.engine import rendering
from holopath_addon.operators import session
from holopath_addon.operators.jobs import Job
from tests.patience import NEVER


@pytest.fixture
def store(tmp_path, monkeypatch):
    """An empty folder of baked light."""
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path))
    return preferences.store()


def test_bake(lit, store):
    assert not bpy.ops.holopath.show_texture.poll() and not bpy.ops.holopath.clear_baked.poll()
    assert bpy.ops.holopath.bake() == {"FINISHED"}
    assert session.current.bake["reused"] == "nothing" and store.size() == session.current.bake["bytes"] > 0
    assert session.TEXTURE not in bpy.data.images
    assert bpy.ops.holopath.show_texture() == {"FINISHED"}
    image = bpy.data.images[session.TEXTURE]
    assert max(image.pixels) > 0 and image.is_float

    lit.holopath.method = "fast"
    lit.holopath.focus = 2.0
    bpy.ops.holopath.render_hologram()
    assert session.current.bake["reused"] == "all"
    assert not bpy.ops.holopath.show_texture.poll()  # but the panel has another button in its place
    assert bpy.ops.holopath.bake(show=True) == {"FINISHED"}
    assert session.current.bake["reused"] == "all" and session.current.texture is not None
    assert bpy.ops.holopath.bake(anew=True) == {"FINISHED"}
    assert session.current.bake["reused"] == "nothing"

    assert bpy.ops.holopath.clear_baked() == {"FINISHED"}
    assert store.size() == 0 and session.current.bake is None
    assert bpy.data.images[session.TEXTURE] == image  # the user's own now


def test_a_bake_computes_with_what_the_main_thread_has_read(lit, store):
    """Also where the main thread began with Mitsuba after the job's own, as at a session's first press of Bake."""
    import drjit

    from holopath_addon.operators.modal_operator import read_task

    area = bpy.data.lights.new("Panel", "AREA")  # whose place is a transform that nobody has evaluated
    lit.collection.objects.link(bpy.data.objects.new("Panel", area))
    bpy.context.view_layer.update()

    def work(progress):
        return read_task(job, progress, lit.name).bake(progress)

    job = session.current.job = Job(work)
    job.start()
    while not job.wait(0.01):
        if job.message == "Reading the scene":
            drjit.detail.new_scope(drjit.JitBackend.LLVM)
        job.answer_query()
    assert job.error is None
    session.current.job = None


def test_a_bake_that_is_canceled(lit, store):
    task = session.prepare(bpy.context.evaluated_depsgraph_get(), lit.holopath)
    job = session.current.job = Job(task.bake)
    job.start()
    assert not bpy.ops.holopath.bake.poll() and not bpy.ops.holopath.plan.poll()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert job.wait(NEVER) and isinstance(job.error, engine.Cancelled)
    assert session.current.bake is None and store.size() == 0


def test_baking_fails_in_a_sentence(scene, monkeypatch):
    def fail(*_, **__):
        raise engine.InvalidInput("There is no room.")

    monkeypatch.setattr(rendering, "baked_picture", fail)
    with pytest.raises(RuntimeError, match="There is no room"):
        bpy.ops.holopath.bake()
    assert not session.running() and session.current.bake is None
