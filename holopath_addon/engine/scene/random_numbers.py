"""Random numbers for each lane of a compiled program, independent of the number of lanes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass
class Sampler:
    """Sampler of independent random numbers, with the sequences and methods of Mitsuba's `independent`.

    Mitsuba's sampler makes the number of lanes a part of the compiled program, and numbers lanes from 0. Here the
    caller numbers them, so that each lane has the same random numbers whatever lanes are traced beside it. After a
    Dr.Jit loop the sampler continues from the loop's state, whether or not the returned sampler is used.

    Attributes
    ----------
    generator : mitsuba.PCG32
    """

    generator: Any

    @classmethod
    def seeded(cls, seed: int | mi.UInt32, lane: mi.UInt32) -> Sampler:
        """Seed a sequence for each lane.

        Parameters
        ----------
        seed : int or mitsuba.UInt32
            Seed of all lanes, of which the low 32 bits count, or of each lane.
        lane : mitsuba.UInt32
            Numbers of the lanes.
        """
        if isinstance(seed, int):
            seed = dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)
        # pyrefly: ignore[not-callable]  # missing from Mitsuba's stubs
        return cls(mi.PCG32(1, *mi.sample_tea_32(seed, lane)))

    def next_1d(self) -> mi.Float:
        """Draw a number, uniform in [0, 1)."""
        return self.generator.next_float32()

    def next_2d(self) -> mi.Point2f:
        """Draw a point, uniform in the unit square."""
        return mi.Point2f(self.next_1d(), self.next_1d())
