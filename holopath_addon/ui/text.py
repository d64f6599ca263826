"""Text and layouts of panels."""

import textwrap

from bpy.types import Context, Menu, Panel, UILayout


def count(number: int, thing: str) -> str:
    """Count things in words: ``1 frame``, ``8 frames``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def layout_of(owner: Panel | Menu) -> UILayout:
    """Layout of a panel or menu, which Blender sets before `draw`."""
    assert owner.layout is not None
    return owner.layout


def split_layout_of(owner: Panel) -> UILayout:
    """Layout of a panel with labels at the left, as in Blender's Properties."""
    layout = layout_of(owner)
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def alert(layout: UILayout, context: Context, text: str) -> None:
    """Draw an error text in red; see `wrapped`."""
    column = layout.column()
    column.alert = True
    wrapped(column, context, text, icon="ERROR")


def wrapped(layout: UILayout, context: Context, text: str, icon: str = "NONE") -> None:
    """Draw a label that wraps at the region's width.

    Parameters
    ----------
    layout : UILayout
    context : Context
        Context of the panel, whose region has the width.
    text : str
    icon : str
        Name of Blender's icon in the first line.
    """
    assert context.preferences is not None and context.region is not None  # while a panel is drawn
    scale = context.preferences.system.ui_scale
    characters = max(16, int((context.region.width / scale - 60) / 6.2))
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, characters)):
        column.label(text=line, icon=icon if number == 0 else "NONE" if icon == "NONE" else "BLANK1")
