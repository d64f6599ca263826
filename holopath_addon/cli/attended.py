"""A command that a window has started and watches.

It tells how far it is in lines of JSON on standard error: ``{"done": 0.4, "message": ...}`` and ``{"say": ...}``. It is
canceled when its standard input ends, of which the window holds the other end: for as long as it wants the work, and no
longer than it lives itself, however it ends.
"""

import _thread
import json
import os
import shutil
import signal
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

from ..workflow import failures
from .console import Progress

COPY = ".scene-"  # begins the name of a folder that holds a scene for such a command alone
OFTEN = 0.25  # seconds between two lines of progress
PATIENCE = 10.0  # seconds that canceled work is given to clear away what it was writing
PRIORITY = 5  # lower than the window's, by so much


class Told(Progress):
    """Progress and remarks for the window."""

    def __init__(self):
        super().__init__()
        self._last = -OFTEN

    def __call__(self, done, message):
        if done >= 1 or time.monotonic() - self._last >= OFTEN:
            self._last = time.monotonic()
            self._tell(done=float(done), message=message)

    def say(self, text):
        self._tell(say=text)

    def _tell(self, **entries):
        try:
            print(json.dumps(entries), file=sys.stderr, flush=True)
        except OSError:
            # The window is gone, and so is the input. What waits to be said would fail again when Python ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


@contextmanager
def attended(scene):
    """While the block runs, the end of standard input raises KeyboardInterrupt in it; then a scene's copy goes.

    Parameters
    ----------
    scene : path
        Its folder is removed where its name begins with `COPY`.
    """
    if os.name == "posix":
        os.nice(PRIORITY)
        # Else it would kill Blender at once, in the middle of a file, to say something to a window that is gone.
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    lock, over = threading.Lock(), threading.Event()
    threading.Thread(target=_listen, args=(lock, over), name="holopath attended", daemon=True).start()
    try:
        yield
    finally:
        try:
            with (
                lock
            ):  # what ends the input from now on interrupts nothing, least of all Blender on its way out
                over.set()
        finally:
            folder = Path(scene).parent
            if folder.name.startswith(COPY):
                shutil.rmtree(folder, ignore_errors=True)


def _listen(lock, over):
    with suppress(OSError):
        while os.read(0, 1024):
            pass
    with lock:
        if over.is_set():
            return
        _thread.interrupt_main()
    time.sleep(PATIENCE)
    # In the middle of a kernel: what is half written is swept away by whoever goes on.
    os._exit(failures.FAILED)
