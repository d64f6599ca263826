"""Numbers and tables in Dr.Jit memory: constants that stay constants, and rows that are fetched in packets."""

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
    """A vector that is kept, such as an axis: data to compiled programs, so that other numbers compile nothing.

    As literals its components would not stay one number each: Dr.Jit 1.5 may widen them in place to the arrays that
    they meet (docs/theory.md, "A trap of Dr.Jit"). Numbers that are kept are `drjit.opaque` for the same reason.

    Parameters
    ----------
    kind : type
        Such as `mitsuba.Vector3f`.
    values : sequence of float
    """
    vector = kind(*map(float, values))
    dr.make_opaque(vector)
    return vector


def mean(color: mi.Color3f) -> mi.Float:
    """Mean of a color's channels.

    `drjit.mean` writes the number of lanes into the program, which is then compiled anew for each.
    """
    return (color.x + color.y + color.z) * (1 / 3)


ALIGNMENT = 64  # bytes, of the widest vectors of any processor


def loaded(kind: type, values: np.ndarray) -> Any:
    """A NumPy array in memory of its own, as Dr.Jit's.

    Dr.Jit 1.5 would use NumPy's memory as it lies. It compiles a program that reads an array lane by lane, or rows of
    it, again for one that begins at a multiple of 64 bytes, or does not: with three arrays eight programs, by chance.

    Parameters
    ----------
    kind : {mitsuba.Float, mitsuba.UInt32, mitsuba.UInt64}
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
    """Row length of a buffer whose rows of `count` values `gather_row` reads in packets of 4, 2 or 1."""
    return count if count <= 2 else 4 * math.ceil(count / 4)


def gather_row(buffer: Any, index: mi.UInt32, count: int) -> list:
    """The `count` values of row `index` of a buffer made by `packed`."""
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
    """A 2-D array, float32 or uint32, as a flat Dr.Jit buffer with rows of `row_stride`."""
    rows, count = values.shape
    if count != row_stride(count):
        values = np.pad(values, ((0, 0), (0, row_stride(count) - count)))
    return loaded(mi.UInt32 if values.dtype == np.uint32 else mi.Float, values.ravel())


def packed_phasors(phasors: Sequence[np.ndarray]) -> Any:
    """Unit phasors as pairs of signed bytes, two frames a word, the frames of a grain side by side.

    Rounding to 1/127 is noise at -50 dB, far under any speckle, and a quarter of the memory traffic, which
    limits the kernel when there are many frames.
    """
    frames = len(phasors)
    pairs = np.zeros((phasors[0].size, 2 * math.ceil(frames / 2), 2), np.int8)
    for m, phasor in enumerate(phasors):
        pairs[:, m] = np.round(PHASOR_SCALE * phasor.ravel().view(np.float32).reshape(-1, 2))
    return packed(pairs.reshape(len(pairs), -1).view(np.uint32))


def gather_phasors(buffer: Any, index: mi.UInt32, frames: int) -> list:
    """Real and imaginary parts, times `PHASOR_SCALE`, of each frame's phasor at a grain."""
    parts = []
    for word in gather_row(buffer, index, math.ceil(frames / 2)):
        word = mi.Int(word)
        parts += [mi.Float((word << shift) >> 24) for shift in (24, 16, 8, 0)]
    return parts[: 2 * frames]
