"""Angular spectrum propagation between parallel planes.

Sign convention exp(-i omega t): propagation forward by z multiplies a plane wave by exp(+i kz z).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.fft

from ..errors import InvalidInput
from ..memory import installed
from ..pixels import EvenSteps, Pitch, axes, coarsest, frequencies
from ..scene.variants import threads
from . import arrays
from .arrays import PROCESSOR, Array

BLOCK = 1 << 18  # numbers that are computed at a time
MAX_MEMORY_FRACTION = 1 / 16  # of the machine's memory for fields that are propagated at once
# Pixels of guard band around light of a modulator, which spreads farther than its steepest waves walk, so that little
# of it wraps around: for the optimization of phases, and for the evaluation of images. The rest falls slowly, as band
# limits are sharp. Of random phases at 256 x 256 it is 2e-3 of the energy without a guard band, 5e-4 and 1.6e-4 with
# these.
OPTIMIZATION_GUARD, EVALUATION_GUARD = 96, 256
INFRARED = 1.6e-6  # meters; shorter than the pitch of most panels
WHOLE = 1e-8  # deviation, in pixels of a grid, up to which a step divides the grid
BYTES = 40  # for a pixel of a padded grid: spectrum, transfer function, their product, and memory of FFTs


def circular_band(shape: Sequence[int], pitch: Pitch = 1.0) -> np.ndarray:
    """Mask of the FFT bins that a pixel grid records at every azimuth (paper section 4.3, Omega_f).

    They are within the circle of radius 1 / (2 pitch), of the larger pitch.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    pitch : float or (float, float)
        Pixel pitch; only the ratio of its two values matters.
    """
    fy, fx = frequencies(shape, pitch)
    return fx[None, :] ** 2 + fy[:, None] ** 2 <= 0.25


def transfer_function(
    shape: Sequence[int],
    pitch: Pitch,
    wavelength: float,
    distance: float,
    band: str = "circular",
    tilt: Sequence[float] = (0.0, 0.0),
    on: Array = PROCESSOR,
) -> Array:
    """Carrier-free transfer function exp(i z (kz - k)) of free space.

    The phase is computed as -(2 pi z / wavelength) u / (1 + sqrt(1 - u)), since 2 pi z sqrt(1/wavelength^2 - f^2) loses
    digits. Frequencies that are not `representable` are zero.

    Parameters
    ----------
    shape : (int, int)
        Padded rows and columns.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength, distance : float
        Meters; the distance may be negative.
    band : {'circular', 'full'}
        Keep the recordable circle, or every wave that is not evanescent.
    tilt : (float, float)
        Sines to +x and +y of a plane wave, relative to which the grid's frequencies are measured.
    on : array, optional
        Array whose library and device compute. Default: NumPy.

    Returns
    -------
    array, complex64, `shape`, in FFT order
    """
    pixel = coarsest(pitch)
    scale, turns = float((wavelength / pixel) ** 2), float(-2 * math.pi / wavelength * distance)
    lines = (
        f + pixel / wavelength * sine for f, sine in zip(frequencies(shape, pitch), tilt[::-1], strict=True)
    )
    down, across = (arrays.like(line**2, on) for line in lines)
    rows, columns = (arrays.like(each, on) for each in representable(shape, pitch, wavelength, distance))
    transfer, xp = arrays.empty(shape, "complex64", on), arrays.namespace(on)
    height = max(1, BLOCK // shape[1]) if xp is np else shape[0]

    def fill(first):  # in double precision, a few rows at a time
        part = slice(first, first + height)
        square = across[None, :] + down[part, None]
        u = scale * square
        keep = square <= 0.25 if band == "circular" else u < 1
        keep &= rows[part, None] & columns[None, :]
        phase = turns * u / (1 + xp.sqrt(xp.maximum(1 - u, 0)))
        # without whole turns, removed in double precision, the phase is exact to 1e-6 rad in single precision
        phase = arrays.as_type(xp.remainder(phase, 2 * math.pi), "float32")
        cosine, sine = (xp.where(keep, wave(phase), 0.0) for wave in (xp.cos, xp.sin))
        arrays.set_parts(transfer[part, :], cosine, sine)

    parts = range(0, shape[0], height)
    if len(parts) == 1:
        fill(0)
        return transfer
    with ThreadPoolExecutor(min(threads(), len(parts))) as pool:
        list(pool.map(fill, parts))
    return transfer


def phase_retardation(shape: Sequence[int], pitch: Pitch, wavelength: float) -> np.ndarray:
    """Phase retardation of each plane wave against the carrier, k - kz, radians per meter, in FFT order.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    """
    fy, fx = (wavelength * scipy.fft.fftfreq(n, d) for n, d in zip(shape, axes(pitch), strict=True))
    u = fx[None, :] ** 2 + fy[:, None] ** 2  # squares of sines
    return (2 * math.pi / wavelength) * u / (1 + np.sqrt(np.maximum(1 - u, 0)))


class FreeSpace:
    """`transfer_function` at many distances on one grid, in single precision: exact to 1e-4 rad up to 0.1 m.

    Parameters
    ----------
    shape : (int, int)
        Padded rows and columns.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    passes : numpy.ndarray of bool, optional
        FFT bins that pass a stop, see `Optics.stop_mask`. Default: all of the band.
    on : array, optional
        Array whose library and device compute. Default: NumPy.
    """

    def __init__(
        self,
        shape: Sequence[int],
        pitch: Pitch,
        wavelength: float,
        passes: np.ndarray | None = None,
        on: Array = PROCESSOR,
    ) -> None:
        self.shape, self.pitch, self.wavelength = shape, pitch, wavelength
        self.band = circular_band(shape, pitch) if passes is None else passes
        self._retardation = arrays.like(phase_retardation(shape, pitch, wavelength), on, "float32")
        self._passes = arrays.mask(self.band, on)

    def __call__(self, distance: float) -> Array:
        """Return the transfer function of a distance in meters, complex64, in FFT order."""
        transfer = arrays.phasors(float(-distance) * self._retardation)
        transfer *= self._passes
        for axis, within in enumerate(representable(self.shape, self.pitch, self.wavelength, distance)):
            if not within.all():
                within = arrays.mask(within, transfer)
                transfer *= within[:, None] if axis == 0 else within[None, :]
        return transfer


def representable(shape: Sequence[int], pitch: Pitch, wavelength: float, distance: float) -> list[np.ndarray]:
    """Masks of the FFT frequencies of each axis at which the sampled transfer function has no aliases.

    Matsushima and Shimobaba, Opt. Express 17, 19662 (2009), eq. 21.

    Parameters
    ----------
    shape : (int, int)
        Padded rows and columns.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength, distance : float
        Meters.
    """
    within = []
    for n, d in zip(shape, axes(pitch), strict=True):
        limit = 1 / (wavelength * math.hypot(2 * distance / (n * d), 1))
        within.append(np.abs(scipy.fft.fftfreq(n, d)) <= limit)
    return within


def padded_shape(
    shape: Sequence[int], pitch: Pitch, wavelength: float, distance: float, guard: int = 0
) -> tuple[int, int]:
    """Smallest fast FFT shape on which a window is propagated without wrap-around.

    A wave of the steepest recordable slope walks s = tan(asin(wavelength / 2 pitch)) |distance|; the grid must hold the
    window and one such walk, and the kernel's two walks. Light that a sharp band limit spreads farther falls with the
    third power of the distance; the guard band holds most of it.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the window.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength, distance : float
        Meters.
    guard : int
        Pixels of guard band, `OPTIMIZATION_GUARD` or `EVALUATION_GUARD` for light of a modulator.
    """
    spread = math.tan(math.asin(wavelength / (2 * coarsest(pitch)))) * abs(distance)
    walks = [math.ceil(spread / d) + 8 for d in axes(pitch)]
    return tuple(
        scipy.fft.next_fast_len(max(n + walk + guard, 2 * walk)) for n, walk in zip(shape, walks, strict=True)
    )


def grid_bytes(shape: Sequence[int], pitch: Pitch, wavelength: float, distance: float, guard: int = 0) -> int:
    """Memory for the propagation of one field, bytes; see `padded_shape` for the parameters."""
    return BYTES * math.prod(padded_shape(shape, pitch, wavelength, distance, guard))


def stack_bytes(grid: int, fields: int) -> int:
    """Memory of `propagate_stack`, bytes.

    Parameters
    ----------
    grid : int
        Bytes for a field's grid, see `grid_bytes`.
    fields : int
        Number of fields.
    """
    return grid * _count_at_once(grid, fields)


def _count_at_once(grid, fields):
    """Number of fields that are propagated at once: 1 if the machine's memory is unknown."""
    return max(1, min(threads(), fields, int(MAX_MEMORY_FRACTION * (installed() or 0) / grid)))


