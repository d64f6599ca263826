"""Operators: thin, over the plain functions of `session` and `pipeline`."""

from . import baked, demos, field, focus_list, hologram, rendering

CLASSES = (
    *rendering.CLASSES,
    *baked.CLASSES,
    *field.CLASSES,
    *focus_list.CLASSES,
    *hologram.CLASSES,
    *demos.CLASSES,
)
