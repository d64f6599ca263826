"""Fields at the panel of another bench, whose colors have other pixel positions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..optics import COLORS
from ..pixels import beyond, coarsest, frequencies
from . import arrays
from .propagation import carrier, commensurate, padded_shape, propagate_stack, transfer_function

if TYPE_CHECKING:
    from ..optics import Optics
    from ..wavefield import WaveField


def at_panel(field: WaveField, optics: Optics) -> WaveField:
    """Propagate a field to the panel of another bench, at its pixels for each color.

    Light that misses the panel is lost, and so are directions that its pixels cannot send.

    Parameters
    ----------
    field : WaveField
    optics : Optics
        Optics of the other bench.

    Returns
    -------
    WaveField
        Without `WaveField.extra_frames` if the pixel positions change.

    Raises
    ------
    InvalidInput
        If the field is of another lens, or the optics do not fit its pixels.
    """
    if optics.lens != field.hologram.optics.lens:
        raise InvalidInput(
            "The field was rendered for another lens. Render it with this one, or set the other one again."
        )
    before, after = field.hologram, replace(field.hologram, optics=optics)
    if all(getattr(before.optics, name) == getattr(optics, name) for name in COLORS):
        return replace(field, hologram=after)
    data, shape = arrays.empty(field.data.shape, "complex64", field.data), field.data.shape[-2:]
    for k, wavelength in enumerate(before.wavelengths):
        pitch = before.pitch_at(wavelength)
        lines = after.raster(wavelength).lines_on(before.raster(wavelength))
        distance = after.distance_at(wavelength) - before.distance_at(wavelength)
        padded = commensurate(padded_shape(shape, pitch, wavelength, distance, beyond(lines, shape)), lines)
        transfer = transfer_function(padded, pitch, wavelength, distance, on=data)
        transfer *= carrier(wavelength, distance)
        fy, fx = frequencies(padded, pitch)
        edge = 0.5 * coarsest(pitch) / coarsest(after.pitch_at(wavelength))
        transfer *= arrays.mask(np.hypot(fy[:, None], fx) <= edge, data)
        for m, wave in enumerate(propagate_stack(field.data[:, k, ...], transfer, lines)):
            data[m, k, ...] = wave
    return replace(field, data=data, hologram=after, extra_frames=None)
