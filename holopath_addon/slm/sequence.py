"""Which pictures are sent to a device, and in what order."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import replace
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from ..engine.errors import InvalidInput
from .calibration import Calibration
from .driver import Picture
from .packing import pack, packing_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ..engine.encoding.phase_hologram import PhaseHologram


MOST_BYTES = 512 << 20  # of pictures that are kept


class Sequence:
    """Holograms as pictures, one round of them.

    A round shows every hologram `repeats` times, and each time every frame and wavelength of it the same number of
    times, so that what the eye averages is balanced: eight frames in pictures of three take eight pictures.

    Parameters
    ----------
    holograms : sequence of engine.PhaseHologram
        More than one: an animation. All of one size and with the same wavelengths.
    calibration : Calibration, optional
        Default: even steps of one turn, of as many bits and pixels as the device has. Packings for PLMs have none.
    packing : str
        See `packing_of`.
    order : str
        See `pack`.
    repeats : int
        Times that each hologram is shown before the next.
    falling : bool
        Whether the phase falls as the level rises; a calibration says it itself.

    Raises
    ------
    InvalidInput
        If the holograms differ, or their levels do not go into such pictures.
    """

    def __init__(
        self,
        holograms: Iterable[PhaseHologram],
        calibration: Calibration | None = None,
        packing: str = "time",
        order: str = "RGB",
        repeats: int = 1,
        falling: bool = False,
    ) -> None:
        self.holograms = list(holograms)
        if not self.holograms:
            raise InvalidInput("There is no hologram to show: encode one first.")
        self.packing, self.order, self._packing = packing, order, packing_of(packing)
        if sorted(order) != sorted("RGB"):
            raise InvalidInput(f"The order of channels is RGB in some order, not {order}.")
        if self._packing.layout is not None and order != "RGB":
            raise InvalidInput(
                f"The packing {packing} names its channels itself: leave out the order {order}."
            )
        if repeats < 1:
            raise InvalidInput(f"A hologram is shown at least once, not {repeats} times.")
        first = self.holograms[0]
        for number, other in enumerate(self.holograms):
            if (
                other.data.shape != first.data.shape
                or other.hologram.wavelengths != first.hologram.wavelengths
            ):
                raise InvalidInput(
                    f"Hologram {number} has another size or wavelengths than the first: render it alike."
                )
        if calibration is None and self._packing.grid != (1, 1):
            raise InvalidInput(
                f"The levels of a device for the packing {packing} are not even: give its calibration, see docs/slm.md."
            )
        self._any_bits = calibration is None and not self._packing.own_bits
        if falling and calibration is not None:
            raise InvalidInput(
                'A calibration says itself whether phases fall: write "falling": true into it, not the switch.'
            )
        most = self._packing.most_bits
        own = most if self._packing.layout is not None else min(most, 8)
        self.calibration = calibration or Calibration(bits=own, falling=falling)
        self._free = self.calibration.size is None
        self._packing.require(self.calibration.bits)
        frames, wavelengths = first.data.shape[:2]
        self._shown = [(m, k) for m in range(frames) for k in range(wavelengths)]
        self.each = self._packing.each
        self._of_one = math.lcm(len(self._shown), self.each) // self.each
        self._repeats = repeats
        self._tables, self._kept, self._bytes, self._lock = {}, OrderedDict(), 0, Lock()

    def __len__(self) -> int:
        """Pictures of a round."""
        return len(self.holograms) * self.pictures_each

    @property
    def pictures_each(self) -> int:
        """Pictures in which a hologram is shown before the next, its repeats included."""
        return self._repeats * self._of_one

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures."""
        (width, height), (columns, rows) = self._pixels, self._packing.grid
        return width * columns, height * rows

    @property
    def _pixels(self):
        """Of the device, the calibration's or the hologram's."""
        hologram = self.holograms[0].hologram
        return tuple(self.calibration.size or (hologram.width, hologram.height))

    def fit(self, width: int, height: int, bits: int = 0, name: str = "the device") -> None:
        """Make pictures of a device's size and bits, with the hologram in the middle, where no calibration says others.

        Parameters
        ----------
        width, height : int
            Of a picture.
        bits : int
            Of the device's levels; 0: any.
        name : str
            Of the device, for messages.

        Raises
        ------
        InvalidInput
            If it says others, or the hologram is larger.
        """
        if bits and self._any_bits and self.each == 1 and bits != self.calibration.bits:
            self.calibration = replace(self.calibration, bits=bits)
            self._forget()
        if bits and not self._packing.own_bits and bits != self.calibration.bits:
            raise InvalidInput(
                f"The levels have {self.calibration.bits} bits, {name} takes {bits}: give the calibration, or bits, "
                "that belong to it."
            )
        if not width:
            return
        columns, rows = self._packing.grid
        if width % columns or height % rows:
            raise InvalidInput(
                f"The packing {self.packing} takes {columns} x {rows} pixels of a picture for each of the device: "
                f"{width} x {height} are no multiple of it, choose another packing or monitor."
            )
        width, height = width // columns, height // rows
        hologram = self.holograms[0].hologram
        if self._free and (hologram.width > width or hologram.height > height):
            raise InvalidInput(
                f"The hologram has {hologram.width} x {hologram.height} pixels, the device only {width} x {height}: "
                "render it for this device, or choose another."
            )
        if self._free and self._pixels != (width, height):
            self.calibration = replace(self.calibration, size=(width, height))
            self._forget()
        if self._pixels != (width, height):
            own = self._pixels
            raise InvalidInput(
                f"The calibration is of a device of {own[0]} x {own[1]} pixels, this one has {width} x "
                f"{height}: give the calibration that belongs to it."
            )

    def _forget(self):
        """The pictures that were made for another device."""
        self._kept.clear()
        self._tables.clear()
        self._bytes = 0

    def picture(self, number: int) -> Picture:
        """The picture of that number, counted on through the rounds.

        Returns
        -------
        Picture
        """
        at = number % len(self)
        key = at // self.pictures_each, at % self._of_one
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        picture = self._made(*key)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = picture
                self._bytes += picture.pixels.nbytes
            while self._bytes > MOST_BYTES and len(self._kept) > 1:
                _, old = self._kept.popitem(last=False)
                self._bytes -= old.pixels.nbytes
        return picture

    def _made(self, index, place):
        hologram = self.holograms[index]
        wavelengths = hologram.hologram.wavelengths
        begin = place * self.each
        parts = tuple(self._shown[n % len(self._shown)] for n in range(begin, begin + self.each))
        levels = [
            self.calibration.levels(hologram.data[m, k], wavelengths[k], self._table(wavelengths[k]))
            for m, k in parts
        ]
        pixels = np.ascontiguousarray(pack(levels, self.packing, self.order))
        return Picture(pixels, (index, place), parts, self.calibration.bits)

    def _table(self, wavelength):
        if wavelength not in self._tables:
            self._tables[wavelength] = self.calibration.table(wavelength)
        return self._tables[wavelength]
