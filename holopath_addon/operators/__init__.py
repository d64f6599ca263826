"""Operators: thin, over the plain functions of `session` and `pipeline`."""

from . import field, rendering

CLASSES = (*rendering.CLASSES, *field.CLASSES)
