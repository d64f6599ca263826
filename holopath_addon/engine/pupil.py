"""The part of the viewer's pupil that is looked through."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .errors import InvalidInput


@dataclass(frozen=True)
class Pupil:
    """A circular part of the viewer's pupil plane, in world metres about the camera's axis.

    Attributes
    ----------
    x, y : float
        Centre, to the right and up.
    diameter : float
        Positive. What lies beyond the recordable cone holds no light.
    """

    x: float
    y: float
    diameter: float

    def __post_init__(self):
        if not all(map(math.isfinite, (self.x, self.y, self.diameter))) or self.diameter <= 0:
            raise InvalidInput("A pupil needs a finite position and a positive diameter.")
