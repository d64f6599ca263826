"""Amplitude holograms: a picture of the interference with an off-axis reference wave, as it is printed on film."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..waves import arrays
from .double_phase import transmission
from .phase_hologram import PhaseHologram

if TYPE_CHECKING:
    from ..wavefield import WaveField
    from ..waves.arrays import Array

# Percentile of the field's amplitudes that the reference wave has. A weaker one leaves more of the halo, abs(v)^2,
# within the stop; of a stronger one the zero order reaches there past the borders of the print. demo:suzanne, 256
# pixels, stop of radius 0.48 at 0.5: within 0.1 dB of the best of 1 to 30 times the root mean square.
REFERENCE = 99.9


def interference(
    thing: WaveField | PhaseHologram, frame: int = 0, color: int = 0, binary: bool = False
) -> Array:
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
    array, float32, shape (y, x)
        Of the library of the data. Between 0 and 1; row 0 is the top for a viewer to whom the light runs.

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
    values, hologram = thing.data[frame, color, ...], thing.hologram
    xp = arrays.namespace(values)
    if isinstance(thing, PhaseHologram):
        waves, reference = xp.exp(1j * arrays.as_type(values, "complex64")), 1.0
    else:
        passes = optics.passes(values.shape, hologram.pitch_at(hologram.wavelengths[color]))
        passed = arrays.ifft2(arrays.fft2(values) * arrays.mask(passes, values))
        beam = hologram.illumination(color)
        waves = transmission(passed, beam if beam is None else arrays.like(beam, values))
        reference = float(np.percentile(arrays.on_processor(xp.abs(waves)), REFERENCE))
    intensity = xp.abs(waves + reference) ** 2
    if not xp.any(intensity > 0):
        raise InvalidInput("There is no light in this frame at this wavelength: choose another one.")
    shown = intensity > xp.mean(intensity) if binary else intensity / xp.max(intensity)
    return arrays.as_type(shown, "float32")
