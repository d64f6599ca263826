"""A process of its own that reads an HDF5 file: damaged ones bring HDF5's library down, and whoever has it loaded.

``python hdf5_reader.py FILE FOLDER`` writes each data set of numbers as ``N.npy``, and ``contents.json`` with their
names, and the attributes of all that is in the file. It knows nothing of HoloPath, whose modules take their time.
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np


def main(file, folder):
    """Read it all."""
    names, matlab, attributes = [], {}, {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset) and item.size and item.dtype.kind in "fiucV":
            array = numbers(item[()])
            if array is not None:
                if "MATLAB_class" in item.attrs:
                    matlab[name] = plain(item.attrs["MATLAB_class"])
                np.save(folder / f"{len(names)}.npy", array)
                names.append(name)
        attributes.update({key: plain(value) for key, value in item.attrs.items()})

    with h5py.File(file) as stored:
        attributes.update({key: plain(value) for key, value in stored.attrs.items()})
        stored.visititems(visit)
    known = {key: value for key, value in attributes.items() if value is not None}
    (folder / "contents.json").write_text(json.dumps({"names": names, "matlab": matlab, "attributes": known}))


def numbers(array):
    """An array; complex, of a compound of two as MATLAB and others write them; None of other compounds."""
    if array.dtype.kind != "V":
        return array
    names = array.dtype.names or ()
    if len(names) != 2 or any(array.dtype[name].kind != "f" for name in names):
        return None
    whole = np.empty(array.shape, np.result_type(array.dtype[names[0]], np.complex64))
    whole.real, whole.imag = (array[name] for name in names)
    return whole


def plain(value):
    """An attribute as words, numbers or a list of numbers; None of others."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist() if value.dtype.kind in "fiub" else None
    return value if isinstance(value, str) else None


if __name__ == "__main__":
    try:
        main(sys.argv[1], Path(sys.argv[2]))
    except Exception as error:  # there is no end to what a file may hold
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
