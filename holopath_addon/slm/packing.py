"""Packing of holograms into pictures: in channels, in their bits, or as levels spread over both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engine.errors import InvalidInput
from ..engine.settings.choices import Choice
from ..engine.settings.former_names import current_name
from ..engine.waves.bit_layout import LAYOUTS, BitLayout, layout_beside


@dataclass(frozen=True)
class Packing(Choice):
    """A layout of holograms in a picture.

    Attributes
    ----------
    each : int
        Number of holograms in a picture.
    max_bits : int
        Maximum number of bits of their levels.
    memory : tuple of int
        States of a pixel's electrodes for each level, one bit an electrode; empty where levels are not split.
    cells : tuple of tuple of int
        The bit of that state at each electrode, row by row from the top.
    mirrored : bool
        Whether a picture of electrodes is mirrored left and right.
    layout : BitLayout or None
        The bits of the channels that a level is spread over.
    """

    each: int
    max_bits: int
    memory: tuple = ()
    cells: tuple = ((0,),)
    mirrored: bool = False
    layout: BitLayout | None = None

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of the picture per pixel of a hologram."""
        return len(self.cells[0]), len(self.cells)

    @property
    def own_bits(self) -> bool:
        """Whether levels are not simply a picture's channel."""
        return bool(self.memory) or self.layout is not None

    def require(self, bits: int) -> None:
        """Refuse levels whose number of bits does not fit the packing.

        Raises
        ------
        InvalidInput
        """
        if self.layout is not None and bits != self.max_bits:
            raise InvalidInput(
                f"The packing {self.name} takes levels of {self.max_bits} bits, got {bits}. Choose another packing, or "
                f"set {self.max_bits} bits in the calibration or by --bits."
            )
        if bits > self.max_bits:
            raise InvalidInput(
                f"The packing {self.name} takes levels of at most {self.max_bits} "
                f"bit{'s' if self.max_bits > 1 else ''}, got {bits}. Choose another packing, or set the bits in a "
                "calibration."
            )

    def spread(self, levels: np.ndarray) -> np.ndarray:
        """States, 0 or 1, of all electrodes for levels of shape (y, x); shape (rows y, columns x)."""
        memory, (columns, rows) = np.array(self.memory, np.uint8)[levels], self.grid
        plane = np.empty((levels.shape[0] * rows, levels.shape[1] * columns), np.uint8)
        for y, x in np.ndindex(rows, columns):
            plane[y::rows, x::columns] = memory >> np.uint8(self.cells[y][x]) & np.uint8(1)
        return plane[:, ::-1] if self.mirrored else plane

    def gather(self, plane: np.ndarray) -> np.ndarray:
        """Levels of the states of all electrodes: the inverse of `spread`."""
        plane, (columns, rows) = plane[:, ::-1] if self.mirrored else plane, self.grid
        memory = sum(
            plane[y::rows, x::columns] << np.uint8(self.cells[y][x]) for y, x in np.ndindex(rows, columns)
        )
        return np.argsort(self.memory).astype(np.uint8)[memory]


# Texas Instruments' phase light modulators: states of a mirror's electrodes from the lowest height on, and the places
# of its four electrodes. Source: devices p67 and p47 of TI's package ti_plm 1.1.0
HEIGHTS = (3, 2, 1, 7, 0, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12)
PLM_067, PLM_047 = ((1, 3), (0, 2)), ((2, 3), (0, 1))
PACKINGS = {
    packing.name: packing
    for packing in (
        Packing("time", "One Hologram", "One frame of one color per picture, one after the other", 0, 1, 16),
        Packing(
            "color",
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
        Packing(
            "slm-200",
            "10 Bits for SLM-200",
            "One hologram of 10 bits in the highest bits of red, green and blue, for Santec's SLM-200",
            5,
            1,
            10,
            layout=LAYOUTS["slm-200"],
        ),
        Packing(
            "slm-200-120hz",
            "Two for SLM-200 of 120 Hz",
            "Two holograms of 10 bits in the bits of red, green and blue, for Santec's SLM-200 of 120 Hz",
            6,
            2,
            10,
            layout=LAYOUTS["slm-200-120hz"],
        ),
    )
}


def packing_of(name: str) -> Packing:
    """Find a packing by its name, or make one of bits of channels.

    Parameters
    ----------
    name : str
        A key of `PACKINGS`, or bits of channels such as ``R7-5,G7-5,B7-4``; see `engine.waves.bit_layout.bit_layout`.

    Raises
    ------
    InvalidInput
        If there is none.
    """
    name = current_name("packing", name)
    if name in PACKINGS:
        return PACKINGS[name]
    layout = layout_beside(PACKINGS, name)
    return Packing(
        name, name, "Levels in these bits of the channels", -1, layout.each, layout.bits, layout=layout
    )


def pack(levels: list[np.ndarray], packing: str, order: str = "RGB") -> np.ndarray:
    """Put holograms into one picture.

    Parameters
    ----------
    levels : sequence of numpy.ndarray, uint8 or uint16, shape (y, x)
        As many as the packing holds.
    packing : str
        See `packing_of`.
    order : str
        Order in which the device shows channels: the first holograms go into the first, from the lowest bit on.
        Ignored where levels are spread over channels.

    Returns
    -------
    numpy.ndarray, uint8 (uint16 of a single hologram of more bits), shape (y, x) or (y, x, 3), times the packing's grid
    """
    if packing == "time":
        return levels[0]
    kind = packing_of(packing)
    if kind.layout is not None:
        return kind.layout.spread(levels)
    planes = (
        [kind.spread(level) << np.uint8(n % 8) for n, level in enumerate(levels)] if kind.memory else levels
    )
    picture = np.zeros((*planes[0].shape, 3), np.uint8)
    for place, plane in enumerate(planes):
        picture[..., "RGB".index(order[3 * place // kind.each])] |= plane
    return picture


def unpack(picture: np.ndarray, packing: str, order: str = "RGB") -> list[np.ndarray]:
    """Levels of the holograms in a picture, in the order of display: the inverse of `pack`.

    Parameters
    ----------
    picture : numpy.ndarray
        Result of `pack`.
    packing, order : str
        See `pack`.
    """
    if packing == "time":
        return [picture]
    kind = packing_of(packing)
    if kind.layout is not None:
        return kind.layout.gather(picture)
    channels = [picture[..., "RGB".index(c)] for c in order]
    if not kind.memory:
        return channels
    return [kind.gather(channel >> np.uint8(bit) & np.uint8(1)) for channel in channels for bit in range(8)]
