"""Properties by the names of the version before: scripts, presets and files use them for one version more."""

import warnings
from typing import Any

import bpy

from ...engine.settings.former_names import FORMER_NAMES, current_name

NAMES = FORMER_NAMES["property"]


def _former(old):
    """Attribute of the former name; it is no property of Blender's, so files hold the current one."""

    def warn(text):
        warnings.warn(text, DeprecationWarning, stacklevel=4)

    def get(self):
        return getattr(self, current_name("property", old, warn))

    def set_(self, value):
        setattr(self, current_name("property", old, warn), value)

    return property(get, set_, doc=f"Former name of `{NAMES[old]}`.")


class FormerNames:
    """Attributes of all former names, for classes of property groups."""

    locals().update({old: _former(old) for old in NAMES})


def adopt(props):
    """Set properties from values that a file of the version before holds by their former names.

    Parameters
    ----------
    props : bpy.types.PropertyGroup
    """
    # Blender 5 keeps values of properties apart from those that users add.
    values = props.bl_system_properties_get() if hasattr(props, "bl_system_properties_get") else props
    known = props.bl_rna.properties
    for old, new in NAMES.items():
        if values is None or old not in values or new not in known or props.is_property_set(new):
            continue
        value = values[old]
        if known[new].type == "ENUM":
            value = next((item.identifier for item in known[new].enum_items if item.value == value), None)
        if value is not None:
            setattr(props, new, value)


def adopt_animation():
    """Point keyframes and drivers of scenes at the current names; otherwise Blender ignores them without a word."""
    for curve in _curves():
        path, _, name = curve.data_path.rpartition(".")
        if name in NAMES and path.startswith("holopath"):
            curve.data_path = f"{path}.{NAMES[name]}"


def _curves():
    """Animation curves of all actions, and drivers of all scenes."""
    actions: Any = bpy.data.actions  # the stubs are of one version of Blender
    for action in actions:
        if hasattr(action, "layers"):  # since Blender 4.4
            strips = [strip for layer in action.layers for strip in layer.strips]
            yield from (curve for strip in strips for bag in strip.channelbags for curve in bag.fcurves)
        else:
            yield from action.fcurves
    for scene in bpy.data.scenes:
        if scene.animation_data:
            yield from scene.animation_data.drivers
