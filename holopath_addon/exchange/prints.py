"""Gray and binary pictures for print, with the dots per inch in the file's header."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from ..engine import InvalidInput
from ..engine.files import whole_file
from .optional import import_library

INCH = 25.4e-3  # meters
BITS = (1, 8, 16)
SUFFIXES = (".png", ".tif", ".tiff")
PITCH_TOLERANCE = 1e-3  # relative difference between the dots of a print and the hologram's pixels


def dots_per_inch(pitch: float) -> float:
    """Dots per inch of a print whose dots have a pitch in meters."""
    return INCH / pitch


def check_dots(dpi: float, pitch: float) -> None:
    """Refuse a printer whose dots do not have the hologram's pitch.

    Parameters
    ----------
    dpi : float
        Dots per inch of the printer.
    pitch : float
        Pixel pitch of the hologram, meters.

    Raises
    ------
    InvalidInput
    """
    if not 0 < dpi < float("inf"):
        raise InvalidInput(f"Expected a positive number of dots per inch, got {dpi:g}.")
    dot = INCH / dpi
    if abs(dot / pitch - 1) > PITCH_TOLERANCE:
        raise InvalidInput(
            f"{dpi:g} dots per inch are {dot * 1e6:.5g} µm apart, the hologram's pixels {pitch * 1e6:.5g} µm. Render "
            f"it with --pitch {dot * 1e6:.5g}, or print it with {dots_per_inch(pitch):.5g} dots per inch."
        )


def write_print(path: Path | str, picture: np.ndarray, bits: int, pitch: float) -> None:
    """Write a picture, which appears complete or not at all, and replaces an existing one.

    Parameters
    ----------
    path : path
        Its suffix is one of `SUFFIXES`.
    picture : numpy.ndarray, shape (y, x)
        Values from 0, black, to 1.
    bits : int
        Bits per pixel, one of `BITS`.
    pitch : float
        Pitch of the dots, meters.

    Raises
    ------
    InvalidInput
        If the suffix is unknown, or the path cannot be a file.
    BackendUnavailable
        If the library for it is not installed.
    OSError
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidInput(f"Expected a print of {', '.join(SUFFIXES)}, got '{path.suffix}'.")
    levels = np.round(picture * (2**bits - 1)).astype(np.uint16 if bits == 16 else np.uint8)
    data = _png(levels, bits, pitch) if suffix == ".png" else None
    with whole_file(path) as part:
        if data is not None:
            part.write_bytes(data)
        else:
            _write_tiff(part, levels, bits, pitch)


def _png(levels, bits, pitch):
    """Encode gray of 1, 8 or 16 bits (ISO/IEC 15948) with pixels per meter, which Mitsuba's writer lacks."""
    height, width = levels.shape
    rows = np.packbits(levels, axis=1) if bits == 1 else levels.astype(">u2" if bits == 16 else "u1")
    rows = np.ascontiguousarray(rows).view(np.uint8).reshape(height, -1)
    filter_rows = np.pad(rows, ((0, 0), (1, 0)))  # each row starts with its filter: 0, none
    per_meter = round(1 / pitch)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)),
        (b"pHYs", struct.pack(">IIB", per_meter, per_meter, 1)),
        (b"IDAT", zlib.compress(filter_rows.tobytes(), 6)),
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
        import_library("tifffile").imwrite(
            file, pixels, photometric="minisblack", resolution=(dpi, dpi), resolutionunit="INCH"
        )
