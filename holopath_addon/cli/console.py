"""Progress and remarks on standard error; saved files on standard output, where render farms read them."""

import os
import sys
import threading
import time
from contextlib import contextmanager

ENABLE_VIRTUAL_TERMINAL_PROCESSING = 4  # Windows' name
MAX_SILENCE = 60.0  # seconds; batch systems stop work that prints nothing for some minutes

_open_line = False
_latest = None  # latest line of progress, printed or not
_print_time = 0.0  # of the last line, on the monotonic clock


def close_line():
    """End the line of progress that a terminal updates in place."""
    global _open_line
    if _open_line:
        print(file=sys.stderr)
        _open_line = False


def takes_escapes(stream):
    """Whether a text stream is a terminal that understands escape sequences, as a window of Windows does when told."""
    if not stream.isatty() or os.name != "nt":
        return stream.isatty()
    import ctypes
    import msvcrt

    kernel, mode = ctypes.windll.kernel32, ctypes.c_ulong()  # pyrefly: ignore[missing-attribute]  # of Windows
    handle = ctypes.c_void_p(msvcrt.get_osfhandle(stream.fileno()))  # pyrefly: ignore[missing-attribute]
    is_console = kernel.GetConsoleMode(handle, ctypes.byref(mode))
    return bool(is_console and kernel.SetConsoleMode(handle, mode.value | ENABLE_VIRTUAL_TERMINAL_PROCESSING))


@contextmanager
def heartbeat():
    """Repeat the latest progress after each minute of silence within the block, except in a terminal.

    A thread prints it, because Mitsuba and Blender may compute for long without a call of the progress.
    """
    global _latest, _print_time
    if sys.stderr.isatty():
        yield
        return
    _latest, _print_time = None, time.monotonic()
    stop = threading.Event()
    thread = threading.Thread(target=_repeat, args=(stop,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _repeat(stop):
    global _print_time
    while not stop.wait(max(0.0, _print_time + MAX_SILENCE - time.monotonic())):
        if time.monotonic() - _print_time < MAX_SILENCE:
            continue  # something was printed meanwhile
        _print_time = time.monotonic()
        if _latest is not None:
            print(f"{_latest} (still at work)", file=sys.stderr, flush=True)


class Progress:
    """Progress on standard error: one updating line in a terminal, a line now and then elsewhere.

    Parameters
    ----------
    quiet : bool
        Whether to print nothing, not even on standard output.
    """

    def __init__(self, quiet=False):
        self._quiet = quiet
        self._terminal = takes_escapes(sys.stderr)
        self._last_time, self._last_done, self._last_message = time.monotonic(), -1.0, None

    def __call__(self, done, message):
        """Print progress if it is news and due.

        Parameters
        ----------
        done : float
            Fraction of the work.
        message : str
        """
        global _open_line, _latest, _print_time
        if self._quiet:
            return
        line = f"{done:4.0%} {message}"
        _latest = line if done < 1 else None
        now = time.monotonic()
        wait, step = (0.1, 0.0) if self._terminal else (2.0, 0.1)
        is_news = done - self._last_done >= step or message != self._last_message
        if not (is_news and now - self._last_time >= wait or done >= 1):
            return
        self._last_time, self._last_done, self._last_message = now, done, message
        _print_time = now
        if self._terminal:
            print(f"\r\x1b[K{line}", end="\n" if done >= 1 else "", file=sys.stderr, flush=True)
            _open_line = done < 1
        else:
            print(line, file=sys.stderr, flush=True)

    def say(self, text):
        """Print a remark in a line of its own.

        Parameters
        ----------
        text : str
        """
        if not self._quiet:
            close_line()
            print(text, file=sys.stderr)

    def saved(self, picture, seconds):
        """Print the file of a finished still or frame on standard output in Blender's words, which render farms read.

        Parameters
        ----------
        picture : path
            Viewable image.
        seconds : float
            Time of its render.
        """
        if self._quiet:
            return
        close_line()
        text = f"Saved: '{picture}'\nTime: {_timecode(seconds)}\n"
        encoding = sys.stdout.encoding or "utf-8"
        # Names of files may have letters that the encoding lacks.
        print(text.encode(encoding, "backslashreplace").decode(encoding), end="", flush=True)


def _timecode(seconds):
    """A time as ``01:02.34``, or ``01:00:02.34`` from an hour on."""
    hundredths = int(seconds * 100)
    minutes, hundredths = divmod(hundredths, 6000)
    hours, minutes = divmod(minutes, 60)
    short = f"{minutes:02d}:{hundredths // 100:02d}.{hundredths % 100:02d}"
    return f"{hours:02d}:{short}" if hours else short
