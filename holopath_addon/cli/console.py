"""Progress and remarks on standard error; on standard output, what a render farm listens for."""

import sys
import threading
import time
from contextlib import contextmanager

SILENCE = 60.0  # seconds; batch systems take work that says nothing for some minutes for dead

_open_line = False
_latest = None  # line of progress, printed or not
_printed = 0.0  # when one was, on the monotonic clock


def close_line():
    """End the updating line of a terminal."""
    global _open_line
    if _open_line:
        print(file=sys.stderr)
        _open_line = False


@contextmanager
def alive():
    """Where standard error is no terminal, the latest progress is printed again after each minute of silence.

    A thread does so until the block ends: work may be within Mitsuba or Blender for as long as it takes.
    """
    global _latest, _printed
    if sys.stderr.isatty():
        yield
        return
    _latest, _printed = None, time.monotonic()
    ended = threading.Event()
    thread = threading.Thread(target=_repeat, args=(ended,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _repeat(ended):
    global _printed
    while not ended.wait(max(0.0, _printed + SILENCE - time.monotonic())):
        if time.monotonic() - _printed < SILENCE:
            continue  # something was printed meanwhile
        _printed = time.monotonic()
        if _latest is not None:
            print(f"{_latest} (still at work)", file=sys.stderr, flush=True)


class Progress:
    """Progress on standard error: one updating line in a terminal, a line now and then elsewhere.

    Parameters
    ----------
    quiet : bool
        Say nothing, on standard output neither.
    """

    def __init__(self, quiet=False):
        self._quiet = quiet
        self._terminal = sys.stderr.isatty()
        self._last_time, self._last_done, self._last_message = time.monotonic(), -1.0, None

    def __call__(self, done, message):
        """Called by the work; Ctrl-C arrives as KeyboardInterrupt between calls."""
        global _open_line, _latest, _printed
        if self._quiet:
            return
        line = f"{done:4.0%} {message}"
        _latest = line if done < 1 else None
        now = time.monotonic()
        wait, step = (0.1, 0.0) if self._terminal else (2.0, 0.1)
        news = done - self._last_done >= step or message != self._last_message
        due = news and now - self._last_time >= wait
        if not (due or done >= 1):
            return
        self._last_time, self._last_done, self._last_message = now, done, message
        _printed = now
        if self._terminal:
            print(f"\r\x1b[K{line}", end="\n" if done >= 1 else "", file=sys.stderr, flush=True)
            _open_line = done < 1
        else:
            print(line, file=sys.stderr, flush=True)

    def say(self, text):
        """A line of its own."""
        if not self._quiet:
            close_line()
            print(text, file=sys.stderr)

    def saved(self, picture, seconds):
        """Tell of a still or frame that is made, on standard output and as Blender does, which render farms read.

        Parameters
        ----------
        picture : path
            A viewable picture of it.
        seconds : float
            That it took.
        """
        if self._quiet:
            return
        close_line()
        text = f"Saved: '{picture}'\nTime: {_timecode(seconds)}\n"
        encoding = sys.stdout.encoding or "utf-8"
        print(
            text.encode(encoding, "backslashreplace").decode(encoding), end="", flush=True
        )  # any file's name


def _timecode(seconds):
    """``01:02.34``, or ``01:00:02.34`` from an hour on."""
    hundredths = int(seconds * 100)
    minutes, hundredths = divmod(hundredths, 6000)
    hours, minutes = divmod(minutes, 60)
    short = f"{minutes:02d}:{hundredths // 100:02d}.{hundredths % 100:02d}"
    return f"{hours:02d}:{short}" if hours else short
