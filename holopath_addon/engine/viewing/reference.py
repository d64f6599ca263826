"""Reference images: Mitsuba's path tracer through the pupil of each wavelength."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..errors import InvalidInput
from ..hologram import channel
from ..mapping import DepthMapping, squared
from ..pixels import coarsest
from ..scene import variants
from .preview import CameraLens, number, path_tracer

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..optics import Pupil
    from ..progress import Progress

CELLS = 512  # along a side of the Fourier plane, each open or closed by the stop
CHUNK_PATHS = 1 << 21  # between two calls of progress; less than a second on two cores


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
    """Incoherent images through a thin lens: the limit of a perfect hologram of infinitely many frames.

    A cone of slope s_max fills a pupil of radius s_max beta / F. An image focused at depth D is that of a thin lens of
    this radius focused at D. Wavelengths for which the scene is the same share their paths, see `_Pupils`.

    Parameters
    ----------
    scene, camera, hologram :
        As for `render`. Images have the size of `Hologram.picture`.
    focus : sequence of float
        World depths, meters; `math.inf` is allowed.
    pupil : Pupil, optional
        Default: the whole recordable cone.
    spp : int
        Number of paths for each pixel and wavelength, rounded up to fill the strata.
    near : float, optional
        World depth of the volume's near end, meters. Default: as in `plan`.
    max_depth : int
        As `Settings.max_depth`.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.
    seed : int
        Seed of the random paths; different seeds give independent noise.
    halves : bool
        Whether to return two images of half the paths each instead. Their noise is independent: with both, `psnr` and
        `ssim` do not count it.

    Returns
    -------
    numpy.ndarray, float32, shape (focus, y, x, wavelength) or (focus, half, y, x, wavelength)
        In the scene's radiance units, row 0 is the top.

    Raises
    ------
    InvalidInput
        If a focus is not in front of the camera, or there are no paths.
    BackendUnavailable
        If Mitsuba cannot compute on this machine.
    Cancelled
        If `progress` raised it.
    """
    if spp < 1:
        raise InvalidInput(f"Expected at least one path for each pixel, got {spp}.")
    if halves:
        on_progress = progress or (lambda done, message: None)
        images = [
            reference(
                scene, camera, hologram, focus, pupil, max(1, -(-spp // 2)), near, max_depth,
                lambda done, message, half=half: on_progress((half + done) / 2, message), 2 * seed + half,
            )
            for half in range(2)
        ]  # fmt: skip
        return np.stack(images, axis=1)
    variants.activate_for(scene)
    camera, hologram = squared(camera, hologram)
    from ..planning.pilot import near_end
    from ..scene.dispersion import tuned, wavelength_groups

    progress = progress or (lambda done, message: None)
    near = near or near_end(scene, camera, hologram)
    mapping = DepthMapping.of(hologram, camera, near)
    mapping.depth_to_z(list(focus))  # refuses depths behind the camera
    images = np.empty((len(focus), hologram.height, hologram.width, len(hologram.wavelengths)), np.float32)
    groups = [part for group in wavelength_groups(scene, hologram.wavelengths) for part in _by_channel(group)]
    integrator = path_tracer(scene, camera.sees_sky, max_depth)
    for f, depth in enumerate(focus):
        lens = CameraLens(camera, hologram.width, hologram.height, min(depth, 1e5))
        for g, group in enumerate(groups):
            radii = {channel(w): mapping.pupil_radius(hologram.max_slope(w)) for w in group}
            done = f * len(groups) + g

            def on_progress(part, done=done):
                progress((done + part) / (len(focus) * len(groups)), "Reference")

            with tuned(scene, group):
                image = _image(
                    scene, integrator, lens, _Pupils(radii, pupil, hologram.optics), hologram, spp * len(group),
                    seed * len(groups) + g, on_progress,
                )  # fmt: skip
            for k, w in enumerate(hologram.wavelengths):
                if w in group:
                    images[f, :, :, k] = image[:, :, channel(w)]
    return images


def _by_channel(wavelengths):
    """Groups of wavelengths, no two of which show the same channel of the scene."""
    groups = []
    for w in wavelengths:
        for group in groups:
            if channel(w) not in map(channel, group):
                group.append(w)
                break
        else:
            groups.append([w])
    return groups


class _Pupils:
    """Random points of the open pupils of several wavelengths, which share them.

    For the whole pupil, points come from each wavelength's own disk equally often. They count for every wavelength
    whose disk contains them, weighted by the inverse of the joint density (the balance heuristic; Veach and Guibas,
    SIGGRAPH 1995). The disks are concentric, and 2.2 of three paths or more count for each of red, green and blue.
    For a part of the pupil, points count for the wavelengths whose disk contains them.

    Parameters
    ----------
    radii : dict of int to float
        Radius in meters of the disk of each wavelength, by the channel that the wavelength shows.
    pupil : Pupil or None
        Part of the pupil; None for the whole.
    optics : Optics
        Bench whose stop the points have to pass.
    """

    def __init__(self, radii, pupil, optics):
        import mitsuba as mi

        from ..scene.buffers import constant

        if pupil and pupil.diameter / 2 >= max(radii.values()) + math.hypot(pupil.x, pupil.y):
            pupil = None  # it contains every disk
        self._center = constant(mi.Point2f, (pupil.x, pupil.y) if pupil else (0.0, 0.0))
        disks = [pupil.diameter / 2] if pupil else sorted(radii.values())
        self._squares = [number(r**2) for r in disks]
        self._densities = [number(1 / (len(disks) * math.pi * r**2)) for r in disks]
        self._radii, self._open = radii, None
        if optics.stopped:
            self._open = mi.Bool(optics.open_at(*_cells()).ravel())
        self._own = {c: number(r**2) for c, r in radii.items()}
        self._scale = self._densities[-1]

    def sample(self, uniform):
        """Points in meters, to the right and up, and their weight for each channel, up to a common factor."""
        import drjit as dr
        import mitsuba as mi

        # Inverse distribution of the squared radius, whose density falls by a step at the edge of each disk.
        square, probability, start = mi.Float(0), mi.Float(0), mi.Float(0)
        for k, end in enumerate(self._squares):
            slope = math.pi * sum(self._densities[k:])
            square = dr.select(uniform.x >= probability, start + (uniform.x - probability) / slope, square)
            probability, start = probability + slope * (end - start), end
        square = dr.minimum(square, self._squares[-1])
        pairs = zip(self._squares, self._densities, strict=True)
        density = sum(dr.select(square <= end, part, 0) for end, part in pairs)
        sine, cosine = dr.sincos(2 * dr.pi * uniform.y)
        point = dr.sqrt(square) * mi.Vector2f(cosine, sine) + self._center
        weight = mi.Color3f(0)
        for c, end in self._own.items():
            is_open = dr.squared_norm(point) <= end
            if self._open is not None:
                column, row = (mi.Int((1 + at / self._radii[c]) * (CELLS / 2)) for at in (point.x, -point.y))
                column, row = (dr.clip(at, 0, CELLS - 1) for at in (column, row))
                is_open &= dr.gather(mi.Bool, self._open, mi.UInt(row * CELLS + column))
            weight[c] = dr.select(is_open, self._scale / density, 0)
        return point, weight


def _cells():
    """Centers of the cells of a grid over the Fourier plane, to the right and up, in units of the band's edge."""
    centers = (2 * np.arange(CELLS) + 1) / CELLS - 1
    return centers[None, :], -centers[:, None]


