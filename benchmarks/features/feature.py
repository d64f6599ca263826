"""What a feature is, and the parts of a picture by which it is judged."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

BOUND = 0.03
SQUARE, WIDE, TALL = (48, 48), (60, 36), (36, 60)


def disk(inner, outer):
    """Places of a picture by their distance from its center, in halves of its width."""
    return lambda x, y: (inner <= np.hypot(x, y)) & (np.hypot(x, y) < outer)


def box(left, right, bottom, top):
    """Places of a picture, in halves of its width and height, y up."""
    return lambda x, y: (left <= x) & (x < right) & (bottom <= y) & (y < top)


EVERYWHERE = {"picture": box(-1, 1, -1, 1)}
BALL = {"center": disk(0, 0.45), "rim": disk(0.45, 0.72)}
MIDDLE = {"middle": box(-0.55, 0.55, -0.55, 0.55)}
OBJECT = {"object": disk(0, 0.6), "around": disk(0.6, 2)}


@dataclass(frozen=True)
class Feature:
    """A scene that shows one feature.

    Attributes
    ----------
    name, group : str
    build : callable
        ``build(stage)`` fills an empty stage.
    regions : dict of str to callable
        ``region(x, y)`` tells which places of the picture, from -1 to 1 and y up, count.
    bound : float
        Largest mean absolute relative difference from Cycles' picture in any region.
    reason : str
        Why the bound is another than `BOUND`.
    notes : frozenset of str
        Features of the notes that the exporter has to make here, besides those on what was baked.
    resolution : tuple of int
    depth : int
        Longest path, vertices without the camera's.
    reference : callable or None
        ``reference(stage)`` changes the scene, before Cycles renders it, to what the picture should be.
    """

    name: str
    group: str
    build: Callable
    regions: dict = field(default_factory=lambda: BALL)
    bound: float = BOUND
    reason: str = ""
    notes: frozenset = frozenset()
    resolution: tuple = SQUARE
    depth: int = 6
    reference: Callable | None = None
