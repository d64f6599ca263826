"""Pixels of pictures: what is stored in their channels, and the light that it stands for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...engine import InvalidInput
from ...engine.scene import variants

if TYPE_CHECKING:
    from pathlib import Path

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".exr", ".hdr")
MAX_PIXELS = 1 << 26  # of a picture, as of a hologram


def read_picture(path: Path) -> np.ndarray:
    """Read a picture: EXR and HDR files are linear, the others sRGB, which is decoded.

    Returns
    -------
    numpy.ndarray, float32, shape (y, x, 3)
        Linear RGB.

    Raises
    ------
    InvalidInput
        If it cannot be read, or is partly transparent.
    """
    pixels, names = stored_pixels(path)
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
    alpha = next((k for k, name in enumerate(names) if name == "A"), None)
    if alpha is not None and (pixels[..., alpha] < full).any():
        raise InvalidInput(f"{path} is transparent in places: lay it on a color first.")
    wanted = ["R", "G", "B"] if {"R", "G", "B"} <= set(names) else ["Y"] * 3
    if not set(wanted) <= set(names):
        raise InvalidInput(f"{path} has no colors, but {', '.join(names)}: give a picture of RGB or gray.")
    color = pixels[..., [names.index(name) for name in wanted]].astype(np.float32)
    return np.ascontiguousarray(color if pixels.dtype.kind == "f" else linear(color / np.float32(full)))


def linear(encoded: np.ndarray) -> np.ndarray:
    """Decode sRGB (IEC 61966-2-1), 0 to 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def stored_pixels(path: Path) -> tuple[np.ndarray, list[str]]:
    """Pixels [y, x, channel] of an image file, of unsigned or floating-point numbers, and the channels' names.

    Raises
    ------
    InvalidInput
        If it cannot be read, or has other numbers.
    """
    try:
        pixels, names = _array(path) if path.suffix.lower() == ".npy" else _bitmap(path)
    except Exception as error:  # there is no end to what a file may hold
        reason = " ".join(str(error).split())[:200]
        raise InvalidInput(f"{path} cannot be read as a picture ({reason}): give another file.") from None
    if pixels.dtype.kind not in "uf":
        raise InvalidInput(
            f"{path} has pixels of {pixels.dtype}: give 8 or 16 bits, or floating-point numbers."
        )
    return pixels.reshape(*pixels.shape[:2], -1), names


def _bitmap(path):
    bitmap = variants.bitmaps().Bitmap(str(path))
    if bitmap.pixel_count() > MAX_PIXELS:
        raise ValueError(f"it has over {MAX_PIXELS >> 20} megapixels")
    return np.array(bitmap), [field.name for field in bitmap.struct_()]


def _array(path):
    pixels = np.load(path, allow_pickle=False)
    if pixels.ndim != 2:
        raise ValueError(f"it has the shape {pixels.shape} instead of rows and columns")
    return pixels, ["Y"]
