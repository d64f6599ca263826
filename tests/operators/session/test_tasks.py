"""Tasks: cameras, threads and progress."""

import bpy
import numpy as np
import pytest

from holopath_addon.operators import session
from holopath_addon.operators.jobs import Job
from tests.patience import NEVER


def test_another_camera_than_the_scene_has(scene):
    """A local camera of a 3D View, which F12 renders."""
    camera = bpy.data.objects.new("Local", bpy.data.cameras.new("Local"))
    camera.location.x = 0.1
    scene.collection.objects.link(camera)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    task = session.prepare(depsgraph, scene.holopath, camera=camera)
    assert task.exported.camera.position[0] == pytest.approx(0.1)
    assert task.request.origin.scene_state["camera"] == "Local"


def test_job_in_a_thread_is_the_same_as_without(scene):
    task = session.prepare(bpy.context.evaluated_depsgraph_get(), scene.holopath)
    here, there = Job(task.compute), Job(task.compute)
    here.run()
    there.start()
    assert there.wait(NEVER)
    np.testing.assert_array_equal(here.result.field.data, there.result.field.data)
    assert there.done == pytest.approx(1.0)


@pytest.mark.parametrize("settings", [{}, {"method": "fast"}, {"despeckle": 1}])
def test_progress_never_goes_back(lit, settings):
    for name, value in settings.items():
        setattr(lit.holopath, name, value)
    task, reports = session.prepare(bpy.context.evaluated_depsgraph_get(), lit.holopath), []
    task.compute(lambda done, message: reports.append(done))
    assert reports[0] == 0 and reports[-1] == 1 and reports == sorted(reports)
