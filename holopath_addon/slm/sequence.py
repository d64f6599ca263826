"""Sequences of pictures for a device."""

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


MAX_CACHE_BYTES = 512 << 20  # of pictures


def check_responses(packing: str, calibration: Calibration | None) -> None:
    """Check that a device whose levels are uneven has a calibration with responses.

    Parameters
    ----------
    packing : str
        See `Sequence`.
    calibration : Calibration or None

    Raises
    ------
    InvalidInput
    """
    if packing_of(packing).grid != (1, 1) and not (calibration and calibration.responses):
        raise InvalidInput(
            f"The levels of a device for the packing {packing} are uneven. Give its calibration with responses, see "
            "docs/slm.md."
        )


class Sequence:
    """One round of pictures that show holograms.

    A round shows every hologram `repeats` times, and each time all of its frames and wavelengths equally often, so that
    the eye's average is balanced: eight frames in pictures of three take eight pictures.

    Parameters
    ----------
    holograms : sequence of engine.PhaseHologram
        Several make an animation. All have the same size and wavelengths.
    calibration : Calibration, optional
        Default: even steps of one turn, with the bits and pixels of the device. Packings for PLMs have no default.
    packing : str
        See `packing_of`.
    order : str
        See `pack`.
    repeats : int
        Number of times that each hologram is shown before the next.
    falling : bool
        Whether the phase falls as the level rises. Set it only without a calibration, which has its own.

    Raises
    ------
    InvalidInput
        If the holograms differ, or their levels do not fit the packing.
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
            raise InvalidInput("There is no hologram to show. Encode one first.")
        self.packing, self.order, self._packing = packing, order, packing_of(packing)
        if sorted(order) != sorted("RGB"):
            raise InvalidInput(f"Expected an order of the channels R, G and B, got {order}.")
        if self._packing.layout is not None and order != "RGB":
            raise InvalidInput(f"The packing {packing} names its channels itself. Omit the order {order}.")
        if repeats < 1:
            raise InvalidInput(f"Repeats must be at least 1, got {repeats}.")
        first = self.holograms[0]
        for number, other in enumerate(self.holograms):
            if (
                other.data.shape != first.data.shape
                or other.hologram.wavelengths != first.hologram.wavelengths
            ):
                raise InvalidInput(
                    f"Hologram {number} differs from the first in size or wavelengths. Render both alike."
                )
        if calibration is None and self._packing.grid != (1, 1):
            raise InvalidInput(
                f"The levels of a device for the packing {packing} are uneven. Give its calibration, see docs/slm.md."
            )
        self._any_bits = calibration is None and not self._packing.own_bits
        if falling and calibration is not None:
            raise InvalidInput(
                'A calibration has its own falling. Write "falling": true into it, and omit the switch.'
            )
        max_bits = self._packing.max_bits
        bits = max_bits if self._packing.layout is not None else min(max_bits, 8)
        self.calibration = calibration or Calibration(bits=bits, falling=falling)
        self._any_size = self.calibration.size is None
        self._packing.require(self.calibration.bits)
        frames, wavelengths = first.data.shape[:2]
        self._parts = [(m, k) for m in range(frames) for k in range(wavelengths)]
        self.each = self._packing.each
        self._pictures_once = math.lcm(len(self._parts), self.each) // self.each
        self._repeats = repeats
        self._tables, self._cache, self._bytes, self._lock = {}, OrderedDict(), 0, Lock()

    def __len__(self) -> int:
        """Number of pictures in a round."""
        return len(self.holograms) * self.pictures_each

    @property
    def pictures_each(self) -> int:
        """Number of pictures of one hologram, its repeats included."""
        return self._repeats * self._pictures_once

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures in pixels."""
        (width, height), (columns, rows) = self._pixels, self._packing.grid
        return width * columns, height * rows

    @property
    def notes(self) -> list[str]:
        """Sentences on what the user may have overlooked."""
        own, notes = self.calibration, []
        keys = "measured_levels", "display_model"
        has_any = own.responses or own.size is not None or not own.plain
        if not has_any and any(each.report.get(key) for each in self.holograms for key in keys):
            notes.append(
                "The phases are for the levels of a calibrated device, and are shown without its calibration. Give "
                "the one that they were encoded with (--calibration, in Blender Calibration)."
            )
        nanometers = [w * 1e9 for w in self.holograms[0].hologram.wavelengths]
        count = len(nanometers)
        if self.packing == "color" and count > 1:
            colors = {"R": "red", "G": "green", "B": "blue"}
            where = ", ".join(
                f"{nanometers[k % count]:g} nm in {colors[c]}" for k, c in enumerate(self.order)
            )
            if count != 3:
                notes.append(f"Channels have no wavelength of their own: the first picture has {where}.")
            elif nanometers != sorted(nanometers, reverse=True):
                notes.append(f"Pictures have {where}, in the order of the hologram's wavelengths.")
        return notes

    @property
    def _pixels(self):
        """Width and height of the device: the calibration's, else the hologram's."""
        hologram = self.holograms[0].hologram
        return tuple(self.calibration.size or (hologram.width, hologram.height))

    def fit(self, width: int, height: int, bits: int = 0, name: str = "the device") -> None:
        """Adapt the pictures to a device's size and bits, with the hologram in the center.

        Parameters
        ----------
        width, height : int
            Size of a picture in pixels; 0 for any.
        bits : int
            Bits of the device's levels; 0 for any.
        name : str
            Name of the device, for messages.

        Raises
        ------
        InvalidInput
            If the calibration has another size or other bits, or the hologram is larger.
        """
        if bits and self._any_bits and self.each == 1 and bits != self.calibration.bits:
            self.calibration = replace(self.calibration, bits=bits)
            self._forget()
        if bits and not self._packing.own_bits and bits != self.calibration.bits:
            raise InvalidInput(
                f"The levels have {self.calibration.bits} bits, {name} takes {bits}. Give its calibration or bits."
            )
        if not width:
            return
        columns, rows = self._packing.grid
        if width % columns or height % rows:
            raise InvalidInput(
                f"The packing {self.packing} takes {columns} x {rows} pixels of a picture per pixel of the device, "
                f"and {width} x {height} is not a multiple. Choose another packing or monitor."
            )
        width, height = width // columns, height // rows
        hologram = self.holograms[0].hologram
        if self._any_size and (hologram.width > width or hologram.height > height):
            raise InvalidInput(
                f"The hologram has {hologram.width} x {hologram.height} pixels, the device only {width} x {height}. "
                "Render it for this device, or choose another."
            )
        if self._any_size and self._pixels != (width, height):
            self.calibration = replace(self.calibration, size=(width, height))
            self._forget()
        if self._pixels != (width, height):
            own = self._pixels
            raise InvalidInput(
                f"The calibration is for a device of {own[0]} x {own[1]} pixels, this one has {width} x {height}. Give "
                "the calibration of this device."
            )

    def _forget(self):
        """Drop cached pictures and tables of another device."""
        self._cache.clear()
        self._tables.clear()
        self._bytes = 0

    def picture(self, number: int) -> Picture:
        """Make the picture of a number, which counts through all rounds."""
        at = number % len(self)
        key = at // self.pictures_each, at % self._pictures_once
        with self._lock:
            if key in self._cache:
                self._cache.move_to_end(key)
                return self._cache[key]
        picture = self._make(*key)
        with self._lock:
            if key not in self._cache:
                self._cache[key] = picture
                self._bytes += picture.pixels.nbytes
            while self._bytes > MAX_CACHE_BYTES and len(self._cache) > 1:
                _, old = self._cache.popitem(last=False)
                self._bytes -= old.pixels.nbytes
        return picture

    def _make(self, index, place):
        hologram = self.holograms[index]
        wavelengths = hologram.hologram.wavelengths
        begin = place * self.each
        parts = tuple(self._parts[n % len(self._parts)] for n in range(begin, begin + self.each))
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
