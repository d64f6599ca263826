"""Progress and remarks on standard error."""

import sys
import time

_open_line = False


def close_line():
    """End the updating line of a terminal."""
    global _open_line
    if _open_line:
        print(file=sys.stderr)
        _open_line = False


class Progress:
    """Progress on standard error: one updating line in a terminal, a line now and then elsewhere.

    Parameters
    ----------
    quiet : bool
        Say nothing.
    """

    def __init__(self, quiet=False):
        self._quiet = quiet
        self._terminal = sys.stderr.isatty()
        self._last_time, self._last_done, self._last_message = time.monotonic(), -1.0, None

    def __call__(self, done, message):
        """Called by the work; Ctrl-C arrives as KeyboardInterrupt between calls."""
        global _open_line
        now = time.monotonic()
        wait, step = (0.1, 0.0) if self._terminal else (2.0, 0.1)
        news = done - self._last_done >= step or message != self._last_message
        due = news and now - self._last_time >= wait
        if self._quiet or not (due or done >= 1):
            return
        self._last_time, self._last_done, self._last_message = now, done, message
        line = f"{done:4.0%} {message}"
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
