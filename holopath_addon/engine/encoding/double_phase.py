"""Double phase: a complex field by pairs of pixels, without optimization."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..waves import arrays
from ..waves.modulator import wrapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..waves.arrays import Array

CLIPPED = 0.005  # fraction of the energy beyond the clipping level
BINS = 1000  # of the histogram of amplitudes
# Fraction of a beam's largest amplitude: no pixel compensates for less. Of 0.05 to 1 this leaves the least stray light
# of double phase, and the smallest error within the field's own band (a waist of 0.9 times half the panel).
MIN_BEAM = 0.2
# Phases of a descent's start, radians: an even wave between half and a fourteenth of the largest intensity, so that
# pixels can become brighter or darker; and the percentile of a picture's amplitudes that the largest one shows. A start
# that is too bright ends in grain where the picture is brighter than all pixels can show (docs/measurements.md, Few
# frames).
MIN_SPREAD, MAX_SPREAD = math.pi / 4, 1.3
BRIGHT = 99.5


def transmission(waves: Array, beam: Array | None) -> Array:
    """Transmission of pixels that turns a beam into waves; faint parts of the beam are not fully compensated.

    Parameters
    ----------
    waves : array, complex, shape (..., y, x)
    beam : array, complex, shape (y, x), or None
        None for an even beam of amplitude 1.
    """
    xp = arrays.namespace(waves)
    return waves if beam is None else waves * (xp.conj(beam) / xp.maximum(xp.abs(beam), MIN_BEAM) ** 2)


def half_band(shape: Sequence[int]) -> np.ndarray:
    """FFT bins that every second pixel of a checkerboard samples without aliases.

    They are abs(fx) + abs(fy) <= 1/2 in cycles per pixel of each direction. Double phase shows every second pixel's
    value twice, so that higher frequencies become noise (Maimone et al., ACM TOG 36(4), 85 (2017)).
    """
    fy, fx = (np.abs(scipy.fft.fftfreq(n)) for n in shape)
    return fx[None, :] + fy[:, None] <= 0.5


def clipping_level(waves: Array, beam: Array | None = None) -> float:
    """Amplitude at which waves are clipped: the clipped part has the fraction `CLIPPED` of their energy.

    The farther an amplitude is below the level, the farther its two phases are apart, and the more stray light they
    make; with the level at the brightest speckle nearly all amplitudes are far below.

    Parameters
    ----------
    waves : array, complex
    beam : array, complex, optional
        Beam on the pixels, if waves are their `transmission`: energies are then those of the light.
    """
    xp = arrays.namespace(waves)
    size = xp.abs(waves)
    if not xp.any(size > 0):
        return 0.0
    weights = None if beam is None else xp.broadcast_to(xp.abs(beam) ** 2, size.shape)
    counts, edges = arrays.histogram(size, BINS, float(xp.max(size)), weights)
    sizes, levels = (edges[1:] + edges[:-1]) / 2, edges[1:]
    cut = np.array([(counts[sizes > a] * (sizes[sizes > a] - a) ** 2).sum() for a in levels])
    return float(levels[np.argmax(cut <= CLIPPED * (counts * sizes**2).sum())])


def double_phase(wave: Array) -> Array:
    """Return phases, float32 in [0, 2 pi), for complex amplitudes of magnitude up to 1, shape (y, x)."""
    xp = arrays.namespace(wave)
    spread = arrays.arccos(xp.minimum(xp.abs(wave), 1.0)) * arrays.like(_checkerboard(wave.shape), wave)
    return wrapped(arrays.angle(wave) + spread)


def spread_for(amplitude: Array) -> float:
    """Spread of the double phase of an even wave as bright as a picture's mean, where pixels can show its bright parts.

    Parameters
    ----------
    amplitude : array, shape (y, x)
        Amplitudes of the picture.

    Returns
    -------
    float
        Radians, from `MIN_SPREAD` to `MAX_SPREAD`: the arc cosine of the mean over the bright amplitude.
    """
    amplitude = arrays.on_processor(amplitude)
    bright = float(np.percentile(amplitude, BRIGHT)) or float(amplitude.max()) or 1.0
    spread = math.acos(min(1.0, float(amplitude.mean()) / bright))
    return min(max(spread, MIN_SPREAD), MAX_SPREAD)


def even_double_phase(shape: Sequence[int], spread: float = MIN_SPREAD) -> np.ndarray:
    """Double phase of an even wave: a checkerboard of plus and minus `spread`.

    With an even start every pixel is equally bright. From this one a descent can direct as much light as it needs past
    the stop, to the corners of the Fourier plane.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    spread : float
        Radians. The wave has the square of its cosine of the largest intensity: half by default.

    Returns
    -------
    numpy.ndarray, float32, shape (y, x)
        Radians.
    """
    return np.float32(spread) * _checkerboard(shape)


def _checkerboard(shape):
    """Checkerboard of 1 and -1."""
    rows, columns = (1 - 2 * (np.arange(n, dtype=np.float32) % 2) for n in shape)
    return rows[:, None] * columns
