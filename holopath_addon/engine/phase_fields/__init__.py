"""The phase that incoherent scattering gives each frame: at random (paper section 4.3), or designed for less speckle.

Maps are periodic; a hologram of any size repeats them.
"""

import math
import os
from pathlib import Path

import numpy as np
import scipy.fft

from ..propagation import circular_band

SETS = (1, 3, 8, 24)  # frames of the designed sets, made by `design`
REACH = (
    60.0  # largest defocus wavelength z / pitch^2 that they serve; beyond, they are as good as random ones
)
GAIN = (0.57, 0.5, 0.36, 0.27)  # their squared error in textured pictures, over that of independent frames


def phasors_of(kind, frames, height, width, seed=0):
    """exp(i phi_m) of the frames of a hologram.

    Parameters
    ----------
    kind : {'designed', 'random'}
    frames, height, width, seed : int
        The hologram's.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, rows, columns), of unit modulus
        One period: the hologram's own size for random fields.
    """
    if kind == "random":
        return random_phasors(frames, height, width, seed)
    return designed_phasors(frames, seed)


def designed_phasors(frames, seed=0):
    """exp(i phi_m) of maps whose frame mean looks incoherent at any focus, see `design`.

    The smallest set with enough frames is used, the first of them if it has more. Beyond the largest set it is
    repeated, each time moved aside, which makes the speckle of the repetitions independent.

    Parameters
    ----------
    frames : int
    seed : int
        Moves the maps as a whole; 0 does not.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, size, size), of unit modulus, periodic
    """
    count = next((m for m in SETS if m >= frames), SETS[-1])
    turn = np.exp((2j * math.pi / 256) * np.arange(256)).astype(np.complex64)
    maps = turn[np.load(Path(__file__).with_name(f"designed_{count}.npy"))]
    repeats = []
    for number in range(math.ceil(frames / count)):
        rng = np.random.default_rng((seed, number))
        shift = rng.integers(0, maps.shape[-1], 2) if seed or number else (0, 0)
        repeats.append(np.roll(maps, shift, (1, 2)))
    return np.concatenate(repeats)[:frames]


def random_phasors(frames, height, width, seed=0):
    """exp(i phi_m) of independent band-limited Gaussian random fields, periodic with the hologram.

    r_m = IFFT(circle(f <= 1 / (2 pitch)) exp(i xi_m)), xi_m uniform; phi_m = arg r_m. The band in units of
    the pixel grid is the same for all wavelengths.

    Parameters
    ----------
    frames, height, width : int
    seed : int
        Frame m depends on the seed and m alone, so fewer frames are a prefix of more.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, height, width), of unit modulus
    """
    band = circular_band((height, width))
    phasors = np.empty((frames, height, width), np.complex64)
    for m in range(frames):
        xi = np.random.default_rng((seed, m)).random((height, width), dtype=np.float32)
        field = scipy.fft.ifft2(band * np.exp(2j * np.float32(math.pi) * xi), workers=os.cpu_count())
        phasors[m] = np.exp(1j * np.angle(field))
    return phasors


def speckle_contrast(kind, frames):
    """Contrast of what speckle is left in pictures of textured scenes, as a share of their intensity.

    1/sqrt(frames) for random fields, less for designed ones: as measured for the sets (benchmarks/phase_fields.py),
    interpolated between them.

    Parameters
    ----------
    kind : {'designed', 'random'}
    frames : int

    Returns
    -------
    float
    """
    gain = 1.0 if kind == "random" else float(np.interp(math.log(frames), np.log(SETS), GAIN))
    return math.sqrt(gain / frames)


def recordable_fraction(phasors):
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
        energy = np.abs(scipy.fft.fft2(phasor, workers=os.cpu_count())) ** 2
        kept += energy[band].sum(dtype=np.float64)
        total += energy.sum(dtype=np.float64)
    return kept / total


def pixel_transmission(samples=256):
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
