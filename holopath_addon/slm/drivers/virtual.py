"""A simulated bench: an SLM that shows what it is sent, its optics, and a camera that can be focused."""

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
    """Takes levels, as a real SLM does, and makes of them what its camera sees.

    Parameters
    ----------
    hologram : engine.PhaseHologram
        That is shown: its pitch, wavelengths, volume and the light sources' strengths are the bench's.
    truth : Calibration, optional
        What the SLM really does with its levels: the phases they give, how it is mirrored and shifted, and of its
        panel what `Calibration.correction` would make flat. Default: even steps of one turn on the hologram's pixels,
        of 8 bits or as many as the packing spreads.
    modulator : engine.Modulator, optional
        Fill factor, unmodulated light and crosstalk. Default: none.
    packing : str
        Of the pictures that it is sent, see `packing_of`.
    order : str
        Of the channels, see `packing.pack`.

    Attributes
    ----------
    focus : float
        World depth in metres at which the camera looks; that of the volume's middle at first.
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
            truth = Calibration() if self._kind.layout is None else Calibration(bits=self._kind.most_bits)
        elif self._kind.layout is not None:
            self._kind.require(truth.bits)
        self._hologram, self._truth = hologram, truth
        self._modulator, self._packing, self._order = modulator or Modulator(), packing, order
        if self._modulator.bits is not None:
            raise InvalidInput("The bits of a virtual SLM are its calibration's.")
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

    def open(self, rate: float | None, told: Callable[[int, str], None]) -> None:
        """Nothing is to be opened; see `Driver`."""

    def show(self, number: int, picture: Picture) -> None:
        """Show a picture: the camera sees it until its parts are shown anew, and averages what it sees."""
        shape = picture.pixels.shape
        if shape[:2] != (self.info.height, self.info.width):
            raise InvalidInput(
                f"The picture has {shape[1]} x {shape[0]} pixels, the virtual SLM "
                f"{self.info.width} x {self.info.height}."
            )
        if len(picture.parts) != self._kind.each:
            raise InvalidInput(
                f"The picture holds {len(picture.parts)} holograms, the virtual SLM is one for the packing "
                f"{self._packing}: give it that of the pictures."
            )
        levels = unpack(picture.pixels, self._packing, self._order)
        for part, level in zip(picture.parts, levels, strict=True):
            self._levels[part] = level.copy()

    def close(self, finish: bool = False) -> None:
        """The camera still has what was shown."""

    def focus_at(self, distance: float) -> None:
        """Focus the camera at a distance from the SLM, metres, within or near the hologram's volume."""
        self.focus = float(self._mapping.z_to_depth(distance))

    def expose(self) -> None:
        """Forget what was shown before."""
        self._levels.clear()

    def capture(self) -> np.ndarray:
        """The camera's picture at its focus: the mean over the frames shown, linear, shape (y, x, wavelength).

        Raises
        ------
        engine.InvalidInput
            If nothing was shown.
        """
        if not self._levels:
            raise InvalidInput("The virtual camera has seen nothing yet: stream a hologram first.")
        hologram = self._hologram.hologram
        size = hologram.picture.height, hologram.picture.width
        picture = np.zeros((*size, len(hologram.wavelengths)), np.float32)
        levels, counts = dict(self._levels), np.zeros(len(hologram.wavelengths))
        for (_, k), level in levels.items():
            picture[..., k] += self._seen(level, k)
            counts[k] += 1
        return picture / np.maximum(counts, 1).astype(np.float32)

    def _seen(self, level, k):
        """Intensity at the focus of what one frame's levels make of one light source."""
        wavelength = self._hologram.hologram.wavelengths[k]
        hologram = self._hologram.hologram
        shape = hologram.height, hologram.width
        # neighbors blur the panel's own phases, of any turn, not what is left of them modulo 2 pi
        phases = self._truth.seen(level, wavelength, shape, self._modulator.shown)
        light = np.float32(self._hologram.gains[k]) * self._bare.light(phases)
        illumination = hologram.illumination(k)
        if illumination is not None:
            light *= illumination
        camera, near = self._hologram.camera, self._hologram.near
        if (
            hologram.optics.colors_apart or hologram.in_air is not hologram
        ):  # pictures of all colors have one grid, which all decide
            whole = np.zeros((1, len(hologram.wavelengths), *shape), np.complex64)
            whole[0, k] = light
            return Refocuser(WaveField(whole, hologram, camera, near, modulated=True))([self.focus])[
                0, ..., k
            ]
        # what is measured of the beam may be of all wavelengths
        alone = replace(hologram, wavelengths=(wavelength,), optics=replace(hologram.optics, beam=Beam()))
        field = WaveField(light[None, None], alone, camera, near, modulated=True)
        return Refocuser(field)([self.focus])[0, ..., 0]
