"""RGB-D descent: phases that show a picture with depth sharp where it is in focus.

Choi et al., ACM TOG 40(6), 240 (2021). On each layer only the pixels are compared whose surfaces lie on it: what is out
of focus is as it comes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..waves import arrays
from ..waves.propagation import TEACHING_GUARD
from ..waves.supervision import relative
from ..waves.target_images import TargetImages, Viewpoint
from .layers import sliced
from .shots import picture_with_depth
from .supervised import phases_for

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """As of `layers.field`, of one modulus in each wavelength."""
    hologram = job.hologram
    radiance, z = picture_with_depth(job.of_pictures, lambda done, what: progress(0.3 * done, what))
    depths, number = sliced(job, z)

    def pictures(k, on):
        wavelength = hologram.wavelengths[k]
        viewpoints = [Viewpoint(float(z) - hologram.distance_at(wavelength)) for z in depths]
        wanted = _OnLayers(
            job.shape, hologram.pitch_at(wavelength), wavelength, viewpoints, TEACHING_GUARD, on
        )
        light, own = job.at_pixels(radiance[k], k), job.at_pixels(number, k, order=0)
        wanted.radiance = arrays.like(light, on)
        for layer in range(len(depths)):
            wanted.targets[layer, ...] = arrays.like(np.where(own == layer, light, 0), on, "float32")
        return wanted

    return phases_for(job, pictures, lambda done, what: progress(0.3 + 0.7 * done, what))


class _OnLayers(TargetImages):
    """Target images of which only what is in focus counts."""

    radiance = None

    def weight(self, number):
        return arrays.namespace(self.targets).where(
            self.targets[number, ...] > 0, relative(self.radiance), 0.0
        )
