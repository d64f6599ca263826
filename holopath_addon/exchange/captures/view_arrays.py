"""Reader of views in NumPy files."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from ...engine import InvalidInput
from .pixels import MAX_PIXELS, linear

if TYPE_CHECKING:
    from pathlib import Path

_NUMBERS = re.compile(r"(.*?)(\d+)(?:[_,. -](\d+))?")  # a prefix, then row and column, or column
MAX_NAMES = 6  # in a message


def read_views(path: Path) -> np.ndarray:
    """Read views from one array, or from an array for each view.

    Parameters
    ----------
    path : Path
        An .npy of the shape (view, y, x, 3), from left to right, or (view row, view column, y, x, 3), from the top
        left; an .npz with one such array; or an .npz with an array (y, x, 3) for each view, whose names differ only in
        the view's number, or its row and column, at the end. Integers are sRGB, floats are linear.

    Returns
    -------
    numpy.ndarray, float32, shape (view row, view column, y, x, 3)
        Linear radiance.

    Raises
    ------
    InvalidInput
        If the file cannot be read, has another shape, or an unclear order of views.
    """
    try:
        array = (
            _of_archive(path)
            if path.suffix.lower() == ".npz"
            else _check(np.load(path, allow_pickle=False, mmap_mode="r"))
        )
        views = np.array(array, np.float32)
    except InvalidInput:
        raise
    except Exception as error:  # a file may hold anything
        reason = " ".join(str(error).split())[:200]
        raise InvalidInput(f"{path} cannot be read as views ({reason}). Give another file.") from None
    if array.dtype.kind == "u":
        views = linear(views / np.float32(np.iinfo(array.dtype).max)).astype(np.float32)
    return views.reshape(-1, *views.shape[-4:])


def _check(array):
    if array.ndim not in (4, 5) or array.shape[-1] != 3 or not array.size:
        raise ValueError(
            f"it has the shape {array.shape} instead of (view, y, x, 3) or (view row, view column, y, x, 3)"
        )
    if array.size > 3 * MAX_PIXELS:
        raise ValueError(f"it has over {MAX_PIXELS >> 20} megapixels")
    if array.dtype not in (np.uint8, np.uint16) and array.dtype.kind != "f":
        raise ValueError(f"it has numbers of {array.dtype} instead of 8 or 16 bits, or floating-point ones")
    return array


def _of_archive(path):
    """The only array of views in an archive, or its arrays of single views as one."""
    with np.load(path, allow_pickle=False) as file:
        if sum(part.file_size for part in file.zip.infolist()) > 8 * 3 * MAX_PIXELS + (1 << 20):
            raise ValueError(f"it has over {MAX_PIXELS >> 20} megapixels")
        arrays = {name: file[name] for name in file.files}
    arrays = {name: array for name, array in arrays.items() if array.ndim >= 3 and array.shape[-1] == 3}
    whole = [array for array in arrays.values() if array.ndim > 3]
    if len(arrays) == 1 and whole:
        return _check(whole[0])
    if not arrays or whole:
        raise InvalidInput(
            f"{path} has {len(arrays)} arrays that can be views ({_enumerate(arrays)}). Write one of the shape "
            "(view, y, x, 3) or (view row, view column, y, x, 3), or one of (y, x, 3) for each view."
        )
    if len({(array.shape, array.dtype) for array in arrays.values()}) > 1:
        raise InvalidInput(
            f"{path} has views of different sizes or types ({_enumerate(arrays)}). Write all alike."
        )
    places = _places(path, arrays)
    rows, columns = (max(place[axis] for place in places) + 1 for axis in (0, 1))
    first = next(iter(arrays.values()))
    views = np.empty((rows, columns, *first.shape), first.dtype)
    for place, array in zip(places, arrays.values(), strict=True):
        views[place] = array
    return _check(views)


def _places(path, arrays):
    """Row and column of each view, from 0."""
    matches = [_NUMBERS.fullmatch(name) for name in arrays]
    alike = all(matches) and len({(each[1], each[3] is None) for each in matches if each}) == 1
    numbers = (
        [(int(each[2]), int(each[3])) if each[3] else (0, int(each[2])) for each in matches if each]
        if alike
        else []
    )
    lowest = [min(axis) for axis in zip(*numbers, strict=True)]
    places = [tuple(n - low for n, low in zip(each, lowest, strict=True)) for each in numbers]
    count = (max(row for row, _ in places) + 1) * (max(column for _, column in places) + 1) if places else 0
    if not count == len(set(places)) == len(arrays):
        raise InvalidInput(
            f"The names of the arrays of {path} ({_enumerate(arrays)}) do not define the order of the views. Number "
            "them from left to right as view_0, view_1, or by row and column as view_0_0, view_0_1, without a gap."
        )
    return places


def _enumerate(arrays):
    names = ", ".join(list(arrays)[:MAX_NAMES])
    return names + (", ..." if len(arrays) > MAX_NAMES else "")
