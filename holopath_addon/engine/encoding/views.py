"""Target views all over the volume and the pupil, each on a grid that is as fine as its light needs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..optics import ON_AXIS, Optics
from ..pixels import EvenSteps, Pitch, axes, beyond, coarsest
from ..scene.variants import threads
from ..waves import arrays
from ..waves.arrays import PROCESSOR, Array
from ..waves.propagation import OPTIMIZATION_GUARD, FreeSpace, commensurate, fast_multiple, padded_shape
from ..waves.target_images import TransferCache, Viewpoint

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

MAX_DEPTHS = 20
MAX_STRIDE = 4  # pixels between samples of a view; FFT shapes are multiples of it
BATCH_BYTES = 1 << 25  # of spectra that are transformed at once
MIN_CAPTURED_FRACTION = (
    0.25  # of a cone of light, as in a corner: no view is brightened by more than its inverse
)
USUAL_FRAMES, MAX_PARTS_FACTOR = (
    8,
    3.0,
)  # with more frames there are more parts of the pupil, up to this factor
SHARPENING_STEPS = 10  # of `ViewTargets.sharpen`
SHARPENING_MARGIN = 16  # pixels by which images are continued beyond their border for it
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True)
class ViewKind:
    """Views through parts of the pupil of one size.

    Attributes
    ----------
    radius : float
        Radius of the part in terms of that of the stop's `stop_circle`; 1 is the whole stop.
    each : int
        Number of views at each depth, for up to eight frames; see `number`.
    weight : float
        Weight of their mean loss; the weights of all kinds sum to 1.
    looks : int
        Number of such views in a step.
    """

    radius: float
    each: int
    weight: float
    looks: int

    @property
    def apart(self) -> int:
        """Pixels between samples of such a view."""
        return min(MAX_STRIDE, 1 << max(0, math.floor(-math.log2(self.radius))))

    def number(self, frames: int) -> int:
        """Number of views at each depth: more frames can show more parts of the pupil besides the whole."""
        if self.radius >= 1:
            return self.each
        return round(self.each * min(max(1.0, frames / USUAL_FRAMES), MAX_PARTS_FACTOR))


# A few frames cannot show all views exactly. These weights gain most: halves and quarters gain nearly as much from 1/20
# each as from half of it, while the whole pupil loses decibels. Fewer parts improve themselves alone, and not the views
# between them (docs/theory.md, Many frames).
PARTS = (ViewKind(0.5, 4, 0.05, 2), ViewKind(0.25, 8, 0.05, 2))


def kinds_for(eyebox: float) -> tuple[ViewKind, ...]:
    """Kinds of views, whose parts of the pupil have `eyebox` times their weights in `PARTS`.

    Parameters
    ----------
    eyebox : float
        Factor from 0, the whole pupil alone, to 1.
    """
    parts = [replace(kind, weight=eyebox * kind.weight) for kind in PARTS] if eyebox else []
    return ViewKind(1.0, 1, 1 - sum(kind.weight for kind in parts), 1), *parts


def step_transforms(eyebox: float) -> float:
    """FFTs of the whole grid for each frame in a step: to its spectrum and back, and to some views and back."""
    return 2 + 2 * sum(kind.looks / kind.apart**2 for kind in kinds_for(eyebox))


def transforms(frames: int, eyebox: float) -> float:
    """FFTs of the whole grid for each frame of the views at one depth, for phases of a number of frames."""
    return sum(kind.number(frames) / kind.apart**2 for kind in kinds_for(eyebox))


@dataclass(frozen=True)
class ViewedVolume:
    """Volume that light of one wavelength is viewed in, and the grid of the light's fields.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of the fields.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    low, high : float
        Distances of the volume's ends from the fields' plane, meters.
    optics : Optics
        Optics with the stop; parts of the pupil are those of its `stop_circle`.
    places : (EvenSteps, EvenSteps), optional
        Rows and columns of the image between those of the fields, at which views of the whole pupil are sampled as far
        as FFTs allow. Default: those of the fields.
    """

    shape: tuple[int, int]
    pitch: Pitch
    wavelength: float
    low: float
    high: float
    optics: Optics = ON_AXIS
    places: Sequence[EvenSteps] | None = None

    @property
    def padded(self) -> tuple[int, int]:
        """Shape of spectra: with a guard band, and fast for FFTs."""
        farthest, guard = max(abs(self.low), abs(self.high)), OPTIMIZATION_GUARD
        if self.places is not None:  # colors apart may reach beyond the fields
            guard = max(guard, beyond(self.places, self.shape))
        shape = padded_shape(self.shape, self.pitch, self.wavelength, farthest, guard)
        padded = tuple(fast_multiple(size, MAX_STRIDE) for size in shape)
        return padded if self.places is None else commensurate(padded, self.places, MAX_STRIDE)

    @property
    def slope(self) -> float:
        """Slope of light at the rim of the stop's `stop_circle`, relative to that at its center."""
        return self.optics.stop_circle[2] * math.tan(math.asin(self.wavelength / (2 * coarsest(self.pitch))))

    @property
    def distances(self) -> np.ndarray:
        """Distances from the fields' plane at which views are focused, meters.

        They are evenly spaced, up to a depth of focus apart; farther in volumes deeper than `MAX_DEPTHS` of these.
        """
        count = 1 + math.ceil((self.high - self.low) * self.slope**2 / self.wavelength)
        return np.linspace(self.low, self.high, min(MAX_DEPTHS, max(2, count)))


