"""Panels: the same sections in the 3D View's sidebar and the Render properties; Image Editor; materials."""

from typing import TYPE_CHECKING

import bpy

from . import sections
from .device import device
from .display_presets import HOLOPATH_PT_display_presets
from .engine_panels import EnginePanel
from .optics import optics
from .text import layout_of, split_layout_of

# In the order of work: name, label (empty: no header), function that draws it, whether closed at first.
_SUBPANELS = (
    ("display", "Display", sections.display, True),
    ("display_optics", "Optics", optics, True),
    ("depth", "Depth", sections.depth, True),
    ("quality", "Quality", sections.quality, True),
    ("advanced", "Advanced", sections.advanced, True),
    ("estimate", "Estimate", sections.estimate, True),
    ("baked_light", "Baked Light", sections.baked_light, True),
    ("render", "", sections.render, False),
    ("animation", "Animation", sections.animation, True),
    ("reconstruct", "Reconstruction", sections.reconstruct, False),
    ("hologram", "Hologram", sections.hologram, False),
    ("device", "Display Device", device, True),
    ("notes", "Export Notes", sections.notes, True),
)


if TYPE_CHECKING:
    _Panel = bpy.types.Panel
else:
    _Panel = object


class _Section(_Panel):
    """Base of a panel that draws one section."""

    @staticmethod
    def section(layout, context):
        raise NotImplementedError

    def draw(self, context: bpy.types.Context):
        self.section(split_layout_of(self), context)


class _View3D:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "HoloPath"


class _Properties(EnginePanel):
    bl_context = "render"


class HOLOPATH_PT_view3d(_Section, _View3D, bpy.types.Panel):
    """Main panel of the sidebar's HoloPath tab."""

    bl_label = "HoloPath"
    section = staticmethod(sections.summary)


class HOLOPATH_PT_render(_Section, _Properties, bpy.types.Panel):
    """Main panel of the Render properties."""

    bl_label = "HoloPath"
    section = staticmethod(sections.summary)


class HOLOPATH_PT_image(_Section, bpy.types.Panel):
    """Focus control beside the reconstruction."""

    bl_label = "HoloPath"
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "HoloPath"

    @staticmethod
    def section(layout, context):
        """Draw the focus control of the other panels, and the last failure."""
        sections.reconstruct(layout, context)
        sections.failure(layout, context)


class HOLOPATH_PT_material(_Section, bpy.types.Panel):
    """HoloPath's settings of a material; shown for any engine, like the sidebar."""

    bl_label = "HoloPath"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "material"
    bl_options = {"DEFAULT_CLOSED"}
    section = staticmethod(sections.material)

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return context.material is not None and not context.material.is_grease_pencil


def _display_presets(self, context):
    HOLOPATH_PT_display_presets.draw_panel_header(layout_of(self))


_HEADERS = {"display": {"draw_header_preset": _display_presets}}

_PARENTS = {"display_optics": "_display"}  # subpanels of another one of these


def _subpanels(parent, place):
    """Classes of all subpanels of a panel; `place` is the base that says where they are."""
    for name, label, section, closed in _SUBPANELS:
        identifier = f"{parent.__name__}_{name}"
        yield type(
            identifier,
            (_Section, place, bpy.types.Panel),
            {
                "__doc__": section.__doc__,
                "bl_idname": identifier,
                "bl_label": label,
                "bl_parent_id": parent.__name__ + _PARENTS.get(name, ""),
                "bl_options": ({"DEFAULT_CLOSED"} if closed else set())
                | (set() if label else {"HIDE_HEADER"}),
                "section": staticmethod(section),
            }
            | _HEADERS.get(name, {}),
        )


CLASSES = (
    HOLOPATH_PT_view3d,
    *_subpanels(HOLOPATH_PT_view3d, _View3D),
    HOLOPATH_PT_render,
    *_subpanels(HOLOPATH_PT_render, _Properties),
    HOLOPATH_PT_material,
    HOLOPATH_PT_image,
)
