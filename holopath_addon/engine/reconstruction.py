"""What a viewer sees: the stored field refocused through a pupil."""

import math
from dataclasses import dataclass

import numpy as np

from .errors import InvalidInput
from .hologram import channel
from .propagation import field_of, padded_shape, spectral_u, spectrum, transfer_function


@dataclass(frozen=True)
class Pupil:
    """A circular part of the viewer's pupil plane, in world metres about the camera's axis.

    Attributes
    ----------
    x, y : float
        Centre, to the right and up.
    diameter : float
        Positive. What lies beyond the recordable cone holds no light.
    """

    x: float
    y: float
    diameter: float

    def __post_init__(self):
        if not all(map(math.isfinite, (self.x, self.y, self.diameter))) or self.diameter <= 0:
            raise InvalidInput("A pupil needs a finite position and a positive diameter.")


def pupil_mask(shape, pitch, wavelength, mapping, pupil):
    """FFT bins whose plane waves pass the pupil: slope s meets the pupil plane at X = s beta / F."""
    fy, fx = (np.fft.fftfreq(n, pitch) for n in shape)
    cosine = np.sqrt(np.maximum(1 - spectral_u(shape, pitch, wavelength), 1e-12))
    scale = wavelength / cosine * mapping.beta / mapping.focal
    inside = np.hypot(fx[None, :] * scale - pupil.x, -fy[:, None] * scale - pupil.y) <= pupil.diameter / 2
    if not (inside & (fx[None, :] ** 2 + fy[:, None] ** 2 <= (0.5 / pitch) ** 2)).any():
        radius = mapping.pupil_radius(math.tan(math.asin(wavelength / (2 * pitch))))
        raise InvalidInput(
            f"The pupil lies outside the light: the hologram fills a radius of {radius * 1e3:.3g} mm around the axis."
        )
    return inside


def reconstruct(field, focus, pupil=None, progress=None):
    """Time-averaged intensity of a wave field, focused at world depths.

    Parameters
    ----------
    field : WaveField
    focus : sequence of float
        World depths along the camera's axis, metres; `math.inf` for the far end.
    pupil : Pupil, optional
        Default: the whole recordable cone.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    numpy.ndarray, float32, shape (focus, y, x, wavelength)
        In the scene's radiance units, row 0 at the top.

    Raises
    ------
    InvalidInput
        If a focus is not in front of the camera or the pupil misses the light.
    """
    progress = progress or (lambda done, message: None)
    hologram, mapping = field.hologram, field.mapping
    distances = mapping.depth_to_z(list(focus))
    frames, colours, *shape = field.data.shape
    images = np.zeros((len(distances), *shape, colours), np.float32)
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(shape, hologram.pitch, wavelength, float(np.abs(distances).max()))
        transfers = [transfer_function(padded, hologram.pitch, wavelength, z) for z in distances]
        if pupil is not None:
            mask = pupil_mask(padded, hologram.pitch, wavelength, mapping, pupil)
            transfers = [transfer * mask for transfer in transfers]
        for m in range(frames):
            waves = spectrum(field.data[m, k], padded)
            for image, transfer in zip(images, transfers, strict=True):
                at_focus = field_of(waves * transfer, shape)
                image[..., k] += at_focus.real**2 + at_focus.imag**2
            progress((k * frames + m + 1) / (frames * colours), "Refocusing")
    return images / frames


def to_rgb(image, wavelengths):
    """Linear RGB picture of an intensity image.

    Parameters
    ----------
    image : numpy.ndarray, shape (..., wavelength)
    wavelengths : sequence of float
        Metres; each lights the channel it was rendered from. A single one gives a grey picture.

    Returns
    -------
    numpy.ndarray, float32, shape (..., 3)
    """
    if len(wavelengths) == 1:
        return np.repeat(image, 3, axis=-1).astype(np.float32)
    rgb = np.zeros((*image.shape[:-1], 3), np.float32)
    channels = [channel(w) for w in wavelengths]
    for k, c in enumerate(channels):
        rgb[..., c] += image[..., k] / channels.count(c)
    return rgb
