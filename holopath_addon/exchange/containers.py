"""Kinds of files: named arrays, and beside them attributes, which are words, numbers and lists of numbers.

None of them can hold code: what is read is never unpickled. HDF5 is read in a process of its own, see `hdf5_reader`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..engine import BackendUnavailable, Cancelled, InvalidInput
from ..engine.files import whole_file
from . import pictures
from .optional import needed

Attributes = dict[str, Any]
NOTES = "attributes"  # name of what holds them where a kind of file has arrays alone
PATIENCE, SLOWEST = 30.0, 1e6  # seconds, and bytes a second, after which HDF5's library goes round in circles
USER_BLOCK = 512  # bytes before the HDF5 of a MATLAB file
_MATLAB = {"f4": "single", "f8": "double", "c8": "single", "u1": "uint8", "u2": "uint16"}
NUMBERS = "fiucb"  # kinds of NumPy's types
PICKLED = (".pt", ".pth", ".pkl", ".pickle")


@dataclass
class Container:
    """Of a file.

    Attributes
    ----------
    arrays : dict of str to numpy.ndarray
    attributes : dict of str to str, float or list of float
        Of the file, and of its arrays if it has several that say the same.
    own : dict of str to dict
        Attributes of arrays, by their names.
    colored : frozenset of str
        Names of arrays whose last of three axes is red, green and blue.
    """

    arrays: dict[str, np.ndarray]
    attributes: Attributes = field(default_factory=dict)
    own: dict[str, Attributes] = field(default_factory=dict)
    colored: frozenset[str] = frozenset()


def read(path: Path | str) -> Container:
    """All arrays of numbers of a file, and its attributes.

    Raises
    ------
    InvalidInput
        If the file cannot be read, or its name does not end on one of `READABLE`.
    BackendUnavailable
        If the library for it is not installed.
    """
    path = Path(path)
    reader, _ = _kind(path)
    try:
        if not path.is_file():
            raise InvalidInput(f"There is no file {path}: give one that ends on {', '.join(READABLE)}.")
        container = reader(path)
    except (InvalidInput, BackendUnavailable, Cancelled):
        raise
    except Exception as error:  # there is no end to what a file may hold
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InvalidInput(
            f"{path} cannot be read ({reason}): write it again, or give another file."
        ) from error
    if not container.arrays:
        raise InvalidInput(f"{path} holds no array of numbers: give another file.")
    return container


def write(path: Path | str, container: Container) -> None:
    """Write a file that appears whole or not at all, and replaces one that is there.

    Raises
    ------
    InvalidInput
        If its name does not end on one of `SUFFIXES`, the container does not suit that kind of file, or there can be
        no file.
    BackendUnavailable
        If the library for it is not installed.
    OSError
    """
    path = Path(path)
    _, writer = _kind(path)
    with whole_file(path) as part:
        writer(part, container)


def _kind(path):
    suffix = path.suffix.lower()
    if suffix in PICKLED:
        raise InvalidInput(
            f"{path} is pickled, which can run any code when it is read: write the tensor with "
            "safetensors.torch.save_file, or numpy.save."
        )
    if suffix not in _KINDS:
        raise InvalidInput(f"{path} is of no kind that is known: end its name on {', '.join(READABLE)}.")
    return _KINDS[suffix]


def _read_hdf5(path):
    """Data sets of all groups, by their path, and attributes of the file and of them."""
    arrays, _, attributes, own = _hdf5(path)
    return Container(arrays, attributes, own)


def _hdf5(path):
    """Arrays, the MATLAB class of those that have one, attributes, and those of each, as `hdf5_reader` finds them."""
    needed("h5py")
    reader = Path(__file__).with_name("hdf5_reader.py")
    with tempfile.TemporaryDirectory(prefix="holopath-") as folder:
        try:
            process = subprocess.run(
                [sys.executable, str(reader), str(path), folder],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
                timeout=PATIENCE + path.stat().st_size / SLOWEST,
            )
        except subprocess.TimeoutExpired:
            raise ValueError("it is damaged: reading it does not end") from None
        if process.returncode:
            said = process.stderr.splitlines()[-1:] if process.returncode > 0 else []
            raise ValueError(*said or ("it is damaged",))
        found = json.loads((Path(folder) / "contents.json").read_text())
        arrays = {name: np.load(Path(folder) / f"{n}.npy") for n, name in enumerate(found["names"])}
    return arrays, found["matlab"], found["attributes"], found["own"]


def _write_hdf5(path, container):
    h5py = needed("h5py")
    with h5py.File(path, "w") as file:
        for name, array in container.arrays.items():
            stored = file.create_dataset(name, data=array)
            for key, value in container.attributes.items():
                stored.attrs[key] = value


def _read_mat(path):
    """A MATLAB file of version 7.3, which is HDF5, or an earlier one, which SciPy reads."""
    with open(path, "rb") as file:
        newer = file.read(10) == b"MATLAB 7.3"
    if newer:
        arrays, classes, _, _ = _hdf5(path)
        values = {name: _from_matlab(array, classes.get(name)) for name, array in arrays.items()}
    else:
        from scipy.io import loadmat

        values = loadmat(path)
    container = Container({})
    for name, value in values.items():
        if isinstance(value, str):
            container.attributes[name] = value
        elif not isinstance(value, np.ndarray):
            continue
        elif value.dtype.kind == "U" and value.size == 1:
            container.attributes[name] = str(value.item())
        elif value.dtype.kind in "fiub" and (value.ndim < 2 or min(value.shape) == 1):
            listed = value.ravel().tolist()
            container.attributes[name] = listed[0] if len(listed) == 1 else listed
        elif value.dtype.kind in NUMBERS:
            container.arrays[name] = value
    return container


def _from_matlab(array, kind):
    """A text, or an array as MATLAB shows it: HDF5 has its axes in reverse."""
    if kind == "char":
        return array.astype(np.uint16).tobytes().decode("utf-16-le")
    return (array.astype(bool) if kind == "logical" else array).T


def _write_mat(path, container):
    """Version 7.3: HDF5 behind a block of text; MATLAB's axes run the other way, and numbers are 1 x 1."""
    h5py = needed("h5py")
    with h5py.File(path, "w", userblock_size=USER_BLOCK) as file:
        for name, array in container.arrays.items():
            _matlab(file, name, array)
        for name, value in container.attributes.items():
            if isinstance(value, str):
                text = np.frombuffer(value.encode("utf-16-le"), np.uint16)[:, None]
                file.create_dataset(name, data=text).attrs.update(
                    MATLAB_class=np.bytes_(b"char"), MATLAB_int_decode=np.int32(2)
                )
            else:
                _matlab(file, name, np.atleast_2d(np.asarray(value, float)))
    header = b"MATLAB 7.3 MAT-file, written by HoloPath".ljust(124, b" ") + b"\x00\x02IM"
    with open(path, "r+b") as file:
        file.write(header)


