"""Operators: thin, over the plain functions of `session` and `pipeline`."""

from . import baked, field, rendering

CLASSES = (*rendering.CLASSES, *baked.CLASSES, *field.CLASSES)
