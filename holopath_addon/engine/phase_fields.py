"""Band-limited Gaussian random fields: the phase that incoherent scattering gives each frame (paper section 4.3)."""

import math
import os

import numpy as np
import scipy.fft

from .propagation import circular_band


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
