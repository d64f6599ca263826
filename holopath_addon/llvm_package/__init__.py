"""The LLVM of PyPI's package llvm-nanobind, which `pip install holopath[llvm]` brings.

It is a shared library beside a Python module that nobody imports here. Its file has a name of its own, so that it is
named to Dr.Jit in `DRJIT_LIBLLVM_PATH`. HoloPath's own package holopath_llvm has it under its usual name, and comes
first.
"""

from __future__ import annotations

import importlib.util
import os
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

PIN = "llvm-nanobind==21.1.6.3"  # as in the extra `llvm` of pyproject.toml
OLDEST_PYTHON = (3, 12)  # that pip installs it for; the library itself asks for none

# The library, from the folder that holds the Python module `llvm`.
_PATTERNS = {
    "linux": "llvm_nanobind.libs/libLLVM-*.so*",
    "darwin": "llvm_nanobind.dylibs/libLLVM*.dylib",
    "win32": "llvm/LLVM.dll",
}


def library() -> Path | None:
    """Path of the library where the package is installed. Loads nothing.

    Returns
    -------
    Path or None
    """
    module, pattern = importlib.util.find_spec("llvm"), _PATTERNS.get(sys.platform)
    if module is None or pattern is None:
        return None
    folders = [Path(folder).parent for folder in module.submodule_search_locations or ()]
    return next((path for folder in folders for path in sorted(folder.glob(pattern))), None)


def name() -> None:
    """Have Dr.Jit take this LLVM, if it is imported later.

    Not where it was imported before, where somebody has named another, or where HoloPath's own LLVM is installed.
    """
    if (
        "drjit" in sys.modules
        or "DRJIT_LIBLLVM_PATH" in os.environ
        or importlib.util.find_spec("holopath_llvm")
    ):
        return
    if path := library():
        os.environ["DRJIT_LIBLLVM_PATH"] = str(path)


def command() -> str:
    """The command that brings this LLVM to the Python that runs this, to be pasted into a shell.

    pip refuses the package for a Python older than `OLDEST_PYTHON`. It takes it there into a folder that is named,
    and the library serves any Python.

    Returns
    -------
    str
    """
    words = [sys.executable, "-m", "pip", "install"]
    if sys.version_info < OLDEST_PYTHON:
        words += ["--ignore-requires-python", f"--python-version={'.'.join(map(str, OLDEST_PYTHON))}"]
        words += ["--no-deps", "--only-binary=:all:", f"--target={sysconfig.get_path('platlib')}"]
    words.append(PIN)
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)
