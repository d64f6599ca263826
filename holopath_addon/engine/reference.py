"""The truth to compare with: Mitsuba's thin-lens camera with the hologram's pupil, one a wavelength."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

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
    halves: bool = False,
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
    halves : bool
        Give two pictures of half the paths instead, whose noise is independent: with both, `psnr` and `ssim` do not
        count it.

    Returns
    -------
    numpy.ndarray, float32, shape (focus, y, x, wavelength) or (focus, half, y, x, wavelength)

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    if halves:
        told, asked = progress or (lambda done, message: None), max(1, -(-spp // 2))
        pictures = [
            reference(
                scene, camera, hologram, focus, pupil, asked, near, max_depth,
                lambda done, message, half=half: told((half + done) / 2, message), 2 * seed + half,
            )
            for half in range(2)
        ]  # fmt: skip
        return np.stack(pictures, axis=1)
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
    """Mitsuba's `thinlens` sensor; it looks along +z with x to the left, the camera along -z.

    Paths are stratified in each pixel (Kensler, Pixar technical memo 13-01, 2013), in as many strata as there are
    paths or a few more.
    """
    import mitsuba as mi

    across = math.isqrt(spp)
    spp = across * -(-spp // across)  # what Mitsuba would round to, with a warning
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
            "sampler": {"type": "multijitter", "sample_count": spp},
        }
    )
    integrator = path_tracer(scene, camera.sees_sky, max_depth)
    return np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed))


def diffracted(pictures: np.ndarray, hologram: Hologram, openings: Sequence[float] | None = None) -> np.ndarray:
    """Pictures as light through the pupil shows them at best: blurred by what is open of it.

    The incoherent image is the picture * abs(h)^2, with h the transform of the opening (Goodman, Introduction to
    Fourier Optics, section 6.3). The rays of `reference` know nothing of it.

    Parameters
    ----------
    pictures : numpy.ndarray, shape (..., y, x, wavelength)
    hologram : Hologram
    openings : sequence of float, optional
        Radius of what is open in each wavelength's own cone, cycles a pixel; the whole cone, 0.5, when not given.

    Returns
    -------
    numpy.ndarray, float32, of the same shape
    """
    openings = [0.5] * len(hologram.wavelengths) if openings is None else openings
    rows, columns = pictures.shape[-3:-1]
    f = np.hypot(scipy.fft.fftfreq(rows)[:, None], scipy.fft.fftfreq(columns))
    out = np.empty(pictures.shape, np.float32)
    for k, radius in enumerate(openings):
        kernel = np.abs(scipy.fft.ifft2(f <= radius)) ** 2
        transfer = scipy.fft.fft2(kernel / kernel.sum())
        out[..., k] = scipy.fft.ifft2(scipy.fft.fft2(pictures[..., k]) * transfer).real
    return np.maximum(out, 0)
