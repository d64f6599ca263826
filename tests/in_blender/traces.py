"""Traces of HoloPath in a running Blender. Imported by scripts that run there, and in the bpy module."""

import sys

import bpy

OWNERS = (bpy.types.Scene, bpy.types.Material, bpy.types.Object, bpy.types.Camera, bpy.types.WindowManager)
BASES = (
    bpy.types.AddonPreferences,
    bpy.types.Menu,
    bpy.types.Operator,
    bpy.types.Panel,
    bpy.types.PropertyGroup,
    bpy.types.RenderEngine,
    bpy.types.UIList,
)


def traces():
    """All of it, a sorted list of lines; empty where HoloPath is not enabled."""
    found = [f"type {name}" for name in dir(bpy.types) if "holopath" in name.lower()]
    for base in BASES:
        found += [
            f"class {cls.__name__}"
            for cls in base.__subclasses__()
            if "holopath" in cls.__module__ and getattr(cls, "is_registered", False)
        ]
    for name in dir(bpy.types):
        kind = getattr(bpy.types, name)
        if "HOLOPATH" in getattr(kind, "COMPAT_ENGINES", ()):
            found.append(f"panel {name}")
        drawn = getattr(getattr(kind, "draw", None), "_draw_funcs", ())
        found += [f"drawn in {name}" for function in drawn if "holopath" in function.__module__]
    for name in dir(bpy.app.handlers):
        callbacks = getattr(bpy.app.handlers, name)
        if isinstance(callbacks, list):
            found += [f"handler {name}" for call in callbacks if "holopath" in call.__module__]
    for owner in OWNERS:
        found += [
            f"property of {owner.__name__}" for key in owner.bl_rna.properties.keys() if "holopath" in key
        ]
    found += [f"operator {name}" for name in dir(bpy.ops.holopath)]
    for name, module in list(sys.modules.items()):
        if "holopath" in name and name.endswith(".operators.session.refocusing"):
            if bpy.app.timers.is_registered(module._poll_refocus):
                found.append("timer of refocusing")
    return sorted(set(found))


def modules(name):
    """Python modules of a package that are loaded."""
    return sorted(key for key in sys.modules if key == name or key.startswith(f"{name}."))
