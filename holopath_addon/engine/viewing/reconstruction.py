"""Numerical reconstruction: images of a stored field, refocused through a pupil."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput, real_numbers
from ..hologram import channel
from ..memory import shortage
from ..optics import ON_AXIS, Optics
from ..pixels import Pitch, axes, beyond, coarsest, frequencies
from ..progress import stage
from ..waves import arrays
from ..waves.lens import Collins, behind_lens
from ..waves.panels import at_panel
from ..waves.propagation import (
    EVALUATION_GUARD,
    circular_band,
    commensurate,
    fast_multiple,
    field_of,
    grid_bytes,
    padded_shape,
    sampled,
    spectrum,
    transfer_function,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..hologram import Hologram
    from ..mapping import DepthMapping
    from ..optics import Pupil
    from ..pixels import EvenSteps
    from ..progress import Progress
    from ..wavefield import WaveField
    from ..waves.arrays import Array

MAX_CACHE_BYTES = 1 << 29  # of spectra in a `Refocuser`: eight frames of 1920 x 1080 pixels in three colors
FAR = 4  # sideways travel of the steepest waves, in widths of the SLM, up to which its padded grid is wide enough


def far_from(hologram: Hologram) -> float:
    """Distance from the SLM in meters at which the far field begins, which takes a single Fresnel transform.

    Up to there the angular spectrum is well sampled on the SLM's pixels. The transform's chirp is well sampled from
    1 / `FAR` of that distance on. The volume always lies before it. Infinite behind a lens, whose image is a far field
    already.
    """
    if hologram.in_air is not hologram:
        return math.inf
    width = max(hologram.width * hologram.pitch_x, hologram.height * hologram.pitch_y)
    volume = max(abs(hologram.depth_far), abs(hologram.depth_near))
    return max(FAR * width / hologram.widest_slope, 2 * volume)


def picture_pitch(hologram: Hologram, distance: float) -> float:
    """Pixel pitch of an image at a distance, meters.

    Parameters
    ----------
    hologram : Hologram
    distance : float
        Distance from the SLM, or behind a lens from the plane of the image `in_air`, meters.
    """
    if abs(distance) < far_from(hologram):
        return coarsest(hologram.picture.pitch)
    return min(hologram.wavelengths) * abs(distance) / hologram.shorter_side


ROUNDING = 1e-9  # relative bound of the rounding error of a wave's sine
EDGE_BINS = (
    2  # FFT bins that the edge of a part of the pupil may lose where its light just fills a coarser grid
)


def pupil_mask(
    shape: tuple[int, int],
    pitch: Pitch,
    wavelength: float,
    mapping: DepthMapping,
    pupil: Pupil,
    optics: Optics = ON_AXIS,
) -> np.ndarray:
    """FFT bins whose plane waves pass the pupil: slope s meets the pupil plane at X = s beta / F.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the FFT.
    pitch : float or (float, float)
        Pixel pitch, meters; (x, y) of pixels that are not square.
    wavelength : float
        Meters.
    mapping : DepthMapping
    pupil : Pupil
    optics : Optics
        Bench with the stop.

    Returns
    -------
    numpy.ndarray of bool, `shape`
        In FFT order.

    Raises
    ------
    InvalidInput
        If the pupil misses the light that passes the stop.
    """
    fy, fx = (np.fft.fftfreq(n, d) for n, d in zip(shape, axes(pitch), strict=True))
    # Compute only the bins that can pass: a slope is a sine over a cosine, which lies between that of the pupil's
    # steepest wave and 1.
    radius, per_slope = pupil.diameter / 2, mapping.beta / mapping.focal
    steepest = (math.hypot(pupil.x, pupil.y) + radius) / per_slope
    rows, columns = (
        _between(wavelength * f, (center - radius) / per_slope, (center + radius) / per_slope, steepest)
        for f, center in ((-fy, pupil.y), (fx, pupil.x))
    )
    square = (wavelength * fx[None, columns]) ** 2 + (wavelength * fy[rows, None]) ** 2
    scale = wavelength / np.sqrt(np.maximum(1 - square, 1e-12)) * mapping.beta / mapping.focal
    across, up = fx[None, columns] * scale - pupil.x, -fy[rows, None] * scale - pupil.y
    block = np.ix_(rows, columns)
    inside = np.zeros(shape, bool)
    inside[block] = across**2 + up**2 <= pupil.diameter**2 / 4  # a root would take longer than all else
    right, down = (
        2 * f[part] for f, part in zip(frequencies(shape, pitch)[::-1], (columns, rows), strict=True)
    )
    if not (inside[block] & optics.open_at(right[None, :], -down[:, None])).any():
        if optics.stopped:
            raise InvalidInput("The pupil lies outside the light that passes the stop. Move it there.")
        radius = mapping.pupil_radius(math.tan(math.asin(wavelength / (2 * coarsest(pitch)))))
        raise InvalidInput(
            f"The pupil lies outside the light, which fills a radius of {radius * 1e3:.3g} mm around the axis. "
            f"Move it there."
        )
    return inside


def _between(sines, low, high, steepest):
    """Indices of the sines whose slopes may lie from `low` to `high`, for waves of slopes up to `steepest`."""
    cosine = 1 / math.hypot(1, steepest)
    ends = [end * part for end in (low, high) for part in (cosine, 1.0)]
    margin = ROUNDING * (1 + max(map(abs, ends)))
    return np.flatnonzero((sines >= min(ends) - margin) & (sines <= max(ends) + margin))


class Refocuser:
    """Images of a wave field at any focus and through any pupil, with the spectra of its frames in a cache.

    Refocusing then takes one inverse FFT for each frame and wavelength.

    Parameters
    ----------
    field : WaveField
    max_bytes : int
        Size of the cache. Spectra that do not fit are computed again each time.
    own_pixels : bool
        Whether images have the display's own pixels where these are not square, instead of those of
        `Hologram.picture`.
    max_apart : int
        Maximum of the argument `apart` of later calls.

    Examples
    --------
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> hologram = engine.Hologram(32, 32, 8e-6, (516.5e-9,))
    >>> camera = engine.Camera(np.eye(4), 0.5)
    >>> field = engine.WaveField(np.ones((1, 1, 32, 32), np.complex64), hologram, camera, near=0.5)
    >>> refocus = engine.Refocuser(field)
    >>> refocus([0.5, np.inf]).shape  # (focus, y, x, wavelength)
    (2, 32, 32, 1)
    >>> refocus([0.5], engine.Pupil(0.0, 0.0, diameter=1e-3)).shape
    (1, 32, 32, 1)
    """

    def __init__(
        self,
        field: WaveField,
        max_bytes: int = MAX_CACHE_BYTES,
        own_pixels: bool = False,
        max_apart: int = 1,
    ) -> None:
        # spectra are those of the SLM's pixels, or of the image's behind its lens
        self.field, self._grid = field, field.hologram.in_air
        self._own, self._max_apart = own_pixels or self._grid.plain, max_apart
        self._max_bytes, self._guard = max_bytes, EVALUATION_GUARD if field.modulated else 0
        self._lenses = [behind_lens(self._grid, wavelength) for wavelength in self._grid.wavelengths]
        self._spectra = {}  # by wavelength, frame and shape
        self._transfers = {}  # of each wavelength the latest one, with its shape and distance
        self._lock = threading.Lock()

    def __call__(
        self,
        focus: Sequence[float],
        pupil: Pupil | None = None,
        progress: Progress | None = None,
        apart: int = 1,
    ) -> Array:
        """Images at several depths, as of `reconstruct`. Threads wait for each other.

        Parameters
        ----------
        focus : sequence of float
            World depths, meters.
        pupil : Pupil, optional
            Default: the whole recordable cone.
        progress : callable, optional
            ``progress(done, message)``, may raise `Cancelled`.
        apart : int
            Distance in pixels between those that are computed; 1 for all. Light through half of the pupil has half of
            the bandwidth, so that every second pixel is enough, and FFTs take a quarter of the time.

        Returns
        -------
        array, float32, shape (focus, y, x, wavelength)

        Raises
        ------
        InvalidInput
            If a focus is not in front of the camera or the pupil misses the light.
        """
        depths = list(real_numbers(focus, "the focus"))
        if not depths:
            raise InvalidInput("Expected at least one focus distance, got none.")
        views = [(float(z), pupil) for z in self.field.mapping.depth_to_z(depths)]
        with self._lock:
            return self._pictures(views, progress, apart)

    def through(
        self, focus: float, pupils: Sequence[Pupil], progress: Progress | None = None, apart: int = 1
    ) -> Array:
        """Images at one depth through each of several pupils, faster than by a call for each.

        Parameters
        ----------
        focus : float
            World depth, meters.
        pupils : sequence of Pupil
        progress : callable, optional
            ``progress(done, message)``, may raise `Cancelled`.
        apart : int
            Distance in pixels between those that are computed.

        Returns
        -------
        array, float32, shape (pupil, y, x, wavelength)

        Raises
        ------
        InvalidInput
            If the focus is not in front of the camera or a pupil misses the light.
        """
        (distance,) = self.field.mapping.depth_to_z([focus])
        with self._lock:
            return self._pictures([(float(distance), pupil) for pupil in pupils], progress, apart)

    def on(self, optics: Optics) -> Refocuser:
        """Refocuser of the same light on another bench, see `at_panel`.

        It shares the spectra where only beam or stop differ.

        Parameters
        ----------
        optics : Optics
            The other bench.

        Raises
        ------
        InvalidInput
            If the field was rendered for another lens, or the optics do not fit its pixels.
        """
        other = Refocuser(at_panel(self.field, optics), self._max_bytes, self._own, self._max_apart)
        if other.field.data is self.field.data:
            other._spectra, other._lock = self._spectra, self._lock
        return other

    def _pictures(self, views, progress, apart):
        """Images for views, each a distance from the SLM in meters and a pupil."""
        progress = progress or (lambda done, message: None)
        far_field, groups = far_from(self.field.hologram), {}
        for number, (distance, pupil) in enumerate(views):  # the far field by pupils, all else together
            far = abs(distance) >= far_field
            groups.setdefault((far, pupil if far else None), []).append(number)
        images, done = None, 0
        for (far, pupil), numbers in groups.items():
            on_progress = stage(progress, done / len(views), (done + len(numbers)) / len(views))
            if far:
                distances = np.array([views[number][0] for number in numbers])
                part = self._far(distances, pupil, on_progress)[:, ::apart, ::apart, :]
            else:
                part = self._near([views[number] for number in numbers], on_progress, apart)
            if len(numbers) == len(views):
                return part
            if images is None:
                images = arrays.empty((len(views), *part.shape[1:]), "float32", part)
            for index, number in enumerate(numbers):
                images[number, ...] = part[index, ...]
            done += len(numbers)
        return images

    def _mask(self, k, padded, pupil):
        """FFT bins that pass the stop and the pupil; None for all of the band."""
        grid, wavelength = self._grid, self._grid.wavelengths[k]
        optics, pitch = grid.optics, grid.pitch_at(wavelength)
        mask = optics.stop_mask(padded, pitch) if optics.stopped else None
        if pupil is not None:
            part = pupil_mask(padded, pitch, wavelength, self.field.mapping, pupil, optics)
            mask = part if mask is None else mask & part
        return mask

    def _far(self, distances, pupil, progress):
        """Far-field images by one Fresnel transform each: a pixel of `picture_pitch` sums the light that hits it."""
        hologram, data, size = self._grid, self.field.data, self.field.hologram.picture
        frames, colors, *shape = data.shape
        images = arrays.zeros((len(distances), size.height, size.width, colors), "float32", data)
        done = 0
        for k, wavelength in enumerate(hologram.wavelengths):
            padded = self._padded(k, 0.0)
            mask = self._mask(k, padded, pupil)
            pitch, own = hologram.pitch_at(wavelength), hologram.distance_at(wavelength)
            mask = arrays.mask(circular_band(padded, pitch) if mask is None else mask, data)
            # pixels of the display, and squares of the image, in which near images count light
            area = math.prod(axes(pitch)) / coarsest(size.pitch) ** 2
            transforms = [
                Collins(shape, pitch, wavelength, 1.0, z - own, images.shape[1:3], picture_pitch(hologram, z))
                for z in distances
            ]
            for m in range(frames):
                wave = field_of(self._spectrum(k, m, padded) * mask, shape, overwrite=True)
                for number, (transform, z) in enumerate(zip(transforms, distances, strict=True)):
                    ramp = self._ramp(k, z - own)
                    light = wave if ramp is None else wave * ramp
                    images[number, ..., k] += arrays.intensity(transform.propagate(light)) / frames
                done += len(transforms)
                progress(done / (len(distances) * frames * colors), "Refocusing")
            if area != 1:
                images[..., k] *= area
        # the light of a grid of pixels repeats beyond these bounds
        for axis, d in ((1, hologram.pitch_y), (2, hologram.pitch_x)):
            n = images.shape[axis]
            within = np.abs(np.arange(n) - (n - 1) / 2) <= hologram.shorter_side / d / 2
            within = arrays.mask(within, data)
            images *= within[None, :, None, None] if axis == 1 else within[None, None, :, None]
        return images

    def _ramp(self, k, distance):
        """Phase factor that moves the Fresnel transform of a wavelength by its shift; None without a shift.

        u(x - s) at a distance z is U(x' - s), for U the transform of u(y) exp(2 pi i y s / (wavelength z)).
        """
        wavelength = self._grid.wavelengths[k]
        raster = self._grid.raster(wavelength)
        if not any(raster.middle):
            return None
        ramp = 1.0
        for axis, (n, d, shift) in enumerate(
            zip(raster.shape, axes(raster.pitch), raster.middle, strict=True)
        ):
            turns = (np.arange(n) - (n - 1) / 2) * (d * shift / (wavelength * distance))
            factor = np.exp(2j * math.pi * turns)
            ramp = ramp * (factor[:, None] if axis == 0 else factor[None, :])
        return arrays.like(ramp, self.field.data, "complex64")

    def _near(self, views, progress, apart):
        """Images within the angular spectrum's range, see `far_from`."""
        grid, (frames, colors) = self._grid, self.field.data.shape[:2]
        shape = grid.raster(grid.wavelengths[0]).shape
        color_offset = max(abs(grid.distance_at(wavelength)) for wavelength in grid.wavelengths)
        farthest = max(abs(distance) for distance, _ in views) + color_offset
        for wavelength in grid.wavelengths:
            needed = grid_bytes(shape, grid.pitch_at(wavelength), wavelength, farthest, self._guard)
            needed += 4 * len(views) * colors * math.prod(shape)
            shortage(needed, f"Refocusing {farthest * 1e3:.3g} mm from {grid.origin}", self.field.data)
        whole = shape if self._own and self._lenses[0] is None else grid.picture.raster().shape
        size = [-(-n // apart) for n in whole]
        images, done = arrays.empty((len(views), *size, colors), "float32", self.field.data), 0
        for k in range(colors):
            padded, places, lines = self._padded(k, farthest), self._places(k), self._lines(k)
            masks = {pupil: self._mask(k, padded, pupil) for pupil in {pupil for _, pupil in views}}
            sparse = apart > 1 and places is None and lines is None
            bins = {
                p: _bins(mask, apart) if sparse and mask is not None else None for p, mask in masks.items()
            }
            transfer_bytes = 8 * math.prod(padded) // (1 if None in bins.values() else apart**2)
            batch_size = max(1, MAX_CACHE_BYTES // transfer_bytes)
            for first in range(0, len(views), batch_size):
                batch = views[first : first + batch_size]
                transfers = []
                for distance, pupil in batch:
                    progress(done / (len(views) * frames * colors), "Refocusing")
                    transfers.append(self._transfer(k, padded, distance, masks[pupil], bins[pupil], apart))
                sum_shape = size if lines is None else shape
                sums = [arrays.zeros(sum_shape, "float32", transfer) for transfer in transfers]
                for m in range(frames):
                    spectrum_ = self._spectrum(k, m, padded)
                    for total, transfer, (_, pupil) in zip(sums, transfers, batch, strict=True):
                        own = bins[pupil]
                        waves = (spectrum_ if own is None else arrays.at(spectrum_, *own)) * transfer
                        if places is not None:
                            at_focus = sampled(waves, places)
                        else:
                            at_focus = field_of(waves, shape if own is None else size, overwrite=True)
                        if own is None and lines is None:
                            at_focus = at_focus[::apart, ::apart]
                        total += arrays.intensity(at_focus)
                        done += 1
                        progress(done / (len(views) * frames * colors), "Refocusing")
                for number, total in enumerate(sums, first):
                    if lines is not None:
                        total = arrays.as_type(averaged(total, lines)[::apart, ::apart], "float32")
                    images[number, ..., k] = total / frames
        return images

    def _padded(self, k, distance):
        """FFT shape for a wavelength and distance: if large enough that of the volume, whose spectra can be cached."""
        needed = self._shape(k, distance)
        volume = self._shape(k, max(abs(self._grid.depth_far), abs(self._grid.depth_near)))
        return volume if min(np.subtract(volume, needed)) >= 0 else needed

    def _shape(self, k, distance):
        grid, places = self._grid, self._places(k)
        wavelength, guard = grid.wavelengths[k], self._guard
        shape = grid.raster(wavelength).shape
        if places is not None:
            guard = max(guard, beyond(places, shape))
        padded = padded_shape(shape, grid.pitch_at(wavelength), wavelength, distance, guard)
        if places is not None:
            return commensurate(padded, places)
        return tuple(fast_multiple(n, self._max_apart) for n in padded)

    def _places(self, k):
        """Places of the image's pixels on the panel's grid; None where both are the same."""
        if self._own:
            return None
        grid = self._grid
        return grid.picture.raster().lines_on(grid.raster(grid.wavelengths[k]))

    def _lines(self, k):
        """Places of the image's pixels on a wavelength's own grid behind a lens; None where both are the same."""
        if self._lenses[k] is None:
            return None
        own, shared = self._grid.raster(self._grid.wavelengths[k]), self._grid.raster()
        return None if own == shared else shared.lines_on(own)

    def _transfer(self, k, padded, distance, mask, bins, apart):
        """Transfer function to a distance, times a mask and in bins; each wavelength's latest one is cached without."""
        key, grid = (padded, distance), self._grid
        if self._transfers.get(k, (None,))[0] != key:
            wavelength = grid.wavelengths[k]
            own_distance = distance - grid.distance_at(wavelength)
            self._transfers[k] = (
                key,
                transfer_function(
                    padded, grid.pitch_at(wavelength), wavelength, own_distance, on=self.field.data
                ),
            )
        transfer = self._transfers[k][1]
        if bins is not None:
            passes = mask[np.ix_(*bins)] * np.float32(1 / apart**2)
            return arrays.at(transfer, *bins) * arrays.like(passes, transfer)
        return transfer if mask is None else transfer * arrays.mask(mask, transfer)

    def _spectrum(self, k, m, padded):
        cached = self._spectra.get((k, m, padded))
        if cached is not None:
            return cached
        wave = self.field.data[m, k, ...]
        if self._lenses[k] is not None:
            wave = self._lenses[k].propagate(wave)
        waves = spectrum(wave, padded)
        cache_bytes = sum(8 * math.prod(shape) for _, _, shape in (*self._spectra, (k, m, padded)))
        if padded == self._padded(k, 0.0) and cache_bytes <= self._max_bytes:
            self._spectra[k, m, padded] = waves
        return waves


def averaged(images: Array, lines: Sequence[EvenSteps]) -> Array:
    """Intensities on the pixels of another grid: the mean over each, where the original pixels are constant.

    Between its pixels a field of unit modulus has another modulus, and its intensity is speckled. So intensities are
    computed at the field's own pixels, and averaged from these.

    Parameters
    ----------
    images : array, shape (..., y, x)
        Intensities at the field's own pixels.
    lines : (EvenSteps, EvenSteps)
        Rows and columns of the other grid, all of which lie within the images.

    Returns
    -------
    array, float64, shape (..., rows, columns)
    """
    xp, images = arrays.namespace(images), arrays.as_type(images, "float64")
    for axis, line in zip((-2, -1), lines, strict=True):
        values = xp.moveaxis(images, axis, -1)
        count = values.shape[-1]
        sums = arrays.zeros((*values.shape[:-1], count + 1), "float64", values)
        sums[..., 1:] = arrays.cumulative(values)
        ends = line.first + 0.5 + line.step * (np.arange(line.count + 1) - 0.5)
        ends = ends.clip(0, count)  # rounding
        low = np.minimum(ends.astype(int), count - 1)
        fraction, low = arrays.like(ends - low, values), arrays.like(low, values)
        part = (xp.take(sums, low, axis=-1) + fraction * xp.take(values, low, axis=-1)) / line.step
        images = xp.moveaxis(part[..., 1:] - part[..., :-1], -1, axis)
    return images


def _bins(mask, apart):
    """Bins of a spectrum that hold the light through a mask and fit into the FFT of every `apart`-th pixel.

    None if the mask is open to more than these and `EDGE_BINS`. Sampling aliases frequencies: each keeps its place
    modulo the smaller grid.
    """
    bins = []
    for axis, count in enumerate(mask.shape):
        numbers = np.flatnonzero(mask.any(1 - axis))
        numbers = np.where(numbers >= count / 2, numbers - count, numbers)
        size = count // apart
        if count % apart or np.ptp(numbers) >= size + EDGE_BINS:
            return None
        own = (int(numbers.min()) + int(numbers.max()) + 1) // 2 - size // 2 + np.arange(size)
        place = np.empty(size, int)
        place[own % size] = own % count
        bins.append(place)
    return bins


def reconstruct(
    field: WaveField, focus: Sequence[float], pupil: Pupil | None = None, progress: Progress | None = None
) -> Array:
    """Time-averaged intensity of a wave field, focused at world depths.

    Depths that map to `far_from` or farther from the SLM are in its far field: there a pixel is `picture_pitch` wide
    and sums the light that falls on it.

    Parameters
    ----------
    field : WaveField
        Its data may be an array of another library than NumPy, as for `propagate`.
    focus : sequence of float
        World depths along the camera's axis, meters; `math.inf` for the far end.
    pupil : Pupil, optional
        Default: the whole recordable cone.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    array, float32, shape (focus, y, x, wavelength)
        In the scene's radiance units, row 0 is the top, on the grid `Hologram.picture`. Of the same library as the
        field's data.

    Raises
    ------
    InvalidInput
        If a focus is not in front of the camera or the pupil misses the light.

    Examples
    --------
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> hologram = engine.Hologram(32, 32, 8e-6, (516.5e-9,))
    >>> camera = engine.Camera(np.eye(4), 0.5)
    >>> field = engine.WaveField(np.ones((1, 1, 32, 32), np.complex64), hologram, camera, near=0.5)
    >>> images = engine.reconstruct(field, [0.5, 1.0, np.inf])
    >>> images.shape  # (focus, y, x, wavelength)
    (3, 32, 32, 1)
    """
    return Refocuser(field, max_bytes=0)(focus, pupil, progress)


def to_rgb(image: np.ndarray, wavelengths: Sequence[float]) -> np.ndarray:
    """Linear RGB image of intensities.

    Parameters
    ----------
    image : numpy.ndarray, shape (..., wavelength)
        Intensities, as of `reconstruct`.
    wavelengths : sequence of float
        Meters. Each gives the channel that it was rendered from; a single one gives all, a gray image.

    Returns
    -------
    numpy.ndarray, float32, shape (..., 3)

    Examples
    --------
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> engine.to_rgb(np.array([[1.0, 0.5]]), (640e-9, 450e-9))  # red and blue
    array([[1. , 0. , 0.5]], dtype=float32)
    """
    if len(wavelengths) == 1:
        return np.repeat(image, 3, axis=-1).astype(np.float32)
    rgb = np.zeros((*image.shape[:-1], 3), np.float32)
    channels = [channel(w) for w in wavelengths]
    for k, c in enumerate(channels):
        rgb[..., c] += image[..., k] / channels.count(c)
    return rgb
