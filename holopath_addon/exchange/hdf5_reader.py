"""A process of its own that reads an HDF5 file: damaged ones bring HDF5's library down, and whoever has it loaded.

``python hdf5_reader.py FILE FOLDER`` writes each data set of numbers as ``N.npy``, and ``contents.json`` with their
names and their attributes, and the attributes on which all that is in the file agrees. It knows nothing of HoloPath,
whose modules take their time.
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np

COMPLEX = (
    ("r", "i"),
    ("re", "im"),
    ("real", "imag"),
    ("real", "imaginary"),
)  # names of a compound's two numbers

PER_ARRAY = ("units", "bits")  # attributes that tell nothing of other arrays


def main(file, folder):
    """Read it all."""
    names, matlab, own = [], {}, {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset) and item.size and item.dtype.kind in "fiucbV":
            array = numbers(item[()])
            if array is not None:
                if "MATLAB_class" in item.attrs:
                    matlab[name] = plain(item.attrs["MATLAB_class"])
                np.save(folder / f"{len(names)}.npy", array)
                names.append(name)
        own[name] = known(item)

    with h5py.File(file) as stored:
        own["/"] = known(stored)
        stored.visititems(visit)
    attributes, several = {}, set()
    for name, said in own.items():
        said = said if name == "/" else {key: said[key] for key in said if key not in PER_ARRAY}
        several |= {key for key in said if key in attributes and said[key] != attributes[key]}
        attributes.update(said)
    attributes = {key: value for key, value in attributes.items() if key not in several} | own.pop("/")
    found = {"names": names, "matlab": matlab, "attributes": attributes, "own": own}
    (folder / "contents.json").write_text(json.dumps(found))


def known(item):
    """Attributes of a file, a group or a data set that are words, numbers or lists of numbers."""
    values = {key: plain(value) for key, value in item.attrs.items()}
    return {key: value for key, value in values.items() if value is not None}


def numbers(array):
    """An array; complex, of a compound of two as MATLAB and others write them; None of other compounds."""
    if array.dtype.kind != "V":
        return array
    names = array.dtype.names or ()
    if tuple(name.lower() for name in names) not in COMPLEX or any(
        array.dtype[name].kind != "f" for name in names
    ):
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
