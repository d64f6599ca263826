"""Fields elsewhere: propagated to the pixels of a display, or of another bench, whose colors have other positions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..optics import COLORS
from ..pixels import Raster, beyond, coarsest, frequencies
from . import arrays
from .propagation import carrier, commensurate, padded_shape, propagate_stack, transfer_function

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..hologram import AerialImage, Hologram
    from ..optics import Optics
    from ..wavefield import WaveField
    from .arrays import Array


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


def propagate_fields(
    field: Array,
    hologram: Hologram | AerialImage,
    distance: float,
    carried: bool = True,
    display: Hologram | None = None,
    guard: int = 0,
) -> Iterator[tuple[int, int, Array]]:
    """Propagate a stack of fields: yield the numbers of wavelength and frame, and the field.

    Parameters
    ----------
    field : array, complex, shape (frame, wavelength, y, x)
    hologram : Hologram or AerialImage
        Pixels and wavelengths of the field.
    distance : float
        Distance to propagate, meters.
    carried : bool
        Whether the fields have their `carrier`.
    display : Hologram, optional
        Display whose pixels the fields are to have, at the distance where they lie for each wavelength. Default: the
        pixels of `hologram`.
    guard : int
        Minimum number of dark pixels beyond the edges.
    """
    shape, start = field.shape[-2:], distance
    for k, wavelength in enumerate(hologram.wavelengths):
        places, beyond_edge = None, guard
        if display is not None:
            distance = start + display.distance_at(wavelength)
            places = display.raster(wavelength).lines_on(Raster(shape, hologram.pitch))
            beyond_edge = max(guard, beyond(places, shape))
        padded = padded_shape(shape, hologram.pitch, wavelength, distance, beyond_edge)
        padded = padded if places is None else commensurate(padded, places)
        transfer = transfer_function(padded, hologram.pitch, wavelength, distance, on=field)
        if carried:
            transfer = transfer * carrier(wavelength, distance)
        for m, wave in enumerate(propagate_stack(field[:, k, ...], transfer, places)):
            yield k, m, wave
