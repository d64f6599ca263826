"""How much memory this machine has, or its graphics card, and what to say when work does not fit into it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InvalidInput

AT_ONCE = 1 << 28  # bytes of fields of many frames that are traced together
CARD_BATCH = 2 << 30  # bytes of a card's memory, free beside the field and phases, with which it encodes
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


def on_card(array: Any) -> tuple[int, int] | None:
    """Bytes of the graphics card whose memory an array lies in, in all and free now; None where that is the machine's.

    Parameters
    ----------
    array : array
        Of NumPy, CuPy, PyTorch or another library of the Array API standard.
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
    """Bytes of a card's memory that pictures of a field take.

    Parameters
    ----------
    field, images : float
        Bytes of the field and of the pictures.
    """
    return 2 * field + images


def encoding_on_card(field: float) -> float:
    """Bytes of a card's memory with which a field of so many is encoded there, in batches that go by what is free."""
    return 2 * field + CARD_BATCH


def on_processor(array: Any) -> np.ndarray:
    """NumPy's array of the same numbers; a copy where those are in a card's memory."""
    if isinstance(array, np.ndarray) or not hasattr(array, "__dlpack__"):
        return np.asarray(array)
    import array_api_compat

    if array_api_compat.is_torch_array(array):
        array = array.detach().resolve_conj()
    if array_api_compat.is_torch_array(array) or array_api_compat.is_cupy_array(array):
        array = array_api_compat.to_device(array, "cpu")
    return np.asarray(array)


def shortage(needed: float, doing: str, array: Any = None) -> list[str]:
    """What to warn of when memory is short.

    Parameters
    ----------
    needed : float
        Bytes.
    doing : str
        What needs them, as the subject of a sentence.
    array : array, optional
        In whose memory they are needed. Default: in the machine's.

    Returns
    -------
    list of str
        A sentence where less is free now, nothing otherwise.

    Raises
    ------
    InvalidInput
        If the machine, or the card, has not as much at all.
    """
    card = None if array is None else on_card(array)
    (whole, free), place = (
        card or (installed(), available()),
        "this graphics card" if card else "this machine",
    )
    if whole is not None and needed > whole:
        raise InvalidInput(
            f"{doing} needs about {_gigabytes(needed)} of memory, and {place} has {_gigabytes(whole)}: choose "
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
