"""The truth to compare with: Mitsuba's thin-lens camera with the hologram's pupil, one a wavelength."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from . import backend
from .hologram import channel
from .mapping import DepthMapping
from .preview import FARTHEST, Preview, path_tracer
from .probing import near_end

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mitsuba as mi

    from .camera import Camera
    from .hologram import Hologram
    from .progress import Progress
    from .reconstruction import Pupil


def reference(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    focus: Sequence[float],
    pupil: Pupil | None = None,
    spp: int = 256,
    near: float | None = None,
    max_depth: int = 8,
    progress: Progress | None = None,
    seed: int = 0,
) -> np.ndarray:
    """Incoherent pictures through a thin lens, the limit of a perfect hologram of infinitely many frames.

    A cone of slope s_max fills a pupil of radius s_max beta / F; a picture focused at depth D is that of a
    thin lens of this radius focused at D. Without lens shift and with the whole pupil Mitsuba's own
    `thinlens` sensor is used; otherwise `Preview` on rays from the part of the pupil asked for.

    Parameters
    ----------
    scene, camera, hologram :
        As for `render`.
    focus : sequence of float
        World depths, metres; `math.inf` allowed.
    pupil : Pupil, optional
    spp : int
        Paths a pixel.
    near : float, optional
        World depth of the volume's near end; found as in `plan` when not given.
    max_depth : int
        As `Settings.max_depth`.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.
    seed : int
        Pictures of different seeds have independent noise.

    Returns
    -------
    numpy.ndarray, float32, shape (focus, y, x, wavelength)

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    backend.activate()
    from .dispersion import tuned

    progress = progress or (lambda done, message: None)
    near = near or near_end(scene, camera, hologram)
    mapping = DepthMapping.of(hologram, camera, near)
    mapping.depth_to_z(list(focus))  # refuses what is behind the camera
    images = np.empty((len(focus), hologram.height, hologram.width, len(hologram.wavelengths)), np.float32)
    centred = pupil is None and camera.shift_x == 0 and camera.shift_y == 0
    for f, depth in enumerate(focus):
        for k, wavelength in enumerate(hologram.wavelengths):
            radius = mapping.pupil_radius(hologram.max_slope(wavelength))
            depth, number = min(depth, 1e5), seed * len(hologram.wavelengths) + k
            with tuned(scene, (wavelength,)):
                if centred:
                    picture = _thin_lens(scene, camera, hologram, radius, depth, spp, max_depth, number)
                else:
                    size = hologram.width, hologram.height
                    picture = Preview(scene, camera, *size, depth, radius, max_depth, number, pupil).refine(
                        spp
                    )
            images[f, :, :, k] = picture[:, :, channel(wavelength)]
            progress(
                (f * len(hologram.wavelengths) + k + 1) / (len(focus) * len(hologram.wavelengths)),
                "Reference",
            )
    return images


def _thin_lens(scene, camera, hologram, radius, depth, spp, max_depth, seed):
    """Mitsuba's `thinlens` sensor; it looks along +z with x to the left, the camera along -z."""
    import mitsuba as mi

    flip = np.diag([-1.0, 1.0, -1.0, 1.0])
    sensor = mi.load_dict(
        {
            "type": "thinlens",
            "to_world": mi.ScalarTransform4f(camera.to_world @ flip),
            "fov": math.degrees(camera.fov_x),
            "fov_axis": "x",
            "aperture_radius": radius,
            "focus_distance": depth,
            "near_clip": max(camera.clip_start, min(1e-4, 1e-3 * depth)),
            "far_clip": min(camera.clip_end, FARTHEST),
            "film": {
                "type": "hdrfilm",
                "width": hologram.width,
                "height": hologram.height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        }
    )
    integrator = path_tracer(scene, camera.sees_sky, max_depth)
    return np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed))