def propagate_stack(
    fields: Array, transfer: Array, places: Sequence[EvenSteps] | None = None
) -> Iterator[Array]:
    """Propagate a stack of fields by a transfer function, several at once on the processor.

    Parameters
    ----------
    fields : array, shape (field, y, x)
        A field must not change before it is yielded.
    transfer : array, complex64
        Transfer function on a grid of `padded_shape`.
    places : (EvenSteps, EvenSteps), optional
        Rows and columns at which the results are sampled, see `sampled`. Default: those of the fields.

    Yields
    ------
    array, complex64, shape (y, x)
        The propagated fields, in order.
    """
    each = (fields[n, ...] for n in range(fields.shape[0]))

    def one(field, workers):
        waves = spectrum(field, transfer.shape, workers)
        waves *= transfer
        if places is not None:
            return sampled(waves, places)
        return field_of(waves, field.shape, workers, overwrite=True)

    count = _count_at_once(BYTES * math.prod(transfer.shape), fields.shape[0])
    if count == 1 or not isinstance(fields, np.ndarray):
        yield from (one(field, threads()) for field in each)
        return
    with ThreadPoolExecutor(count) as pool:
        results = deque()
        try:
            for field in each:
                results.append(pool.submit(one, field, 1))
                if len(results) > count:
                    yield results.popleft().result()
            while results:
                yield results.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def spectrum(field: Array, shape: Sequence[int], workers: int | None = None) -> Array:
    """FFT of the last two axes, zero-padded, complex64. Rows of zeros are not transformed.

    Parameters
    ----------
    field : array, complex, shape (..., y, x)
    shape : (int, int)
        Padded rows and columns.
    workers : int, optional
        Number of threads. Default: all.
    """
    field, workers = arrays.as_type(arrays.known(field), "complex64"), workers or threads()
    rows = arrays.fft(field, shape[1], workers=workers)
    if shape[0] > field.shape[-2]:
        padded = arrays.zeros((*field.shape[:-2], *shape), "complex64", field)
        padded[..., : field.shape[-2], :] = rows
        rows = padded
    return arrays.fft(rows, axis=-2, overwrite=True, workers=workers)


