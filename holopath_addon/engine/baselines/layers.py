"""RGB-D layers: an image with depth, cut into layers that light passes from the farthest to the nearest.

Each layer blocks what lies behind it where it has surfaces itself (Zhang, Cao and Jin, Appl. Opt. 56, F138 (2017);
Shi et al., Nature 591, 234 (2021) call such targets occlusion-aware):

    U_k = P(U_(k-1), z_k - z_(k-1)) (1 - m_k) + m_k sqrt(L) exp(i phi)

with P the band-limited angular spectrum method, m_k the pixels of layer k, L their radiance, phi random. With few
frames phi varies little, see `light_randomness`. It is then added to the phase k z of a wave along the axis, because
adjacent layers would otherwise be out of phase.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..waves.phase_fields import FEW_FRAMES
from ..waves.propagation import carrier, field_of, padded_shape, spectrum, transfer_function
from . import light_randomness
from .shots import picture_with_depth

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput

MAX_LAYERS = 64


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Wave field at the SLM; parameters and result as of `baselines.field`."""
    hologram = job.hologram
    radiance, z = picture_with_depth(job, lambda done, message: progress(0.3 * done, message))
    depths, number = sliced(job, z)
    amplitude = np.sqrt(radiance) * np.float32(gain_for(job.settings.frames))
    out = np.empty((job.settings.frames, *radiance.shape), np.complex64)
    steps = [*np.diff(depths), -depths[-1]]
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(job.shape, hologram.pitch, wavelength, max(np.abs(steps)))
        sources = np.stack([amplitude[k] * random_phasor(job, m, k) for m in range(len(out))])
        waves = np.where(number == 0, sources, 0)
        for layer, step in enumerate(steps, 1):
            transfer = step_transfer(job, padded, wavelength, step)
            mask = number == layer  # empty at the SLM
            for m, source in enumerate(sources):
                waves[m] = np.where(mask, source, field_of(spectrum(waves[m], padded) * transfer, job.shape))
            progress(0.3 + 0.7 * (k + layer / len(steps)) / len(hologram.wavelengths), "Layers")
        out[:, k] = waves
    return out


def sliced(job: BaselineInput, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut a depth map into layers half a depth of focus apart, without empty ones.

    Parameters
    ----------
    job : BaselineInput
    z : numpy.ndarray, shape (y, x)
        Meters from the SLM.

    Returns
    -------
    depths : numpy.ndarray
        Layers from the farthest to the nearest, meters from the SLM; `MAX_LAYERS` or fewer.
    number : numpy.ndarray of int, shape (y, x)
        Index of the layer of each pixel.
    """
    low, high = float(z.min()), float(z.max())
    count = min(MAX_LAYERS, 1 + math.ceil((high - low) / (0.5 * job.hologram.depth_of_focus)))
    slab = np.minimum((z - low) / max(high - low, 1e-12) * count, count - 1).astype(int)
    filled, number = np.unique(slab, return_inverse=True)
    return low + (filled + 0.5) * (high - low) / count, number.reshape(z.shape)


def random_phasor(job: BaselineInput, frame: int, color: int, randomness: float | None = None) -> np.ndarray:
    """Phasors exp(i r phi) with independent phases phi for each pixel, frame and color.

    Parameters
    ----------
    job : BaselineInput
    frame, color : int
        Indices of the frame and of the wavelength.
    randomness : float, optional
        Factor r. Default: `light_randomness` of the number of frames.

    Returns
    -------
    numpy.ndarray, complex64, shape (y, x)
    """
    rng = np.random.default_rng((job.settings.seed, frame, color))
    if randomness is None:
        randomness = light_randomness(job.settings.frames)
    turn = np.complex64(2j * math.pi * randomness)
    return np.exp(turn * rng.random(job.shape, dtype=np.float32))


def gain_for(frames: int) -> float:
    """Factor of amplitudes with phases of `random_phasor` for the right brightness within the recordable band.

    With phases r phi, phi uniform from -pi to pi, sinc^2 r of the power is in their mean, all of which is in the band.
    The rest is spread evenly over the grid's frequencies, pi / 4 of which are in the band.

    Parameters
    ----------
    frames : int
        Number of frames, which sets r.
    """
    coherent = float(np.sinc(light_randomness(frames))) ** 2
    return math.sqrt(4 / (math.pi + (4 - math.pi) * coherent))


def step_transfer(job: BaselineInput, padded: tuple[int, int], wavelength: float, step: float) -> np.ndarray:
    """Transfer function from a layer to the next one, for phases of `random_phasor`.

    Parameters
    ----------
    job : BaselineInput
    padded : (int, int)
        Rows and columns of the FFT.
    wavelength, step : float
        Meters; the step is the distance to the next layer.

    Returns
    -------
    numpy.ndarray, complex64, shape `padded`
    """
    transfer = transfer_function(padded, job.hologram.pitch, wavelength, step)
    if job.settings.frames >= FEW_FRAMES:
        transfer *= carrier(wavelength, step)
    return transfer
