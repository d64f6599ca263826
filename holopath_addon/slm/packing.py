"""How a picture holds holograms: in its channels, in their bits, and as levels that are spread over both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engine.errors import InvalidInput
from ..engine.settings import Choice
from ..engine.waves.bit_layout import LAYOUTS, BitLayout, layout_beside


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
    layout : BitLayout or None
        Which bits of which channels a level is spread over.
    """

    each: int
    most_bits: int
    memory: tuple = ()
    cells: tuple = ((0,),)
    mirrored: bool = False
    layout: BitLayout | None = None

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of the picture that a hologram's pixel takes."""
        return len(self.cells[0]), len(self.cells)

    @property
    def own_bits(self) -> bool:
        """Whether the bits of levels are not those of a picture's channel."""
        return bool(self.memory) or self.layout is not None

    def require(self, bits: int) -> None:
        """Refuse levels of bits that do not go into such pictures.

        Raises
        ------
        InvalidInput
        """
        if self.layout is not None and bits != self.most_bits:
            raise InvalidInput(
                f"The packing {self.name} takes levels of {self.most_bits} bits, these have {bits}: choose another "
                f"packing, or say bits of {self.most_bits} in the calibration or by --bits."
            )
        if bits > self.most_bits:
            raise InvalidInput(
                f"The packing {self.name} takes levels of {self.most_bits} bit{'s' if self.most_bits > 1 else ''} at "
                f"most, the calibration says {bits}: choose another packing, or give bits in a calibration."
            )

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
    """The packing of a name, or of the bits of channels that levels are spread over.

    Parameters
    ----------
    name : str
        Of `PACKINGS`, or bits of channels such as ``R7-5,G7-5,B7-4``; see `engine.waves.bit_layout.bit_layout`.

    Raises
    ------
    InvalidInput
        If there is none.
    """
    if name in PACKINGS:
        return PACKINGS[name]
    layout = layout_beside(PACKINGS, name)
    return Packing(
        name, name, "Levels in these bits of the channels", -1, layout.each, layout.bits, layout=layout
    )


def pack(levels: list[np.ndarray], packing: str, order: str = "RGB") -> np.ndarray:
    """Put holograms into one picture, as devices take them.

    Parameters
    ----------
    levels : sequence of numpy.ndarray, uint8 or uint16, shape (y, x)
        As many as the packing takes.
    packing : str
        See `packing_of`.
    order : str
        In which channels are shown: the first holograms go into the first; within one, the lowest bit first. Where
        levels are spread over channels it does not count.

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
    """The holograms in a picture, in the order in which they are shown; the reverse of `pack`."""
    if packing == "time":
        return [picture]
    kind = packing_of(packing)
    if kind.layout is not None:
        return kind.layout.gathered(picture)
    channels = [picture[..., "RGB".index(c)] for c in order]
    if not kind.memory:
        return channels
    return [kind.gathered(channel >> np.uint8(bit) & np.uint8(1)) for channel in channels for bit in range(8)]
