"""Words in panels."""

import textwrap


def count(number, thing):
    """``1 frame``, ``8 frames``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def wrapped(layout, context, text, icon="NONE"):
    """Label that wraps at the region's width."""
    scale = context.preferences.system.ui_scale
    characters = max(16, int((context.region.width / scale - 60) / 6.2))
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, characters)):
        column.label(text=line, icon=icon if number == 0 else "NONE" if icon == "NONE" else "BLANK1")
