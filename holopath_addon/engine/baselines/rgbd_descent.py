"""RGB-D descent: phases that show an image with depth sharp on its layers.

Choi et al., ACM TOG 40(6), 240 (2021). On each layer only the pixels of its own surfaces are compared; light that is
out of focus is free.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..waves import arrays
from ..waves.propagation import OPTIMIZATION_GUARD
from ..waves.target_images import TargetImages, Viewpoint
from .layers import sliced
from .shots import picture_with_depth
from .supervised import phases_for

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Light of phases; parameters and result as of `baselines.field`."""
    hologram = job.hologram
    radiance, z = picture_with_depth(job.of_pictures, lambda done, message: progress(0.3 * done, message))
    depths, number = sliced(job, z)

    def targets_of(k, on):
        wavelength = hologram.wavelengths[k]
        viewpoints = [Viewpoint(float(z) - hologram.distance_at(wavelength)) for z in depths]
        images = _OnLayers(
            job.shape, hologram.pitch_at(wavelength), wavelength, viewpoints, OPTIMIZATION_GUARD, on
        )
        light, own = job.at_pixels(radiance[k], k), job.at_pixels(number, k, order=0)
        images.radiance = arrays.like(light, on)
        images.layers = arrays.like(own, on)
        for layer in range(len(depths)):
            images.targets[layer, ...] = arrays.like(np.where(own == layer, light, 0), on, "float32")
        return images

    return phases_for(job, targets_of, lambda done, message: progress(0.3 + 0.7 * done, message))


class _OnLayers(TargetImages):
    """Target images of which only the parts in focus count, the black ones, too."""

    radiance = layers = None  # of each pixel

    def intensity(self, number):
        return self.radiance

    def weight(self, number):
        return arrays.namespace(self.targets).where(self.layers == number, super().weight(number), 0.0)
