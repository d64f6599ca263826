"""Reader of the vertices of PLY files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...engine import InvalidInput
from ...engine.scene.captured.points import MAX_POINTS
from .pixels import linear

if TYPE_CHECKING:
    from pathlib import Path

_NUMBERS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
MAX_HEADER = 1 << 16  # bytes of a PLY file's header


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the vertices of a PLY file, ASCII or binary.

    Returns
    -------
    points : numpy.ndarray, float64, shape (point, 3)
    colors : numpy.ndarray, float32, shape (point, 3)
        Linear RGB: integers are decoded from sRGB, floats are linear already.

    Raises
    ------
    InvalidInput
        If the file cannot be read, has faces, or its vertices have no colors.
    """
    try:
        with open(path, "rb") as file:
            order, elements = _ply_header(file)
            vertices = _ply_vertices(path, file, order, elements)
    except InvalidInput:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InvalidInput(f"{path} cannot be read as a PLY file ({reason}). Give another file.") from None
    points = np.stack([vertices[name].astype(np.float64) for name in "xyz"], -1)
    channels = [vertices[name] for name in ("red", "green", "blue")]
    colors = np.stack([channel.astype(np.float32) for channel in channels], -1)
    if channels[0].dtype.kind in "iu":
        colors = linear(colors / np.float32(np.iinfo(channels[0].dtype).max))
    return points, colors


def _ply_header(file):
    """Byte order, and the elements in order: name, count, and properties as names and types, None for lists."""
    if file.readline(8).strip() != b"ply":
        raise ValueError("it does not start with the line ply")
    order, elements, size = None, [], 0
    while True:
        line = file.readline(MAX_HEADER)
        size += len(line)
        if not line or size > MAX_HEADER:
            raise ValueError("its header does not end")
        words = line.decode("ascii", "replace").split()
        if words[:1] == ["end_header"]:
            break
        if words[:1] == ["format"]:
            order = words[1]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append((words[-1], None if words[1] == "list" else _NUMBERS[words[1]]))
    if order not in _ORDERS:
        raise ValueError(f"its format is {order}")
    return order, elements


def _ply_vertices(path, file, order, elements):
    """Arrays of the vertices' properties by name."""
    counts = {name: count for name, count, _ in elements}
    if counts.get("face"):
        raise InvalidInput(
            f"{path} has faces. Remove them to show its points, or use it as a shape of type ply in a Mitsuba .xml to "
            "show its surface."
        )
    if not counts.get("vertex"):
        raise InvalidInput(f"{path} has no vertices. Give a PLY file with points.")
    if counts["vertex"] > MAX_POINTS:
        raise InvalidInput(
            f"Expected at most {MAX_POINTS} points, got {counts['vertex']} in {path}. Thin them out."
        )
    for name, count, properties in elements:
        lists = any(kind is None for _, kind in properties)
        if name == "vertex":
            break
        if order == "ascii":
            for _ in range(count):
                file.readline()
        elif lists and count:
            raise ValueError(f"lists of the element {name} come before its vertices")
        else:
            file.seek(count * sum(np.dtype(kind).itemsize for _, kind in properties), 1)
    names = [each for each, _ in properties]
    missing = [each for each in ("x", "y", "z", "red", "green", "blue") if each not in names]
    if missing:
        raise InvalidInput(
            f"The vertices of {path} have no {', '.join(missing)}. Give points with the properties x, y, z, red, green "
            "and blue."
        )
    if lists:
        raise ValueError("its vertices have lists")
    kinds = np.dtype([(each, _ORDERS[order] + kind) for each, kind in properties])
    if order == "ascii":
        table = np.loadtxt(file, max_rows=count, ndmin=2, dtype=np.float64)
        if table.shape != (count, len(names)):
            raise ValueError(f"it has {len(table)} vertices of {count}")
        return {each: table[:, k].astype(kinds[each]) for k, each in enumerate(names)}
    table = np.frombuffer(file.read(count * kinds.itemsize), kinds)
    if len(table) != count:
        raise ValueError(f"it has {len(table)} vertices of {count}")
    return {each: table[each] for each in names}
