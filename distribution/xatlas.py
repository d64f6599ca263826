"""xatlas for a Python that PyPI has no wheel of it for, built from its source distribution.

The source is compiled by zig, which PyPI has as the package ziglang: it brings a C++ library to link in, and names of
an old C library, so that the module loads wherever Blender does. The headers are of the Python that it is for, which
must be on this computer. The binding is compiled with a newer pybind11 than lies in the source, one that knows that
Python.
"""

import platform as system
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import zipfile
from pathlib import Path

from . import wheels

PLATFORM = "linux-x64"
PYTHONS = ("3.14",)  # without a wheel on PyPI
TAG = "manylinux_2_17_x86_64.manylinux2014_x86_64"
TARGET = "x86_64-linux-gnu.2.17"
OPTIONS = (
    "-std=c++17",
    "-O2",
    "-DNDEBUG",
    "-fPIC",
    "-fvisibility=hidden",
    "-shared",
    "-s",
    "-w",
    "-mcpu=baseline",
)


def here():
    """Whether this computer can build it: one of `PLATFORM`."""
    return wheels.SYSTEMS.get((system.system(), system.machine())) == PLATFORM


def headers(python):
    """Folder of a Python's headers on this computer, by its program's own word.

    Parameters
    ----------
    python : str
        Such as ``3.14``.

    Returns
    -------
    Path or None
        None where the program or the headers are missing, and on other systems.
    """
    program = shutil.which(f"python{python}")
    if program is None or not here():
        return None
    command = [program, "-c", "import sysconfig; print(sysconfig.get_path('include'))"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    folder = Path(result.stdout.strip())
    return folder if not result.returncode and (folder / "Python.h").exists() else None


def missing(python):
    """What to do where `headers` finds none: a sentence."""
    return (
        f"There is no xatlas in what is built for Python {python}, so that baked light has a cell for every triangle: "
        f"building it takes Linux and that Python's headers (Debian: apt install python{python}-dev)."
    )


def wheel(python, include, folder, kept=wheels.KEPT):
    """Build the wheel into `folder`, and return its path.

    Parameters
    ----------
    python : str
        Such as ``3.14``.
    include : Path
        Folder of its headers, see `headers`.
    folder : Path
    kept : Path, optional
        Where the files of the lock are, or are downloaded to.

    Returns
    -------
    Path
    """
    files = {path.name.split("-")[0]: path for path in wheels.locked_wheels(PLATFORM, wheels.XATLAS, kept)}
    name = files["xatlas"].name.removesuffix(".tar.gz")
    version, tag = name.split("-")[1], "cp" + python.replace(".", "")
    about = f"{name}.dist-info"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="holopath-xatlas-") as temporary:
        work = Path(temporary)
        with tarfile.open(files["xatlas"]) as archive:
            archive.extractall(work, filter="data")
        for package in ("pybind11", "ziglang"):
            with zipfile.ZipFile(files[package]) as archive:
                archive.extractall(work)
        zig, module = work / "ziglang" / "zig", work / f"xatlas.cpython-{tag[2:]}-x86_64-linux-gnu.so"
        zig.chmod(0o755)
        source = Path(name)
        ours = source / "extern" / "xatlas" / "source" / "xatlas"
        sources = [*sorted((work / source / "src").glob("*.cpp")), work / ours / "xatlas.cpp"]
        command = [zig, "c++", "-target", TARGET, *OPTIONS, f"-DVERSION_INFO={version}"]
        command += [f"-I{path}" for path in ("pybind11/include", include, source / "src", ours)]
        # Debian's header leads to one of another folder; the C library's there must not come before zig's.
        command += [
            "-idirafter",
            include.parent,
            *[path.relative_to(work) for path in sources],
            "-o",
            module.name,
        ]
        result = subprocess.run(command, cwd=work, capture_output=True, text=True, check=False)
        if result.returncode:
            raise SystemExit(
                f"distribution: xatlas does not compile for Python {python}: {result.stderr[-2000:]}"
            )
        licenses = {"xatlas-python": source, "xatlas": source / "extern" / "xatlas"}
        metadata = (
            f"Metadata-Version: 2.4\nName: xatlas\nVersion: {version}\n"
            "Summary: Python bindings for xatlas, built for HoloPath from PyPI's source distribution\n"
            + "".join(f"License-File: {text}.txt\n" for text in licenses)
        )
        target = folder / f"{name}-{tag}-{tag}-{TAG}.whl"
        with wheels.writing(target, packed=True) as add:
            add(module.name, module.read_bytes())
            for text, place in licenses.items():
                add(f"{about}/licenses/{text}.txt", (work / place / "LICENSE").read_bytes())
            add(f"{about}/METADATA", metadata.encode())
            tags = "".join(f"Tag: {tag}-{tag}-{system}\n" for system in TAG.split("."))
            wheel_file = f"Wheel-Version: 1.0\nGenerator: HoloPath\nRoot-Is-Purelib: false\n{tags}"
            add(f"{about}/WHEEL", wheel_file.encode())
    return target


def install():
    """Build it for the Python that runs this, and have pip install it there."""
    python = "{}.{}".format(*sys.version_info)
    include = Path(sysconfig.get_path("include"))
    if not here() or not (include / "Python.h").exists():
        raise SystemExit(f"distribution: {missing(python)}")
    with tempfile.TemporaryDirectory(prefix="holopath-xatlas-") as folder:
        wheels.install(wheel(python, include, Path(folder), Path(folder)))
