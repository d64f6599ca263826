"""Operators that are modal for long, and make way for Blender's auto-save: Blender saves only while none is modal."""

import time
from functools import partial
from typing import TYPE_CHECKING

import bpy

MINUTE = 60.0  # seconds
PAUSE = 0.2  # seconds; an auto-save that is due comes within 0.01 s

_paused: dict[str, dict] = {}  # attributes of the operators that make way, by identifier

if TYPE_CHECKING:
    _Operator = bpy.types.Operator
else:
    _Operator = object


class LongModal(_Operator):
    """Base of operators that are modal for long.

    Its `invoke` begins with `resume`, and ends with `become_modal`. Its `modal` calls `make_way` at timer events.
    """

    _modal_since = 0.0
    _window = 0  # address of the window whose timer it hears

    def become_modal(self) -> set:
        """Receive events from now on; the result of `invoke`."""
        self._modal_since = time.monotonic()
        self._window = bpy.context.window.as_pointer() if bpy.context.window else 0
        bpy.data.window_managers[0].modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def make_way(self) -> bool:
        """Whether the operator has to end now, as Blender's auto-save may be due; another one goes on after it.

        The time is that of Blender's preferences, since this operator became modal.
        """
        preferences = bpy.context.preferences
        assert preferences is not None
        paths = preferences.filepaths
        unsaved = paths.use_auto_save_temporary_files and bpy.data.is_dirty
        if not unsaved or dragging() or time.monotonic() - self._modal_since < paths.auto_save_time * MINUTE:
            return False
        name = type(self).bl_idname
        _paused[name] = dict(vars(self))
        bpy.app.timers.register(partial(_go_on, name), first_interval=PAUSE)
        return True

    def resume(self) -> bool:
        """Whether this operator goes on in the place of a paused one; it then has its attributes."""
        attributes = _paused.pop(type(self).bl_idname, None)
        if attributes is None:
            return False
        vars(self).update(attributes)
        return True


def dragging() -> bool:
    """Whether the user is moving, painting or sculpting something."""
    return any(
        {"BLOCKING", "MACRO"} & operator.bl_options  # what moves a copy is a macro
        for window in bpy.data.window_managers[0].windows
        for operator in getattr(window, "modal_operators", ())
    )


def is_paused(operator: type) -> bool:
    """Whether an operator of this class makes way, and is to be invoked again."""
    return operator.bl_idname in _paused


def forget_paused() -> None:
    """Let nothing go on: what the paused operators watched was stopped."""
    _paused.clear()


def _go_on(name):
    """Invoke the operator that goes on, unless the user or a new file was faster."""
    if dragging():  # an Esc is for what is dragged
        return PAUSE
    if name in _paused:
        group, function = name.split(".")
        windows, own = bpy.data.window_managers[0].windows, _paused[name]["_window"]
        window = next((each for each in windows if each.as_pointer() == own), windows[0])
        try:
            with bpy.context.temp_override(window=window):
                getattr(getattr(bpy.ops, group), function)("INVOKE_DEFAULT")
        finally:
            _paused.pop(name, None)  # what cannot go on is over
    return None
