"""Memory of this machine and its graphics card: how much there is, and messages where it is short."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InvalidInput

AT_ONCE = 1 << 28  # bytes of fields of many frames that are traced together
CARD_BATCH = 2 << 30  # bytes of a card's memory for encoding, besides field and phases
CGROUPS = Path("/sys/fs/cgroup")  # limits of containers, services and batch jobs, see cgroups(7)


def installed() -> int | None:
    """Total memory of this machine or container, bytes; None if unknown."""
    if sys.platform == "win32":
        return _windows()[0]
    try:
        whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError):
        return None
    try:
        groups = Path("/proc/self/cgroup").read_text()
    except OSError:
        groups = ""
    for file in limit_files(groups):
        try:
            whole = min(whole, int(file.read_text()))
        except (OSError, ValueError):  # no limit
            continue
    return whole


def limit_files(groups: str) -> list[Path]:
    """Files with the limits of control groups and of their ancestors, of versions 1 and 2.

    Parameters
    ----------
    groups : str
        Text of ``/proc/self/cgroup``. In a container its paths may be those of the host, so the root is always taken.
    """
    files: list[Path] = []
    for line in ["0::/", "1:memory:/", *groups.splitlines()]:
        _, controllers, path = [*line.split(":", 2), "", ""][:3]
        if controllers and "memory" not in controllers.split(","):
            continue
        root, name = (CGROUPS / "memory", "memory.limit_in_bytes") if controllers else (CGROUPS, "memory.max")
        group = root / path.lstrip("/")
        files += [folder / name for folder in (group, *group.parents) if folder.is_relative_to(root)]
    return list(dict.fromkeys(files))


def available() -> int | None:
    """Free memory, bytes; the total if unknown."""
    if sys.platform == "win32":
        return _windows()[1]
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        (free,) = (int(line.split()[1]) << 10 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, ValueError):
        return installed()
    return min(free, installed() or free)


def on_card(array: Any) -> tuple[int, int] | None:
    """Total and free memory in bytes of the graphics card that holds an array; None if it is in the machine's memory.

    Parameters
    ----------
    array : array
        Array of NumPy, CuPy, PyTorch or another library of the Array API standard.
    """
    if isinstance(array, np.ndarray):
        return None
    import array_api_compat

    if array_api_compat.is_torch_array(array) and array.is_cuda:
        import torch

        free, whole = torch.cuda.mem_get_info(array.device)
        pool = torch.cuda.memory_reserved(array.device) - torch.cuda.memory_allocated(array.device)
        return whole, free + pool
    if array_api_compat.is_cupy_array(array):
        import cupy

        with array.device:
            free, whole = cupy.cuda.runtime.memGetInfo()
            return whole, free + cupy.get_default_memory_pool().free_bytes()
    return None


def refocusing_on_card(field: float, images: float) -> float:
    """Bytes of a card's memory for refocusing.

    Parameters
    ----------
    field, images : float
        Bytes of the field and of its images.
    """
    return 2 * field + images


def encoding_on_card(field: float) -> float:
    """Bytes of a card's memory for encoding a field of `field` bytes; the size of batches follows the free memory."""
    return 2 * field + CARD_BATCH


def on_processor(array: Any) -> np.ndarray:
    """NumPy array of the same numbers; a copy if these are in a card's memory."""
    if isinstance(array, np.ndarray) or not hasattr(array, "__dlpack__"):
        return np.asarray(array)
    import array_api_compat

    if array_api_compat.is_torch_array(array):
        array = array.detach().resolve_conj()
    if array_api_compat.is_torch_array(array) or array_api_compat.is_cupy_array(array):
        array = array_api_compat.to_device(array, "cpu")
    return np.asarray(array)


def shortage(needed: float, doing: str, array: Any = None) -> list[str]:
    """Warnings of too little free memory.

    Parameters
    ----------
    needed : float
        Bytes.
    doing : str
        Work that needs them, as the subject of a sentence.
    array : array, optional
        Array whose memory is used. Default: the machine's memory.

    Returns
    -------
    list of str
        One warning if less is free now, otherwise none.

    Raises
    ------
    InvalidInput
        If the machine, or the card, has less in total.
    """
    card = None if array is None else on_card(array)
    (whole, free), place = (
        card or (installed(), available()),
        "this graphics card" if card else "this machine",
    )
    if whole is not None and needed > whole:
        raise InvalidInput(
            f"{doing} needs about {gigabytes(needed)} of memory, and {place} has {gigabytes(whole)}. Choose "
            f"fewer pixels, frames or wavelengths, or a depth range nearer to the SLM."
        )
    if free is not None and needed > free:
        return [
            f"{doing} needs about {gigabytes(needed)} of memory, and {gigabytes(free)} are free. Close other "
            f"programs, or choose fewer pixels, frames or wavelengths."
        ]
    return []


def gigabytes(count: float) -> str:
    """A number of bytes in words."""
    return f"{count / 1e9:.3g} GB"


def _windows():
    """Total and free memory of Windows, bytes; None if unknown."""
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
