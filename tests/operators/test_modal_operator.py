"""Scenes that operators read in a thread."""

from holopath_addon import engine
from holopath_addon.operators.jobs import Job


def test_a_scene_that_is_left_is_not_read(scene):
    """An operator renders the scene whose button was pressed, or nothing."""
    from holopath_addon.operators.modal_operator import read_task

    job = Job(lambda progress: read_task(job, progress, "Another"))
    job.run()
    assert isinstance(job.error, engine.InvalidInput) and "'Another' was left or deleted" in str(job.error)
