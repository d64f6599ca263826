"""How much memory this machine has, and what to say when work does not fit into it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from .errors import InvalidInput

AT_ONCE = 1 << 28  # bytes of fields of many frames that are traced together
LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # of a container


def installed() -> int | None:
    """Bytes that programs on this machine, or in this container, can have in all; None where it does not tell."""
    if sys.platform == "win32":
        return _windows()[0]
    try:
        whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError):
        return None
    for name in LIMITS:
        try:
            whole = min(whole, int(Path(name).read_text()))
        except (OSError, ValueError):  # there is none
            continue
    return whole


def available() -> int | None:
    """Bytes that are free now; all of them where the machine does not tell."""
    if sys.platform == "win32":
        return _windows()[1]
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        (free,) = (int(line.split()[1]) << 10 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, ValueError):
        return installed()
    return min(free, installed() or free)


def shortage(needed: float, doing: str) -> list[str]:
    """What to warn of when memory is short.

    Parameters
    ----------
    needed : float
        Bytes.
    doing : str
        What needs them, as the subject of a sentence.

    Returns
    -------
    list of str
        A sentence where less is free now, nothing otherwise.

    Raises
    ------
    InvalidInput
        If the machine has not as much at all.
    """
    whole, free = installed(), available()
    if whole is not None and needed > whole:
        raise InvalidInput(
            f"{doing} needs about {_gigabytes(needed)} of memory, and this machine has {_gigabytes(whole)}: choose "
            f"fewer pixels, frames or wavelengths, or bring the depth range nearer to the SLM."
        )
    if free is not None and needed > free:
        return [
            f"{doing} needs about {_gigabytes(needed)} of memory, and {_gigabytes(free)} are free: close other "
            f"programs, or choose fewer pixels, frames or wavelengths."
        ]
    return []


def _gigabytes(count):
    return f"{count / 1e9:.3g} GB"


def _windows():
    """Installed and free bytes; None where Windows does not tell."""
    import ctypes

    class Status(ctypes.Structure):
        _fields_ = [("length", ctypes.c_ulong), ("load", ctypes.c_ulong)] + [
            (name, ctypes.c_ulonglong) for name in ("whole", "free", *"abcde")
        ]

    status = Status(length=ctypes.sizeof(Status))
    # pyrefly: ignore[missing-attribute]  # there is one on Windows
    if not ctypes.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)):
        return None, None
    return status.whole, status.free
