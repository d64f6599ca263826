"""Add-on preferences: what computes, and where baked light is kept."""

import os

import bpy
from bpy.props import EnumProperty, StringProperty

from .engine import BakeStore, backend

# In an extension the add-on is the package above that holds the manifest.
ADDON = ".".join(__package__.split(".")[: 3 if __package__.startswith("bl_ext.") else 1])


def _chosen():
    """The preferences; None where HoloPath is no add-on of this Blender."""
    addon = bpy.context.preferences.addons.get(ADDON)
    return addon.preferences if addon else None


def store():
    """Where this Blender keeps baked light: as the preferences say, else in the extension's own folder."""
    preferences = _chosen()
    if preferences is not None and preferences.bake_folder:
        return BakeStore(bpy.path.abspath(preferences.bake_folder))
    if ADDON.startswith("bl_ext.") and not os.environ.get("HOLOPATH_CACHE"):
        return BakeStore(bpy.utils.extension_path_user(ADDON, path="cache"))
    return BakeStore.default()


def apply():
    """Choose the backend as the preferences say; before Mitsuba is first used.

    Raises
    ------
    engine.BackendUnavailable
    """
    preferences = _chosen()
    if preferences is None:
        backend.activate()
        return
    if preferences.llvm_library:
        os.environ["DRJIT_LIBLLVM_PATH"] = bpy.path.abspath(preferences.llvm_library)
    backend.activate(None if preferences.backend == "AUTO" else preferences.backend)


class HoloPathPreferences(bpy.types.AddonPreferences):
    """Shown in Edit > Preferences > Add-ons > HoloPath."""

    bl_idname = ADDON

    backend: EnumProperty(
        name="Compute With",
        description="Processor that traces rays",
        items=[
            ("AUTO", "Automatic", "The graphics card where Mitsuba can use it, else the processor", 0),
            (backend.CUDA, "Graphics card (CUDA)", "An NVIDIA card with OptiX", 1),
            (backend.LLVM, "Processor (LLVM)", "All cores, through LLVM 19 or newer", 2),
        ],
    )
    llvm_library: StringProperty(
        name="LLVM Library",
        description="libLLVM file to use in place of the newest one found; takes effect after a restart",
        subtype="FILE_PATH",
    )
    bake_folder: StringProperty(
        name="Baked Light",
        description="Folder to keep baked light in; empty: one of HoloPath's own",
        subtype="DIR_PATH",
    )

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "backend")
        layout.prop(self, "llvm_library")
        layout.prop(self, "bake_folder")
        for row in _backends():
            icon = "CHECKMARK" if row["available"] else "X"
            layout.label(text=f"{row['name']}: {row['detail']}", icon=icon)


_described = []


def _backends():
    """`backend.describe()`, asked once a session: it loads libraries."""
    if not _described:
        _described.extend(backend.describe())
    return _described


CLASSES = (HoloPathPreferences,)
