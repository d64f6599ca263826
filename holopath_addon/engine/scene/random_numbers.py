"""Random numbers of each lane of a program, however many lanes it has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass
class Sampler:
    """Independent random numbers: those of Mitsuba's sampler of that name, drawn as from it.

    Mitsuba's makes the number of lanes a part of the compiled program, and numbers lanes from 0. Of this one the caller
    numbers them, so that they draw the same numbers whatever else is traced beside them. Where a loop of Dr.Jit's
    draws, the sampler goes on after it, too, whether or not the one that the loop returns is taken.

    Attributes
    ----------
    generator : mitsuba.PCG32
    """

    generator: Any

    @classmethod
    def seeded(cls, seed: int | mi.UInt32, lane: mi.UInt32) -> Sampler:
        """A sequence for each lane.

        Parameters
        ----------
        seed : int or mitsuba.UInt32
            One for all, of which the low 32 bits count, or of each lane.
        lane : mitsuba.UInt32
            Numbers of the lanes.
        """
        if isinstance(seed, int):
            seed = dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)
        # pyrefly: ignore[not-callable]  # missing from Mitsuba's stubs
        return cls(mi.PCG32(1, *mi.sample_tea_32(seed, lane)))

    def next_1d(self) -> mi.Float:
        """Uniform in [0, 1)."""
        return self.generator.next_float32()

    def next_2d(self) -> mi.Point2f:
        """Uniform in the unit square."""
        return mi.Point2f(self.next_1d(), self.next_1d())
