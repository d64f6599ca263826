"""What a viewer sees: the stored field refocused through a pupil."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..errors import InvalidInput
from ..hologram import channel
from ..memory import shortage
from ..optics import ON_AXIS, Optics
from ..pixels import Pitch, axes, beyond, coarsest, frequencies
from ..progress import stage
from ..waves import arrays
from ..waves.lens import Collins, behind_lens
from ..waves.panels import at_panel
from ..waves.propagation import (
    JUDGING_GUARD,
    circular_band,
    commensurate,
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

MOST_BYTES = (
    1 << 29
)  # of spectra that a `Refocuser` keeps: 1920 x 1080 in three colors has room for eight frames
FAR = 4  # widths that the steepest waves walk: to where a grid of the SLM's pixels, padded, is wide enough


def far_from(hologram: Hologram) -> float:
    """Distance from the SLM, meters, from which on pictures are those of the far field, by one Fresnel transform.

    Nearer the angular spectrum is sampled well on the SLM's pixels, and from one such width on the transform's chirp
    is. The volume lies before it. Behind a lens there is none: its picture is a far field.
    """
    if hologram.in_air is not hologram:
        return math.inf
    width = max(hologram.width * hologram.pitch_x, hologram.height * hologram.pitch_y)
    volume = max(abs(hologram.depth_far), abs(hologram.depth_near))
    return max(FAR * width / hologram.widest_slope, 2 * volume)


def picture_pitch(hologram: Hologram, distance: float) -> float:
    """Width in meters of a pixel of a picture at a distance from the SLM, or from the plane of the image `in_air`."""
    if abs(distance) < far_from(hologram):
        return coarsest(hologram.picture.pitch)
    return min(hologram.wavelengths) * abs(distance) / hologram.shorter_side


ROUNDING = 1e-9  # of a wave's sine: more than double precision loses
EDGE_BINS = 2  # that the edge of a part of the pupil may lose where its light just fills a coarser grid


def pupil_mask(
    shape: tuple[int, int],
    pitch: Pitch,
    wavelength: float,
    mapping: DepthMapping,
    pupil: Pupil,
    optics: Optics = ON_AXIS,
) -> np.ndarray:
    """FFT bins whose plane waves pass the pupil: slope s meets the pupil plane at X = s beta / F.

    Raises
    ------
    InvalidInput
        If it misses the light that passes the stop of the optics.
    """
    fy, fx = (np.fft.fftfreq(n, d) for n, d in zip(shape, axes(pitch), strict=True))
    # Only where its waves can be is computed: a slope is a sine over a cosine, which is 1 at most, and at least that
    # of the pupil's steepest wave.
    radius, per_slope = pupil.diameter / 2, mapping.beta / mapping.focal
    steepest = (math.hypot(pupil.x, pupil.y) + radius) / per_slope
    rows, columns = (
        _between(wavelength * f, (center - radius) / per_slope, (center + radius) / per_slope, steepest)
        for f, center in ((-fy, pupil.y), (fx, pupil.x))
    )
    square = (wavelength * fx[None, columns]) ** 2 + (wavelength * fy[rows, None]) ** 2
    scale = wavelength / np.sqrt(np.maximum(1 - square, 1e-12)) * mapping.beta / mapping.focal
    across, up = fx[None, columns] * scale - pupil.x, -fy[rows, None] * scale - pupil.y
    there = np.ix_(rows, columns)
    inside = np.zeros(shape, bool)
    inside[there] = across**2 + up**2 <= pupil.diameter**2 / 4  # a root takes longer than all else
    right, down = (
        2 * f[some] for f, some in zip(frequencies(shape, pitch)[::-1], (columns, rows), strict=True)
    )
    if not (inside[there] & optics.open_at(right[None, :], -down[:, None])).any():
        if optics.stopped:
            raise InvalidInput("The pupil lies outside the light that passes the stop: move it there.")
        radius = mapping.pupil_radius(math.tan(math.asin(wavelength / (2 * coarsest(pitch)))))
        raise InvalidInput(
            f"The pupil lies outside the light, which fills a radius of {radius * 1e3:.3g} mm around the axis: "
            f"move it there."
        )
    return inside


def _between(sines, low, high, steepest):
    """Numbers of the sines whose slopes may lie from `low` to `high`, of waves of slopes up to `steepest`."""
    cosine = 1 / math.hypot(1, steepest)
    ends = [end * part for end in (low, high) for part in (cosine, 1.0)]
    margin = ROUNDING * (1 + max(map(abs, ends)))
    return np.flatnonzero((sines >= min(ends) - margin) & (sines <= max(ends) + margin))


class Refocuser:
    """A wave field ready to be focused: the spectra of its frames are kept from one focus to the next.

    Refocusing is then one inverse FFT a frame and wavelength.

    Parameters
    ----------
    field : WaveField
    most_bytes : int
        Spectra that do not fit into this much memory are computed anew each time.
    own_pixels : bool
        Whether pictures have the display's own pixels where these are not square, instead of those of
        `Hologram.picture`.
    max_apart : int
        Pixels between those of pictures, at most.
    """

    def __init__(
        self,
        field: WaveField,
        most_bytes: int = MOST_BYTES,
        own_pixels: bool = False,
        max_apart: int = 1,
    ) -> None:
        # what spectra are of: the SLM's pixels, or those of the image behind its lens
        self.field, self._grid = field, field.hologram.in_air
        self._own, self._max_apart = own_pixels or self._grid.plain, max_apart
        self._most_bytes, self._guard = most_bytes, JUDGING_GUARD if field.modulated else 0
        self._ways = [behind_lens(self._grid, wavelength) for wavelength in self._grid.wavelengths]
        self._spectra = {}  # by wavelength, frame and shape
        self._transfers = {}  # the last one of each wavelength, after its shape and distance
        self._lock = threading.Lock()

    def __call__(
        self,
        focus: Sequence[float],
        pupil: Pupil | None = None,
        progress: Progress | None = None,
        apart: int = 1,
    ) -> Array:
        """Pictures at several distances, as `reconstruct`, of every pixel or those `apart`; one thread at a time.

        Light through half of the pupil has half of the bandwidth, so that every second pixel holds it, and its FFTs
        take a quarter of the time.

        Raises
        ------
        InvalidInput
        """
        views = [(float(z), pupil) for z in self.field.mapping.depth_to_z(list(focus))]
        with self._lock:
            return self._pictures(views, progress, apart)

    def through(
        self, focus: float, pupils: Sequence[Pupil], progress: Progress | None = None, apart: int = 1
    ) -> Array:
        """Pictures at one distance through several pupils: as by as many calls, in less time.

        Raises
        ------
        InvalidInput
        """
        (distance,) = self.field.mapping.depth_to_z([focus])
        with self._lock:
            return self._pictures([(float(distance), pupil) for pupil in pupils], progress, apart)

    def on(self, optics: Optics) -> Refocuser:
        """The same light seen on another bench, see `at_panel`; what differs in beam or stop alone shares the spectra.

        Raises
        ------
        InvalidInput
            If the field is of another lens, or the optics do not go with its pixels.
        """
        other = Refocuser(at_panel(self.field, optics), self._most_bytes, self._own, self._max_apart)
        if other.field.data is self.field.data:
            other._spectra, other._lock = self._spectra, self._lock
        return other

    def _pictures(self, views, progress, apart):
        """Of each distance from the SLM and pupil."""
        progress = progress or (lambda done, message: None)
        beyond_near, numbers = far_from(self.field.hologram), {}
        for number, (distance, pupil) in enumerate(views):  # the far field by pupils, all else together
            far = abs(distance) >= beyond_near
            numbers.setdefault((far, pupil if far else None), []).append(number)
        images, done = None, 0
        for (far, pupil), some in numbers.items():
            told = stage(progress, done / len(views), (done + len(some)) / len(views))
            if far:
                distances = np.array([views[number][0] for number in some])
                found = self._far(distances, pupil, told)[:, ::apart, ::apart, :]
            else:
                found = self._near([views[number] for number in some], told, apart)
            if len(some) == len(views):
                return found
            if images is None:
                images = arrays.empty((len(views), *found.shape[1:]), "float32", found)
            for number, place in enumerate(some):
                images[place, ...] = found[number, ...]
            done += len(some)
        return images

    def _mask(self, k, padded, pupil):
        """FFT bins that pass the stop and the pupil; None for all of the band."""
        grid, wavelength = self._grid, self._grid.wavelengths[k]
        optics, pitch = grid.optics, grid.pitch_at(wavelength)
        mask = optics.passes(padded, pitch) if optics.stopped else None
        if pupil is not None:
            part = pupil_mask(padded, pitch, wavelength, self.field.mapping, pupil, optics)
            mask = part if mask is None else mask & part
        return mask

    def _far(self, distances, pupil, progress):
        """By one transform each, of pixels as wide as `picture_pitch` says, which have the light that meets them."""
        hologram, data, size = self._grid, self.field.data, self.field.hologram.picture
        frames, colors, *shape = data.shape
        images = arrays.zeros((len(distances), size.height, size.width, colors), "float32", data)
        done = 0
        for k, wavelength in enumerate(hologram.wavelengths):
            padded = self._padded(k, 0.0)
            mask = self._mask(k, padded, pupil)
            pitch, own = hologram.pitch_at(wavelength), hologram.distance_at(wavelength)
            mask = arrays.mask(circular_band(padded, pitch) if mask is None else mask, data)
            ways = [
                Collins(shape, pitch, wavelength, 1.0, z - own, images.shape[1:3], picture_pitch(hologram, z))
                for z in distances
            ]
            for m in range(frames):
                wave = field_of(self._spectrum(k, m, padded) * mask, shape, overwrite=True)
                for place, way in enumerate(ways):
                    images[place, ..., k] += arrays.intensity(way.there(wave)) / frames
                done += len(ways)
                progress(done / (len(distances) * frames * colors), "Refocusing")
        # beyond that pixels send the same once more
        for axis, d in ((1, hologram.pitch_y), (2, hologram.pitch_x)):
            n = images.shape[axis]
            within = np.abs(np.arange(n) - (n - 1) / 2) <= hologram.shorter_side / d / 2
            within = arrays.mask(within, data)
            images *= within[None, :, None, None] if axis == 1 else within[None, None, :, None]
        return images

    def _near(self, views, progress, apart):
        """By angular spectra."""
        grid, (frames, colors) = self._grid, self.field.data.shape[:2]
        shape = grid.raster(grid.wavelengths[0]).shape
        aside = max(abs(grid.distance_at(wavelength)) for wavelength in grid.wavelengths)
        farthest = max(abs(distance) for distance, _ in views) + aside
        for wavelength in grid.wavelengths:
            needed = grid_bytes(shape, grid.pitch_at(wavelength), wavelength, farthest, self._guard)
            needed += 4 * len(views) * colors * math.prod(shape)
            shortage(needed, f"Refocusing {farthest * 1e3:.3g} mm from {grid.origin}", self.field.data)
        whole = shape if self._own and self._ways[0] is None else grid.picture.raster().shape
        size = [-(-n // apart) for n in whole]
        images, done = arrays.empty((len(views), *size, colors), "float32", self.field.data), 0
        for k in range(colors):
            padded, places, lines = self._padded(k, farthest), self._places(k), self._lines(k)
            masks = {pupil: self._mask(k, padded, pupil) for pupil in {pupil for _, pupil in views}}
            sparse = apart > 1 and places is None and lines is None
            bins = {
                p: _bins(mask, apart) if sparse and mask is not None else None for p, mask in masks.items()
            }
            held = 8 * math.prod(padded) // (1 if None in bins.values() else apart**2)
            together = max(1, MOST_BYTES // held)  # whose transfer functions fit
            for first in range(0, len(views), together):
                some = views[first : first + together]
                transfers = []
                for distance, pupil in some:
                    progress(done / (len(views) * frames * colors), "Refocusing")
                    transfers.append(self._transfer(k, padded, distance, masks[pupil], bins[pupil], apart))
                seen = size if lines is None else shape
                sums = [arrays.zeros(seen, "float32", transfer) for transfer in transfers]
                for m in range(frames):
                    spectrum_ = self._spectrum(k, m, padded)
                    for total, transfer, (_, pupil) in zip(sums, transfers, some, strict=True):
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
        """FFT shape for a wavelength and distance: that of the volume, so that spectra may be kept, if it is enough."""
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
        return tuple(_fast_multiple(n, self._max_apart) for n in padded)

    def _places(self, k):
        """Where pixels of the picture lie between those of the panel; None where they are these."""
        if self._own:
            return None
        grid = self._grid
        return grid.picture.raster().lines_on(grid.raster(grid.wavelengths[k]))

    def _lines(self, k):
        """Where pixels of pictures lie between a wavelength's own behind a lens; None where they are these."""
        if self._ways[k] is None:
            return None
        own, shared = self._grid.raster(self._grid.wavelengths[k]), self._grid.raster()
        return None if own == shared else shared.lines_on(own)

    def _transfer(self, k, padded, distance, mask, bins, apart):
        """The transfer function to a distance, behind a mask and in bins; a wavelength's last one is kept without."""
        key, grid = (padded, distance), self._grid
        if self._transfers.get(k, (None,))[0] != key:
            wavelength = grid.wavelengths[k]
            away = distance - grid.distance_at(wavelength)
            what = padded, grid.pitch_at(wavelength), wavelength, away
            self._transfers[k] = key, transfer_function(*what, on=self.field.data)
        transfer = self._transfers[k][1]
        if bins is not None:
            passes = mask[np.ix_(*bins)] * np.float32(1 / apart**2)
            return arrays.at(transfer, *bins) * arrays.like(passes, transfer)
        return transfer if mask is None else transfer * arrays.mask(mask, transfer)

    def _spectrum(self, k, m, padded):
        kept = self._spectra.get((k, m, padded))
        if kept is not None:
            return kept
        wave = self.field.data[m, k, ...]
        if self._ways[k] is not None:
            wave = self._ways[k].there(wave)
        waves = spectrum(wave, padded)
        held = sum(8 * math.prod(shape) for _, _, shape in (*self._spectra, (k, m, padded)))
        if padded == self._padded(k, 0.0) and held <= self._most_bytes:
            self._spectra[k, m, padded] = waves
        return waves


