"""Pipes to programs that may end: a display's window, ffmpeg, workers."""

import signal
import threading
from collections.abc import Callable


def ignore_broken_pipes() -> Callable[[], None]:
    """Make a write to a program that has ended raise BrokenPipeError, in this whole process.

    Python does so by itself, but not the Python in Blender: there such a write would end Blender at once, without a
    message.

    Returns
    -------
    callable
        Called without arguments, it restores what was before.
    """
    number = getattr(signal, "SIGPIPE", None)  # Windows has no such signal
    if number is None or threading.current_thread() is not threading.main_thread():
        return lambda: None
    before = signal.signal(number, signal.SIG_IGN)

    def restore():
        signal.signal(number, signal.SIG_DFL if before is None else before)

    return restore
