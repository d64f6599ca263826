"""Work in a thread that reports progress and can be cancelled. Imports no bpy."""

import threading

from .. import engine


class Job:
    """One piece of work.

    Parameters
    ----------
    work : callable
        ``work(progress)`` returns the result; `progress(done, message)` raises `engine.Cancelled` once
        `cancel` was called.

    Attributes
    ----------
    done : float
        0..1.
    message : str
        What is being done.
    result : object or None
    error : BaseException or None
    """

    def __init__(self, work):
        self._work = work
        self._cancel = threading.Event()
        self._thread = None
        self.done = 0.0
        self.message = ""
        self.result = None
        self.error = None

    @property
    def running(self):
        """Whether the thread is at work."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def cancelling(self):
        """Whether `cancel` was called."""
        return self._cancel.is_set()

    def start(self):
        """Run in a thread of its own."""
        self._thread = threading.Thread(target=self.run, name="HoloPath", daemon=True)
        self._thread.start()

    def run(self):
        """Run in this thread; never raises."""
        try:
            self.result = self._work(self._progress)
        except BaseException as error:  # whatever it is belongs to whoever waits for the job
            self.error = error

    def cancel(self):
        """Ask the work to stop at its next report of progress."""
        self._cancel.set()

    def wait(self, seconds):
        """Wait for the end of the thread; True if it has ended."""
        if self._thread is not None:
            self._thread.join(seconds)
        return not self.running

    def _progress(self, done, message):
        if self._cancel.is_set():
            raise engine.Cancelled
        self.done, self.message = done, message
