"""Double phase: a complex field from pairs of pixels, at once and without optimisation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

CLIPPED = 0.005  # of the energy
BINS = 1000
# Of a beam's largest amplitude: no pixel makes up for less. Of 0.05 to 1 the least light of double phase goes astray,
# and what is within the field's own band is nearest to it (a waist of 0.9 times half the panel).
FAINT = 0.2
# Of a descent's start, radians: pixels show half of the largest intensity then, and can become brighter or darker. With
# one frame of demo:suzanne 0.5 to 1.1 end within 0.4 dB, and an even start 4.5 dB below.
SPREAD = math.pi / 4


def transmission(waves: np.ndarray, beam: np.ndarray | None) -> np.ndarray:
    """What pixels have to let through of a beam, None for an even one, for light to be `waves`."""
    return waves if beam is None else waves * (np.conj(beam) / np.maximum(np.abs(beam), FAINT) ** 2)


def half_band(shape: Sequence[int]) -> np.ndarray:
    """FFT bins that a checkerboard's pixels of one colour sample without aliases: abs(fx) + abs(fy) <= 1/2 in cycles a
    pixel of each direction, whatever its length.

    Double phase shows every second pixel's value twice; what is beyond becomes noise (Maimone et al., ACM TOG
    36(4), 85 (2017)).
    """
    fy, fx = (np.abs(scipy.fft.fftfreq(n)) for n in shape)
    return fx[None, :] + fy[:, None] <= 0.5


def clipping_level(waves: Iterable[np.ndarray], beam: np.ndarray | None = None) -> float:
    """Amplitude beyond which waves are cut: where what is cut off has `CLIPPED` of their energy.

    With a beam, waves are what pixels have to let through, and their energy is that of the light.

    The farther an amplitude is under the level, the farther its two phases are apart, and the more light goes astray;
    with the level at the brightest speckle nearly all are.
    """
    size = np.abs(waves)
    if not size.any():
        return 0.0
    weights = None if beam is None else np.broadcast_to(np.abs(beam) ** 2, size.shape)
    counts, edges = np.histogram(size, BINS, (0, float(size.max())), weights=weights)
    sizes, levels = (edges[1:] + edges[:-1]) / 2, edges[1:]
    cut = np.array([(counts[sizes > a] * (sizes[sizes > a] - a) ** 2).sum() for a in levels])
    return float(levels[np.argmax(cut <= CLIPPED * (counts * sizes**2).sum())])


def double_phase(wave: np.ndarray) -> np.ndarray:
    """Phases, float32 in [0, 2 pi), of complex amplitudes of magnitude 1 at most, shape (y, x)."""
    spread = np.arccos(np.minimum(np.abs(wave), 1)) * _checkerboard(wave.shape)
    turn = np.float32(2 * math.pi)
    phase = np.mod(np.angle(wave) + spread, turn).astype(np.float32)
    return np.where(phase < turn, phase, 0)  # the largest float below a turn is rounded to it


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
    rows, columns = np.indices(shape, sparse=True)
    return (1 - 2 * ((rows + columns) % 2)).astype(np.float32)
