"""Focal stack: phases that show what a thin lens shows at several depths (Choi et al., SIGGRAPH 2022, 32)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..progress import Stages, parts
from ..waves import arrays
from ..waves.propagation import OPTIMIZATION_GUARD
from ..waves.target_images import TargetImages, Viewpoint
from .shots import through_pupil
from .supervised import phases_for

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput

DEPTHS = 7


def planes_of(z_low: float, z_high: float) -> np.ndarray:
    """Depths of the images, evenly between two hologram-space depths, meters from the SLM."""
    return np.linspace(z_low, z_high, DEPTHS if z_high > z_low else 1)


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Light of phases; parameters and result as of `baselines.field`."""
    hologram = job.hologram
    slope = hologram.widest_slope
    planes = planes_of(job.z_low, job.z_high)
    # more paths, because such phases are worst at showing noise
    paths = job.paths * len(hologram.wavelengths)
    stages = Stages(progress, "supervised")
    each_plane = parts(stages["images"], len(planes))
    stack = [
        through_pupil(job.of_pictures, z, [(0.0, 0.0, slope)], on_progress, paths)[0]
        for z, on_progress in zip(planes, each_plane, strict=True)
    ]

    def targets_of(k, on):
        wavelength = hologram.wavelengths[k]
        viewpoints = [Viewpoint(float(z) - hologram.distance_at(wavelength)) for z in planes]
        images = TargetImages(
            job.shape, hologram.pitch_at(wavelength), wavelength, viewpoints, OPTIMIZATION_GUARD, on
        )
        for number, picture in enumerate(stack):
            images.targets[number, ...] = arrays.like(job.at_pixels(picture[k], k), on, "float32")
        return images

    return phases_for(job, targets_of, stages["phases"])
