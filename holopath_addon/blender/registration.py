"""Registration of HoloPath's classes, settings, handlers and command with Blender."""

import os
from collections.abc import Callable
from functools import partial

import bpy

from .. import operators, ui
from ..operators import background, devices, session
from ..workflow.signals import ignore_signals_of_writes
from . import preferences, properties, render_engine, viewport

_CLASSES = (
    *properties.CLASSES,
    *preferences.CLASSES,
    *operators.CLASSES,
    *ui.CLASSES,
    *render_engine.CLASSES,
)
_undo: list[Callable[[], object]] = []


def register():
    """Register everything; if one part fails, the others are unregistered."""
    try:
        ignore_signals_of_writes()
        for cls in _CLASSES:
            bpy.utils.register_class(cls)
            _undo.append(partial(bpy.utils.unregister_class, cls))
        for begin, end in (
            (preferences.attach, preferences.detach),
            (properties.attach, properties.detach),
            (ui.share_panels, ui.unshare_panels),
            (ui.add_to_menus, ui.remove_from_menus),
            (ui.show_overlay, ui.hide_overlay),
        ):
            begin()
            _undo.append(end)
        _undo.append(background.detach)
        for module in (session, devices, viewport):
            _undo.append(module.detach)
            for callbacks, handler in module.handlers():
                callbacks.append(handler)
                _undo.append(partial(_stop_listening, callbacks, handler))
        if hasattr(bpy.utils, "register_cli_command"):
            command = bpy.utils.register_cli_command("holopath", _run_command)
            _undo.append(lambda: bpy.utils.unregister_cli_command(command))
    except BaseException:
        unregister()
        raise


def unregister():
    """Undo `register`, last part first; if one part fails, the others are still undone."""
    while _undo:
        try:
            _undo.pop()()
        except BaseException:
            unregister()
            raise


def _stop_listening(callbacks, handler):
    if handler in callbacks:  # another add-on may have cleared the list
        callbacks.remove(handler)


def _run_command(argv):
    from .. import cli

    backend = preferences.chosen_backend()  # it also sets the variable of the chosen LLVM
    if backend:  # what is given with a command counts more than what was chosen in the window
        os.environ.setdefault("HOLOPATH_BACKEND", backend)
    return cli.main(argv, preferences.store())
