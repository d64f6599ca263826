"""Amplitude holograms: the interference pattern with an off-axis reference wave, for printing on film."""

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

# Amplitude of the reference wave as a percentile of the field's amplitudes. A weaker one leaves more of the halo,
# abs(v)^2, within the stop; the zero order of a stronger one reaches it from the borders of the print. demo:suzanne,
# 256 pixels, stop of radius 0.48 at 0.5: within 0.1 dB of the best of 1 to 30 times the root mean square.
REFERENCE = 99.9


def interference(
    thing: WaveField | PhaseHologram, frame: int = 0, color: int = 0, binary: bool = False
) -> Array:
    """Intensity of the pixels' transmission, v, with a reference wave of amplitude r.

    A film whose amplitude transmission is proportional to it shows the image along the carrier::

        I = abs(v + r)^2 = abs(v)^2 + r^2 + r v + r conj(v),  v = u exp(i pi (c_x x + c_y y) / pitch) / beam

    with the field u within the stop and the carrier c, in units of the band's edge. Shifted by the carrier it is
    abs(u + r exp(-i pi (c_x x + c_y y) / pitch))^2, an off-axis reference (Leith and Upatnieks, JOSA 52, 1123 (1962)).
    The term r v is the image, around c; r conj(v) its twin, around -c; the others are around the zero order.

    Parameters
    ----------
    thing : WaveField or PhaseHologram
        Field or phases of a bench with a carrier. For phases v is the SLM's transmission, exp(i phase), and r is 1, so
        that phases of one bit become black and white.
    frame, color : int
        Indices of the frame and of the wavelength.
    binary : bool
        Black and white only, with the mean of I as threshold. Default: gray.

    Returns
    -------
    array, float32, shape (y, x)
        Values from 0 to 1, in the library of the data; row 0 is the top for the viewer.

    Raises
    ------
    InvalidInput
        If there is no carrier, or no light.
    """
    optics = thing.hologram.optics
    if not any(optics.carrier):
        raise InvalidInput(
            "Without a carrier the image and its twin overlap. Choose one, such as --carrier 0.5,0."
        )
    values, hologram = thing.data[frame, color, ...], thing.hologram
    xp = arrays.namespace(values)
    if isinstance(thing, PhaseHologram):
        waves, reference = xp.exp(1j * arrays.as_type(values, "complex64")), 1.0
    else:
        mask = optics.stop_mask(values.shape, hologram.pitch_at(hologram.wavelengths[color]))
        passed = arrays.ifft2(arrays.fft2(values) * arrays.mask(mask, values))
        beam = hologram.illumination(color)
        waves = transmission(passed, beam if beam is None else arrays.like(beam, values))
        reference = float(np.percentile(arrays.on_processor(xp.abs(waves)), REFERENCE))
    intensity = xp.abs(waves + reference) ** 2
    if not xp.any(intensity > 0):
        raise InvalidInput("There is no light in this frame at this wavelength. Choose another one.")
    pattern = intensity > xp.mean(intensity) if binary else intensity / xp.max(intensity)
    return arrays.as_type(pattern, "float32")
