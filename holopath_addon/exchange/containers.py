"""Kinds of files: named arrays with attributes, which are strings, numbers and lists of numbers.

No file can execute code: nothing is unpickled. HDF5 is read in a separate process, see `hdf5_reader`.
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
from .optional import import_library

Attributes = dict[str, Any]
ATTRIBUTES_NAME = "attributes"  # of the array that holds them, in files of arrays only
# Seconds, and bytes per second: a longer reading of HDF5 is an endless loop
PATIENCE, MIN_RATE = 30.0, 1e6
USER_BLOCK = 512  # bytes before the HDF5 of a MATLAB file
_MATLAB = {"f4": "single", "f8": "double", "c8": "single", "u1": "uint8", "u2": "uint16"}
NUMBERS = "fiucb"  # kinds of NumPy's numeric types
PICKLE_SUFFIXES = (".pt", ".pth", ".pkl", ".pickle")


@dataclass
class Container:
    """The contents of a file.

    Attributes
    ----------
    arrays : dict of str to numpy.ndarray
        Arrays of numbers by name.
    attributes : dict of str to str, float or list of float
        Attributes of the file, and those on which all of its arrays agree.
    array_attributes : dict of str to dict
        Attributes of arrays by the arrays' names.
    color_arrays : frozenset of str
        Names of arrays whose last of three axes is red, green and blue.
    """

    arrays: dict[str, np.ndarray]
    attributes: Attributes = field(default_factory=dict)
    array_attributes: dict[str, Attributes] = field(default_factory=dict)
    color_arrays: frozenset[str] = frozenset()


def read(path: Path | str) -> Container:
    """Read all arrays of numbers in a file, and its attributes.

    Parameters
    ----------
    path : path
        Its suffix is one of `READABLE`.

    Returns
    -------
    Container

    Raises
    ------
    InvalidInput
        If the file cannot be read, or its suffix is unknown.
    BackendUnavailable
        If the library for it is not installed.
    """
    path = Path(path)
    reader, _ = _kind(path)
    try:
        if not path.is_file():
            raise InvalidInput(f"The file {path} does not exist. Give a file of {', '.join(READABLE)}.")
        container = reader(path)
    except (InvalidInput, BackendUnavailable, Cancelled):
        raise
    except Exception as error:  # a file may hold anything
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InvalidInput(
            f"{path} cannot be read ({reason}). Write it again, or give another file."
        ) from error
    if not container.arrays:
        raise InvalidInput(f"{path} has no array of numbers. Give another file.")
    return container


def write(path: Path | str, container: Container) -> None:
    """Write a file, which appears complete or not at all, and replaces an existing one.

    Parameters
    ----------
    path : path
        Its suffix is one of `SUFFIXES`.
    container : Container
        Arrays and attributes; attributes of single arrays are not written.

    Raises
    ------
    InvalidInput
        If the suffix is unknown, that kind of file cannot hold the container, or the path cannot be a file.
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
    if suffix in PICKLE_SUFFIXES:
        raise InvalidInput(
            f"{path} is pickled, and could run any code when it is read. Write the tensor with "
            "safetensors.torch.save_file, or numpy.save."
        )
    if suffix not in _KINDS:
        raise InvalidInput(f"Expected a file of {', '.join(READABLE)}, got {path}.")
    return _KINDS[suffix]


def _read_hdf5(path):
    """Read the data sets of all groups by their path, and the attributes of the file and of data sets."""
    arrays, _, attributes, array_attributes = _hdf5(path)
    return Container(arrays, attributes, array_attributes)


def _hdf5(path):
    """Arrays, their MATLAB classes, attributes, and attributes of arrays, see `hdf5_reader`."""
    import_library("h5py")
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
                timeout=PATIENCE + path.stat().st_size / MIN_RATE,
            )
        except subprocess.TimeoutExpired:
            raise ValueError("it is damaged: reading it does not end") from None
        if process.returncode:
            reason = process.stderr.splitlines()[-1:] if process.returncode > 0 else []
            raise ValueError(*reason or ("it is damaged",))
        contents = json.loads((Path(folder) / "contents.json").read_text())
        arrays = {name: np.load(Path(folder) / f"{n}.npy") for n, name in enumerate(contents["names"])}
    return arrays, contents["matlab"], contents["attributes"], contents["array_attributes"]