def averaged(pictures: Array, lines: Sequence[EvenSteps]) -> Array:
    """Intensities on the pixels of another grid: each is the mean over its square, of squares that are even.

    Between pixels a field of unit modulus is not of unit modulus, and its intensity is speckled. So intensities are
    taken at the field's own pixels, and spread over these.

    Parameters
    ----------
    pictures : array, shape (..., y, x)
    lines : (EvenSteps, EvenSteps)
        Rows and columns of the other grid, all of which lie within the pictures.

    Returns
    -------
    array, float64, of as many rows and columns
    """
    xp, pictures = arrays.namespace(pictures), arrays.as_type(pictures, "float64")
    for axis, line in zip((-2, -1), lines, strict=True):
        values = xp.moveaxis(pictures, axis, -1)
        count = values.shape[-1]
        sums = arrays.zeros((*values.shape[:-1], count + 1), "float64", values)
        sums[..., 1:] = arrays.cumulative(values)
        ends = line.first + 0.5 + line.step * (np.arange(line.count + 1) - 0.5)
        ends = ends.clip(0, count)  # rounding
        low = np.minimum(ends.astype(int), count - 1)
        share, low = arrays.like(ends - low, values), arrays.like(low, values)
        part = (xp.take(sums, low, axis=-1) + share * xp.take(values, low, axis=-1)) / line.step
        pictures = xp.moveaxis(part[..., 1:] - part[..., :-1], -1, axis)
    return pictures


