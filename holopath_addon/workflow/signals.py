"""Signals that Python ignores by itself, and the Python in Blender does not."""

import signal
import threading


def ignore_signals_of_writes() -> None:
    """Have writes that fail raise an exception in this whole process, from now on.

    These are writes to a program that has ended (a display's window, ffmpeg, a worker; SIGPIPE) and beyond the largest
    allowed size of a file (SIGXFSZ). By default either ends a process at once, and Blender without a message. Threads
    may still write when HoloPath is disabled, so nothing is restored.
    """
    if threading.current_thread() is not threading.main_thread():  # only that one may
        return
    for name in ("SIGPIPE", "SIGXFSZ"):  # Windows has neither
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, signal.SIG_IGN)
