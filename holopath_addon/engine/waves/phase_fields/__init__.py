"""Phases of scattered light in each frame: random (paper section 4.3), designed for less speckle, or smooth.

Maps are periodic; a hologram of any size repeats them.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ...errors import InvalidInput
from ...scene.variants import threads
from ..propagation import circular_band

if TYPE_CHECKING:
    from collections.abc import Sequence

MAX_FRAMES = 256  # of a hologram
SETS = (1, 3, 8, 24)  # numbers of frames of the designed sets, made by `design`
MIN_PREFIXES = (
    1,
    2,
    5,
    20,
)  # numbers of first frames of each set that are better than as many of smaller sets
REACH = 60.0  # largest defocus wavelength z / pitch^2 of the designed sets; beyond, they are no better than random ones
GAIN = (
    0.57,
    0.5,
    0.36,
    0.27,
)  # squared error of the sets in textured images, over that of independent frames
FEW_FRAMES = (
    6  # number of frames from which fields show more with designed maps than with all surfaces in phase
)
# Number of frames from which phases show more if their descent starts with a designed field. With six and seven frames
# aimed waves end within 0.2 dB of it, and the whole pupil never loses more than 1 dB by one frame more.
DESIGNED_STARTS = 8
BEST_RANDOMNESS = (0.0, 0.1)  # of the start with one frame, and with more, which must differ
# Number of frames from which waves are aimed at different points of the pupil; with two, halves of the pupil would be
# dark. And the points' distance from its center in terms of its radius: 0.2 to 0.35 are equally good with three frames,
# a narrower ring is better with more.
MIN_AIMED_FRAMES, RING = 3, 0.25
# Weight of parts of the pupil from which random phases are the best start of a descent. With three frames of
# demo:suzanne and a smaller weight, smooth ones show more of the whole pupil and less of its parts.
RANDOM_EYEBOX = 0.3


def phasors_of(
    kind: str, frames: int, height: int, width: int, seed: int = 0, randomness: float | None = None
) -> np.ndarray:
    """Phasors exp(i phi_m), one for each frame of a hologram.

    Parameters
    ----------
    kind : {'designed', 'random', 'smooth'}
    frames, height, width, seed : int
        Number of frames, rows and columns of the hologram, and seed.
    randomness : float, optional
        Randomness of smooth fields, 0 to 1.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, rows, columns), of unit modulus
        One period: the hologram's own size for random and smooth fields.
    """
    if kind == "designed":
        return designed_phasors(frames, seed)
    return random_phasors(frames, height, width, seed, 1.0 if randomness is None else randomness)


def randomness_for(frames: int, eyebox: float) -> float | None:
    """Best randomness of the start of a descent; the optimum is flat.

    It rises with the weight of parts of the pupil, as phases must send light there.

    Parameters
    ----------
    frames : int
        Number of frames.
    eyebox : float
        Weight of parts of the pupil, see `encode`.

    Returns
    -------
    float or None
        Randomness from 0 to 1; None from `DESIGNED_STARTS` frames, where a field of designed phases is the best start,
        unless the pupil counts as a whole alone.
    """
    if frames >= DESIGNED_STARTS and eyebox:
        return None
    best = BEST_RANDOMNESS[min(frames, len(BEST_RANDOMNESS)) - 1]
    return best if frames >= FEW_FRAMES else best + (1 - best) * min(1.0, eyebox / RANDOM_EYEBOX)


def straight_share(randomness: float) -> float:
    """Fraction of an even surface's light that smooth phase fields do not scatter, as if it were in phase.

    It is the squared mean of exp(i r phi) over the uniform phases phi, sinc(r)^2. The rest goes in all directions.

    Parameters
    ----------
    randomness : float
        r, from 0 to 1.

    Returns
    -------
    float
        1 for fields in phase, 0 for random ones.
    """
    return round(float(np.sinc(randomness) ** 2), 12)  # exactly 0 at 1


def designed_phasors(frames: int, seed: int = 0) -> np.ndarray:
    """Phasors exp(i phi_m) of maps whose frame mean looks incoherent at any focus, see `design`.

    They are those of several sets, the largest first; each but the first is shifted, which makes its speckle
    independent. A set is replaced by its first frames if few are missing. If many are missing, smaller sets are better:
    otherwise images of nine frames would have 2 dB less than those of eight.

    Parameters
    ----------
    frames : int
        Number of frames.
    seed : int
        Seed of the shift of all maps; 0 for none.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, size, size), of unit modulus, periodic
    """
    turn = np.exp((2j * math.pi / 256) * np.arange(256)).astype(np.complex64)
    parts, remaining = [], frames
    while remaining:
        count = max(m for m, prefix in zip(SETS, MIN_PREFIXES, strict=True) if prefix <= remaining)
        maps = turn[np.load(Path(__file__).with_name(f"designed_{count}.npy"))[:remaining]]
        rng = np.random.default_rng((seed, len(parts)))
        shift = rng.integers(0, maps.shape[-1], 2) if seed or parts else (0, 0)
        parts.append(np.roll(maps, shift, (1, 2)))
        remaining -= len(maps)
    return np.concatenate(parts)


def random_phasors(
    frames: int, height: int, width: int, seed: int = 0, randomness: float = 1.0
) -> np.ndarray:
    """Phasors exp(i r phi_m) of independent band-limited Gaussian random fields, periodic with the hologram.

    The fields are IFFT(circle(f <= 1 / (2 pitch)) exp(i xi_m)), with uniform xi_m; phi_m is their argument. The band in
    units of the pixel grid is the same for all wavelengths.

    Parameters
    ----------
    frames, height, width : int
        Number of frames, rows and columns.
    seed : int
        Seed; frame m depends on it and m alone, so fewer frames are a prefix of more.
    randomness : float
        r: 1 for random phases, 0 for none, in between for smooth ones (Yoo et al., Opt. Lett. 46, 4769, 2021).

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, height, width), of unit modulus
    """
    band = circular_band((height, width))
    phasors = np.empty((frames, height, width), np.complex64)
    for m in range(frames):
        xi = np.random.default_rng((seed, m)).random((height, width), dtype=np.float32)
        field = scipy.fft.ifft2(band * np.exp(2j * np.float32(math.pi) * xi), workers=threads())
        phasors[m] = np.exp(1j * np.float32(randomness) * np.angle(field))
    return phasors


def aimed_waves(
    frames: int,
    shape: Sequence[int],
    scale: Sequence[float] = (1.0, 1.0),
    center: Sequence[float] = (0.0, 0.0),
) -> np.ndarray:
    """Plane waves, each of which meets the pupil at a different point.

    Light of smooth phases meets the pupil in one point, and other parts of it are dark. The waves of few frames meet a
    ring around its center: out of focus, images then have several points of a blur, and every part of the pupil has
    light of some frame. The ring shrinks from `MIN_AIMED_FRAMES` frames on, to a point at `DESIGNED_STARTS`. From these
    on only phases for the pupil as a whole begin so, and it is as wide as at first. Waves of one and of two frames meet
    the center.

    Parameters
    ----------
    frames : int
        Number of frames.
    shape : (int, int)
        Rows and columns.
    scale : (float, float)
        Radius of the pupil down and across, in units of 1/2 cycle per pixel.
    center : (float, float)
        Center of the pupil down and across, in units of 1/2 cycle per pixel.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, y, x), of unit modulus
    """
    rows, columns = (np.arange(n) for n in shape)
    radius = 0.0
    if frames >= DESIGNED_STARTS:
        radius = RING
    elif frames >= MIN_AIMED_FRAMES:
        radius = float(np.interp(frames, (MIN_AIMED_FRAMES, DESIGNED_STARTS), (RING, 0)))
    waves = np.empty((frames, *shape), np.complex64)
    for frame in range(frames):
        angle = 2 * math.pi * (frame + 0.5) / frames
        down = center[0] + radius * scale[0] * math.cos(angle)
        across = center[1] + radius * scale[1] * math.sin(angle)
        waves[frame] = np.exp(1j * math.pi * down * rows)[:, None] * np.exp(1j * math.pi * across * columns)
    return waves


def speckle_contrast(kind: str, frames: int, randomness: float | None = None) -> float:
    """Contrast of the speckle in images of textured scenes, as a fraction of their intensity.

    It is 1/sqrt(frames) for random fields, and less for designed ones: as measured for the sets
    (benchmarks/phase_fields.py), interpolated between them. Smooth fields have partially developed speckle: if a
    fraction s of the light is in phase, the contrast of a frame is sqrt(1 - s^2) (Goodman, Speckle Phenomena in Optics,
    2007, section 3.2).

    Parameters
    ----------
    kind : {'designed', 'random', 'smooth'}
    frames : int
        Number of frames.
    randomness : float, optional
        Randomness of smooth fields, 0 to 1. Default: 0.

    Returns
    -------
    float
    """
    if kind == "designed":
        gain = float(np.interp(math.log(frames), np.log(SETS), GAIN))
    elif kind == "smooth":
        gain = 1 - straight_share(randomness or 0.0) ** 2
    else:
        gain = 1.0
    return math.sqrt(gain / frames)


def frames_for(kind: str, contrast: float, randomness: float | None = None) -> int:
    """Minimum number of frames with a speckle contrast up to a given one.

    Parameters
    ----------
    kind, randomness
        See `speckle_contrast`.
    contrast : float
        Maximum speckle contrast.

    Returns
    -------
    int

    Raises
    ------
    InvalidInput
        If more than `MAX_FRAMES` are needed.
    """
    for frames in range(1, MAX_FRAMES + 1):
        if speckle_contrast(kind, frames, randomness) <= contrast:
            return frames
    min_contrast = speckle_contrast(kind, MAX_FRAMES, randomness)
    raise InvalidInput(
        f"A speckle contrast of {contrast:.1%} takes over {MAX_FRAMES} frames. Choose {min_contrast:.1%} or more."
    )


def recordable_fraction(phasors: np.ndarray) -> float:
    """Fraction of the phasors' energy within the circular band, which a plane of unit amplitude keeps.

    Parameters
    ----------
    phasors : numpy.ndarray, complex, shape (frames, height, width)

    Returns
    -------
    float
    """
    band = circular_band(phasors.shape[-2:])
    kept = total = 0.0
    for phasor in phasors:
        energy = np.abs(scipy.fft.fft2(phasor, workers=threads())) ** 2
        kept += energy[band].sum(dtype=np.float64)
        total += energy.sum(dtype=np.float64)
    return kept / total


def pixel_transmission(samples: int = 256) -> float:
    """Fraction of the light that an estimator keeps whose phases are constant over a pixel.

    It is the mean of sinc^2(fx d) sinc^2(fy d) over the circular band for pixels of width d, as with the paper's random
    rays.

    Parameters
    ----------
    samples : int
        Number of frequencies along each axis.

    Returns
    -------
    float
    """
    f = (np.arange(samples) + 0.5) / samples - 0.5
    window = np.sinc(f) ** 2
    inside = f[:, None] ** 2 + f**2 <= 0.25
    return float((window[:, None] * window)[inside].mean())
