"""The phase that scattering gives each frame: at random (paper section 4.3), designed for less speckle, or smooth.

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
SETS = (1, 3, 8, 24)  # frames of the designed sets, made by `design`
FEWEST = (1, 2, 5, 20)  # first frames of each that are better than as many of smaller sets
REACH = (
    60.0  # largest defocus wavelength z / pitch^2 that they serve; beyond, they are as good as random ones
)
GAIN = (0.57, 0.5, 0.36, 0.27)  # their squared error in textured pictures, over that of independent frames
FEW_FRAMES = 6  # from which on fields show more with designed maps than with all surfaces in phase
# From which on phases show more where they begin with those of a designed field. With six and seven aimed waves end
# within 0.2 dB of it, and the whole pupil loses nowhere more than 1 dB from one frame more.
DESIGNED_STARTS = 8
FITTING = (0.0, 0.1)  # randomness that phases begin with: of one frame, and of more, which must differ
# Frames from which on light is aimed at places of its own; between two, halves of the pupil would be dark. And how far
# from its middle, of the pupil's radius: 0.2 to 0.35 are as good with three frames, with more a narrower ring.
FEWEST_AIMED, RING = 3, 0.25
# Weight of parts of the pupil from which on a descent had best begin with random phases. With three frames of
# demo:suzanne and less than that, smooth ones show more of the whole pupil and less of its parts.
RANDOM_EYEBOX = 0.3


def phasors_of(
    kind: str, frames: int, height: int, width: int, seed: int = 0, randomness: float | None = None
) -> np.ndarray:
    """exp(i phi_m) of the frames of a hologram.

    Parameters
    ----------
    kind : {'designed', 'random', 'smooth'}
    frames, height, width, seed : int
        The hologram's.
    randomness : float, optional
        Of smooth fields, 0 to 1.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, rows, columns), of unit modulus
        One period: the hologram's own size for random and smooth fields.
    """
    if kind == "designed":
        return designed_phasors(frames, seed)
    return random_phasors(frames, height, width, seed, 1.0 if randomness is None else randomness)


def randomness_for(frames: int, eyebox: float = 0.0) -> float | None:
    """Randomness of the phases that a descent of so many frames had best begin with; the optimum is flat.

    The more parts of the pupil count, the more random: phases must send light there.

    Parameters
    ----------
    frames : int
    eyebox : float
        Weight of parts of the pupil, see `encode`.

    Returns
    -------
    float or None
        From 0 to 1; None from `DESIGNED_STARTS` on, where it had best begin with a field of designed phases.
    """
    if frames >= DESIGNED_STARTS:
        return None
    least = FITTING[min(frames, len(FITTING)) - 1]
    return least if frames >= FEW_FRAMES else least + (1 - least) * min(1.0, eyebox / RANDOM_EYEBOX)


def straight_share(randomness: float) -> float:
    """Share of an even surface's light that smooth phase fields send straight on, as if all were in phase.

    The squared mean of exp(i r phi) over the phases phi, which are uniform: sinc(r)^2. The rest goes everywhere.

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
    """exp(i phi_m) of maps whose frame mean looks incoherent at any focus, see `design`.

    Sets follow each other, the largest first, each but the first moved aside, which makes their speckle independent.
    The first frames of a set stand for it where few are missing; of a set of which many are missing they are worse than
    smaller sets, and with eight frames and one more pictures would have 2 dB less than with eight.

    Parameters
    ----------
    frames : int
    seed : int
        Moves the maps as a whole; 0 does not.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, size, size), of unit modulus, periodic
    """
    turn = np.exp((2j * math.pi / 256) * np.arange(256)).astype(np.complex64)
    parts, left = [], frames
    while left:
        count = max(m for m, fewest in zip(SETS, FEWEST, strict=True) if fewest <= left)
        maps = turn[np.load(Path(__file__).with_name(f"designed_{count}.npy"))[:left]]
        rng = np.random.default_rng((seed, len(parts)))
        shift = rng.integers(0, maps.shape[-1], 2) if seed or parts else (0, 0)
        parts.append(np.roll(maps, shift, (1, 2)))
        left -= len(maps)
    return np.concatenate(parts)


