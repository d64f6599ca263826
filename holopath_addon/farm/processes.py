"""Identity of processes, whether they still run, and delayed interrupts."""

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
# Windows constants for `_start_time_on_windows`.
_QUERY_LIMITED_INFORMATION = 0x1000
_STILL_ACTIVE = 259


def host() -> str:
    """Name of this machine, for messages."""
    return socket.gethostname()


@cache
def place() -> str:
    """The scope in which process numbers are unique: this boot of the machine, and the container."""
    if sys.platform != "linux":
        return host()
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    return f"{host()} {boot} {os.stat('/proc/self/ns/pid').st_ino}"


def start_time(pid: int) -> str:
    """Start time of a process of this place in the system's own form; empty if it does not run.

    Process numbers are reused, so a process is identified by number and start time.
    """
    if sys.platform == "linux":
        return _start_time_on_linux(pid)
    if sys.platform == "win32":
        return _start_time_on_windows(pid)
    words = ["ps", "-o", "state=,lstart=", "-p", str(pid)]
    output = subprocess.run(words, capture_output=True, text=True, check=False).stdout.split()
    return " ".join(output[1:]) if output and output[0][0] != "Z" else ""


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM until the end of the block.

    An interrupt during import makes bpy and Mitsuba crash, and one after a file's creation would lose track of it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrivals: list[int] = []
    handlers = {number: signal.signal(number, lambda got, _: arrivals.append(got)) for number in INTERRUPTS}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler or signal.SIG_DFL)
        if arrivals:
            signal.raise_signal(arrivals[0])  # to the previous handler, which may be that of an outer block


def _start_time_on_linux(pid):
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return ""
    fields = text.rpartition(")")[2].split()  # the name before may contain anything
    return "" if fields[0] in "ZX" else fields[19]  # proc_pid_stat(5): state, starttime


def _start_time_on_windows(pid):
    import ctypes
    from ctypes import wintypes

    # pyrefly: ignore[missing-attribute]  # only on Windows
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
        success = kernel.GetExitCodeProcess(process, ctypes.byref(code))
        success = success and kernel.GetProcessTimes(process, *map(ctypes.byref, times))
        start = times[0].dwHighDateTime << 32 | times[0].dwLowDateTime
        return str(start) if success and code.value == _STILL_ACTIVE else ""
    finally:
        kernel.CloseHandle(process)
