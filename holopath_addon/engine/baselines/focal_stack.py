"""Focal stack: phases that show what a thin lens shows at several depths (Choi et al., SIGGRAPH 2022, 32)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..waves.pictures import Pictures, Vantage
from .shots import through_pupil
from .supervised import phases_for

if TYPE_CHECKING:
    from ..progress import Progress
    from . import Job

DEPTHS = 7


def field(job: Job, progress: Progress) -> np.ndarray:
    """As of `layers.field`, of one modulus in each wavelength."""
    hologram = job.hologram
    slope = hologram.widest_slope
    planes = np.linspace(job.z_low, job.z_high, DEPTHS if job.z_high > job.z_low else 1)
    stack = []
    for number, z in enumerate(planes):

        def told(done, what, number=number):
            progress(0.4 * (number + done) / len(planes), what)

        # noise of the pictures is what such phases are worst at
        paths = job.paths * len(hologram.wavelengths)
        stack.append(through_pupil(job, z, [(0.0, 0.0, slope)], told, paths)[0])

    def pictures(k):
        vantages = [Vantage(float(z)) for z in planes]
        wanted = Pictures(job.shape, hologram.pitch, hologram.wavelengths[k], vantages)
        wanted.wanted[:] = [picture[k] for picture in stack]
        return wanted

    return phases_for(job, pictures, lambda done, what: progress(0.4 + 0.6 * done, what))
