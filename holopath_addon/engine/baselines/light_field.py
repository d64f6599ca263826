"""Light field: phases that show views from all over the pupil (Choi et al., SIGGRAPH 2022, 32).

The view through a part of the pupil is the light whose frequencies pass it. Parts are as wide as the spectrum of the
authors' window of nine pixels, and overlap. With adjacent parts the sum of the light of several parts would be free, so
that there is speckle through the whole pupil, and phases would put light where no part, or only one, sees it. With
these parts some of the speckle remains.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..pixels import axes, coarsest
from ..progress import Stages, parts
from ..waves import arrays
from ..waves.propagation import OPTIMIZATION_GUARD
from ..waves.target_images import TargetImages, Viewpoint
from .shots import through_pupil
from .supervised import phases_for

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput

# Parts of the pupil, whose radius is 1: number and radius of each ring, and the parts' own radius.
RINGS = ((1, 0.0), (6, 0.475), (12, 0.85))
PART = 0.5
PICTURES = 7  # images of a focal stack, whose number of paths a light field shares


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Light of phases; parameters and result as of `baselines.field`."""
    hologram, z = job.hologram, 0.5 * (job.z_low + job.z_high)
    squares, disks, colors = job.of_pictures, parts_of_pupil(), len(hologram.wavelengths)
    paths = math.ceil(job.paths * PICTURES / (len(disks) * colors))
    views = []
    stages = Stages(progress, "supervised")
    each_color = parts(stages["images"], colors)
    for wavelength, on_progress in zip(hologram.wavelengths, each_color, strict=True):
        slope = hologram.max_slope(wavelength)
        grid = squares.hologram
        own = replace(squares, hologram=replace(grid, wavelengths=(wavelength,), optics=grid.optics.of_rays))
        scaled = [(x * slope, y * slope, PART * slope) for x, y in disks]
        views.append(through_pupil(own, z, scaled, on_progress, paths)[:, 0])

    def targets_of(k, on):
        # the edge of the cone is at half a cycle per pixel; rows run down
        wavelength = hologram.wavelengths[k]
        distance = z - hologram.distance_at(wavelength)
        viewpoints = [Viewpoint(distance, (0.5 * x, -0.5 * y, 0.5 * PART)) for x, y in disks]
        images = _Views(
            job.shape, hologram.pitch_at(wavelength), wavelength, viewpoints, OPTIMIZATION_GUARD, on
        )
        for number, view in enumerate(views[k]):
            target = images.band_fraction(number) * job.at_pixels(view, k)
            images.targets[number, ...] = arrays.like(target, on, "float32")
        return images

    return phases_for(job, targets_of, stages["phases"], whole=False)


def parts_of_pupil() -> list[tuple[float, float]]:
    """Centers of equal disks that cover the unit disk, on `RINGS`."""
    polar = [(radius, 2 * math.pi * n / count) for count, radius in RINGS for n in range(count)]
    return [(radius * math.cos(angle), radius * math.sin(angle)) for radius, angle in polar]


class _Views(TargetImages):
    """Target images through parts of the pupil."""

    def band_fraction(self, number):
        """Fraction of the light in the band that passes a viewpoint."""
        mask = self.viewpoints[number].part_mask(self.padded, self.space.pitch)
        return float((mask & self.space.band).sum() / self.space.band.sum())

    def weight(self, number):
        """Weight of each pixel; 0 for those that light from the SLM does not reach through the part."""
        viewpoint, space = self.viewpoints[number], self.space
        inside = []
        for count, frequency, pitch in zip(
            self.shape, (viewpoint.part[1], viewpoint.part[0]), axes(space.pitch), strict=True
        ):
            slope = math.tan(math.asin(space.wavelength * frequency / coarsest(space.pitch)))
            start = np.arange(count) - viewpoint.distance * slope / pitch
            inside.append((start >= 0) & (start <= count - 1))
        return super().weight(number) * arrays.mask(inside[0][:, None] & inside[1], self.targets)
