"""A simulated bench: an SLM, its optics, and a camera with a focus."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...engine.errors import InvalidInput
from ...engine.mapping import DepthMapping
from ...engine.optics import Beam
from ...engine.viewing.reconstruction import Refocuser
from ...engine.wavefield import WaveField
from ...engine.waves.modulator import Modulator
from ..calibration import Calibration
from ..driver import Info
from ..packing import packing_of, unpack

if TYPE_CHECKING:
    from collections.abc import Callable

    from ...engine.encoding.phase_hologram import PhaseHologram
    from ..driver import Picture


class VirtualDriver:
    """A driver of a simulated SLM, whose camera takes pictures of the reconstruction.

    Parameters
    ----------
    hologram : engine.PhaseHologram
        The hologram to show. The bench has its pitch, wavelengths, volume and strengths of light sources.
    truth : Calibration, optional
        True behavior of the SLM: the phases of its levels, mirroring and shift, and the error of the panel that
        `Calibration.correction` compensates. Default: even steps of one turn on the hologram's pixels, of 8 bits or
        those of the packing.
    modulator : engine.Modulator, optional
        Fill factor, unmodulated light and crosstalk. Default: an ideal modulator.
    packing : str
        Packing of the pictures, see `packing_of`.
    order : str
        Order of the channels, see `packing.pack`.

    Attributes
    ----------
    focus : float
        World depth of the camera's focus, meters; at first the center of the volume.

    Raises
    ------
    engine.InvalidInput
    """

    def __init__(
        self,
        hologram: PhaseHologram,
        truth: Calibration | None = None,
        modulator: Modulator | None = None,
        packing: str = "time",
        order: str = "RGB",
    ) -> None:
        self._kind = packing_of(packing)
        if truth is None:
            truth = Calibration() if self._kind.layout is None else Calibration(bits=self._kind.max_bits)
        elif self._kind.layout is not None:
            self._kind.require(truth.bits)
        self._hologram, self._truth = hologram, truth
        self._modulator, self._packing, self._order = modulator or Modulator(), packing, order
        if self._modulator.bits is not None:
            raise InvalidInput(
                "A virtual SLM has its bits from the calibration. Omit those of the modulator."
            )
        self._bare = replace(self._modulator, crosstalk=0.0)
        self._levels = {}  # by frame and wavelength
        self._mapping = DepthMapping.of(hologram.hologram, hologram.camera, hologram.near)
        volume = hologram.hologram
        self.focus_at((volume.depth_far + volume.depth_near) / 2)
        width, height = self._truth.size or (volume.width, volume.height)
        columns, rows = self._kind.grid
        bits = self._truth.bits
        self.info = Info(
            "virtual", width * columns, height * rows, bits, channels=3, note="a simulated bench"
        )

    def open(self, rate: float | None, on_picture: Callable[[int, str], None]) -> None:
        """Do nothing; see `Driver`."""

    def show(self, number: int, picture: Picture) -> None:
        """Show a picture; see `Driver`. The camera averages over all parts, each as it was shown last."""
        shape = picture.pixels.shape
        if shape[:2] != (self.info.height, self.info.width):
            raise InvalidInput(
                f"Expected a picture of {self.info.width} x {self.info.height} pixels for the virtual SLM, got "
                f"{shape[1]} x {shape[0]}."
            )
        if len(picture.parts) != self._kind.each:
            raise InvalidInput(
                f"The picture holds {len(picture.parts)} holograms, the packing {self._packing} of the virtual SLM "
                f"{self._kind.each}. Use one packing for both."
            )
        levels = unpack(picture.pixels, self._packing, self._order)
        for part, level in zip(picture.parts, levels, strict=True):
            self._levels[part] = level.copy()

    def close(self, finish: bool = False) -> None:
        """Keep what was shown, for the camera; see `Driver`."""

    def focus_at(self, distance: float) -> None:
        """Focus the camera at a distance in meters from the SLM, within or near the hologram's volume."""
        self.focus = float(self._mapping.z_to_depth(distance))

    def expose(self) -> None:
        """Start a new exposure: forget what was shown."""
        self._levels.clear()

    def capture(self) -> np.ndarray:
        """Take a picture: linear intensity, averaged over the shown frames, shape (y, x, wavelength).

        Raises
        ------
        engine.InvalidInput
            If nothing was shown.
        """
        if not self._levels:
            raise InvalidInput("Nothing was shown to the virtual camera yet. Stream a hologram first.")
        hologram = self._hologram.hologram
        size = hologram.picture.height, hologram.picture.width
        picture = np.zeros((*size, len(hologram.wavelengths)), np.float32)
        levels, counts = dict(self._levels), np.zeros(len(hologram.wavelengths))
        for (_, k), level in levels.items():
            picture[..., k] += self._intensity(level, k)
            counts[k] += 1
        return picture / np.maximum(counts, 1).astype(np.float32)

    def _intensity(self, level, k):
        """Intensity at the focus for one frame's levels and one light source."""
        wavelength = self._hologram.hologram.wavelengths[k]
        hologram = self._hologram.hologram
        shape = hologram.height, hologram.width
        # crosstalk blurs the panel's unwrapped phases, not those modulo 2 pi
        phases = self._truth.shown_phases(level, wavelength, shape, self._modulator.shown)
        light = np.float32(self._hologram.gains[k]) * self._bare.light(phases)
        illumination = hologram.illumination(k)
        if illumination is not None:
            light *= illumination
        camera, near = self._hologram.camera, self._hologram.near
        if (
            hologram.optics.colors_apart or hologram.in_air is not hologram
        ):  # pictures of all colors share a grid that depends on all
            whole = np.zeros((1, len(hologram.wavelengths), *shape), np.complex64)
            whole[0, k] = light
            return Refocuser(WaveField(whole, hologram, camera, near, modulated=True))([self.focus])[
                0, ..., k
            ]
        # a measured beam may cover all wavelengths
        alone = replace(hologram, wavelengths=(wavelength,), optics=replace(hologram.optics, beam=Beam()))
        field = WaveField(light[None, None], alone, camera, near, modulated=True)
        return Refocuser(field)([self.focus])[0, ..., 0]
