"""RGB-D layers: a picture with depth, cut into layers that light passes from the farthest to the nearest.

Each layer blocks what lies behind it where it has surfaces itself (Zhang, Cao and Jin, Appl. Opt. 56, F138 (2017);
Shi et al., Nature 591, 234 (2021) call such targets occlusion-aware):

    U_k = P(U_(k-1), z_k - z_(k-1)) (1 - m_k) + m_k sqrt(L) exp(i phi)

with P the band-limited angular spectrum method, m_k the pixels of layer k, L their radiance, phi random.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..waves.propagation import carrier, field_of, padded_shape, spectrum, transfer_function
from .shots import picture_with_depth

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput

MOST_LAYERS = 64
GAIN = math.sqrt(4 / math.pi)  # of amplitudes with independent phases: the band keeps pi / 4 of their light


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """The wave field at the SLM; parameters as of `baselines.BaselineInput`, progress may raise.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
    """
    hologram = job.hologram
    radiance, z = picture_with_depth(job, lambda done, what: progress(0.3 * done, what))
    depths, number = sliced(job, z)
    amplitude = np.sqrt(radiance) * np.float32(GAIN)
    out = np.empty((job.settings.frames, *radiance.shape), np.complex64)
    steps = [*np.diff(depths), -depths[-1]]
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(job.shape, hologram.pitch, wavelength, max(np.abs(steps)))
        sources = np.stack([amplitude[k] * random_phasor(job, m, k) for m in range(len(out))])
        waves = np.where(number == 0, sources, 0)
        for layer, step in enumerate(steps, 1):
            transfer = transfer_function(padded, hologram.pitch, wavelength, step)
            transfer *= carrier(wavelength, step)
            here = number == layer  # none at the SLM
            for m, source in enumerate(sources):
                waves[m] = np.where(here, source, field_of(spectrum(waves[m], padded) * transfer, job.shape))
            progress(0.3 + 0.7 * (k + layer / len(steps)) / len(hologram.wavelengths), "Layers")
        out[:, k] = waves
    return out


def sliced(job: BaselineInput, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Layers half a depth of focus apart, where there are surfaces.

    Parameters
    ----------
    job : BaselineInput
    z : numpy.ndarray, shape (y, x)
        Metres from the SLM.

    Returns
    -------
    depths : numpy.ndarray
        Of the layers, from the farthest to the nearest, metres from the SLM.
    number : numpy.ndarray of int, shape (y, x)
        Layer of each pixel.
    """
    low, high = float(z.min()), float(z.max())
    count = min(MOST_LAYERS, 1 + math.ceil((high - low) / (0.5 * job.hologram.depth_of_focus)))
    slab = np.minimum((z - low) / max(high - low, 1e-12) * count, count - 1).astype(int)
    filled, number = np.unique(slab, return_inverse=True)
    return low + (filled + 0.5) * (high - low) / count, number.reshape(z.shape)


def random_phasor(job: BaselineInput, frame: int, colour: int) -> np.ndarray:
    """exp(i phi) with phases independent from pixel to pixel, frame to frame and colour to colour."""
    rng = np.random.default_rng((job.settings.seed, frame, colour))
    return np.exp(np.complex64(2j * math.pi) * rng.random(job.shape, dtype=np.float32))
