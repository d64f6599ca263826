"""Operators: thin, over the plain functions of `session` and `pipeline`."""

from . import baked, field, hologram, rendering

CLASSES = (*rendering.CLASSES, *baked.CLASSES, *field.CLASSES, *hologram.CLASSES)
