"""Add-on preferences: what computes, and where baked light is kept."""

import os
import textwrap

import bpy
from bpy.props import EnumProperty, StringProperty

from ..engine import BakeStore, InvalidInput
from ..engine.scene import variants
from ..engine.waves import libraries

# In an extension the add-on is the package above that holds the manifest.
_PACKAGE = __name__.rpartition(".")[0]
ADDON = ".".join(_PACKAGE.split(".")[: 3 if _PACKAGE.startswith("bl_ext.") else 1])
PROGRAMS = "DRJIT_CACHE_DIR"
LINE = 80  # characters of a line that fits into the preferences
# By docs/measurements.md, On a graphics card; the size is that of the zip, of all platforms and Pythons at most.
GAIN = (
    f"{libraries.EXTENSION} is an extension of 470 MB, which takes 0.9 GB on disk. With it a Full HD hologram is "
    "expected in a third of the time, and its phases in a tenth. Get it from HoloPath's repository, or from disk."
)
WAVES = {"lacking": "INFO", "failing": "ERROR", "computing": "CHECKMARK"}  # by a card, and their icons
_found: dict = {}


def _chosen():
    """The preferences; None where HoloPath is no add-on of this Blender."""
    preferences = bpy.context.preferences
    addon = preferences.addons.get(ADDON) if preferences else None
    return addon.preferences if addon else None


def store():
    """Where this Blender keeps baked light: as the preferences say, else in the extension's own folder."""
    preferences = _chosen()
    if preferences is not None and preferences.bake_folder:
        return BakeStore(bpy.path.abspath(preferences.bake_folder))
    if ADDON.startswith("bl_ext.") and not os.environ.get("HOLOPATH_CACHE"):
        return BakeStore(bpy.utils.extension_path_user(ADDON, path="cache"))
    return BakeStore.default()


def attach():
    """Have Dr.Jit keep compiled programs in the extension's own folder, which goes with it, unless told where."""
    if ADDON.startswith("bl_ext.") and PROGRAMS not in os.environ:
        os.environ[PROGRAMS] = _found["programs"] = bpy.utils.extension_path_user(ADDON, path="programs")


def detach():
    """Undo `attach`."""
    if _found.pop("programs", None):
        os.environ.pop(PROGRAMS, None)


def wanted():
    """Backend that the preferences choose, None for the best; tells `engine.scene.variants` the LLVM that they name."""
    preferences = _chosen()
    if preferences is None:
        return None
    if preferences.llvm_library:
        os.environ["DRJIT_LIBLLVM_PATH"] = _found["llvm"] = bpy.path.abspath(preferences.llvm_library)
    elif _found.pop("llvm", None):
        os.environ.pop("DRJIT_LIBLLVM_PATH", None)
    return None if preferences.backend == "AUTO" else preferences.backend


def cluster():
    """What renders animations, as ``holopath render --cluster`` takes it; empty for this computer alone."""
    preferences = _chosen()
    return preferences.cluster.strip() if preferences is not None else ""


def environment():
    """That of a process that computes as this Blender does, which may have preferences that are not saved yet."""
    backend = wanted()
    kept = {"HOLOPATH_CACHE": str(store().folder)}
    return os.environ | kept | ({"HOLOPATH_BACKEND": backend} if backend else {})


def backends():
    """`variants.describe()`, asked once until `look_again`: it loads libraries."""
    if "rows" not in _found:
        _found["wanted"] = wanted()
        _found["rows"] = variants.describe()
    return _found["rows"]


def look_again():
    """Forget which backends there are, and what a card lacks."""
    _found.pop("rows", None)
    _found.pop("lacking", None)


def on_card():
    """Whether rays are traced on a card: there is one, and the preferences do not choose the processor."""
    usable = next(row["available"] for row in backends() if row["name"] == variants.CUDA)
    return usable and _found["wanted"] in (None, variants.CUDA)


def try_card():
    """Find out what keeps waves from being computed on a card, a sentence; empty where nothing does, or without one."""
    if on_card():
        try:
            _found["lacking"] = libraries.choose()[1]
        except InvalidInput as error:  # of the variable that names a library
            _found["lacking"] = str(error)
    return _found.get("lacking", "")


def waves():
    """What computes waves where there is a card, a sentence, and which of `WAVES` that is; both empty without one."""
    if not on_card():
        return "", ""
    lacking = _found.get("lacking")
    kind = "lacking" if not libraries.installed() else "failing" if lacking else "computing"
    return lacking or libraries.describe(), kind


def missing():
    """Why nothing can compute as the preferences wish, in a sentence; empty if it can."""
    rows = [row for row in backends() if _found["wanted"] in (None, row["name"])]
    if any(row["available"] for row in rows):
        return ""
    detail = rows[-1]["detail"]
    if rows[-1]["name"] == variants.CUDA:
        detail = f"The graphics card cannot be used: {detail}; choose Automatic in the add-on's preferences."
    return detail


def _changed(preferences, context):
    look_again()


class HoloPathPreferences(bpy.types.AddonPreferences):
    """Shown in Edit > Preferences > Add-ons > HoloPath."""

    bl_idname = ADDON

    backend: EnumProperty(
        name="Compute With",
        description="Processor that traces rays",
        update=_changed,
        items=[
            ("AUTO", "Automatic", "The graphics card where Mitsuba can use it, else the processor", 0),
            (variants.CUDA, "Graphics Card (CUDA)", "An NVIDIA card with OptiX", 1),
            (variants.LLVM, "Processor (LLVM)", "All cores, through LLVM 19 or newer", 2),
        ],
    )
    llvm_library: StringProperty(
        name="LLVM Library",
        description="libLLVM file of this computer to use in place of HoloPath's own; takes effect after a restart",
        subtype="FILE_PATH",
        update=_changed,
    )
    bake_folder: StringProperty(
        name="Baked Light",
        description="Folder to keep baked light in; empty: one of HoloPath's own",
        subtype="DIR_PATH",
    )

    cluster: StringProperty(
        name="Cluster",
        description=(
            "What renders animations in the background: address of a Dask scheduler such as tcp://10.0.0.5:8786, or "
            "local:4 for so many processes of this computer; empty: this computer alone"
        ),
    )

    def draw(self, context: bpy.types.Context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "backend")
        layout.prop(self, "llvm_library")
        layout.prop(self, "bake_folder")
        layout.prop(self, "cluster")
        column = layout.column(align=True)
        for row in backends():
            icon = "CHECKMARK" if row["available"] else "X"
            column.label(text=f"{row['name']}: {row['detail']}", icon=icon)
        said, kind = waves()
        if said:
            column = layout.column(align=True)
            lines = textwrap.wrap(said, LINE) + textwrap.wrap(GAIN if kind == "lacking" else "", LINE)
            for number, line in enumerate(lines):
                column.label(text=line, icon="BLANK1" if number else WAVES[kind])
        if kind == "lacking":
            layout.operator("holopath.get_card_extension")
        layout.operator("holopath.check")


CLASSES = (HoloPathPreferences,)