def _bins(mask, apart):
    """Bins of a spectrum that those of every `apart`-th pixel's are, of a mask that lets hardly others through; None if
    there are more.

    Frequencies keep their places modulo the smaller grid, as samples alias them.
    """
    found = []
    for axis, count in enumerate(mask.shape):
        numbers = np.flatnonzero(mask.any(1 - axis))
        numbers = np.where(numbers >= count / 2, numbers - count, numbers)
        size = count // apart
        if count % apart or np.ptp(numbers) >= size + EDGE_BINS:
            return None
        own = (int(numbers.min()) + int(numbers.max()) + 1) // 2 - size // 2 + np.arange(size)
        place = np.empty(size, int)
        place[own % size] = own % count
        found.append(place)
    return found


def _fast_multiple(count, of):
    """The next multiple that FFTs are fast on; of 1 the number itself."""
    if of == 1:
        return count
    count = -(-count // of) * of
    while scipy.fft.next_fast_len(count) != count:
        count += of
    return count


def reconstruct(
    field: WaveField, focus: Sequence[float], pupil: Pupil | None = None, progress: Progress | None = None
) -> Array:
    """Time-averaged intensity of a wave field, focused at world depths.

    Depths from `far_from` the SLM on are of its far field, where a pixel is as wide as `picture_pitch` says and holds
    the light that meets it.

    Parameters
    ----------
    field : WaveField
        Its data may be of another library than NumPy, as for `propagate`.
    focus : sequence of float
        World depths along the camera's axis, meters; `math.inf` for the far end.
    pupil : Pupil, optional
        Default: the whole recordable cone.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    array, float32, shape (focus, y, x, wavelength)
        Of the library of the field's data, in the scene's radiance units, row 0 at the top; on the grid
        `Hologram.picture`.

    Raises
    ------
    InvalidInput
        If a focus is not in front of the camera or the pupil misses the light.
    """
    return Refocuser(field, most_bytes=0)(focus, pupil, progress)


def to_rgb(image: np.ndarray, wavelengths: Sequence[float]) -> np.ndarray:
    """Linear RGB picture of an intensity image.

    Parameters
    ----------
    image : numpy.ndarray, shape (..., wavelength)
    wavelengths : sequence of float
        Meters; each lights the channel it was rendered from. A single one gives a gray picture.

    Returns
    -------
    numpy.ndarray, float32, shape (..., 3)
    """
    if len(wavelengths) == 1:
        return np.repeat(image, 3, axis=-1).astype(np.float32)
    rgb = np.zeros((*image.shape[:-1], 3), np.float32)
    channels = [channel(w) for w in wavelengths]
    for k, c in enumerate(channels):
        rgb[..., c] += image[..., k] / channels.count(c)
    return rgb
