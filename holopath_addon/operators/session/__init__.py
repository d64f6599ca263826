"""State of this Blender session, with a module each for tasks, results, images, the running job and refocusing."""

import threading

import bpy

from ...blender import properties
from ...blender.properties.optics import on_bench_change
from ..long_modal import forget_paused
from .images import IMAGE, PHASE, TEXTURE, redraw, rgba_rows, show_phase, show_texture, to_rgba, write_image
from .refocusing import (
    is_refocusing,
    keep_and_show,
    refocus,
    refocus_by_settings,
    refocus_if_changed,
    restore_picture,
    show_preview,
    stop_polling,
    stop_sweep,
)
from .results import (
    bake_of,
    encoded_hologram,
    encoding_of,
    keep,
    keep_bake,
    keep_phase,
    keep_plan,
    plan_of,
    stored_refocuser,
    texture_of,
)
from .running_job import end_timer, progress_text, restore_window, running
from .state import current, forget_all, record_error
from .tasks import Task, before_export, cache, prepare, request_of

__all__ = [
    "IMAGE",
    "PHASE",
    "TEXTURE",
    "Task",
    "bake_of",
    "before_export",
    "cache",
    "current",
    "detach",
    "encoded_hologram",
    "encoding_of",
    "end_timer",
    "handlers",
    "is_refocusing",
    "keep",
    "keep_and_show",
    "keep_bake",
    "keep_phase",
    "keep_plan",
    "plan_of",
    "prepare",
    "progress_text",
    "record_error",
    "redraw",
    "refocus",
    "refocus_by_settings",
    "request_of",
    "restore_picture",
    "restore_window",
    "rgba_rows",
    "running",
    "show_phase",
    "show_preview",
    "show_texture",
    "stop_sweep",
    "stored_refocuser",
    "texture_of",
    "to_rgba",
    "write_image",
]


@bpy.app.handlers.persistent
def _stop_work(*_):
    """Stop the work before another file is opened. Results stay, as the file may be broken."""
    for job in (current.job, current.refocus_job):
        if job is not None:
            job.cancel()
            job.wait(5.0)
    restore_window()
    stop_sweep()
    forget_paused()


@bpy.app.handlers.persistent
def _forget_file(*_):
    """Free the results of the last file after another one was opened."""
    forget_all()


@bpy.app.handlers.persistent
def _on_render_end(*_):
    """Take up a field or an error of F12, which in a window calls this on a thread of its own."""
    if threading.current_thread() is threading.main_thread():
        _after_f12()
    else:
        bpy.app.timers.register(_after_f12)


def _after_f12():
    """Write down the distance at which F12 focused automatically, and redraw."""
    distance, current.autofocus_distance = current.autofocus_distance, None
    scene = bpy.data.scenes.get(current.field_scene)
    if distance is not None and scene is not None and properties.of(scene).focus_auto:
        properties.note_focus(properties.of(scene), distance)
    redraw()


def _refocus_on_bench(scene):
    refocus_by_settings(properties.of(scene))


def _show_chosen_frame(props):
    if current.phase is not None:
        show_phase(props.phase_frame)


@bpy.app.handlers.persistent
def _show_undone(*_):
    """Show what the settings describe after an undo, which restores them without a call for each."""
    scene = bpy.context.scene
    if scene is None or scene.name != current.field_scene or current.refocuser is None or running():
        return
    props = properties.of(scene)
    if current.shown_frame != props.phase_frame and PHASE in bpy.data.images:
        _show_chosen_frame(props)
    refocus_if_changed(props)


def handlers():
    """Callbacks for changed settings, opened files and the end of F12's renders: see `registration`.

    Returns
    -------
    list of (list, callable)
        Lists of callbacks, each with one to add.
    """
    handlers = bpy.app.handlers
    return [
        (properties.on_view_change, refocus_by_settings),
        (on_bench_change, _refocus_on_bench),
        (properties.on_frame_change, _show_chosen_frame),
        (handlers.undo_post, _show_undone),
        (handlers.redo_post, _show_undone),
        (handlers.load_pre, _stop_work),
        (handlers.load_post, _forget_file),
        (handlers.render_complete, _on_render_end),
        (handlers.render_cancel, _on_render_end),
    ]


def detach():
    """Stop all work and free everything."""
    stop_polling()
    restore_window(deferred=True)
    stop_sweep(deferred=True)
    _stop_work()
    _forget_file()
    cache.close()
