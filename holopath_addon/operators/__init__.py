"""Operators: thin, over plain functions of `session`, `devices` and `workflow`."""

from . import animation, baked, demos, field, focus_list, hologram, pictures, rendering, streaming

CLASSES = (
    *rendering.CLASSES,
    *baked.CLASSES,
    *field.CLASSES,
    *focus_list.CLASSES,
    *hologram.CLASSES,
    *streaming.CLASSES,
    *animation.CLASSES,
    *demos.CLASSES,
    *pictures.CLASSES,
)
