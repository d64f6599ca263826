"""Gray and binary pictures for print, with the size of their dots in the file's header."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from ..engine import InvalidInput
from ..engine.files import whole_file
from .optional import needed

INCH = 25.4e-3  # meters
BITS = (1, 8, 16)
PRINTED = (".png", ".tif", ".tiff")
WRONG = 1e-3  # of the pitch: as far a print may be from the size of the hologram that was computed


def dots_per_inch(pitch: float) -> float:
    """Of dots that are as far apart as pixels of a pitch in meters."""
    return INCH / pitch


def check_dots(dpi: float, pitch: float) -> None:
    """Refuse a printer whose dots are not as far apart as the pixels of the hologram, by their pitch in meters.

    Raises
    ------
    InvalidInput
    """
    if not 0 < dpi < float("inf"):
        raise InvalidInput(f"A print has a positive number of dots per inch, not {dpi:g}.")
    dot = INCH / dpi
    if abs(dot / pitch - 1) > WRONG:
        raise InvalidInput(
            f"{dpi:g} dots per inch are {dot * 1e6:.5g} µm apart, and the hologram's pixels {pitch * 1e6:.5g} µm: "
            f"render it with --pitch {dot * 1e6:.5g}, or print it with {dots_per_inch(pitch):.5g} dots per inch."
        )


def write_print(path: Path | str, picture: np.ndarray, bits: int, pitch: float) -> None:
    """Write a picture that appears whole or not at all, and replaces one that is there.

    Parameters
    ----------
    path : path
        Its name ends on one of `PRINTED`.
    picture : numpy.ndarray, shape (y, x)
        From 0, black, to 1.
    bits : int
        Of `BITS`.
    pitch : float
        Distance of the dots, meters.

    Raises
    ------
    InvalidInput
        If there is no such kind of file, or no file can be there.
    BackendUnavailable
        If the library for it is not installed.
    OSError
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in PRINTED:
        raise InvalidInput(f"A print ends on {', '.join(PRINTED)}, not on '{path.suffix}': name it so.")
    levels = np.round(picture * (2**bits - 1)).astype(np.uint16 if bits == 16 else np.uint8)
    data = _png(levels, bits, pitch) if suffix == ".png" else None
    with whole_file(path) as part:
        if data is not None:
            part.write_bytes(data)
        else:
            _write_tiff(part, levels, bits, pitch)


def _png(levels, bits, pitch):
    """Gray of 1, 8 or 16 bits (ISO/IEC 15948), with pixels per meter; Mitsuba's writer has no place for these."""
    height, width = levels.shape
    rows = np.packbits(levels, axis=1) if bits == 1 else levels.astype(">u2" if bits == 16 else "u1")
    rows = np.ascontiguousarray(rows).view(np.uint8).reshape(height, -1)
    filtered = np.pad(rows, ((0, 0), (1, 0)))  # each row begins with its filter: 0, none
    per_meter = round(1 / pitch)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)),
        (b"pHYs", struct.pack(">IIB", per_meter, per_meter, 1)),
        (b"IDAT", zlib.compress(filtered.tobytes(), 6)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def _write_tiff(part, levels, bits, pitch):
    dpi = dots_per_inch(pitch)
    pixels = levels.astype(bool) if bits == 1 else levels
    with open(part, "wb") as file:
        needed("tifffile").imwrite(
            file, pixels, photometric="minisblack", resolution=(dpi, dpi), resolutionunit="INCH"
        )
