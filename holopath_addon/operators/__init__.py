"""Operators: thin, over the plain functions of `session` and `pipeline`."""

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
