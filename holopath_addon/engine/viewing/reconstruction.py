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
from ..pixels import Pitch, axes, beyond, coarsest
from ..waves.propagation import (
    JUDGING_GUARD,
    commensurate,
    field_of,
    grid_bytes,
    padded_shape,
    sampled,
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
    pitch: Pitch,
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
    fy, fx = (np.fft.fftfreq(n, d) for n, d in zip(shape, axes(pitch), strict=True))
    cosine = np.sqrt(np.maximum(1 - spectral_u(shape, pitch, wavelength), 1e-12))
    scale = wavelength / cosine * mapping.beta / mapping.focal
    inside = np.hypot(fx[None, :] * scale - pupil.x, -fy[:, None] * scale - pupil.y) <= pupil.diameter / 2
    if not (inside & optics.passes(shape, pitch)).any():
        if optics.stopped:
            raise InvalidInput("The pupil lies outside the light that passes the stop: move it there.")
        radius = mapping.pupil_radius(math.tan(math.asin(wavelength / (2 * coarsest(pitch)))))
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
    own_pixels : bool
        Whether pictures have the display's own pixels where these are not square, instead of those of
        `Hologram.picture`.
    """

    def __init__(self, field: WaveField, most_bytes: int = MOST_BYTES, own_pixels: bool = False) -> None:
        self.field, self._own = field, own_pixels or field.hologram.plain
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
        aside = max(abs(hologram.distance_at(w)) for w in hologram.wavelengths)
        farthest = float(np.abs(distances).max()) + aside
        for wavelength in hologram.wavelengths:
            needed = grid_bytes(shape, hologram.pitch_at(wavelength), wavelength, farthest, self._guard)
            needed += 4 * len(distances) * colours * math.prod(shape)
            doing = f"Refocusing {farthest * 1e3:.3g} mm from the SLM"
            try:
                shortage(needed, doing)
            except InvalidInput as error:
                far = (max(shape) * coarsest(hologram.pitch)) ** 2 / wavelength
                if farthest < far:
                    raise
                raise InvalidInput(
                    f"{doing} is in its far field, beyond {far:.3g} m, to which light is not propagated: choose a "
                    "nearer distance, or add the phase of a lens and refocus to its focal length."
                ) from error
        size = shape if self._own else hologram.picture.raster().shape
        images, done = np.empty((len(distances), *size, colours), np.float32), 0
        for k, wavelength in enumerate(hologram.wavelengths):
            padded, pitch, places = self._padded(k, farthest), hologram.pitch_at(wavelength), self._places(k)
            mask = hologram.optics.passes(padded, pitch) if hologram.optics.stopped else None
            if pupil is not None:
                part = pupil_mask(padded, pitch, wavelength, mapping, pupil, hologram.optics)
                mask = part if mask is None else mask & part
            together = max(1, MOST_BYTES // (8 * math.prod(padded)))  # whose transfer functions fit
            for first in range(0, len(distances), together):
                some = slice(first, first + together)
                transfers = [
                    transfer_function(padded, pitch, wavelength, z - hologram.distance_at(wavelength))
                    for z in distances[some]
                ]
                if mask is not None:
                    for transfer in transfers:
                        transfer *= mask
                sums = np.zeros((len(transfers), *size), np.float32)
                for m in range(frames):
                    waves = self._spectrum(k, m, padded)
                    for total, transfer in zip(sums, transfers, strict=True):
                        at_focus = (
                            field_of(waves * transfer, shape, overwrite=True)
                            if places is None
                            else sampled(waves * transfer, places)
                        )
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
        hologram, shape, places = self.field.hologram, self.field.data.shape[-2:], self._places(k)
        wavelength, guard = hologram.wavelengths[k], self._guard
        if places is not None:
            guard = max(guard, beyond(places, shape))
        padded = padded_shape(shape, hologram.pitch_at(wavelength), wavelength, distance, guard)
        return padded if places is None else commensurate(padded, places)

    def _places(self, k):
        """Where pixels of the picture lie between those of the panel; None where they are these."""
        if self._own:
            return None
        hologram = self.field.hologram
        return hologram.picture.raster().lines_on(hologram.raster(hologram.wavelengths[k]))

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
        In the scene's radiance units, row 0 at the top; on the grid `Hologram.picture`.

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
