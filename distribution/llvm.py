"""The LLVM that Mitsuba computes with on the processor, as a wheel that any Python takes.

PyPI's package llvm-nanobind holds a whole LLVM as a shared library, beside a Python module that asks for Python
3.12. The library asks for none. It is taken out as it is, with what lies beside it and the texts of the licenses.
"""

import fnmatch
import tempfile
import zipfile
from pathlib import Path

from . import wheels

PACKAGE = "holopath_llvm"  # where holopath_addon/engine/scene/variants.py looks for it
LICENSES = Path(__file__).with_name("licenses")

# Files of llvm-nanobind's wheel, and their names in ours where they change: those by which others know LLVM.
LIBRARIES = {
    "linux-x64": {"llvm_nanobind.libs/libLLVM-*.so.*": "libLLVM.so.21.1", "llvm_nanobind.libs/*.so.*": None},
    "windows-x64": {"llvm/LLVM.dll": "LLVM-C.dll"},
    "macos-arm64": {"llvm_nanobind.dylibs/*.dylib": "libLLVM.dylib"},
}
# Of which libraries the licenses are in each.
LICENSED = {
    "linux-x64": ("llvm", "liblzma", "libxml2", "zstd"),
    "windows-x64": ("llvm",),
    "macos-arm64": ("llvm",),
}


def wheel(platform, folder, kept=wheels.KEPT, packed=True):
    """Write the wheel into `folder`, and return its path.

    Parameters
    ----------
    platform : str
        A key of `wheels.PIP_PLATFORMS`.
    folder : Path
    kept : Path, optional
        Where the wheels of the lock are, or are downloaded to.
    packed : bool, optional
        By LZMA; else not at all.

    Returns
    -------
    Path
    """
    (source,) = wheels.locked_wheels(platform, wheels.LLVM, kept)
    version = source.name.split("-")[1]
    system = source.name.rsplit("-", 1)[1].removesuffix(".whl")
    about = f"{PACKAGE}-{version}.dist-info"
    target = folder / f"{PACKAGE}-{version}-py3-none-{system}.whl"
    with zipfile.ZipFile(source) as theirs, wheels.writing(target, packed) as add:
        add(f"{PACKAGE}/__init__.py", b"")  # else folders of this name would be one package
        for name, member in sorted(_libraries(platform, theirs.namelist()).items()):
            add(f"{PACKAGE}/{name}", theirs.read(member))
        for name in LICENSED[platform]:
            add(f"{about}/licenses/{name}.txt", (LICENSES / f"{name}.txt").read_bytes())
        add(f"{about}/METADATA", _metadata(version, LICENSED[platform]).encode())
        tag = f"Root-Is-Purelib: false\nTag: py3-none-{system}\n"
        add(f"{about}/WHEEL", f"Wheel-Version: 1.0\nGenerator: HoloPath\n{tag}".encode())
    return target


def install(platform):
    """Have pip install it into the environment that runs this."""
    with tempfile.TemporaryDirectory(prefix="holopath-llvm-") as folder:
        wheels.install(wheel(platform, Path(folder), Path(folder), packed=False))


def _libraries(platform, names):
    """Members of llvm-nanobind's wheel by their names in ours."""
    found = {}
    for pattern, name in LIBRARIES[platform].items():
        matching = [n for n in fnmatch.filter(names, pattern) if n not in found.values()]
        if not matching:
            raise SystemExit(f"distribution: the wheel of LLVM for {platform} has no {pattern}.")
        found.update({name or member.rsplit("/", 1)[1]: member for member in matching})
    return found


def _metadata(version, licenses):
    files = "".join(f"License-File: {name}.txt\n" for name in licenses)
    return (
        f"Metadata-Version: 2.4\nName: holopath-llvm\nVersion: {version}\n"
        "Summary: LLVM as a shared library, from PyPI's llvm-nanobind\n"
        f"{files}"
    )
