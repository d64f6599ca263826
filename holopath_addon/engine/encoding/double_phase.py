"""Double phase: a complex field from pairs of pixels, at once and without optimisation."""

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

CLIPPED = 0.005  # of the energy
BINS = 1000
# Of a beam's largest amplitude: no pixel makes up for less. Of 0.05 to 1 the least light of double phase goes astray,
# and what is within the field's own band is nearest to it (a waist of 0.9 times half the panel).
FAINT = 0.2
# Of a descent's start, radians: pixels show half of the largest intensity then, and can become brighter or darker. With
# one frame of demo:suzanne 0.5 to 1.1 end within 0.4 dB, and an even start 4.5 dB below.
SPREAD = math.pi / 4


def transmission(waves: Array, beam: Array | None) -> Array:
    """What pixels have to let through of a beam, None for an even one, for light to be `waves`."""
    xp = arrays.namespace(waves)
    return waves if beam is None else waves * (xp.conj(beam) / xp.maximum(xp.abs(beam), FAINT) ** 2)


def half_band(shape: Sequence[int]) -> np.ndarray:
    """FFT bins that a checkerboard's pixels of one colour sample without aliases: abs(fx) + abs(fy) <= 1/2 in cycles a
    pixel of each direction, whatever its length.

    Double phase shows every second pixel's value twice; what is beyond becomes noise (Maimone et al., ACM TOG
    36(4), 85 (2017)).
    """
    fy, fx = (np.abs(scipy.fft.fftfreq(n)) for n in shape)
    return fx[None, :] + fy[:, None] <= 0.5


def clipping_level(waves: Array, beam: Array | None = None) -> float:
    """Amplitude beyond which waves are cut: where what is cut off has `CLIPPED` of their energy.

    With a beam, waves are what pixels have to let through, and their energy is that of the light.

    The farther an amplitude is under the level, the farther its two phases are apart, and the more light goes astray;
    with the level at the brightest speckle nearly all are.
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
    """Phases, float32 in [0, 2 pi), of complex amplitudes of magnitude 1 at most, shape (y, x)."""
    xp = arrays.namespace(wave)
    spread = arrays.arccos(xp.minimum(xp.abs(wave), 1.0)) * arrays.like(_checkerboard(wave.shape), wave)
    return wrapped(arrays.angle(wave) + spread)


def even_double_phase(shape: Sequence[int]) -> np.ndarray:
    """Double phase of an even wave of half of the largest intensity: `SPREAD`, in turn positive and negative.

    A descent that begins with phases alike has light at each pixel as bright as at all others. With these it can send
    as much of it as it needs past the stop, to the corners of the Fourier plane.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.

    Returns
    -------
    numpy.ndarray, float32, shape (y, x)
        Radians.
    """
    return np.float32(SPREAD) * _checkerboard(shape)


def _checkerboard(shape):
    """1 and -1 in turn."""
    rows, columns = (1 - 2 * (np.arange(n, dtype=np.float32) % 2) for n in shape)
    return rows[:, None] * columns