class Views:
    """Views of light all over a volume: its waves in each view, and the adjoint of that.

    Views are at intervals of the depth of focus, through the whole pupil and parts of it. Light through half of the
    pupil has half the bandwidth, so that every second pixel samples it, and its FFTs take a quarter of the time.

    Parameters
    ----------
    volume : ViewedVolume
    frames : int
        Number of frames that are to show the views.
    seed : int
        Seed of the places of the parts of the pupil, and of their order over depths.
    eyebox : float
        Weight of the parts of the pupil, see `kinds_for`.
    on_wait : callable
        Called several times a second while views are computed; may raise `Cancelled`.
    on : array, optional
        Array whose library and device compute. Default: NumPy.

    Attributes
    ----------
    volume : ViewedVolume
    on_wait : callable
    kinds : list of (ViewKind, list of int)
        Each kind, and the numbers of its views; the whole pupil first.
    viewpoints : list of Viewpoint
        Viewpoint of each view.
    padded : (int, int)
        Shape of spectra.
    transforms : float
        FFTs of that shape for each frame, for all views.
    """

    def __init__(
        self,
        volume: ViewedVolume,
        frames: int,
        seed: int,
        eyebox: float = 1.0,
        on_wait: Callable[[], object] = lambda: None,
        on: Array = PROCESSOR,
    ) -> None:
        self.volume, self.padded, self.on_wait = volume, volume.padded, on_wait
        self.kinds: list[tuple[ViewKind, list[int]]] = [(kind, []) for kind in kinds_for(eyebox)]
        mask = volume.optics.stop_mask(self.padded, volume.pitch)
        space = FreeSpace(self.padded, volume.pitch, volume.wavelength, mask, on)
        self._transfers = TransferCache(space)
        self._views: list[_View] = []
        x, y, radius = volume.optics.stop_circle
        rng = np.random.default_rng(seed)
        self.transforms = 1 + len(volume.distances) * transforms(frames, eyebox)
        for kind, numbers in self.kinds:
            distances = np.repeat(volume.distances, kind.number(frames))
            for distance, part in zip(distances, _parts(kind.radius, len(distances), rng), strict=True):
                numbers.append(len(self._views))
                on_wait()
                if part is not None:
                    part = (radius * part[0] + x / 2, radius * part[1] - y / 2, radius * part[2])
                viewpoint = Viewpoint(float(distance), part)
                view = _View(viewpoint, kind.apart, self.padded, volume.pitch, volume.places, on)
                self._views.append(view)

    @property
    def viewpoints(self) -> list[Viewpoint]:
        """Viewpoint of each view."""
        return [view.viewpoint for view in self._views]

    def __len__(self) -> int:
        return len(self._views)

    def nearest_pixels(self, number: int) -> list[np.ndarray]:
        """Rows and columns of the fields' pixels that are nearest to the samples of a view."""
        view, shape, places = self._views[number], self.volume.shape, self.volume.places
        if places is not None and view.viewpoint.part is None:
            return [_nearest(line, n) for line, n in zip(places, shape, strict=True)]
        return [np.arange(0, n, view.apart) for n in shape]

    def spectra(self, light: Array) -> Array:
        """Return the padded spectra of light; both of shape (frame, y, x)."""
        spectra = arrays.empty((light.shape[0], *self.padded), light.dtype, light)
        for batch in self._transform_batches(spectra):
            spectra[batch, ...] = arrays.fft2(light[batch, ...], self.padded, workers=threads())
        return spectra

    def light(self, spectra: Array) -> Array:
        """Return the light of padded spectra, which are overwritten."""
        rows, columns = self.volume.shape
        for batch in self._transform_batches(spectra):
            spectra[batch, ...] = arrays.ifft2(spectra[batch, ...], overwrite=True, workers=threads())
        return spectra[:, :rows, :columns]

    def _transform_batches(self, spectra):
        """Yield slices of frames that are transformed at once, with a chance to cancel before each."""
        for batch in _batches(spectra.shape[0], spectra.shape[1:]):
            self.on_wait()
            yield batch

    def waves(self, spectra: Array, number: int) -> Array:
        """Return the waves in a view, on its own padded grid, of padded spectra; both of shape (frame, y, x)."""
        view = self._views[number]
        transfer = self._transfer(view)
        if view.transmission is None:
            waves = spectra * transfer
        else:
            waves = view.cut(spectra)
            waves *= transfer
        for batch in self._transform_batches(waves):
            waves[batch, ...] = arrays.ifft2(waves[batch, ...], overwrite=True, workers=threads())
        return waves

    def back(self, waves: Array, number: int, gradient: Array) -> None:
        """Add the adjoint of `waves`, times the spectrum's number of bins, to `gradient`; overwrites the waves."""
        view = self._views[number]
        for batch in self._transform_batches(waves):
            waves[batch, ...] = arrays.fft2(waves[batch, ...], overwrite=True, workers=threads())
        waves *= arrays.namespace(waves).conj(self._transfer(view)) * (1 / view.sample_ratio)
        view.put(waves, gradient)

    def _transfer(self, view):
        """Transfer function on the bins of a view; zero outside its part of the pupil."""
        whole = self._transfers(Viewpoint(view.viewpoint.distance))
        if view.transmission is None:
            return whole
        return view.cut(whole[None, ...])[0, ...] * view.transmission


