"""Blender's auto-save, which Blender itself leaves out as long as any operator of a window is modal."""

import os
import time
from contextlib import suppress
from pathlib import Path

import bpy

MINUTE = 60.0  # seconds
MAX_GAP = 5.0  # seconds between two calls, beyond which no operator was modal, and Blender saved by itself

_last_call = _last_save = -float("inf")


def dragging():
    """Whether the user is moving, painting or sculpting something."""
    return any(
        {"BLOCKING", "MACRO"} & operator.bl_options  # what moves a copy is a macro
        for window in bpy.data.window_managers[0].windows
        for operator in getattr(window, "modal_operators", ())
    )


def autosave():
    """Save where Blender's preferences want it; to be called at each timer event of a modal operator."""
    global _last_call, _last_save
    now, paths = time.monotonic(), bpy.context.preferences.filepaths
    if now - _last_call > MAX_GAP:
        _last_save = now
    _last_call = now
    due = now - _last_save > paths.auto_save_time * MINUTE
    if not (due and paths.use_auto_save_temporary_files and bpy.data.is_dirty) or dragging():
        return
    _last_save = now
    with suppress(RuntimeError):  # such as a full disk, of which Blender's report tells
        bpy.ops.wm.save_as_mainfile(filepath=str(autosave_path()), copy=True, relative_remap=False)


def autosave_path():
    """Path of the file that *File > Recover > Auto Save* looks for, see `wm_autosave_location` in Blender's source.

    Returns
    -------
    pathlib.Path
    """
    parts = [Path(bpy.data.filepath).stem] if bpy.data.filepath else []
    return Path(bpy.app.tempdir).parent / "_".join([*parts, str(os.getpid()), "autosave.blend"])
