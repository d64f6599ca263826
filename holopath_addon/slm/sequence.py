"""Which pictures are sent to a device, and in what order."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, replace
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from ..engine.errors import InvalidInput
from ..engine.settings import Choice
from .calibration import Calibration
from .driver import Picture

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ..engine.encoding.phase_hologram import PhaseHologram


@dataclass(frozen=True)
class Packing(Choice):
    """How holograms share a picture.

    Attributes
    ----------
    each, most_bits : int
        So many of them, and most bits of their levels.
    memory : tuple of int
        Where the bits of a level are apart: what the electrodes of a pixel are given for each level.
    cells : tuple of tuple of int
        And which bit of that each of them takes, row by row from the top.
    mirrored : bool
        Whether a picture of electrodes is mirrored left and right.
    """

    each: int
    most_bits: int
    memory: tuple = ()
    cells: tuple = ((0,),)
    mirrored: bool = False

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of the picture that a hologram's pixel takes."""
        return len(self.cells[0]), len(self.cells)

    def spread(self, levels: np.ndarray) -> np.ndarray:
        """Zeros and ones of all electrodes, shape (rows y, columns x)."""
        memory, (columns, rows) = np.array(self.memory, np.uint8)[levels], self.grid
        plane = np.empty((levels.shape[0] * rows, levels.shape[1] * columns), np.uint8)
        for y, x in np.ndindex(rows, columns):
            plane[y::rows, x::columns] = memory >> np.uint8(self.cells[y][x]) & np.uint8(1)
        return plane[:, ::-1] if self.mirrored else plane

    def gathered(self, plane: np.ndarray) -> np.ndarray:
        """The levels of electrodes; the reverse of `spread`."""
        plane, (columns, rows) = plane[:, ::-1] if self.mirrored else plane, self.grid
        memory = sum(
            plane[y::rows, x::columns] << np.uint8(self.cells[y][x]) for y, x in np.ndindex(rows, columns)
        )
        return np.argsort(self.memory).astype(np.uint8)[memory]


# For the heights of a mirror of Texas Instruments' phase light modulators from the lowest on, and where its four
# electrodes lie: the devices p67 and p47 of their package ti_plm 1.1.0.
HEIGHTS = (3, 2, 1, 7, 0, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12)
PLM_067, PLM_047 = ((1, 3), (0, 2)), ((2, 3), (0, 1))
PACKINGS = {
    packing.name: packing
    for packing in (
        Packing("time", "One Hologram", "One frame of one color per picture, one after the other", 0, 1, 16),
        Packing(
            "colour",
            "Three in RGB",
            "Three holograms of up to 8 bits in red, green and blue, for field-sequential SLMs",
            1,
            3,
            8,
        ),
        Packing(
            "bits",
            "24 in Bits",
            "24 holograms of one bit in the bits of red, green and blue, for binary SLMs",
            2,
            24,
            1,
            (0, 1),
        ),
        Packing(
            "plm-067",
            '24 for 0.67" PLMs',
            "24 holograms of 16 levels for Texas Instruments' phase light modulator of 0.67 inches, whose mirrors have "
            "two by two electrodes",
            3,
            24,
            4,
            HEIGHTS,
            PLM_067,
            True,
        ),
        Packing(
            "plm-047",
            '24 for 0.47" PLMs',
            "The same for that of 0.47 inches",
            4,
            24,
            4,
            HEIGHTS,
            PLM_047,
        ),
    )
}
MOST_BYTES = 512 << 20  # of pictures that are kept


def pack(levels: list[np.ndarray], packing: str, order: str = "RGB") -> np.ndarray:
    """Put holograms into one picture, as field-sequential devices take them.

    Parameters
    ----------
    levels : sequence of numpy.ndarray, uint8, shape (y, x)
        As many as the packing takes.
    packing : str
        Of `PACKINGS`.
    order : str
        In which channels are shown: the first holograms go into the first; within one, the lowest bit first.

    Returns
    -------
    numpy.ndarray, uint8, shape (y, x) or (y, x, 3), times the packing's `grid`
    """
    if packing == "time":
        return levels[0]
    kind = PACKINGS[packing]
    planes = (
        [kind.spread(level) << np.uint8(n % 8) for n, level in enumerate(levels)] if kind.memory else levels
    )
    picture = np.zeros((*planes[0].shape, 3), np.uint8)
    for place, plane in enumerate(planes):
        picture[..., "RGB".index(order[3 * place // kind.each])] |= plane
    return picture


def unpack(picture: np.ndarray, packing: str, order: str = "RGB") -> list[np.ndarray]:
    """The holograms in a picture, in the order in which they are shown; the reverse of `pack`."""
    if packing == "time":
        return [picture]
    channels, kind = [picture[..., "RGB".index(c)] for c in order], PACKINGS[packing]
    if not kind.memory:
        return channels
    return [kind.gathered(channel >> np.uint8(bit) & np.uint8(1)) for channel in channels for bit in range(8)]


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
        Of `PACKINGS`.
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
        if packing not in PACKINGS:
            raise InvalidInput(f"There is no packing {packing}: choose one of {', '.join(PACKINGS)}.")
        self.packing, self.order, self._packing = packing, order, PACKINGS[packing]
        if sorted(order) != sorted("RGB"):
            raise InvalidInput(f"The order of channels is RGB in some order, not {order}.")
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
        most = self._packing.most_bits
        if calibration is None and self._packing.grid != (1, 1):
            raise InvalidInput(
                f"The levels of a device for the packing {packing} are not even: give its calibration, see docs/slm.md."
            )
        self._any_bits = calibration is None and not self._packing.memory
        if falling and calibration is not None:
            raise InvalidInput(
                'A calibration says itself whether phases fall: write "falling": true into it, not the switch.'
            )
        self.calibration = calibration or Calibration(bits=min(most, 8), falling=falling)
        self._free = self.calibration.size is None
        if self.calibration.bits > most:
            raise InvalidInput(
                f"The packing {packing} takes levels of {most} bit{'s' if most > 1 else ''} at most, the calibration "
                f"says {self.calibration.bits}: choose another packing, or give bits in a calibration."
            )
        frames, wavelengths = first.data.shape[:2]
        self._shown = [(m, k) for m in range(frames) for k in range(wavelengths)]
        self.each = self._packing.each
        self._of_one = math.lcm(len(self._shown), self.each) // self.each
        self._repeats = repeats
        self._tables, self._kept, self._bytes, self._lock = {}, OrderedDict(), 0, Lock()

    def __len__(self) -> int:
        """Pictures of a round."""
        return len(self.holograms) * self._repeats * self._of_one

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
        if bits and not self._packing.memory and bits != self.calibration.bits:
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
        key = at // (self._of_one * self._repeats), at % self._of_one
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