def random_phasors(
    frames: int, height: int, width: int, seed: int = 0, randomness: float = 1.0
) -> np.ndarray:
    """exp(i r phi_m) of independent band-limited Gaussian random fields, periodic with the hologram.

    They are IFFT(circle(f <= 1 / (2 pitch)) exp(i xi_m)), xi_m uniform; phi_m is their argument. The band in units of
    the pixel grid is the same for all wavelengths.

    Parameters
    ----------
    frames, height, width : int
    seed : int
        Frame m depends on the seed and m alone, so fewer frames are a prefix of more.
    randomness : float
        r: 1 for random phases, 0 for none, smooth ones between (Yoo et al., Opt. Lett. 46, 4769, 2021).

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
    middle: Sequence[float] = (0.0, 0.0),
) -> np.ndarray:
    """Even waves, each of which meets the pupil at a place of its own.

    Light of smooth phases meets the pupil in one point, and parts of it beside that point stay dark. The waves of few
    frames share a ring around its middle: pictures out of focus have as many points of a blur then, and parts of the
    pupil have light of some frame. The ring shrinks to nothing from `FEWEST_AIMED` to `DESIGNED_STARTS` frames. One and
    two frames meet the middle.

    Parameters
    ----------
    frames : int
    shape : (int, int)
        Rows and columns.
    scale : (float, float)
        Radius of the pupil down and across, of 1/2 cycle a pixel.
    middle : (float, float)
        Of the pupil down and across, of 1/2 cycle a pixel.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, y, x), of unit modulus
    """
    rows, columns = (np.arange(n) for n in shape)
    radius = (
        float(np.interp(frames, (FEWEST_AIMED, DESIGNED_STARTS), (RING, 0)))
        if frames >= FEWEST_AIMED
        else 0.0
    )
    waves = np.empty((frames, *shape), np.complex64)
    for frame in range(frames):
        angle = 2 * math.pi * (frame + 0.5) / frames
        down = middle[0] + radius * scale[0] * math.cos(angle)
        across = middle[1] + radius * scale[1] * math.sin(angle)
        waves[frame] = np.exp(1j * math.pi * down * rows)[:, None] * np.exp(1j * math.pi * across * columns)
    return waves


def speckle_contrast(kind: str, frames: int, randomness: float | None = None) -> float:
    """Contrast of what speckle is left in pictures of textured scenes, as a share of their intensity.

    1/sqrt(frames) for random fields, less for designed ones: as measured for the sets (benchmarks/phase_fields.py),
    interpolated between them. Smooth ones have partially developed speckle: of a share s of the light that is in phase
    and the rest that is not, the contrast is sqrt(1 - s^2) (Goodman, Speckle Phenomena in Optics, 2007, section 3.2).

    Parameters
    ----------
    kind : {'designed', 'random', 'smooth'}
    frames : int
    randomness : float, optional
        Of smooth fields, 0 to 1; 0 where not given.

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
    """Fewest frames that leave a speckle contrast of at most so much.

    Parameters
    ----------
    kind, randomness
        As of `speckle_contrast`.
    contrast : float

    Returns
    -------
    int

    Raises
    ------
    InvalidInput
        If `MAX_FRAMES` leave more.
    """
    for frames in range(1, MAX_FRAMES + 1):
        if speckle_contrast(kind, frames, randomness) <= contrast:
            return frames
    least = speckle_contrast(kind, MAX_FRAMES, randomness)
    raise InvalidInput(
        f"A speckle contrast of {contrast:.1%} takes over {MAX_FRAMES} frames: ask for {least:.1%} or more."
    )


def recordable_fraction(phasors: np.ndarray) -> float:
    """Share of the phasors' energy inside the circular band: what a plane of unit amplitude keeps.

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
    """Mean of sinc^2(fx d) sinc^2(fy d) over the circular band: what is kept by an estimator that holds a
    phase constant over a pixel of width d, as the paper's random rays do.

    Returns
    -------
    float
    """
    f = (np.arange(samples) + 0.5) / samples - 0.5
    window = np.sinc(f) ** 2
    inside = f[:, None] ** 2 + f**2 <= 0.25
    return float((window[:, None] * window)[inside].mean())
