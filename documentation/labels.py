"""The labels of the window's panels, as a picture of them shows them.

The script that takes pictures writes them to docs/images/labels.json; a test draws the same panels without a window,
and compares.
"""

import re
from types import SimpleNamespace
from typing import Any

import bpy

from tests.ui.layout import Context, draw

# Numbers vary with the machine and with defaults, and so does the unit of a time.
_NUMBER = re.compile(r"\d[\d.,]*(?: (?:s|min|h)\b)?")
_LOWER = re.compile(r"\b[a-z]{4,}")
_WIDE = 1e6  # pixels: no label is wrapped


def of_panels(scene, names, are_open):
    """Labels of panels in the order in which they are drawn.

    Parameters
    ----------
    scene : bpy.types.Scene
        The one that the window shows.
    names : iterable of str
        The panels' classes.
    are_open : callable
        Whether a panel is open, by the name of its class.

    Returns
    -------
    dict of str to list of str
        By class: the panel's header, if it has one, then the contents of an open panel.
    """
    context = Context(scene)
    context.region = SimpleNamespace(width=_WIDE)
    return {name: _header(name) + (_contents(name, context) if are_open(name) else []) for name in names}


def of_overlay(overlay, scene):
    """Labels in the 3D View.

    Parameters
    ----------
    overlay : module
        The add-on's `ui.overlay`.
    scene : bpy.types.Scene

    Returns
    -------
    list of str
    """
    return [words(outline.label) for outline in overlay.outlines(scene) if outline.label]


def panels(sidebar):
    """Names of a sidebar's main panel and of those directly below it, from top to bottom."""
    classes = [cls for cls in bpy.types.Panel.__subclasses__() if cls.is_registered]
    return [
        cls.__name__
        for cls in classes
        if cls.__name__ == sidebar or getattr(cls, "bl_parent_id", None) == sidebar
    ]


def within(panel):
    """Names of the panels that lie in another one than the main panel, and are seen while that is open."""
    classes = [cls for cls in bpy.types.Panel.__subclasses__() if cls.is_registered]
    return [cls.__name__ for cls in classes if getattr(cls, "bl_parent_id", None) == panel]


def words(text):
    """A text without what varies: numbers are ``#``; nothing remains of a sentence, as it comes from the plan.

    Labels are in Title Case, so a long word in lower case tells a sentence.
    """
    return "" if _LOWER.search(text) else _NUMBER.sub("#", text)


def _header(name):
    cls = getattr(bpy.types, name)
    return [cls.bl_label] if cls.bl_label else []


def _contents(name, context):
    layout: Any = draw(getattr(bpy.types, name), context)
    texts = [text for call in layout.drawn for text in _texts(*call)]
    return [label for label in map(words, texts) if label]


def _texts(function, given):
    """What one call of a layout's function writes: a button's text, a property's name and its choice."""
    yield given.get("heading", "")  # of rows and columns
    text = given.get("text")
    if function == "label":
        yield text or ""
    elif function == "operator":
        module, name = given["operator"].split(".")
        yield getattr(getattr(bpy.ops, module), name).get_rna_type().name if text is None else text
    elif function == "prop":
        prop = given["data"].bl_rna.properties[given["property"]]
        yield prop.name if text is None else text
        if prop.type == "ENUM" and not prop.is_enum_flag:
            chosen = getattr(given["data"], given["property"])
            shown = [item for item in prop.enum_items if given.get("expand") or item.identifier == chosen]
            yield from (item.name for item in shown)