class ViewTargets:
    """Target mean intensities of views.

    Parameters
    ----------
    views : Views
    on : array, optional
        Array whose library and device compute. Default: NumPy.

    Attributes
    ----------
    views : Views
    intensities : list of array, float32, shape (y, x)
        Target of each view.
    frames : int
        Number of frames added.
    """

    def __init__(self, views: Views, on: Array = PROCESSOR) -> None:
        self.views, self.frames = views, 0
        shapes = (tuple(map(len, views.nearest_pixels(number))) for number in range(len(views)))
        self.intensities = [arrays.zeros(shape, "float32", on) for shape in shapes]

    def add(self, fields: Array) -> None:
        """Add frames to the target means; fields of shape (frames, y, x)."""
        before, self.frames = self.frames, self.frames + fields.shape[0]
        for target in self.intensities:
            target *= float(before)
        for batch in _batches(fields.shape[0], self.views.padded):
            spectra = self.views.spectra(fields[batch, ...])
            for number, target in enumerate(self.intensities):
                target += intensity(self.views.waves(spectra, number), target.shape)
        for target in self.intensities:
            target *= 1 / self.frames

    def unvignette(self) -> None:
        """Brighten the targets near their edges as if the fields had none; once, after all frames.

        Part of the cone of light from a point near an edge misses the SLM. The part that meets it is brightened
        accordingly, through any part of the pupil, so that the whole pupil sees no dark border.
        """
        views, volume = self.views, self.views.volume
        reach = volume.slope / coarsest(volume.pitch)
        captured: dict[float, np.ndarray] = {}
        for number, viewpoint in enumerate(views.viewpoints):
            distance = viewpoint.distance
            if distance not in captured:
                radius = abs(distance) * reach
                captured[distance] = _captured_fraction(volume.shape, views.padded, radius, volume.pitch)
            fraction = captured[distance][np.ix_(*views.nearest_pixels(number))]
            self.intensities[number] /= arrays.like(fraction, self.intensities[number])

    def sharpen(self) -> None:
        """Deblur the targets through the whole stop; once, after `unvignette`.

        Frames of random phases show the image * abs(h)^2, where h is the transform of the stop. Optimized phases can
        show the image itself: the light of a frame is coherent, and its phases need not be random. The Richardson-Lucy
        iteration finds the image, and keeps it positive (W. H. Richardson, J. Opt. Soc. Am. 62, 55 (1972)).
        """
        volume = self.views.volume
        pitch = 1.0 if volume.places is not None else volume.pitch
        for number, viewpoint in enumerate(self.views.viewpoints):
            if viewpoint.part is None:
                self.views.on_wait()
                self.intensities[number] = _deblurred(self.intensities[number], volume.optics, pitch)


