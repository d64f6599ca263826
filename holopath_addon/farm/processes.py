"""Processes: which one is meant, on which machine, whether it still runs, and when it may be interrupted."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
# Of Windows, for `_started_on_windows`.
_QUERY_LIMITED_INFORMATION = 0x1000
_STILL_ACTIVE = 259


def host() -> str:
    """This machine's name, for people."""
    return socket.gethostname()


@cache
def place() -> str:
    """Where a process's number means this very process: the machine since it was started, and, in a container, that."""
    if sys.platform != "linux":
        return host()
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    return f"{host()} {boot} {os.stat('/proc/self/ns/pid').st_ino}"


def started(pid: int) -> str:
    """When a process of this place was started, in the system's own terms; empty if it does not run.

    Numbers of processes are given again, so that the number alone does not tell a process.
    """
    if sys.platform == "linux":
        return _started_on_linux(pid)
    if sys.platform == "win32":
        return _started_on_windows(pid)
    words = ["ps", "-o", "state=,lstart=", "-p", str(pid)]
    told = subprocess.run(words, capture_output=True, text=True, check=False).stdout.split()
    return " ".join(told[1:]) if told and told[0][0] != "Z" else ""


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait for the end of the block.

    bpy and Mitsuba crash where it tears their import, and nobody would know of a file that was made just then.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before = {number: signal.signal(number, lambda got, _: arrived.append(got)) for number in INTERRUPTS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)
        if arrived:
            signal.raise_signal(arrived[0])  # to whom it was for, which may be a block around this one


def _started_on_linux(pid):
    try:
        told = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return ""
    fields = told.rpartition(")")[2].split()  # the name in front may hold anything
    return "" if fields[0] in "ZX" else fields[19]  # proc_pid_stat(5): state, starttime


def _started_on_windows(pid):
    import ctypes
    from ctypes import wintypes

    # pyrefly: ignore[missing-attribute]  # of Windows alone
    kernel = ctypes.WinDLL("kernel32", use_last_error=True)
    kernel.OpenProcess.restype = wintypes.HANDLE
    kernel.CloseHandle.argtypes = [wintypes.HANDLE]
    kernel.GetExitCodeProcess.argtypes = [wintypes.HANDLE, ctypes.POINTER(wintypes.DWORD)]
    kernel.GetProcessTimes.argtypes = [wintypes.HANDLE, *[ctypes.POINTER(wintypes.FILETIME)] * 4]
    process = kernel.OpenProcess(_QUERY_LIMITED_INFORMATION, False, pid)
    if not process:
        return ""
    try:
        code, times = wintypes.DWORD(), [wintypes.FILETIME() for _ in range(4)]
        known = kernel.GetExitCodeProcess(process, ctypes.byref(code))
        known = known and kernel.GetProcessTimes(process, *map(ctypes.byref, times))
        begun = times[0].dwHighDateTime << 32 | times[0].dwLowDateTime
        return str(begun) if known and code.value == _STILL_ACTIVE else ""
    finally:
        kernel.CloseHandle(process)
