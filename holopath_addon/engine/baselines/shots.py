"""Images of the scene that baselines start from, by Mitsuba's path tracer."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..hologram import channel
from ..optics import Pupil, Stop
from ..viewing.depth import depth_map
from ..viewing.preview import Preview
from ..viewing.reference import reference

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..progress import Progress
    from . import BaselineInput


def picture_with_depth(job: BaselineInput, progress: Progress) -> tuple[np.ndarray, np.ndarray]:
    """Radiance and depth as seen from the pupil's center.

    Parameters
    ----------
    job : BaselineInput
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    radiance : numpy.ndarray, float32, shape (wavelength, y, x)
    z : numpy.ndarray, float64, shape (y, x)
        Depth of the surface at each pixel's center, meters from the SLM; the volume's far end where there is none.
    """
    settings, size = job.settings, (job.hologram.width, job.hologram.height)

    def picture():
        pinhole = Preview(job.scene, job.camera, *size, max_depth=settings.max_depth, seed=settings.seed)
        return np.moveaxis(pinhole.refine(job.paths, lambda done, _: progress(done, "Picture")), -1, 0)

    radiance = in_each_wavelength(job, picture)
    z = job.mapping.depth_to_z(depth_map(job.scene, job.camera, *size))
    return radiance, np.clip(z, job.z_low, job.z_high)


def in_each_wavelength(job: BaselineInput, colors: Callable[[], np.ndarray]) -> np.ndarray:
    """Radiance in each wavelength of a hologram, with the scene's indices of refraction for that wavelength.

    Parameters
    ----------
    job : BaselineInput
    colors : callable
        ``colors()`` gives red, green and blue along the first axis. It is called once for each group of wavelengths
        with the same indices of refraction, with the scene tuned to them.

    Returns
    -------
    numpy.ndarray, shape (wavelength, ...)
    """
    from ..scene.dispersion import tuned, wavelength_groups

    radiance = {}
    for group in wavelength_groups(job.scene, job.hologram.wavelengths):
        with tuned(job.scene, group):
            rgb = colors()
        radiance |= {wavelength: rgb[channel(wavelength)] for wavelength in group}
    return np.stack([radiance[wavelength] for wavelength in job.hologram.wavelengths])


def through_pupil(
    job: BaselineInput, z: float, parts: Sequence[tuple[float, float, float]], progress: Progress, paths: int
) -> np.ndarray:
    """Images focused at a depth through parts of the pupil.

    Parameters
    ----------
    job : BaselineInput
    z : float
        Depth in focus, meters from the SLM.
    parts : sequence of (float, float, float)
        Center, to the right and up, and radius of each part, in slopes of the light that comes through it. Each
        wavelength's own cone limits the open part.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.
    paths : int
        Number of paths for each pixel of an image, all wavelengths together.

    Returns
    -------
    numpy.ndarray, float32, shape (part, wavelength, y, x)
        Means over the open part; black where nothing is open.
    """
    scale, count = job.mapping.pupil_radius(1.0), len(job.hologram.wavelengths)
    # a field has the light of the whole cone, and serves every stop
    hologram = replace(job.hologram, optics=replace(job.hologram.optics, carrier=None, stop=Stop()))
    images = []
    for number, (x, y, radius) in enumerate(parts):
        image = reference(
            job.scene,
            job.camera,
            hologram,
            [float(job.mapping.z_to_depth(z))],
            Pupil(x * scale, y * scale, 2 * radius * scale),
            math.ceil(paths / count),
            job.near,
            job.settings.max_depth,
            lambda done, _, number=number: progress((number + done) / len(parts), "Pictures"),
            job.settings.seed + number,
        )
        images.append(np.moveaxis(image[0], -1, 0))
    return np.stack(images)