def _image(scene, integrator, lens, pupils, hologram, spp, seed, progress):
    """Mean over paths, shape (y, x, 3), by strips of the image.

    Paths are stratified in each pixel (Kensler, Pixar technical memo 13-01, 2013).
    """
    import drjit as dr
    import mitsuba as mi

    across = math.isqrt(spp)
    spp = across * -(-spp // across)  # the number that Mitsuba would round to, with a warning
    count = min(hologram.height, -(-hologram.width * hologram.height * spp // CHUNK_PATHS))
    rows = -(-hologram.height // count)

    class Strip(mi.Sensor):
        """Some rows of the image, from row `first` on."""

        first: mi.Float

        def sample_ray_differential(self, time, wavelength, position, aperture, active=True):
            point, weight = pupils.sample(aperture)
            place = mi.Point2f(position.x * hologram.width, position.y * rows + self.first)
            return lens.ray(place, point), weight

    class White(mi.SamplingIntegrator):
        """Radiance 1 from everywhere."""

        def __init__(self):
            super().__init__(mi.Properties())

        def sample(self, scene, sampler, ray, medium=None, active=True):
            return mi.Color3f(1), mi.Bool(True), []

    properties = mi.Properties()
    properties["film"] = mi.load_dict(
        {
            "type": "hdrfilm", "width": hologram.width, "height": rows, "rfilter": {"type": "box"},
            "pixel_format": "rgb", "component_format": "float32",
        }
    )  # fmt: skip
    properties["sampler"] = mi.load_dict({"type": "multijitter", "sample_count": spp})
    sensor = Strip(properties)
    image = np.empty((hologram.height, hologram.width, 3), np.float32)
    for strip, first in enumerate(range(0, hologram.height, rows)):
        first = min(first, hologram.height - rows)  # strips of one size are one program; the last may overlap
        sensor.first = dr.opaque(mi.Float, first)
        own = (seed * count + strip) & 0xFFFFFFFF
        part = mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=own)
        # dividing by the mean weight of the same points removes the noise of the pupil itself
        weight = mi.render(scene, sensor=sensor, integrator=White(), spp=spp, seed=own)
        image[first : first + rows] = np.asarray(part) / np.maximum(np.asarray(weight), 1e-6)
        progress((strip + 1) / count)
    return image


def diffracted(
    pictures: np.ndarray, hologram: Hologram, openings: Sequence[float] | None = None
) -> np.ndarray:
    """Blur images by diffraction at the open pupil, the best that light through it can show.

    The incoherent image is convolved with abs(h)^2, where h is the transform of the opening (Goodman, Introduction to
    Fourier Optics, section 6.3). The rays of `reference` do not include it.

    Parameters
    ----------
    pictures : numpy.ndarray, shape (..., y, x, wavelength)
        Intensities on the grid `Hologram.picture`.
    hologram : Hologram
    openings : sequence of float, optional
        Radius of the opening in each wavelength's own cone, cycles per pixel. Default: 0.5, the whole cone.

    Returns
    -------
    numpy.ndarray, float32, shape of `pictures`

    Raises
    ------
    InvalidInput
        If pictures, wavelengths and openings differ in number.
    """
    openings = [0.5] * len(hologram.wavelengths) if openings is None else openings
    if not pictures.shape[-1] == len(openings) == len(hologram.wavelengths):
        raise InvalidInput(
            f"Expected pictures and openings of {len(hologram.wavelengths)} wavelengths, got {pictures.shape[-1]} and "
            f"{len(openings)}."
        )
    grid, (rows, columns) = hologram.picture, pictures.shape[-3:-1]
    f = np.hypot(scipy.fft.fftfreq(rows)[:, None], scipy.fft.fftfreq(columns))
    out = np.empty(pictures.shape, np.float32)
    for k, radius in enumerate(openings):
        cone = coarsest(grid.pitch_at(grid.wavelengths[k]))  # behind a lens wider than a picture's pixel
        mask = grid.optics.stop_mask((rows, columns), (grid.pitch, grid.pitch, cone))
        kernel = np.abs(scipy.fft.ifft2((f <= radius) & mask)) ** 2
        transfer = scipy.fft.fft2(kernel / kernel.sum())
        out[..., k] = scipy.fft.ifft2(scipy.fft.fft2(pictures[..., k]) * transfer).real
    return np.maximum(out, 0)
