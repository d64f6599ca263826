"""HoloPath writes as Blender does: American, labels in Title Case, no full stop after tooltips."""

import re

import bpy

from holopath_addon import engine, operators, ui
from holopath_addon.blender import properties

BRITISH = re.compile(
    r"colour|metre|dioptre|neighbour|behaviour|cancell|centre|grey|licence|favour|modell|optimis|normalis|initialis",
    re.IGNORECASE,
)
SMALL = {"a", "an", "and", "at", "by", "for", "from", "in", "of", "on", "or", "per", "the", "to", "with"}
UNITS = {"m", "mm", "nm", "µm", "µs", "px", "x"}
OWN = {"slmsuite"}  # names that begin small


def is_title(label):
    """Whether each word begins as in Blender's own labels."""
    return all(
        not word[:1].isalpha() or word[0].isupper() or (number and word in SMALL) or word in UNITS | OWN
        for number, word in enumerate(word.strip("(),") for word in label.split())
    )


def written():
    """Labels, then tooltips, of all settings, operators, panels and menus, each with where it is from."""
    labels, tooltips = [], []
    for cls in (*properties.CLASSES, *operators.CLASSES, *ui.CLASSES):
        rna = cls.bl_rna
        if issubclass(cls, bpy.types.Operator | bpy.types.Panel | bpy.types.Menu):
            labels.append((cls.__name__, cls.bl_label))
        if issubclass(cls, bpy.types.Operator):
            tooltips.append((cls.__name__, rna.description))
        own = set(getattr(cls, "__annotations__", {})) | {
            n for b in cls.__mro__ for n in vars(b).get("__annotations__", {})
        }
        for name in own & set(rna.properties.keys()):
            prop = rna.properties[name]
            labels.append((f"{cls.__name__}.{name}", prop.name))
            tooltips.append((f"{cls.__name__}.{name}", prop.description))
            for item in prop.enum_items if prop.type == "ENUM" else ():
                labels.append((f"{cls.__name__}.{name}={item.identifier}", item.name))
                tooltips.append((f"{cls.__name__}.{name}={item.identifier}", item.description))
    return labels, tooltips


def test_labels(addon):
    labels, _ = written()
    assert len(labels) > 150
    wrong = [(where, label) for where, label in labels if BRITISH.search(label) or not is_title(label)]
    assert wrong == []
    assert [where for where, label in labels if label.endswith((".", "!", ":"))] == []


def test_tooltips(addon):
    """Tooltips are checked without names of decisions, which plans and reports keep forever."""
    _, tooltips = written()
    names = ", ".join(engine.FIXABLE)
    tooltips = [(where, text.replace(names, "")) for where, text in tooltips]
    wrong = [(where, text) for where, text in tooltips if BRITISH.search(text) or text.endswith(".")]
    assert len(tooltips) > 150 and wrong == []
