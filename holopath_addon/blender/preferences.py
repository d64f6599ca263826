"""Add-on preferences: processor, folder of baked light, and cluster."""

import os
import textwrap

import bpy
from bpy.props import EnumProperty, StringProperty

from ..engine import BakeStore, InvalidInput
from ..engine.scene import variants
from ..engine.waves import libraries

# Package with the manifest: of an extension the third level, bl_ext.REPOSITORY.NAME.
_PACKAGE = __name__.rpartition(".")[0]
ADDON = ".".join(_PACKAGE.split(".")[: 3 if _PACKAGE.startswith("bl_ext.") else 1])
PROGRAM_CACHE_VARIABLE = "DRJIT_CACHE_DIR"
LINE_LENGTH = 80  # characters of a line that fits into the preferences
# Figures of docs/measurements.md, On a graphics card. The size is that of the largest zip.
GAIN = (
    f"{libraries.EXTENSION} is an extension of 470 MB, which takes 0.9 GB on disk. With it a Full HD hologram is "
    "expected in a third of the time, and its phases in a tenth. Get it from HoloPath's repository, or from disk."
)
WAVE_ICONS = {
    "lacking": "INFO",
    "failing": "ERROR",
    "computing": "CHECKMARK",
}  # by the state of waves on a card
_found: dict = {}  # backends, the chosen one, the card's problem, and variables that were set


def _chosen():
    """The preferences; None if HoloPath is not an add-on of this Blender."""
    preferences = bpy.context.preferences
    addon = preferences.addons.get(ADDON) if preferences else None
    return addon.preferences if addon else None


def store():
    """The `BakeStore` of this Blender: in the folder of the preferences, else in the extension's own."""
    preferences = _chosen()
    if preferences is not None and preferences.bake_folder:
        return BakeStore(bpy.path.abspath(preferences.bake_folder))
    if ADDON.startswith("bl_ext.") and not os.environ.get("HOLOPATH_CACHE"):
        return BakeStore(bpy.utils.extension_path_user(ADDON, path="cache"))
    return BakeStore.default()


def attach():
    """Have Dr.Jit keep compiled programs in the extension's own folder, unless its variable names another."""
    if ADDON.startswith("bl_ext.") and PROGRAM_CACHE_VARIABLE not in os.environ:
        os.environ[PROGRAM_CACHE_VARIABLE] = _found["programs"] = bpy.utils.extension_path_user(
            ADDON, path="programs"
        )


def detach():
    """Undo `attach`."""
    if _found.pop("programs", None):
        os.environ.pop(PROGRAM_CACHE_VARIABLE, None)


def chosen_backend():
    """Backend that the preferences choose; None for the best one. Also sets the variable of the chosen LLVM library."""
    preferences = _chosen()
    if preferences is None:
        return None
    if preferences.llvm_library:
        os.environ["DRJIT_LIBLLVM_PATH"] = _found["llvm"] = bpy.path.abspath(preferences.llvm_library)
    elif _found.pop("llvm", None):
        os.environ.pop("DRJIT_LIBLLVM_PATH", None)
    return None if preferences.backend == "AUTO" else preferences.backend


def cluster():
    """Cluster that renders animations, for ``holopath render --cluster``; empty: this computer only."""
    preferences = _chosen()
    return preferences.cluster.strip() if preferences is not None else ""


def environment():
    """Environment variables of a process that computes as this Blender does, with preferences not saved yet."""
    backend = chosen_backend()
    cache = {"HOLOPATH_CACHE": str(store().folder)}
    return os.environ | cache | ({"HOLOPATH_BACKEND": backend} if backend else {})


def backends():
    """Rows of `variants.describe()`, kept until `forget_backends`, as it loads libraries."""
    if "rows" not in _found:
        _found["chosen"] = chosen_backend()
        _found["rows"] = variants.describe()
    return _found["rows"]


def forget_backends():
    """Forget the kept backends and the card's problem."""
    _found.pop("rows", None)
    _found.pop("lacking", None)


def traces_on_card():
    """Whether rays are traced on a graphics card: one is usable, and the preferences do not choose the processor."""
    usable = next(row["available"] for row in backends() if row["name"] == variants.CUDA)
    return usable and _found["chosen"] in (None, variants.CUDA)


def check_card():
    """Try to compute waves on the card.

    Returns
    -------
    str
        Sentence on the problem; empty without one, or without a card.
    """
    if traces_on_card():
        try:
            _found["lacking"] = libraries.choose()[1]
        except InvalidInput as error:  # the variable names an unknown library
            _found["lacking"] = str(error)
    return _found.get("lacking", "")


def wave_status():
    """State of the computation of waves on the card.

    Returns
    -------
    sentence : str
        What computes them, or the problem; empty without a card.
    kind : str
        Key of `WAVE_ICONS`; empty without a card.
    """
    if not traces_on_card():
        return "", ""
    lacking = _found.get("lacking")
    kind = "lacking" if not libraries.installed() else "failing" if lacking else "computing"
    return lacking or libraries.describe(), kind


def used_backend():
    """The row of `backends` that computes as the preferences choose; None if none can."""
    rows = (row for row in backends() if _found["chosen"] in (None, row["name"]))
    return next((row for row in rows if row["available"]), None)


def backend_problem():
    """Sentence on why no processor can compute as the preferences choose; empty if one can."""
    if used_backend() is not None:
        return ""
    rows = [row for row in backends() if _found["chosen"] in (None, row["name"])]
    detail = rows[-1]["detail"]
    if rows[-1]["name"] == variants.CUDA:
        detail = f"The graphics card cannot be used: {detail}; choose Automatic in the add-on's preferences."
    return detail


def _changed(preferences, context):
    forget_backends()


class HoloPathPreferences(bpy.types.AddonPreferences):
    """Preferences in Edit > Preferences > Add-ons > HoloPath."""

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
        description="libLLVM file to use in place of HoloPath's own; takes effect after a restart",
        subtype="FILE_PATH",
        update=_changed,
    )
    bake_folder: StringProperty(
        name="Baked Light",
        description="Folder for baked light; empty: HoloPath's own",
        subtype="DIR_PATH",
    )

    cluster: StringProperty(
        name="Cluster",
        description=(
            "Cluster that renders animations in the background: address of a Dask scheduler, such as "
            "tcp://10.0.0.5:8786, or local:4 for four processes here; empty: one process on this computer"
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
        sentence, kind = wave_status()
        if sentence:
            column = layout.column(align=True)
            lines = textwrap.wrap(sentence, LINE_LENGTH)
            lines += textwrap.wrap(GAIN if kind == "lacking" else "", LINE_LENGTH)
            for number, line in enumerate(lines):
                column.label(text=line, icon="BLANK1" if number else WAVE_ICONS[kind])
        if kind == "lacking":
            layout.operator("holopath.get_card_extension")
        layout.operator("holopath.check")


CLASSES = (HoloPathPreferences,)
