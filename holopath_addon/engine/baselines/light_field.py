"""Light field: phases that show pictures from all over the pupil (Choi et al., SIGGRAPH 2022, 32).

What is seen from a part of the pupil is the light whose frequencies pass it. Parts are as wide as the spectrum of their
window of nine pixels, and overlap: pictures from parts side by side say nothing about how the light of several parts
adds up, so there is speckle where the whole pupil is open, and light is hidden where no part or only one sees it. With
these parts some of the speckle is left.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..pixels import axes, coarsest
from ..progress import Stages, parts
from ..waves import arrays
from ..waves.propagation import TEACHING_GUARD
from ..waves.target_images import TargetImages, Viewpoint
from .shots import through_pupil
from .supervised import phases_for

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput

# parts of the pupil, the whole of radius 1: how many on rings of what radius, and their own radius
RINGS = ((1, 0.0), (6, 0.475), (12, 0.85))
PART = 0.5
PICTURES = 7  # of a focal stack: a light field takes as many paths in all


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """As of `layers.field`, of one modulus in each wavelength."""
    hologram, z = job.hologram, 0.5 * (job.z_low + job.z_high)
    squares, disks, colors = job.of_pictures, parts_of_pupil(), len(hologram.wavelengths)
    paths = math.ceil(job.paths * PICTURES / (len(disks) * colors))
    views = []
    stages = Stages(progress, "supervised")
    told = parts(stages["images"], colors)
    for wavelength, of_color in zip(hologram.wavelengths, told, strict=True):
        slope = hologram.max_slope(wavelength)
        own = replace(squares, hologram=replace(squares.hologram, wavelengths=(wavelength,)))
        scaled = [(x * slope, y * slope, PART * slope) for x, y in disks]
        views.append(through_pupil(own, z, scaled, of_color, paths)[:, 0])

    def pictures(k, on):
        # the edge of the cone is at half a cycle a pixel; rows go down
        wavelength = hologram.wavelengths[k]
        distance = z - hologram.distance_at(wavelength)
        viewpoints = [Viewpoint(distance, (0.5 * x, -0.5 * y, 0.5 * PART)) for x, y in disks]
        wanted = _Views(job.shape, hologram.pitch_at(wavelength), wavelength, viewpoints, TEACHING_GUARD, on)
        for number, view in enumerate(views[k]):
            seen = wanted.share(number) * job.at_pixels(view, k)
            wanted.targets[number, ...] = arrays.like(seen, on, "float32")
        return wanted

    return phases_for(job, pictures, stages["phases"], whole=False)


def parts_of_pupil() -> list[tuple[float, float]]:
    """Centers of equal disks that cover the unit disk, on `RINGS`."""
    turns = [(radius, 2 * math.pi * n / count) for count, radius in RINGS for n in range(count)]
    return [(radius * math.cos(turn), radius * math.sin(turn)) for radius, turn in turns]


class _Views(TargetImages):
    """Target images through parts of the pupil."""

    def share(self, number):
        """Part of the light in the band that a viewpoint lets through."""
        passes = self.viewpoints[number].passes(self.padded, self.space.pitch)
        return float((passes & self.space.band).sum() / self.space.band.sum())

    def weight(self, number):
        """Of the pixels that light from the SLM reaches on its way through the part; the others do not count."""
        viewpoint, space = self.viewpoints[number], self.space
        inside = []
        for count, frequency, pitch in zip(
            self.shape, (viewpoint.part[1], viewpoint.part[0]), axes(space.pitch), strict=True
        ):
            slope = math.tan(math.asin(space.wavelength * frequency / coarsest(space.pitch)))
            start = np.arange(count) - viewpoint.distance * slope / pitch
            inside.append((start >= 0) & (start <= count - 1))
        return super().weight(number) * arrays.mask(inside[0][:, None] & inside[1], self.targets)
