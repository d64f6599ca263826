"""Pixels of pictures: stored numbers, and linear radiance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...engine import InvalidInput
from ...engine.files import check_palette
from ...engine.hologram import MAX_PIXELS
from ...engine.scene import variants
from ..pictures import check_exr

if TYPE_CHECKING:
    from pathlib import Path

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".exr", ".hdr")


def read_picture(path: Path) -> np.ndarray:
    """Read a picture: EXR and HDR files are linear, others are decoded from sRGB.

    Returns
    -------
    numpy.ndarray, float32, shape (y, x, 3)
        Linear RGB.

    Raises
    ------
    InvalidInput
        If the file cannot be read, or is partly transparent.
    """
    pixels, names = stored_pixels(path)
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
    alpha = next((k for k, name in enumerate(names) if name == "A"), None)
    if alpha is not None and (pixels[..., alpha] < full).any():
        raise InvalidInput(f"{path} is partly transparent. Compose it over a color first.")
    channels = ["R", "G", "B"] if {"R", "G", "B"} <= set(names) else ["Y"] * 3
    if not set(channels) <= set(names):
        raise InvalidInput(f"Expected a picture of RGB or gray, got {', '.join(names)} in {path}.")
    color = pixels[..., [names.index(name) for name in channels]].astype(np.float32)
    return np.ascontiguousarray(color if pixels.dtype.kind == "f" else linear(color / np.float32(full)))


def linear(encoded: np.ndarray) -> np.ndarray:
    """Decode sRGB values from 0 to 1 (IEC 61966-2-1)."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def stored_pixels(path: Path) -> tuple[np.ndarray, list[str]]:
    """Read the stored numbers of an image file, shape (y, x, channel), and the channels' names.

    Raises
    ------
    InvalidInput
        If the file cannot be read, or has other numbers than unsigned integers or floats.
    """
    try:
        pixels, names = _array(path) if path.suffix.lower() == ".npy" else _bitmap(path)
    except InvalidInput:
        raise
    except Exception as error:  # a file may hold anything
        reason = " ".join(str(error).split())[:200]
        raise InvalidInput(f"{path} cannot be read as a picture ({reason}). Give another file.") from None
    if pixels.dtype.kind not in "uf":
        raise InvalidInput(
            f"Expected pixels of 8 or 16 bits or floating-point numbers, got {pixels.dtype} in {path}."
        )
    return pixels.reshape(*pixels.shape[:2], -1), names


def _bitmap(path):
    bitmap = variants.read_bitmap(path)
    if bitmap.pixel_count() > MAX_PIXELS:
        raise ValueError(f"it has over {MAX_PIXELS >> 20} megapixels")
    pixels, kind = np.array(bitmap), path.suffix.lower()
    if kind == ".bmp":
        check_palette(path, pixels)
    elif kind == ".exr":
        check_exr(path)
    return pixels, [field.name for field in bitmap.struct_()]


def _array(path):
    pixels = np.load(path, allow_pickle=False)
    if pixels.ndim != 2:
        raise ValueError(f"it has the shape {pixels.shape} instead of rows and columns")
    return pixels, ["Y"]
