"""Registering leaves nothing behind."""

import subprocess
import sys

import bpy
import pytest

import holopath_addon
from holopath_addon.operators import session

HANDLERS = ("load_pre", "load_post", "render_complete", "render_cancel")


def traces():
    """Everything that HoloPath adds to Blender."""
    names = {name for name in dir(bpy.types) if "holopath" in name.lower()}
    engines = {
        name
        for name in dir(bpy.types)
        if "HOLOPATH" in getattr(getattr(bpy.types, name), "COMPAT_ENGINES", ())
        and "holopath" not in name.lower()
    }
    handlers = [len(getattr(bpy.app.handlers, name)) for name in HANDLERS]
    held = hasattr(bpy.types.Scene, "holopath") or hasattr(bpy.types.Material, "holopath")
    menus = bpy.types.VIEW3D_MT_add, bpy.types.TOPBAR_MT_render
    menu = [len(getattr(each.draw, "_draw_funcs", ())) for each in menus]
    return names, engines, handlers, held, hasattr(bpy.ops.holopath, "plan"), menu


def test_cycles(addon):
    there = traces()
    addon.unregister()
    gone = traces()
    assert gone[0] == set() and gone[1] == set() and gone[3] is False
    for _ in range(3):
        addon.register()
        assert traces() == there
        addon.unregister()
        assert traces() == gone
    addon.register()


def test_failure_leaves_nothing(addon, monkeypatch):
    addon.unregister()
    gone = traces()

    def fail():
        raise RuntimeError("no")

    with monkeypatch.context() as patch:
        patch.setattr("holopath_addon.operators.session.handlers", fail)
        with pytest.raises(RuntimeError):
            addon.register()
    assert traces() == gone
    addon.register()


def test_everything_goes_where_another_addon_took_a_handler(addon):
    addon.unregister()
    gone = traces()
    addon.register()
    bpy.app.handlers.load_post.remove(session._forget_file)
    addon.unregister()
    assert traces() == gone
    addon.register()


def test_everything_goes_where_a_part_does_not(addon, monkeypatch):
    addon.unregister()
    gone = traces()

    def fail():
        raise RuntimeError("no")

    with monkeypatch.context() as patch:
        patch.setattr("holopath_addon.ui.unshare_panels", fail)
        addon.register()
    with pytest.raises(RuntimeError, match="no"):
        addon.unregister()
    left = traces()
    assert (left[0], *left[2:]) == (gone[0], *gone[2:])
    addon.register()
    addon.unregister()
    assert traces() == gone
    addon.register()


def test_package_needs_no_bpy():
    code = "import sys; sys.modules['bpy'] = None; import holopath_addon.engine, holopath_addon.cli"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=holopath_addon.__path__[0] + "/..")


def test_blenders_own_panels_are_shared(addon):
    assert "HOLOPATH" in bpy.types.RENDER_PT_format.COMPAT_ENGINES
    assert "HOLOPATH" in bpy.types.EEVEE_MATERIAL_PT_surface.COMPAT_ENGINES
    addon.unregister()
    assert "HOLOPATH" not in bpy.types.RENDER_PT_format.COMPAT_ENGINES
    addon.register()
