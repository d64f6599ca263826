"""Numbers and tables in Dr.Jit memory: constants that stay constant, and rows that are gathered in packets."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Any

PHASOR_SCALE = 127


def constant(kind: type, values: Iterable[float]) -> Any:
    """Make a vector that is kept, such as an axis, opaque: compiled programs then serve other numbers, too.

    As literals its components would not stay single numbers: Dr.Jit 1.5 may widen them in place to the arrays that
    they are combined with (docs/theory.md, "A trap of Dr.Jit"). Numbers that are kept are `drjit.opaque` for that, too.

    Parameters
    ----------
    kind : type
        Type of the vector, such as `mitsuba.Vector3f`.
    values : iterable of float
    """
    vector = kind(*map(float, values))
    dr.make_opaque(vector)
    return vector


def mean(color: mi.Color3f) -> mi.Float:
    """Mean of a color's channels.

    `drjit.mean` makes the number of lanes a part of the program, which is then compiled again for each.
    """
    return (color.x + color.y + color.z) * (1 / 3)


ALIGNMENT = 64  # bytes of the widest vectors of any processor


def loaded(kind: type, values: np.ndarray) -> Any:
    """Copy a NumPy array to a Dr.Jit array in aligned memory.

    Dr.Jit 1.5 would use NumPy's memory in place. It compiles programs that read an array separately for memory that
    starts at a multiple of 64 bytes and for other memory: with three arrays up to eight programs.

    Parameters
    ----------
    kind : {mitsuba.Float, mitsuba.UInt32, mitsuba.UInt64}
        Type of the result.
    values : numpy.ndarray
        Numbers, in one dimension.
    """
    number = np.dtype({mi.UInt32: np.uint32, mi.UInt64: np.uint64}.get(kind, np.float32))
    space = np.empty(number.itemsize * values.size + ALIGNMENT, np.uint8)
    start = -space.ctypes.data % ALIGNMENT
    aligned = space[start : start + number.itemsize * values.size].view(number)
    aligned[:] = values
    return kind(aligned)


def row_stride(count: int) -> int:
    """Length of rows of `count` values that `gather_row` reads in packets of 4, 2 or 1."""
    return count if count <= 2 else 4 * math.ceil(count / 4)


def gather_row(buffer: Any, index: mi.UInt32, count: int) -> list:
    """Gather the `count` values of row `index` from a buffer of `packed`."""
    stride = row_stride(count)
    if stride == 1:
        return [dr.gather(type(buffer), buffer, index)]
    size = min(stride, 4)
    whole = {
        (2, mi.Float): mi.Vector2f,
        (4, mi.Float): mi.Vector4f,
        (2, mi.UInt32): mi.Vector2u,
        (4, mi.UInt32): mi.Vector4u,
    }
    packet = whole[size, type(buffer)]
    values = []
    for k in range(stride // size):
        values += list(dr.gather(packet, buffer, index * (stride // size) + k))
    return values[:count]


def packed(values: np.ndarray) -> Any:
    """Copy a 2-D array, float32 or uint32, to a flat Dr.Jit buffer with rows of `row_stride`."""
    rows, count = values.shape
    if count != row_stride(count):
        values = np.pad(values, ((0, 0), (0, row_stride(count) - count)))
    return loaded(mi.UInt32 if values.dtype == np.uint32 else mi.Float, values.ravel())


def packed_phasors(phasors: Sequence[np.ndarray]) -> Any:
    """Pack unit phasors in pairs of signed bytes, two frames a word, the frames of a grain side by side.

    Rounding to 1/127 is noise at -50 dB, far below speckle, and needs a quarter of the memory traffic, which limits the
    kernel if there are many frames.

    Parameters
    ----------
    phasors : sequence of numpy.ndarray, complex64, shape (rows, columns)
        One map for each frame.
    """
    frames = len(phasors)
    pairs = np.zeros((phasors[0].size, 2 * math.ceil(frames / 2), 2), np.int8)
    for m, phasor in enumerate(phasors):
        pairs[:, m] = np.round(PHASOR_SCALE * phasor.ravel().view(np.float32).reshape(-1, 2))
    return packed(pairs.reshape(len(pairs), -1).view(np.uint32))


def gather_phasors(buffer: Any, index: mi.UInt32, frames: int) -> list:
    """Gather the phasors of a grain.

    Parameters
    ----------
    buffer : mitsuba.UInt32
        Result of `packed_phasors`.
    index : mitsuba.UInt32
        Number of the grain in the maps.
    frames : int
        Number of frames in the buffer.

    Returns
    -------
    list of mitsuba.Float
        Real and imaginary part of each frame, times `PHASOR_SCALE`.
    """
    parts = []
    for word in gather_row(buffer, index, math.ceil(frames / 2)):
        word = mi.Int(word)
        parts += [mi.Float((word << shift) >> 24) for shift in (24, 16, 8, 0)]
    return parts[: 2 * frames]