def intensity(waves: Array, shape: Sequence[int]) -> Array:
    """Sum over frames of the intensity of waves, without their padding.

    Parameters
    ----------
    waves : array, complex, shape (frame, y, x)
    shape : (int, int)
        Rows and columns without padding.
    """
    return arrays.total_intensity(waves[:, : shape[0], : shape[1]])


class _View:
    """A viewpoint and its bins of the spectrum.

    Attributes
    ----------
    apart : int
        Pixels between samples.
    sample_ratio : float
        Samples over bins of the padded spectrum.
    transmission : array or None
        Transmission of the part on its bins of the padded spectrum, times `sample_ratio`, in FFT order around the
        center of the part. At other places than the fields' also the phase that moves the first of them to the first
        sample. None for the whole pupil at the fields' own.
    """

    def __init__(self, viewpoint, apart, padded, pitch, places, on):
        self.viewpoint, self.apart = viewpoint, apart
        self.transmission, self.sample_ratio = None, 1 / apart**2
        mask = viewpoint.part_mask(padded, pitch)
        if mask is None and places is not None:
            self._shape = tuple(round(n / line.step) for n, line in zip(padded, places, strict=True))
            bins = [scipy.fft.fftfreq(m, 1 / m).round().astype(int) for m in self._shape]
            self._set_blocks(*(b % n for b, n in zip(bins, padded, strict=True)))
            self.sample_ratio = math.prod(self._shape) / math.prod(padded)
            turns = (b * (line.first / n) for b, line, n in zip(bins, places, padded, strict=True))
            down, across = (np.exp(2j * math.pi * turn) for turn in turns)
            self.transmission = (self.sample_ratio * down[:, None] * across).astype(np.complex64)
        if mask is not None:
            x, y, _ = viewpoint.part
            rows, columns = (
                (round(middle * (d / coarsest(pitch)) * n) + _bins(n, apart)) % n
                for middle, d, n in zip((y, x), axes(pitch), padded, strict=True)
            )
            self._shape = len(rows), len(columns)
            self._set_blocks(rows, columns)
            self.transmission = mask[np.ix_(rows, columns)] * np.float32(self.sample_ratio)
        if self.transmission is not None:
            self.transmission = arrays.like(self.transmission, on)

    def _set_blocks(self, rows, columns):
        self._blocks = [(a, b) for a in _runs(rows) for b in _runs(columns)]

    def cut(self, spectra):
        """Return the view's bins of spectra, shape (frame, y, x). Blocks are copied much faster than by index."""
        part = arrays.empty((spectra.shape[0], *self._shape), spectra.dtype, spectra)
        for (rows, to_rows), (columns, to_columns) in self._blocks:
            part[:, to_rows, to_columns] = spectra[:, rows, columns]
        return part

    def put(self, part, spectra):
        """Add the view's bins to those of spectra."""
        if self.transmission is None:
            spectra += part
            return
        for (rows, to_rows), (columns, to_columns) in self._blocks:
            spectra[:, rows, columns] += part[:, to_rows, to_columns]