def _matlab(file, name, array):
    kind = _MATLAB.get(array.dtype.str[1:])
    if kind is None:
        raise InvalidInput(f"MATLAB files do not take arrays of {array.dtype}.")
    if np.iscomplexobj(array):
        stored = np.empty(array.T.shape, [("real", "f4"), ("imag", "f4")])
        stored["real"], stored["imag"] = array.T.real, array.T.imag
    else:
        stored = array.T
    file.create_dataset(name, data=stored).attrs["MATLAB_class"] = np.bytes_(kind.encode())


def _read_npz(path):
    container = Container({})
    with np.load(path, allow_pickle=False) as file:
        for name in file.files:
            array = file[name]
            if name == NOTES and array.dtype.kind == "U":
                container.attributes.update(_object(array.item()))
            elif array.dtype.kind in "fiub" and array.size < 2:
                container.attributes[name] = array.item() if array.size else []
            elif array.dtype.kind in NUMBERS:
                container.arrays[name] = array
            elif array.dtype.kind == "U" and array.size == 1:
                container.attributes[name] = str(array.item())
    return container


def _object(text):
    values = json.loads(text)
    if not isinstance(values, dict):
        raise ValueError("its attributes are none")
    return values


def _write_npz(path, container):
    arrays = {**container.arrays, NOTES: np.array(json.dumps(container.attributes))}
    with zipfile.ZipFile(path, "w") as file:  # numpy.savez leaves it open where it is interrupted
        for name, array in arrays.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as part:
                np.lib.format.write_array(part, array, allow_pickle=False)


def _read_npy(path):
    array = np.load(path, allow_pickle=False)
    if not isinstance(array, np.ndarray) or array.dtype.kind not in NUMBERS:
        raise ValueError("it is no array of numbers")
    return Container({"array": array})


def _write_npy(path, container):
    if len(container.arrays) != 1:
        raise InvalidInput("A .npy file holds one array: choose .npz.")
    with open(path, "wb") as file:
        np.save(file, next(iter(container.arrays.values())))


def _read_safetensors(path):
    safetensors = needed("safetensors")
    with safetensors.safe_open(path, framework="numpy") as file:
        words = file.metadata() or {}
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # it is no dict
    return Container(
        {name: array for name, array in arrays.items() if array.dtype.kind in NUMBERS and array.ndim > 1},
        {name: _value(text) for name, text in words.items()}
        | {name: array.tolist() for name, array in arrays.items() if array.ndim < 2},
    )


def _value(text):
    try:
        return json.loads(text)
    except ValueError:
        return text


def _write_safetensors(path, container):
    numpy = needed("safetensors.numpy")
    words = {name: json.dumps(value) for name, value in container.attributes.items()}
    arrays = {name: np.ascontiguousarray(array) for name, array in container.arrays.items()}
    numpy.save_file(arrays, str(path), metadata=words)


def _reader_of(read_picture):
    """Reader of a kind of pictures, see `pictures`."""

    def reader(path):
        arrays, bits = read_picture(path)
        own = {name: {"bits": bits} for name in arrays} if bits else {}
        colored = frozenset(name for name, a in arrays.items() if a.ndim == 3 and name != pictures.PAGES)
        return Container(arrays, own=own, colored=colored)

    return reader


def _write_picture(path, container):
    raise InvalidInput(
        f"Fields and phases are no pictures: `holopath render` writes those; end the name on {', '.join(SUFFIXES)}."
    )


_KINDS: dict[str, tuple[Callable[[Path], Container], Callable[[Path, Container], None]]] = {
    ".h5": (_read_hdf5, _write_hdf5),
    ".hdf5": (_read_hdf5, _write_hdf5),
    ".mat": (_read_mat, _write_mat),
    ".npz": (_read_npz, _write_npz),
    ".npy": (_read_npy, _write_npy),
    ".safetensors": (_read_safetensors, _write_safetensors),
    ".png": (_reader_of(pictures.read_png), _write_picture),
    ".bmp": (_reader_of(pictures.read_bmp), _write_picture),
    ".exr": (_reader_of(pictures.read_exr), _write_picture),
    ".tif": (_reader_of(pictures.read_tiff), _write_picture),
    ".tiff": (_reader_of(pictures.read_tiff), _write_picture),
}
READABLE = tuple(_KINDS)
SUFFIXES = tuple(name for name, (_, writer) in _KINDS.items() if writer is not _write_picture)
