"""Commands that Blender's window starts and supervises.

Progress is reported in lines of JSON on standard error: ``{"done": 0.4, "message": ...}`` and ``{"say": ...}``. The
command is canceled when its standard input ends. The window holds the other end and closes it to cancel; it also closes
when the window ends, in whatever way.
"""

import _thread
import json
import os
import shutil
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

from ..farm import standard_input
from ..workflow import failures
from .console import Progress

COPY_PREFIX = ".scene-"  # start of the name of a folder with a copy of the scene for one command
PROGRESS_INTERVAL = 0.25  # seconds between two lines of progress
CANCEL_TIMEOUT = 10.0  # seconds in which canceled work must delete its unfinished files
NICENESS = 5  # below the window's priority


class WindowProgress(Progress):
    """Progress and remarks for the window."""

    def __init__(self):
        super().__init__()
        self._last = -PROGRESS_INTERVAL

    def __call__(self, done, message):
        """Report progress as a line of JSON, at most one per `PROGRESS_INTERVAL`.

        Parameters
        ----------
        done : float
            Fraction of the work.
        message : str
        """
        if done >= 1 or time.monotonic() - self._last >= PROGRESS_INTERVAL:
            self._last = time.monotonic()
            self._print(done=float(done), message=message)

    def say(self, text):
        """Print a remark as a line of JSON.

        Parameters
        ----------
        text : str
        """
        self._print(say=text)

    def _print(self, **entries):
        try:
            print(json.dumps(entries), file=sys.stderr, flush=True)
        except OSError:
            # The window is gone. Buffered output would fail again when Python ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


@contextmanager
def supervised(scene):
    """Raise KeyboardInterrupt in the block when standard input ends; delete the scene's copy after the block.

    Parameters
    ----------
    scene : path
        The copy's folder is deleted if its name begins with `COPY_PREFIX`.
    """
    if os.name == "posix":
        os.nice(NICENESS)
    lock, over = threading.Lock(), threading.Event()
    threading.Thread(target=_listen, args=(lock, over), name="holopath supervised", daemon=True).start()
    try:
        yield
    finally:
        try:
            with lock:  # from now on the end of the input does not interrupt anything, such as Blender's exit
                over.set()
        finally:
            folder = Path(scene).parent
            if folder.name.startswith(COPY_PREFIX):
                shutil.rmtree(folder, ignore_errors=True)


def _listen(lock, over):
    with suppress(OSError):
        for _ in standard_input.blocks():
            pass
    with lock:
        if over.is_set():
            return
        _thread.interrupt_main()
    time.sleep(CANCEL_TIMEOUT)
    # The work is within a kernel. The next process deletes its unfinished files.
    os._exit(failures.FAILED)