def _deblurred(blurred, optics, pitch):
    """Image that incoherent light through a stop blurs to the given one, after `SHARPENING_STEPS`."""
    xp, (rows, columns) = arrays.namespace(blurred), blurred.shape
    shape = tuple(scipy.fft.next_fast_len(n + 2 * SHARPENING_MARGIN) for n in blurred.shape)
    wide = (np.pad(np.arange(n), SHARPENING_MARGIN, "symmetric") for n in blurred.shape)
    blurred = arrays.at(
        blurred, *(np.pad(m, (0, n - len(m)), "edge") for n, m in zip(shape, wide, strict=True))
    )
    kernel = np.abs(scipy.fft.ifft2(optics.stop_mask(shape, pitch))) ** 2
    transfer = scipy.fft.rfft2((kernel / kernel.sum()).astype(np.float32))
    transfer = arrays.like(transfer, blurred)

    def blur(image):
        spectrum = arrays.rfft2(image, workers=threads())
        return arrays.irfft2(spectrum * transfer, shape, overwrite=True, workers=threads())

    image, min_value = arrays.copied(blurred), 1e-6 * float(xp.mean(blurred)) or 1.0
    for _ in range(SHARPENING_STEPS):
        image *= blur(blurred / xp.maximum(blur(image), min_value))
    margin = SHARPENING_MARGIN
    return xp.maximum(image, 0.0)[margin : margin + rows, margin : margin + columns]


def _batches(frames, shape):
    """Slices of frames that are transformed at once."""
    size = max(1, BATCH_BYTES // (8 * math.prod(shape)))
    return [slice(first, min(first + size, frames)) for first in range(0, frames, size)]


def _bins(count, apart):
    """Lowest bins of a spectrum, in FFT order, that samples `apart` pixels apart represent."""
    return scipy.fft.fftfreq(count // apart, apart / count).round().astype(int)


def _nearest(line, count):
    """Pixels of a field nearest to the places of a line."""
    return np.clip(np.round(line.first + line.step * np.arange(line.count)), 0, count - 1).astype(int)


def _runs(numbers):
    """Runs of consecutive numbers, as slices of the values and of the indices."""
    ends = [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1).tolist(), len(numbers)]
    return [
        (slice(int(numbers[a]), int(numbers[b - 1]) + 1), slice(a, b))
        for a, b in zip(ends, ends[1:], strict=False)
    ]


def _captured_fraction(shape, padded, radius, pitch):
    """Fraction of each pixel's cone of light that meets the SLM, at least `MIN_CAPTURED_FRACTION`.

    The cone's `radius` at the SLM is in units of the larger pitch.
    """
    sizes = (d / coarsest(pitch) for d in axes(pitch))
    rows, columns = (scipy.fft.fftfreq(n, 1 / n) * size for n, size in zip(padded, sizes, strict=True))
    slm, cone = np.zeros((2, *padded), np.float32)
    slm[: shape[0], : shape[1]] = 1
    cone[np.hypot(columns[None, :], rows[:, None]) <= radius] = 1
    fraction = scipy.fft.irfft2(scipy.fft.rfft2(slm) * scipy.fft.rfft2(cone), padded) / cone.sum()
    return np.maximum(fraction[: shape[0], : shape[1]], MIN_CAPTURED_FRACTION)


def _parts(radius, count, rng):
    """Parts of the pupil for `Viewpoint`, evenly spread over it, in random order; None for the whole pupil.

    They lie on a spiral that turns by the golden angle (Vogel, Math. Biosci. 44, 179 (1979)).
    """
    if radius >= 1:
        return [None] * count
    places = rng.permutation(count) + 0.5
    aside = 0.5 * (1 - radius) * np.sqrt(places / count)
    angle = places * GOLDEN_ANGLE + 2 * math.pi * rng.random()
    return [
        (x, y, 0.5 * radius) for x, y in np.stack([aside * np.cos(angle), aside * np.sin(angle)], -1).tolist()
    ]
