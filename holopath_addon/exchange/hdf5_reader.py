"""A program that reads an HDF5 file in a separate process, as damaged files crash HDF5's library.

``python hdf5_reader.py FILE FOLDER`` writes each data set of numbers as ``N.npy``, and ``contents.json`` with their
names and attributes, and the attributes on which the whole file agrees. It does not import HoloPath, to start fast.
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np

# Names of the two numbers of a compound type that is complex
COMPLEX = (("r", "i"), ("re", "im"), ("real", "imag"), ("real", "imaginary"))
PER_ARRAY = ("units", "bits")  # attributes that hold for one array only


def main(file, folder):
    """Read a file, and write its contents to a folder."""
    names, matlab, item_attributes = [], {}, {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset) and item.size and item.dtype.kind in "fiucbV":
            array = numbers(item[()])
            if array is not None:
                if "MATLAB_class" in item.attrs:
                    matlab[name] = plain(item.attrs["MATLAB_class"])
                np.save(folder / f"{len(names)}.npy", array)
                names.append(name)
        item_attributes[name] = attributes_of(item)

    with h5py.File(file) as root:
        item_attributes["/"] = attributes_of(root)
        root.visititems(visit)
    shared, conflicts = {}, set()
    for name, values in item_attributes.items():
        values = values if name == "/" else {key: values[key] for key in values if key not in PER_ARRAY}
        conflicts |= {key for key in values if key in shared and values[key] != shared[key]}
        shared.update(values)
    shared = {key: value for key, value in shared.items() if key not in conflicts} | item_attributes.pop("/")
    contents = {"names": names, "matlab": matlab, "attributes": shared, "array_attributes": item_attributes}
    (folder / "contents.json").write_text(json.dumps(contents))


def attributes_of(item):
    """Attributes of a file, group or data set that are strings, numbers or lists of numbers."""
    values = {key: plain(value) for key, value in item.attrs.items()}
    return {key: value for key, value in values.items() if value is not None}


def numbers(array):
    """An array of numbers, complex for compounds of two numbers as MATLAB writes them; None for other compounds."""
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
    """An attribute as a string, number or list of numbers; None for other types."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist() if value.dtype.kind in "fiub" else None
    return value if isinstance(value, str) else None


if __name__ == "__main__":
    try:
        main(sys.argv[1], Path(sys.argv[2]))
    except Exception as error:  # a file may hold anything
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