def filtered(field: Array, response: Array) -> Array:
    """Multiply the spectrum of a field, over the last two axes, by `response`, without padding."""
    return arrays.ifft2(arrays.fft2(field, workers=threads()) * response, workers=threads())


def field_of(
    spectrum_: Array, shape: Sequence[int], workers: int | None = None, overwrite: bool = False
) -> Array:
    """Inverse of `spectrum`, cropped to a window, whose rows alone are transformed.

    Parameters
    ----------
    spectrum_ : array, complex64, shape (..., y, x)
    shape : (int, int)
        Rows and columns of the window.
    workers : int, optional
        Number of threads. Default: all.
    overwrite : bool
        Whether the spectrum's memory may be used.
    """
    workers = workers or threads()
    columns = arrays.ifft(spectrum_, axis=-2, overwrite=overwrite, workers=workers)
    rows = arrays.ifft(columns[..., : shape[0], :], overwrite=True, workers=workers)
    return rows[..., : shape[1]]


def commensurate(shape: Sequence[int], places: Sequence[EvenSteps], multiple: int = 1) -> tuple[int, int]:
    """FFT shape, up to 1/8 larger, that the steps of places divide, so that `sampled` is two FFTs; or the closest one.

    Parameters
    ----------
    shape : (int, int)
        Minimum rows and columns.
    places : (EvenSteps, EvenSteps)
        Rows and columns of the samples.
    multiple : int
        Divisor of the rows and columns.

    Returns
    -------
    (int, int)
    """
    best = []
    for min_length, line in zip(shape, places, strict=True):
        first = -(-min_length // multiple) * multiple
        lengths = range(first, first + max(first // 8, 64 * multiple), multiple)
        whole = [n for n in lengths if _off(n, line.step) < WHOLE]
        best.append(
            min(whole, key=lambda n, step=line.step: _work(n) + _work(round(n / step)), default=0)
            or min(lengths, key=lambda n, step=line.step: _off(n, step))
        )
    return tuple(best)


def fast_multiple(count: int, factor: int) -> int:
    """The next multiple of a factor that has a fast FFT; the number itself for the factor 1."""
    if factor == 1:
        return count
    count = -(-count // factor) * factor
    while scipy.fft.next_fast_len(count) != count:
        count += factor
    return count


def _off(count, step):
    """Deviation of a step, in its units, from the nearest one that divides a length."""
    return abs(count / step - round(count / step)) / count


def _work(count):
    """Rough cost of an FFT of a length."""
    return count if scipy.fft.next_fast_len(count) == count else 3 * count


def sampled(spectrum_: Array, places: Sequence[EvenSteps]) -> Array:
    """Inverse of `spectrum` at places that may lie between the pixels, exact for band-limited fields.

    The sum of waves at evenly spaced places is an FFT of another length if their steps divide the grid, and otherwise a
    chirp-z transform along each axis (Rabiner, Schafer and Rader, IEEE Trans. Audio Electroacoust. 17, 86 (1969)).

    Parameters
    ----------
    spectrum_ : array, complex64, shape (y, x)
        Spectrum in FFT order.
    places : (EvenSteps, EvenSteps)
        Rows and columns of the samples.

    Returns
    -------
    array, complex64, of the samples' rows and columns
    """
    rows, columns = places
    return _at_places(_at_places(spectrum_, columns).T, rows).T


def resized(spectra: Array, count: int, axis: int) -> Array:
    """Crop or zero-pad a spectrum in FFT order along an axis to its `count` lowest frequencies."""
    shape, at = list(spectra.shape), (slice(None),) * axis
    n, shape[axis] = shape[axis], count
    wide = arrays.zeros(shape, spectra.dtype, spectra)
    low, high = min(n, count) // 2, (min(n, count) + 1) // 2
    wide[(*at, slice(0, high), ...)] = spectra[(*at, slice(0, high), ...)]
    wide[(*at, slice(count - low, count), ...)] = spectra[(*at, slice(n - low, n), ...)]
    return wide


def _at_places(spectra, line):
    """Sample the last axis of spectra at the places of a line."""
    n = spectra.shape[1]
    if _off(n, line.step) >= WHOLE:
        return _by_chirps(spectra, line)
    m = round(n / line.step)
    turn = phasor(scipy.fft.fftfreq(n, 1 / n) * (line.first / n)) * (m / n)
    wide = resized(spectra, m, 1)
    wide *= resized(arrays.like(turn, spectra, "complex64"), m, 0)
    return arrays.ifft(wide, overwrite=True, workers=threads())[:, : line.count]


def _by_chirps(spectra, line):
    """Sample the last axis at any places, in double precision, some rows at a time."""
    (rows, n), m, xp = spectra.shape, line.count, arrays.namespace(spectra)
    bend, low = line.step / n / 2, n // 2  # bins are counted from the lowest frequency
    j, k, apart = (np.arange(count) for count in (n, m, scipy.fft.next_fast_len(n + m - 1)))
    apart -= len(apart) * (apart >= m)
    first = phasor(bend * j**2 + line.first / n * j)
    last = phasor(bend * k**2 - (line.first + line.step * k) * low / n) / n
    between = scipy.fft.fft(phasor(-bend * apart**2))
    chirps = [arrays.like(each, spectra) for each in (first, between, last)]
    out, height = arrays.empty((rows, m), "complex64", spectra), max(1, BLOCK // n)
    for start in range(0, rows, height):
        part = slice(start, min(start + height, rows))
        waves = bluestein(xp.fft.fftshift(spectra[part, :], axes=1), *chirps)
        out[part, :] = arrays.as_type(waves, "complex64")
    return out


def bluestein(fields: Array, first: Array, between: Array, last: Array) -> Array:
    """Chirp-z transform along the last axis (L. I. Bluestein, IEEE Trans. Audio Electroacoust. 18, 451 (1970)).

    Since 2 j k = j^2 + k^2 - (j - k)^2, fields are multiplied by a chirp, convolved with a second one, and multiplied
    by a third.

    Parameters
    ----------
    fields : array, complex, shape (..., n)
    first, last : array, complex
        The first and the third chirp.
    between : array, complex
        Spectrum of the second chirp.
    """
    waves = arrays.fft(fields * first, between.shape[0])
    waves *= between
    return arrays.ifft(waves, overwrite=True)[..., : last.shape[0]] * last


def phasor(turns: np.ndarray) -> np.ndarray:
    """Phasor exp(2 pi i turns)."""
    return np.exp(2j * math.pi * np.mod(turns, 1.0))


def carrier(wavelength: float, distance: float) -> complex:
    """Carrier exp(i k z), which `transfer_function` leaves out, in the precision of complex64."""
    return complex(np.complex64(np.exp(2j * math.pi * math.fmod(distance / wavelength, 1.0))))


def propagate(
    field: Array, pitch: Pitch, wavelength: float, distance: float, band: str = "circular"
) -> Array:
    """Propagate fields by a distance along z with the band-limited angular spectrum method.

    Parameters
    ----------
    field : array, complex, shape (..., y, x)
        Fields on a grid of `pitch`, zero outside; an array of NumPy, CuPy, PyTorch or another library of the Array API
        standard.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    distance : float
        Meters; backward if negative.
    band : {'circular', 'full'}
        See `transfer_function`.

    Returns
    -------
    array, complex64, same shape
        The propagated fields, of the same library and on the same device.

    Raises
    ------
    InvalidInput
        For arguments in the order of version 0.2, whose distance came first.
    """
    if np.ndim(wavelength) or 0 < distance < wavelength > INFRARED:
        raise InvalidInput(
            f"Expected propagate(field, pitch, wavelength, distance) with one wavelength, got a pitch of {pitch}, a "
            f"wavelength of {wavelength} and a distance of {distance} m. Put the distance last: until version 0.2 it "
            "came first."
        )
    field = arrays.known(field)
    shape = field.shape[-2:]
    padded = padded_shape(shape, pitch, wavelength, distance, EVALUATION_GUARD)
    transfer = transfer_function(padded, pitch, wavelength, distance, band, on=field)
    transfer = transfer * carrier(wavelength, distance)
    out, xp = arrays.empty((math.prod(field.shape[:-2]), *shape), "complex64", field), arrays.namespace(field)
    for number, wave in enumerate(propagate_stack(xp.reshape(field, out.shape), transfer)):
        out[number, ...] = wave
    return xp.reshape(out, field.shape)
