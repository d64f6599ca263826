"""Amplitude holograms: a picture of the interference with an off-axis reference wave, as it is printed on film."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..errors import InvalidInput
from ..memory import on_processor
from .double_phase import transmission
from .phase_hologram import PhaseHologram

if TYPE_CHECKING:
    from ..wavefield import WaveField

# Percentile of the field's amplitudes that the reference wave has. A weaker one leaves more of the halo, abs(v)^2,
# within the stop; of a stronger one the zero order reaches there past the borders of the print. demo:suzanne, 256
# pixels, stop of radius 0.48 at 0.5: within 0.1 dB of the best of 1 to 30 times the root mean square.
REFERENCE = 99.9


def interference(
    thing: WaveField | PhaseHologram, frame: int = 0, color: int = 0, binary: bool = False
) -> np.ndarray:
    """Intensity of what the pixels are to let through, v, together with a reference wave of amplitude r.

    A film whose amplitude transmission is in proportion to it shows the picture along the carrier::

        I = abs(v + r)^2 = abs(v)^2 + r^2 + r v + r conj(v),  v = u exp(i pi (c_x x + c_y y) / pitch) / beam

    with the field u within the stop and the carrier c, in units of the band's edge. Turned by the carrier it is
    abs(u + r exp(-i pi (c_x x + c_y y) / pitch))^2, an off-axis reference (Leith and Upatnieks, JOSA 52, 1123 (1962)).
    The term r v is the picture, around c; r conj(v) its twin, around -c; the others lie around the zero order.

    Parameters
    ----------
    thing : WaveField or PhaseHologram
        Of a bench with a carrier. Of phases v is what the SLM's pixels let through, exp(i phase), and r is 1: phases
        of one bit become black and white.
    frame, color : int
        Which frame, and which of the wavelengths.
    binary : bool
        Black and white alone, parted at the mean of I. Default: gray.

    Returns
    -------
    numpy.ndarray, float32, shape (y, x)
        Between 0 and 1; row 0 is the top for a viewer to whom the light runs.

    Raises
    ------
    InvalidInput
        If there is no carrier, or no light.
    """
    optics = thing.hologram.optics
    if not any(optics.carrier):
        raise InvalidInput(
            "Without a carrier the picture and its twin lie on each other: choose one, such as --carrier 0.5,0."
        )
    values = on_processor(thing.data[frame, color, ...])
    if isinstance(thing, PhaseHologram):
        waves, reference = np.exp(1j * values), 1.0
    else:
        field, wavelength = values, thing.hologram.wavelengths[color]
        passes = optics.passes(field.shape, thing.hologram.pitch_at(wavelength))
        passed = scipy.fft.ifft2(scipy.fft.fft2(field) * passes)
        waves = transmission(passed, thing.hologram.illumination(color))
        reference = float(np.percentile(np.abs(waves), REFERENCE))
    intensity = np.abs(waves + reference) ** 2
    if not intensity.any():
        raise InvalidInput("There is no light in this frame at this wavelength: choose another one.")
    if binary:
        return (intensity > intensity.mean()).astype(np.float32)
    return (intensity / intensity.max()).astype(np.float32)