def _write_hdf5(path, container):
    h5py = import_library("h5py")
    with h5py.File(path, "w") as file:
        for name, array in container.arrays.items():
            file.create_dataset(name, data=array).attrs.update(container.attributes)


def _read_mat(path):
    """Read a MATLAB file of version 7.3, which is HDF5, or an earlier one, which SciPy reads."""
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
        elif value.dtype.kind in "fiub" and value.ndim <= 2 and min(value.shape, default=1) == 1:
            numbers = value.ravel().tolist()
            container.attributes[name] = numbers[0] if len(numbers) == 1 else numbers
        elif value.dtype.kind in NUMBERS:
            container.arrays[name] = value
    return container


def _from_matlab(array, kind):
    """A string, or an array in MATLAB's order of axes, which HDF5 reverses."""
    if kind == "char":
        return array.astype(np.uint16).tobytes().decode("utf-16-le")
    return (array.astype(bool) if kind == "logical" else array).T


def _write_mat(path, container):
    """Write version 7.3: HDF5 after a block of text, with axes in reverse, and numbers as 1 x 1 arrays."""
    h5py = import_library("h5py")
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
        raise InvalidInput(f"MATLAB files cannot hold arrays of {array.dtype}. Choose another kind of file.")
    if np.iscomplexobj(array):
        data = np.empty(array.T.shape, [("real", "f4"), ("imag", "f4")])
        data["real"], data["imag"] = array.T.real, array.T.imag
    else:
        data = array.T
    file.create_dataset(name, data=data).attrs["MATLAB_class"] = np.bytes_(kind.encode())


def _read_npz(path):
    container = Container({})
    with np.load(path, allow_pickle=False) as file:
        for name in file.files:
            array = file[name]
            if name == ATTRIBUTES_NAME and array.dtype.kind == "U":
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
        raise ValueError("its attributes are not a JSON object")
    return values


def _write_npz(path, container):
    arrays = {**container.arrays, ATTRIBUTES_NAME: np.array(json.dumps(container.attributes))}
    with zipfile.ZipFile(path, "w") as file:  # an interrupted numpy.savez leaves the file open
        for name, array in arrays.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as part:
                np.lib.format.write_array(part, array, allow_pickle=False)


def _read_npy(path):
    array = np.load(path, allow_pickle=False)
    if not isinstance(array, np.ndarray) or array.dtype.kind not in NUMBERS:
        raise ValueError("it is not an array of numbers")
    return Container({"array": array})


def _write_npy(path, container):
    if len(container.arrays) != 1:
        raise InvalidInput("A .npy file holds one array. Choose .npz.")
    with open(path, "wb") as file:
        np.save(file, next(iter(container.arrays.values())))


def _read_safetensors(path):
    safetensors = import_library("safetensors")
    with safetensors.safe_open(path, framework="numpy") as file:
        words = file.metadata() or {}
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # not a dict
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
    numpy = import_library("safetensors.numpy")
    words = {name: json.dumps(value) for name, value in container.attributes.items()}
    arrays = {name: np.ascontiguousarray(array) for name, array in container.arrays.items()}
    numpy.save_file(arrays, str(path), metadata=words)


def _reader_of(read_picture):
    """Make the reader of a kind of picture from a function of `pictures`."""

    def reader(path):
        arrays, bits = read_picture(path)
        attributes = {name: {"bits": bits} for name in arrays} if bits else {}
        colors = frozenset(name for name, a in arrays.items() if a.ndim == 3 and name != pictures.PAGES)
        return Container(arrays, array_attributes=attributes, color_arrays=colors)

    return reader


def _write_picture(path, container):
    raise InvalidInput(
        f"Fields and phases cannot be written as pictures. Give a file of {', '.join(SUFFIXES)}. Pictures of phases "
        "lie in the folder hologram, and those for a device are what `holopath stream DIR --driver files` writes."
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
