"""Words in panels."""

import textwrap

from bpy.types import Context, Menu, Panel, UILayout


def count(number: int, thing: str) -> str:
    """``1 frame``, ``8 frames``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def layout_of(drawn: Panel | Menu) -> UILayout:
    """The layout that Blender has given a panel or menu before it asks for its contents."""
    assert drawn.layout is not None
    return drawn.layout


def split_layout_of(drawn: Panel) -> UILayout:
    """`layout_of` with labels at the left, as in Blender's properties."""
    layout = layout_of(drawn)
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def alert(layout: UILayout, context: Context, text: str) -> None:
    """What went wrong, in red."""
    column = layout.column()
    column.alert = True
    wrapped(column, context, text, icon="ERROR")


def wrapped(layout: UILayout, context: Context, text: str, icon: str = "NONE") -> None:
    """Label that wraps at the region's width."""
    assert context.preferences is not None and context.region is not None  # while a panel is drawn
    scale = context.preferences.system.ui_scale
    characters = max(16, int((context.region.width / scale - 60) / 6.2))
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, characters)):
        column.label(text=line, icon=icon if number == 0 else "NONE" if icon == "NONE" else "BLANK1")
