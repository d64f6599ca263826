"""The one place that tells Blender about HoloPath's classes, settings, handlers and command."""

from collections.abc import Callable

import bpy

from . import operators, preferences, properties, render_engine, ui, viewport
from .operators import devices, session

_CLASSES = (
    *properties.CLASSES,
    *preferences.CLASSES,
    *operators.CLASSES,
    *ui.CLASSES,
    *render_engine.CLASSES,
)
_undo: list[Callable[[], object]] = []


def register():
    """Register everything; if one part fails, none stays."""
    try:
        for cls in _CLASSES:
            bpy.utils.register_class(cls)
            _undo.append(lambda cls=cls: bpy.utils.unregister_class(cls))
        preferences.attach()
        _undo.append(preferences.detach)
        properties.attach()
        _undo.append(properties.detach)
        ui.share_panels()
        _undo.append(ui.unshare_panels)
        ui.add_to_menus()
        _undo.append(ui.remove_from_menus)
        ui.show_overlay()
        _undo.append(ui.hide_overlay)
        session.attach()
        _undo.append(session.detach)
        devices.attach()
        _undo.append(devices.detach)
        viewport.attach()
        _undo.append(viewport.detach)
        if hasattr(bpy.utils, "register_cli_command"):
            command = bpy.utils.register_cli_command("holopath", _run_command)
            _undo.append(lambda: bpy.utils.unregister_cli_command(command))
    except BaseException:
        unregister()
        raise


def unregister():
    """Undo `register`, last first; if one part fails, the others go all the same."""
    while _undo:
        try:
            _undo.pop()()
        except BaseException:
            unregister()
            raise


def _run_command(argv):
    from . import cli

    preferences.wanted()  # the LLVM that they name
    return cli.main(argv, preferences.store())
