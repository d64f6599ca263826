"""Microsoft's C++ library for our binaries of Windows, under a name of its own.

Blender 4.2 to 5.0 load a MSVCP140.dll of 2021. Mitsuba, LLVM and xatlas need one of 2024: their mutexes begin as
zeros, which the older library takes for an address when one is locked. So these, Dr.Jit and CuPy import the library
of PyPI's package msvc-runtime instead, as delvewheel has it for the wheels of NumPy and SciPy. Microsoft allows its
unmodified form: the file stays as it is, under another name. The two names are equally long, so that in our binaries
nothing else changes.

The C runtime stays Blender's: vcruntime140.dll, vcruntime140_1.dll, and what Windows itself has as api-ms-win-crt-*.
What one library throws another one catches, which takes one runtime for both; and that of 2021 has all functions that
are needed. `proof` holds that.
"""

import fnmatch
import hashlib
import re
import zipfile

from . import wheels

PLATFORM = "windows-x64"
LIBRARY = "msvcp140.dll"
NAMED = re.compile(rb"(?i)\bmsvcp140\.dll\0")  # in a binary's table of imports
BINARY = re.compile(r"\.(dll|pyd|exe)$", re.IGNORECASE)

# Which packages import it, and the folder of a copy: of those that can be loaded first, beside the binary. Mitsuba
# imports Dr.Jit before, and Windows' loader takes what is in memory under a name. CuPy's binaries lie in many folders:
# the extension that brings them loads the copy first.
COPIES = {
    "drjit": "drjit/",
    "holopath_llvm": "holopath_llvm/",
    "xatlas": "",
    "mitsuba": None,
    "cupy_cuda12x": "cupy_backends/",
}


def own(wheel, folder, kept=wheels.KEPT, packed=True):
    """A wheel whose binaries import the library under its own name.

    Parameters
    ----------
    wheel : Path
        One of Windows.
    folder : Path
        Where the new one is written to, under the same file name.
    kept : Path, optional
        Where the wheels of the lock are, or are downloaded to.
    packed : bool, optional
        By LZMA; else not at all.

    Returns
    -------
    Path
        Of the new wheel; of the given one where its package is not in `COPIES`.
    """
    package = wheel.name.split("-")[0].lower()
    if package not in COPIES:
        return wheel
    (source,) = wheels.locked_wheels(PLATFORM, wheels.CPP, kept)
    with zipfile.ZipFile(source) as archive:
        library = archive.read(_member(archive, f"*.data/data/{LIBRARY}"))
        license_text = archive.read(_member(archive, "*.dist-info/licenses/LICENSE"))
    name = name_of(library)
    target = folder / wheel.name
    with zipfile.ZipFile(wheel) as archive, wheels.writing(target, packed) as add:
        record = _member(archive, "*.dist-info/RECORD")
        changed = 0
        for member in sorted(archive.namelist()):
            if member.endswith("/") or member == record:
                continue
            data = archive.read(member)
            if BINARY.search(member):
                data, count = NAMED.subn(name.encode() + b"\0", data)
                changed += count
            add(member, data)
        if not changed:
            raise SystemExit(
                f"distribution: no binary of {wheel.name} imports {LIBRARY}: take it out of COPIES."
            )
        if (beside := COPIES[package]) is not None:
            add(beside + name, library)
            add(f"{record.removesuffix('RECORD')}licenses/{LIBRARY}.txt", license_text)
    return target


def name_of(library):
    """The name of its own, as long as `LIBRARY`, by its SHA-256: another build has another name."""
    return f"cpp{hashlib.sha256(library).hexdigest()[:5]}.dll"


def _member(archive, pattern):
    (found,) = fnmatch.filter(archive.namelist(), pattern)
    return found
