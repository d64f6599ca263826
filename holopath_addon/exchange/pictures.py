"""Readers of pictures as arrays of stored numbers, without a transfer function or palette.

Each reader returns arrays of shape (y, x), or (y, x, 3) of red, green and blue, and the bits of their levels if they
are fewer than the type's. Several pages of a TIFF file become an array of more axes.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

from ..engine import InvalidInput
from ..engine.files import check_palette
from ..engine.memory import shortage
from ..engine.scene import variants
from .optional import import_library

if TYPE_CHECKING:
    from pathlib import Path

    Pictures = tuple[dict[str, np.ndarray], int | None]

PICTURE, PAGES = "picture", "pages"  # names of the only array of a file
CHANNELS = ("red", "green", "blue")
REC_709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)  # x and y of red, green, blue and white
MULTIPART, DEEP = 0x1000, 0x800  # flags of an EXR file
# TIFF's compression schemes none, LZW, deflate, PackBits, deflate, LZMA, Zstandard
_LOSSLESS = (1, 5, 8, 32773, 32946, 34925, 50000)


def read_png(path: Path) -> Pictures:
    """Read a PNG file of 8 or 16 bits per channel, or of 1, 2 or 4 bits as integers from 0."""
    with open(path, "rb") as file:
        head = file.read(26)
    pixels, (depth, kind) = _bitmap(path), head[24:26]
    if kind == 0 and depth < 8:  # Mitsuba stretches them to 0..255
        return {PICTURE: pixels // np.uint8(255 // (2**depth - 1))}, depth
    return {PICTURE: pixels}, None


def read_bmp(path: Path) -> Pictures:
    """Read a BMP file of 8 bits per channel, gray or RGB."""
    pixels = _bitmap(path)
    check_palette(path, pixels)
    return {PICTURE: pixels}, None


def read_exr(path: Path) -> Pictures:
    """Read the layers of an EXR file by name; a layer without a name is `PICTURE`."""
    check_exr(path)
    bitmap = variants.read_bitmap(path)
    pixels = np.array(bitmap, copy=False)
    pixels = pixels if pixels.ndim == 3 else pixels[..., np.newaxis]
    layers = {}
    for place, field in enumerate(bitmap.struct_()):
        layer, _, channel = field.name.rpartition(".")
        if not layer and channel not in ("R", "G", "B", "A", "Y"):
            layer, channel = channel, "Y"
        layers.setdefault(layer or PICTURE, {})[channel] = pixels[..., place]
    return {name: _join_channels(path, name, channels) for name, channels in layers.items()}, None


def check_exr(path: Path) -> None:
    """Refuse an EXR file of several parts, of a part of a picture, or of other primaries than Rec. 709.

    Raises
    ------
    InvalidInput
    """
    with open(path, "rb") as file:
        flags, header = _exr_header(file.read(1 << 16))
    if flags & (MULTIPART | DEEP):
        raise InvalidInput(f"{path} has several parts, or deep pixels. Write one part with all channels.")
    if header.get("dataWindow") != header.get("displayWindow"):
        raise InvalidInput(f"{path} holds only a part of its picture. Write it without a crop.")
    primaries = header.get("chromaticities") if b"G\0" in header.get("channels", b"") else None
    if primaries and not np.allclose(struct.unpack("<8f", primaries), REC_709, atol=1e-3):
        raise InvalidInput(f"{path} has other primaries than Rec. 709, which mix its channels. Omit them.")


def _join_channels(path, name, channels):
    """Join a layer's channels to one array."""
    alpha = channels.pop("A", None)
    if alpha is not None:
        _require_opaque(path, alpha, 1)
    if set(channels) == {"R", "G", "B"}:
        return np.stack([channels[c] for c in "RGB"], -1)
    if len(channels) != 1:
        raise InvalidInput(
            f"{path} has the channels {', '.join(channels)[:80]} in {name}. Write one of them, or R, G and B."
        )
    return next(iter(channels.values())).copy()


def _exr_header(data):
    """Flags of an EXR file, and the attributes of its first part."""
    flags, at, attributes = int.from_bytes(data[4:8], "little"), 8, {}
    while 0 < (end := data.find(b"\0", at)) != at:
        kind = data.find(b"\0", end + 1)
        size = int.from_bytes(data[kind + 1 : kind + 5], "little")
        attributes[data[at:end].decode("latin-1")] = data[kind + 5 : kind + 5 + size]
        at = kind + 5 + size
    return flags, attributes


def read_tiff(path: Path) -> Pictures:
    """Read a TIFF file of integers, floats or complex numbers; several pages become another axis."""
    tifffile = import_library("tifffile")
    with tifffile.TiffFile(path) as file:
        if len(file.series) != 1:
            raise InvalidInput(f"{path} has {len(file.series)} pictures of different kinds. Write one.")
        series, page = file.series[0], file.series[0].keyframe
        if page.photometric not in (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB):
            raise InvalidInput(
                f"{path} stores its numbers as {page.photometric.name}. Write it as gray with black at 0, or RGB."
            )
        if page.compression not in _LOSSLESS:
            raise InvalidInput(
                f"{path} is compressed by {page.compression.name}, which may change numbers. Write it without."
            )
        shortage(2 * series.nbytes, "Reading the picture")
        pixels, axes = series.asarray(), series.axes
        bits, extra = page.bitspersample, page.extrasamples
    if "S" in axes:
        pixels = np.moveaxis(pixels, axes.index("S"), -1)
        if extra:
            _require_opaque(path, pixels[..., 3 if pixels.shape[-1] == 4 else 1 :], _full(pixels.dtype))
            pixels = pixels[..., : 3 if pixels.shape[-1] == 4 else 1]
        if pixels.shape[-1] not in (1, 3):
            raise InvalidInput(f"{path} has {pixels.shape[-1]} channels. Write one, or red, green and blue.")
        pixels = pixels[..., 0] if pixels.shape[-1] == 1 else pixels
    fewer = isinstance(bits, int) and pixels.dtype.kind == "u" and bits < 8 * pixels.dtype.itemsize
    name = PICTURE if axes in ("YX", "YXS", "SYX") else PAGES
    return {name: np.ascontiguousarray(pixels)}, bits if fewer else None


def _bitmap(path):
    """Integers of a PNG or BMP picture, shape (y, x) or (y, x, 3)."""
    pixels = np.array(variants.read_bitmap(path), copy=False)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError("it has neither 8 nor 16 bits")
    pixels = pixels if pixels.ndim == 3 else pixels[..., np.newaxis]
    if pixels.shape[-1] in (2, 4):
        _require_opaque(path, pixels[..., -1], _full(pixels.dtype))
        pixels = pixels[..., :-1]
    return pixels[..., 0].copy() if pixels.shape[-1] == 1 else pixels.copy()


def _full(dtype):
    return np.iinfo(dtype).max if dtype.kind in "iu" else 1


def _require_opaque(path, alpha, full):
    if (alpha != full).any():
        raise InvalidInput(
            f"{path} has an alpha channel that is not opaque, but pixels of an SLM are opaque. Write it without alpha."
        )
