"""Layouts of levels of any number of bits in the red, green and blue of a picture with 8 bits per channel."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

CHANNELS = "RGB"
MAX_BITS = 16  # bits of a level
_RUN = re.compile(r"([RGB])([0-7])(?:-([0-7]))?")
_BEGIN = re.compile(r"\s*[RGB]\d", re.IGNORECASE)
EXAMPLE = "R7-5,G7-5,B7-4 (the level's highest three bits are bits 7 to 5 of red, and so on)"


@dataclass(frozen=True)
class BitLayout:
    """Channel and bit of a picture for each bit of a level.

    Attributes
    ----------
    places : tuple of tuple of (int, int)
        For each hologram in a picture, in the order of display: a channel, 0 for red, and its bit, 7 for the highest,
        for each bit of a level from the highest to the lowest.
    """

    places: tuple

    @property
    def bits(self) -> int:
        """Number of bits of a level."""
        return len(self.places[0])

    @property
    def each(self) -> int:
        """Number of holograms in a picture."""
        return len(self.places)

    def spread(self, holograms: Sequence[np.ndarray]) -> np.ndarray:
        """Write levels into a picture; its bits outside the layout are 0.

        Parameters
        ----------
        holograms : sequence of numpy.ndarray of unsigned integers, shape (y, x)
            Levels of `bits` bits, `each` of them.

        Returns
        -------
        numpy.ndarray, uint8, shape (y, x, 3)

        Raises
        ------
        InvalidInput
            If a level has more bits.
        """
        picture = np.zeros((*holograms[0].shape, len(CHANNELS)), np.uint8)
        for levels, table in zip(holograms, self._tables, strict=True):
            if (highest := int(levels.max())) >> self.bits:
                raise InvalidInput(
                    f"Expected levels up to {2**self.bits - 1}, for {self.bits} bits of a picture, got {highest}. Use "
                    "levels of fewer bits, or another layout."
                )
            picture |= table[levels]
        return picture

    def gather(self, picture: np.ndarray) -> list[np.ndarray]:
        """Read the levels in a picture, uint8 or uint16; bits outside the layout are ignored, as on a panel."""
        kind, values = np.uint8 if self.bits <= 8 else np.uint16, np.arange(256)
        levels = []
        for places in self.places:
            tables = np.zeros((len(CHANNELS), 256), kind)
            for shift, (channel, bit) in self._shifted(places):
                tables[channel] |= ((values >> bit & 1) << shift).astype(kind)
            levels.append(sum(table[picture[..., channel]] for channel, table in enumerate(tables)))
        return levels

    @cached_property
    def _tables(self):
        """Red, green and blue of each level, for each hologram."""
        levels = np.arange(2**self.bits)
        tables = np.zeros((self.each, len(levels), len(CHANNELS)), np.uint8)
        for table, places in zip(tables, self.places, strict=True):
            for shift, (channel, bit) in self._shifted(places):
                table[:, channel] |= ((levels >> shift & 1) << bit).astype(np.uint8)
        return tables

    def _shifted(self, places):
        """Pairs of a bit's number in a level and its place."""
        return zip(range(self.bits - 1, -1, -1), places, strict=True)

    def stray(self, picture: np.ndarray) -> bool:
        """Whether a picture has bits outside the layout."""
        mask = np.zeros(len(CHANNELS), np.uint8)
        for channel, bit in (place for places in self.places for place in places):
            mask[channel] |= np.uint8(1 << bit)
        return bool((picture & ~mask).any())


def bit_layout(text: str) -> BitLayout:
    """Parse a layout.

    Parameters
    ----------
    text : str
        Runs of bits of a channel, separated by commas, from the highest bit of a level: ``R7-5,G7-5,B7-4`` is a level
        of 10 bits, whose highest is bit 7 of red. Holograms that a device shows one after another are separated by a
        slash.

    Raises
    ------
    InvalidInput
        If the text is not a layout, or has a bit twice.
    """
    places = tuple(tuple(_places(one, text)) for one in text.replace(" ", "").upper().split("/"))
    if len({len(one) for one in places}) > 1:
        counts = " and ".join(str(len(one)) for one in places)
        raise InvalidInput(
            f"The bits '{text}' have levels of {counts} bits. Use the same number for each hologram."
        )
    if len(places[0]) > MAX_BITS:
        raise InvalidInput(
            f"Expected levels of up to {MAX_BITS} bits, got {len(places[0])} by the bits '{text}'. Name fewer."
        )
    every = [place for one in places for place in one]
    twice = [place for place in every if every.count(place) > 1]
    if twice:
        raise InvalidInput(
            f"The bits '{text}' name {CHANNELS[twice[0][0]]}{twice[0][1]} twice. Name each bit of a channel once."
        )
    return BitLayout(places)


def layout_beside(known: Iterable[str], name: str) -> BitLayout:
    """Parse a packing that is not one of the known names as a layout.

    Parameters
    ----------
    known : iterable of str
        The known packings, for the message.
    name : str

    Raises
    ------
    InvalidInput
        If the name is not a layout.
    """
    if not _BEGIN.match(name):
        raise InvalidInput(
            f"There is no packing {name}: choose one of {', '.join(known)}, or name the bits of a panel's channels, "
            "such as R7-5,G7-5,B7-4."
        )
    return bit_layout(name)


def _places(one, text):
    """Yield the channels and bits of one hologram."""
    for run in one.split(","):
        match = _RUN.fullmatch(run)
        if match is None:
            raise InvalidInput(
                f"Expected the bits of a picture's channels that make a level, such as {EXAMPLE}, got '{text}'."
            )
        channel, high = CHANNELS.index(match[1]), int(match[2])
        low = high if match[3] is None else int(match[3])
        if low > high:
            raise InvalidInput(
                f"Expected the highest bit of a level first, got {run}. Write {match[1]}{low}-{high}, or name the bits "
                "one by one."
            )
        yield from ((channel, bit) for bit in range(high, low - 1, -1))


# Layouts of devices, by their documentation. SLM-200: santec, manual of SLMFunc.dll, revision 2.5 (2021), fig. 3.6-1,
# "Original color display (Use Red 3bit, Green 3bit, Blue 4bit)"; the model for 120 Hz, which shows two frames of each
# picture, is in the same figure.
LAYOUTS = {
    "slm-200": bit_layout("R7-5,G7-5,B7-4"),
    "slm-200-120hz": bit_layout("R7-5,G7-5,B7-4/R3-1,G3-1,B3-0"),
}
