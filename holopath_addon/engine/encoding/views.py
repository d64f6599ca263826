"""What light is to show from all over the volume and the pupil, each view on a grid as fine as its light asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..optics import ON_AXIS, Optics
from ..pixels import EvenSteps, Pitch, axes, coarsest
from ..scene.variants import threads
from ..waves import arrays
from ..waves.arrays import PROCESSOR, Array
from ..waves.pictures import Vantage
from ..waves.propagation import TEACHING_GUARD, FreeSpace, commensurate, padded_shape

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

MOST_DEPTHS = 20
COARSEST = 4  # pixels between samples of a view; FFT shapes are multiples of it
MOST_BYTES = 1 << 30  # of transfer functions that are kept
TOGETHER = 1 << 25  # bytes of spectra that are looked at together
LEAST_MET = 0.25  # of a cone of light, as in a corner: what would have to be brighter still stays dark
USUAL_FRAMES, MORE_PARTS = (
    8,
    3.0,
)  # parts of the pupil are as many times more as frames, but so many times at most
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True)
class ViewKind:
    """Views through parts of the pupil of one size.

    Attributes
    ----------
    radius : float
        Of the part, of the pupil's; 1 is the whole pupil.
    each : int
        At each depth, for up to eight frames; see `number`.
    weight : float
        Of their mean loss; the weights of all kinds sum to 1.
    looks : int
        At such views in a step.
    """

    radius: float
    each: int
    weight: float
    looks: int

    @property
    def apart(self) -> int:
        """Pixels between samples of such a view."""
        return min(COARSEST, 1 << max(0, math.floor(-math.log2(self.radius))))

    def number(self, frames: int) -> int:
        """At each depth: the more frames, the more parts they can show besides the whole."""
        if self.radius >= 1:
            return self.each
        return round(self.each * min(max(1.0, frames / USUAL_FRAMES), MORE_PARTS))


SHARPER = 10  # steps of `Views.sharpen`
BESIDE = 16  # pixels that pictures are continued beyond their border for it
# A few frames cannot show all views exactly. These weights are worth most: halves and quarters gain nearly as much from
# a twentieth each as from half of it, while the whole pupil loses decibels. With fewer parts these alone get better,
# and not what lies between them (docs/theory.md, Many frames).
PARTS = (ViewKind(0.5, 4, 0.05, 2), ViewKind(0.25, 8, 0.05, 2))


def kinds_for(eyebox: float) -> tuple[ViewKind, ...]:
    """Kinds of views where parts of the pupil count `eyebox` times their weights in `PARTS`; none of them at 0.

    Parameters
    ----------
    eyebox : float
        From 0, the whole pupil alone, to 1.
    """
    parts = [replace(kind, weight=eyebox * kind.weight) for kind in PARTS] if eyebox else []
    return ViewKind(1.0, 1, 1 - sum(kind.weight for kind in parts), 1), *parts


def step_transforms(eyebox: float) -> float:
    """FFTs of the whole grid that a step takes of each frame: to its spectrum and back, and to some views and back."""
    return 2 + 2 * sum(kind.looks / kind.apart**2 for kind in kinds_for(eyebox))


def transforms(frames: int, eyebox: float) -> float:
    """How many of the whole grid the views at one depth take of each frame, for phases of so many frames."""
    return sum(kind.number(frames) / kind.apart**2 for kind in kinds_for(eyebox))


class Views:
    """Mean intensities that are wanted, in one wavelength.

    At depths a depth of focus apart, through the whole pupil and parts of it. Light through half of the pupil
    has half the bandwidth, so that every second pixel holds it, and its FFTs take a quarter of the time.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the fields.
    pitch : float or (float, float)
    wavelength : float
        Metres.
    low, high : float
        Ends of the volume, from the fields' plane, metres.
    frames : int
        That are to show them.
    seed : int
        Of the order of the parts of the pupil over depths.
    eyebox : float
        Weight of the parts of the pupil, see `kinds_for`.
    optics : Optics
        Through whose stop all is seen; parts of the pupil are those of its `opening`.
    places : (EvenSteps, EvenSteps), optional
        Rows and columns of the picture between those of the fields, at which the whole pupil shows it, but for how far
        FFTs allow that. Default: the fields' own.
    heard : callable
        Called several times a second while views are looked at; may raise `Cancelled`.
    on : array, optional
        In whose namespace views are looked at, where that one lies. Default: NumPy's.

    Attributes
    ----------
    kinds : list of (ViewKind, list of int)
        Each kind, and the numbers of its views; the whole pupil first.
    wanted : list of array, float32, shape (y, x)
        Intensity of each view.
    vantages : list of Vantage
        Of each view.
    padded : (int, int)
        Shape of spectra.
    transforms : float
        FFTs of that shape that a look at all views takes of each frame.
    frames : int
        That are counted.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        pitch: Pitch,
        wavelength: float,
        low: float,
        high: float,
        frames: int,
        seed: int,
        eyebox: float = 1.0,
        optics: Optics = ON_AXIS,
        places: Sequence[EvenSteps] | None = None,
        heard: Callable[[], object] = lambda: None,
        on: Array = PROCESSOR,
    ) -> None:
        self.shape, self._places, self._heard = shape, places, heard
        farthest = max(abs(low), abs(high))
        self.padded = tuple(map(_fast, padded_shape(shape, pitch, wavelength, farthest, TEACHING_GUARD)))
        if places is not None:
            self.padded = commensurate(self.padded, places, COARSEST)
        self.kinds: list[tuple[ViewKind, list[int]]] = [(kind, []) for kind in kinds_for(eyebox)]
        self.wanted = []
        self._optics = optics
        self._space = FreeSpace(self.padded, pitch, wavelength, optics.passes(self.padded, pitch), on)
        self._views: list[_View] = []
        self._transfers: dict[float, Array] = {}
        self.frames = 0
        x, y, radius = optics.opening
        slope = radius * math.tan(math.asin(wavelength / (2 * coarsest(pitch))))
        rng = np.random.default_rng(seed)
        self._reach, self._pitch = slope / coarsest(pitch), pitch
        depths = min(MOST_DEPTHS, max(2, 1 + math.ceil((high - low) * slope**2 / wavelength)))
        self.transforms = 1 + depths * transforms(frames, eyebox)
        for kind, numbers in self.kinds:
            each = kind.number(frames)
            distances = np.repeat(np.linspace(low, high, depths), each)
            for distance, part in zip(distances, _parts(kind.radius, each * depths, rng), strict=True):
                numbers.append(len(self._views))
                heard()
                if part is not None:
                    part = (radius * part[0] + x / 2, radius * part[1] - y / 2, radius * part[2])
                vantage = Vantage(float(distance), part)
                self._views.append(_View(vantage, kind.apart, self.padded, pitch, places, on))
        for view in self._views:
            size = tuple(-(-n // view.apart) for n in shape)
            if places is not None and view.vantage.part is None:
                size = tuple(line.count for line in places)
            self.wanted.append(arrays.zeros(size, "float32", on))

    @property
    def vantages(self) -> list[Vantage]:
        return [view.vantage for view in self._views]

    def __len__(self) -> int:
        return len(self._views)

    def add(self, fields: Array) -> None:
        """Count frames towards the wanted means; fields of shape (frames, y, x)."""
        before, self.frames = self.frames, self.frames + fields.shape[0]
        for wanted in self.wanted:
            wanted *= float(before)
        for some in _parts_of(fields.shape[0], self.padded):
            spectra = self.spectra(fields[some, ...])
            for number, wanted in enumerate(self.wanted):
                wanted += intensity(self.waves(spectra, number), wanted.shape)
        for wanted in self.wanted:
            wanted *= 1 / self.frames

    def unvignette(self) -> None:
        """Want views as bright near their edges as if the fields had none; once, when all frames are counted.

        Of the cone of light that a point near an edge sends out, a part passes beside the SLM. What meets it is wanted
        as much brighter, through any part of the pupil, so that the whole of it sees no dark border.
        """
        met: dict[float, np.ndarray] = {}
        for number, view in enumerate(self._views):
            distance, apart = view.vantage.distance, view.apart
            if distance not in met:
                met[distance] = _met(self.shape, self.padded, abs(distance) * self._reach, self._pitch)
            rows, columns = (np.arange(0, n, apart) for n in self.shape)
            if self._places is not None and view.vantage.part is None:
                rows, columns = map(_nearest, self._places, self.shape)
            self.wanted[number] /= arrays.like(met[distance][np.ix_(rows, columns)], self.wanted[number])

    def sharpen(self) -> None:
        """Want what a thin lens would show through the stop instead of what it blurs; once, after `unvignette`.

        Frames of random phases show the picture * abs(h)^2 through the whole of the stop, with h the transform of what
        is open. Phases can do better: the light of a frame is coherent, and its phases need not be random. The picture
        is found by the iteration of Richardson and Lucy, which keeps it positive (W. H. Richardson, J. Opt. Soc. Am.
        62, 55 (1972)).
        """
        for number, view in enumerate(self._views):
            if view.vantage.part is None:
                self._heard()
                own = 1.0 if self._places is not None else self._pitch
                self.wanted[number] = _deblurred(self.wanted[number], self._optics, own)

    def spectra(self, light: Array) -> Array:
        """Padded spectra of light; both of shape (frame, y, x)."""
        spectra = arrays.empty((light.shape[0], *self.padded), light.dtype, light)
        for some in self._few(spectra):
            spectra[some, ...] = arrays.fft2(light[some, ...], self.padded, workers=threads())
        return spectra

    def light(self, spectra: Array) -> Array:
        """The inverse of `spectra`; overwrites them."""
        for some in self._few(spectra):
            spectra[some, ...] = arrays.ifft2(spectra[some, ...], overwrite=True, workers=threads())
        return spectra[:, : self.shape[0], : self.shape[1]]

    def _few(self, spectra):
        """Slices of frames that are transformed at once, with a look at who may want to cancel before each."""
        for some in _parts_of(spectra.shape[0], spectra.shape[1:]):
            self._heard()
            yield some

    def waves(self, spectra: Array, number: int) -> Array:
        """The waves in a view, on its own padded grid, of padded spectra; both of shape (frame, y, x)."""
        view = self._views[number]
        transfer = self._transfer(view)
        if view.passes is None:
            part = spectra * transfer
        else:
            part = view.cut(spectra)
            part *= transfer
        for some in self._few(part):
            part[some, ...] = arrays.ifft2(part[some, ...], overwrite=True, workers=threads())
        return part

    def back(self, waves: Array, number: int, gradient: Array) -> None:
        """The adjoint of `waves` times the spectrum's number of bins, added to `gradient`; overwrites the waves."""
        view = self._views[number]
        for some in self._few(waves):
            waves[some, ...] = arrays.fft2(waves[some, ...], overwrite=True, workers=threads())
        waves *= arrays.namespace(waves).conj(self._transfer(view)) * (1 / view.share)
        view.put(waves, gradient)

    def _transfer(self, view):
        """From the spectrum's bins that a view has to its own spectrum; zero beyond its part of the pupil."""
        distance = view.vantage.distance
        whole = self._transfers.get(distance)
        if whole is None:
            whole = self._space(distance)
            if (len(self._transfers) + 1) * 8 * math.prod(self.padded) <= MOST_BYTES:
                self._transfers[distance] = whole
        if view.passes is None:
            return whole
        return view.cut(whole[None, ...])[0, ...] * view.passes


def intensity(waves: Array, shape: Sequence[int]) -> Array:
    """Sum over frames, of the part of waves that is not padding."""
    return arrays.total_intensity(waves[:, : shape[0], : shape[1]])


class _View:
    """A vantage and its bins of the spectrum.

    Attributes
    ----------
    apart : int
        Pixels between samples.
    share : float
        Samples over bins of the padded spectrum.
    passes : array or None
        What the part lets through of its bins of the padded spectrum, times `share`; in FFT order around the middle of
        the part. At other places than the fields' own also what brings the first of them to the first sample. None for
        the whole pupil at the fields' own.
    """

    def __init__(self, vantage, apart, padded, pitch, places, on):
        self.vantage, self.apart, self.passes, self.share = vantage, apart, None, 1 / apart**2
        passes = vantage.passes(padded, pitch)
        if passes is None and places is not None:
            self._shape = tuple(round(n / line.step) for n, line in zip(padded, places, strict=True))
            bins = [scipy.fft.fftfreq(m, 1 / m).round().astype(int) for m in self._shape]
            self._set_blocks(*(b % n for b, n in zip(bins, padded, strict=True)))
            self.share = math.prod(self._shape) / math.prod(padded)
            turns = (b * (line.first / n) for b, line, n in zip(bins, places, padded, strict=True))
            down, across = (np.exp(2j * math.pi * turn) for turn in turns)
            self.passes = (self.share * down[:, None] * across).astype(np.complex64)
        if passes is not None:
            x, y, _ = vantage.part
            rows, columns = (
                (round(middle * (d / coarsest(pitch)) * n) + _bins(n, apart)) % n
                for middle, d, n in zip((y, x), axes(pitch), padded, strict=True)
            )
            self._shape = len(rows), len(columns)
            self._set_blocks(rows, columns)
            self.passes = passes[np.ix_(rows, columns)] * np.float32(self.share)
        if self.passes is not None:
            self.passes = arrays.like(self.passes, on)

    def _set_blocks(self, rows, columns):
        self._blocks = [(a, b) for a in _runs(rows) for b in _runs(columns)]

    def cut(self, spectra):
        """Its part's bins of spectra, shape (frame, y, x). Blocks are copied much faster than by index."""
        part = arrays.empty((spectra.shape[0], *self._shape), spectra.dtype, spectra)
        for (rows, to_rows), (columns, to_columns) in self._blocks:
            part[:, to_rows, to_columns] = spectra[:, rows, columns]
        return part

    def put(self, part, spectra):
        """Add its bins to those of spectra."""
        if self.passes is None:
            spectra += part
            return
        for (rows, to_rows), (columns, to_columns) in self._blocks:
            spectra[:, rows, columns] += part[:, to_rows, to_columns]


def _deblurred(blurred, optics, pitch):
    """The picture of which incoherent light through a stop makes this, as far as `SHARPER` steps find it."""
    xp, (rows, columns) = arrays.namespace(blurred), blurred.shape
    shape = tuple(scipy.fft.next_fast_len(n + 2 * BESIDE) for n in blurred.shape)
    wide = (np.pad(np.arange(n), BESIDE, "symmetric") for n in blurred.shape)
    blurred = arrays.at(
        blurred, *(np.pad(m, (0, n - len(m)), "edge") for n, m in zip(shape, wide, strict=True))
    )
    kernel = np.abs(scipy.fft.ifft2(optics.passes(shape, pitch))) ** 2
    transfer = scipy.fft.rfft2((kernel / kernel.sum()).astype(np.float32))
    transfer = arrays.like(transfer, blurred)

    def blur(picture):
        spectrum = arrays.rfft2(picture, workers=threads())
        return arrays.irfft2(spectrum * transfer, shape, overwrite=True, workers=threads())

    picture, least = arrays.copied(blurred), 1e-6 * float(xp.mean(blurred))
    for _ in range(SHARPER):
        picture *= blur(blurred / xp.maximum(blur(picture), least or 1.0))
    return xp.maximum(picture, 0.0)[BESIDE : BESIDE + rows, BESIDE : BESIDE + columns]


def _parts_of(frames, shape):
    """Slices of frames that are looked at together."""
    together = max(1, TOGETHER // (8 * math.prod(shape)))
    return [slice(first, min(first + together, frames)) for first in range(0, frames, together)]


def _bins(count, apart):
    """The lowest bins of a spectrum, in FFT order, that samples so many pixels apart hold."""
    return scipy.fft.fftfreq(count // apart, apart / count).round().astype(int)


def _nearest(line, count):
    """Pixels of a field that are nearest to the places of a line."""
    return np.clip(np.round(line.first + line.step * np.arange(line.count)), 0, count - 1).astype(int)


def _runs(numbers):
    """Where consecutive numbers begin and end, as slices of what they count and of themselves."""
    ends = [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1).tolist(), len(numbers)]
    return [
        (slice(int(numbers[a]), int(numbers[b - 1]) + 1), slice(a, b))
        for a, b in zip(ends, ends[1:], strict=False)
    ]


def _met(shape, padded, radius, pitch):
    """Share of each pixel's cone of light that meets the SLM; `LEAST_MET` at least.

    There the cone is `radius` of the larger pitch wide.
    """
    sizes = (d / coarsest(pitch) for d in axes(pitch))
    rows, columns = (scipy.fft.fftfreq(n, 1 / n) * size for n, size in zip(padded, sizes, strict=True))
    slm, cone = np.zeros((2, *padded), np.float32)
    slm[: shape[0], : shape[1]] = 1
    cone[np.hypot(columns[None, :], rows[:, None]) <= radius] = 1
    share = scipy.fft.irfft2(scipy.fft.rfft2(slm) * scipy.fft.rfft2(cone), padded) / cone.sum()
    return np.maximum(share[: shape[0], : shape[1]], LEAST_MET)


def _parts(radius, count, rng):
    """As many parts of the pupil for `Vantage`, evenly spread over it, in random order; None for all of it.

    A spiral that turns by the golden angle (Vogel, Math. Biosci. 44, 179 (1979)).
    """
    if radius >= 1:
        return [None] * count
    places = rng.permutation(count) + 0.5
    aside = 0.5 * (1 - radius) * np.sqrt(places / count)
    angle = places * GOLDEN_ANGLE + 2 * math.pi * rng.random()
    return [
        (x, y, 0.5 * radius) for x, y in np.stack([aside * np.cos(angle), aside * np.sin(angle)], -1).tolist()
    ]


def _fast(count):
    """The next multiple of `COARSEST` that FFTs are fast on."""
    count = -(-count // COARSEST) * COARSEST
    while scipy.fft.next_fast_len(count) != count:
        count += COARSEST
    return count
