"""What a viewer sees: the stored field refocused through a pupil."""

from __future__ import annotations

import copy
import math
import threading
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..hologram import channel
from ..memory import shortage
from ..optics import ON_AXIS, Optics
from ..waves.propagation import (
    JUDGING_GUARD,
    field_of,
    grid_bytes,
    padded_shape,
    spectral_u,
    spectrum,
    transfer_function,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..mapping import DepthMapping
    from ..optics import Pupil
    from ..progress import Progress
    from ..wavefield import WaveField

MOST_BYTES = (
    1 << 29
)  # of spectra that a `Refocuser` keeps: 1920 x 1080 in three colours has room for eight frames


def pupil_mask(
    shape: tuple[int, int],
    pitch: float,
    wavelength: float,
    mapping: DepthMapping,
    pupil: Pupil,
    optics: Optics = ON_AXIS,
) -> np.ndarray:
    """FFT bins whose plane waves pass the pupil: slope s meets the pupil plane at X = s beta / F.

    Raises
    ------
    InvalidInput
        If it misses the light that passes the stop of the optics.
    """
    fy, fx = (np.fft.fftfreq(n, pitch) for n in shape)
    cosine = np.sqrt(np.maximum(1 - spectral_u(shape, pitch, wavelength), 1e-12))
    scale = wavelength / cosine * mapping.beta / mapping.focal
    inside = np.hypot(fx[None, :] * scale - pupil.x, -fy[:, None] * scale - pupil.y) <= pupil.diameter / 2
    if not (inside & optics.passes(shape)).any():
        if optics.stopped:
            raise InvalidInput("The pupil lies outside the light that passes the stop: move it there.")
        radius = mapping.pupil_radius(math.tan(math.asin(wavelength / (2 * pitch))))
        raise InvalidInput(
            f"The pupil lies outside the light, which fills a radius of {radius * 1e3:.3g} mm around the axis: "
            f"move it there."
        )
    return inside


class Refocuser:
    """A wave field ready to be focused: the spectra of its frames are kept from one focus to the next.

    Refocusing is then one inverse FFT a frame and wavelength.

    Parameters
    ----------
    field : WaveField
    most_bytes : int
        Spectra that do not fit into this much memory are computed anew each time.
    """

    def __init__(self, field: WaveField, most_bytes: int = MOST_BYTES) -> None:
        self.field = field
        self._most_bytes, self._guard = most_bytes, JUDGING_GUARD if field.modulated else 0
        self._spectra = {}  # by wavelength, frame and shape
        self._lock = threading.Lock()

    def __call__(
        self, focus: Sequence[float], pupil: Pupil | None = None, progress: Progress | None = None
    ) -> np.ndarray:
        """Pictures at several distances, as `reconstruct`; one thread at a time."""
        with self._lock:
            return self._pictures(focus, pupil, progress)

    def on(self, optics: Optics) -> Refocuser:
        """The same field, of any beam, seen on another bench: through its stop. Spectra are kept for both.

        Raises
        ------
        InvalidInput
            If the optics do not go with the field's pixels.
        """
        other = copy.copy(self)
        other.field = replace(self.field, hologram=replace(self.field.hologram, optics=optics))
        return other

    def _pictures(self, focus, pupil, progress):
        progress = progress or (lambda done, message: None)
        field, hologram, mapping = self.field, self.field.hologram, self.field.mapping
        distances = mapping.depth_to_z(list(focus))
        frames, colours, *shape = field.data.shape
        farthest = float(np.abs(distances).max())
        for wavelength in hologram.wavelengths:
            needed = grid_bytes(shape, hologram.pitch, wavelength, farthest, self._guard)
            needed += 4 * len(distances) * colours * math.prod(shape)
            doing = f"Refocusing {farthest * 1e3:.3g} mm from the SLM"
            try:
                shortage(needed, doing)
            except InvalidInput as error:
                far = (max(shape) * hologram.pitch) ** 2 / wavelength
                if farthest < far:
                    raise
                raise InvalidInput(
                    f"{doing} is in its far field, beyond {far:.3g} m, to which light is not propagated: choose a "
                    "nearer distance, or add the phase of a lens and refocus to its focal length."
                ) from error
        images, done = np.empty((len(distances), *shape, colours), np.float32), 0
        for k, wavelength in enumerate(hologram.wavelengths):
            padded = self._padded(k, farthest)
            mask = hologram.optics.passes(padded) if hologram.optics.stopped else None
            if pupil is not None:
                part = pupil_mask(padded, hologram.pitch, wavelength, mapping, pupil, hologram.optics)
                mask = part if mask is None else mask & part
            together = max(1, MOST_BYTES // (8 * math.prod(padded)))  # whose transfer functions fit
            for first in range(0, len(distances), together):
                some = slice(first, first + together)
                transfers = [
                    transfer_function(padded, hologram.pitch, wavelength, z) for z in distances[some]
                ]
                if mask is not None:
                    for transfer in transfers:
                        transfer *= mask
                sums = np.zeros((len(transfers), *shape), np.float32)
                for m in range(frames):
                    waves = self._spectrum(k, m, padded)
                    for total, transfer in zip(sums, transfers, strict=True):
                        at_focus = field_of(waves * transfer, shape, overwrite=True)
                        total += at_focus.real**2 + at_focus.imag**2
                    done += len(transfers)
                    progress(done / (len(distances) * frames * colours), "Refocusing")
                images[some, ..., k] = sums / frames
        return images

    def _padded(self, k, distance):
        """FFT shape for a wavelength and distance: that of the volume, so that spectra may be kept, if it is enough."""
        needed = self._shape(k, distance)
        volume = self._shape(k, max(abs(self.field.hologram.depth_far), abs(self.field.hologram.depth_near)))
        return volume if min(np.subtract(volume, needed)) >= 0 else needed

    def _shape(self, k, distance):
        hologram, shape = self.field.hologram, self.field.data.shape[-2:]
        return padded_shape(shape, hologram.pitch, hologram.wavelengths[k], distance, self._guard)

    def _spectrum(self, k, m, padded):
        kept = self._spectra.get((k, m, padded))
        if kept is not None:
            return kept
        waves = spectrum(self.field.data[m, k], padded)
        held = sum(wave.nbytes for wave in self._spectra.values())
        if padded == self._padded(k, 0.0) and held + waves.nbytes <= self._most_bytes:
            self._spectra[k, m, padded] = waves
        return waves


def reconstruct(
    field: WaveField, focus: Sequence[float], pupil: Pupil | None = None, progress: Progress | None = None
) -> np.ndarray:
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
    return Refocuser(field, most_bytes=0)(focus, pupil, progress)


def to_rgb(image: np.ndarray, wavelengths: Sequence[float]) -> np.ndarray:
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
