"""The LLVM of PyPI's package llvm-nanobind, which `pip install holopath[llvm]` brings.

It is a shared library beside a Python module that is not imported here. As its file has an unusual name, Dr.Jit gets it
from the variable `DRJIT_LIBLLVM_PATH`. HoloPath's own package holopath_llvm has the usual name and takes precedence.
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
OLDEST_PYTHON = (3, 12)  # for which pip installs it; the library itself needs no Python

# Path of the library below the folder that holds the Python module `llvm`.
_PATTERNS = {
    "linux": "llvm_nanobind.libs/libLLVM-*.so*",
    "darwin": "llvm_nanobind.dylibs/libLLVM*.dylib",
    "win32": "llvm/LLVM.dll",
}


def library() -> Path | None:
    """Path of the library, without loading it.

    Returns
    -------
    Path or None
        None if the package is not installed.
    """
    module, pattern = importlib.util.find_spec("llvm"), _PATTERNS.get(sys.platform)
    if module is None or pattern is None:
        return None
    folders = [Path(folder).parent for folder in module.submodule_search_locations or ()]
    return next((path for folder in folders for path in sorted(folder.glob(pattern))), None)


def set_library_variable() -> None:
    """Have Dr.Jit use this LLVM when it is imported.

    Does nothing if Dr.Jit is imported already, the variable names another LLVM, or HoloPath's own is installed.
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
    """Shell command that installs this LLVM for the running Python.

    For a Python older than `OLDEST_PYTHON` pip refuses the package, unless it installs into a named folder.

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
