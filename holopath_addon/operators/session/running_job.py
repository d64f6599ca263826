"""The running job: its progress in words, and the changes of its operator to the window."""

import math

import bpy

from .state import current


def running():
    """Whether a job is at work in its thread."""
    return current.job is not None and current.job.running


def progress_text(job):
    """Describe the progress of a `Job`: ``42%, 12 s left: Wave tracing``, ``Compiling…`` or ``Canceling…``."""
    activity, remaining = "Compiling" if job.compiling else job.message, job.remaining
    if job.canceling:
        return "Canceling…"
    if not job.done:
        return f"{activity}…"
    # seconds first: a narrow panel cuts the end of a line off
    left = "" if remaining is None else f", {math.ceil(remaining)} s left:"
    return f"{job.done:.0%}{left} {activity}"


def restore_window(deferred=False):
    """Take back what the running operator changed in the window, once.

    Parameters
    ----------
    deferred : bool
        See `undo_window_change`.
    """
    undo, current.restore_window = current.restore_window, None
    if undo is not None:
        undo_window_change(undo, deferred)


def undo_window_change(undo, deferred):
    """Call a function that takes back a change of the window.

    Blender frees an unregistered operator at the window's next event, and crashes if another operator starts before.

    Parameters
    ----------
    undo : callable
        Called without arguments.
    deferred : bool
        Call it in half a second, after the operator's timer has fired once more, not now.
    """
    if deferred:
        bpy.app.timers.register(undo, first_interval=0.5)
    else:
        undo()


def end_timer(timer, deferred=False):
    """Remove an operator's `bpy.types.Timer`; `deferred` as in `undo_window_change`."""
    undo_window_change(lambda: bpy.data.window_managers[0].event_timer_remove(timer), deferred)
