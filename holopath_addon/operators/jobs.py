"""Jobs: work in a thread that reports progress, can be canceled, and has the main thread call functions."""

import threading
import time
import traceback
from typing import Any

import bpy

from .. import engine
from ..engine.progress import Compiling

# Seconds after which a call is no longer left to the main thread, which may show a dialog or wait for this very thread.
MAIN_THREAD_TIMEOUT = 10.0


def run_on_main_thread(work):
    """Call a function where Blender's data may be changed, and wait for it.

    If the main thread does not take it up, it is called in this one.

    Parameters
    ----------
    work : callable
        Called without arguments.

    Returns
    -------
    object
        Result of `work`, whose exceptions are raised here.
    """
    if threading.current_thread() is threading.main_thread():
        return work()
    started, finished = threading.Lock(), threading.Event()
    job = Job(lambda progress: work())

    def run():
        if started.acquire(blocking=False):
            job.run()
            finished.set()

    bpy.app.timers.register(run)
    if not finished.wait(MAIN_THREAD_TIMEOUT) and started.acquire(blocking=False):
        job.run()
    else:
        finished.wait()
    if job.error is not None:
        raise job.error
    return job.result


class Job:
    """A piece of work.

    Parameters
    ----------
    work : callable
        ``work(progress)`` returns the result; `progress(done, message)` raises `engine.Cancelled` after `cancel`.

    Attributes
    ----------
    done : float
        Progress, 0 to 1.
    message : str
        Current activity.
    compiling : bool
        Whether programs are compiled for it, which takes long once on each machine.
    result : object or None
    error : BaseException or None
    """

    def __init__(self, work):
        self._work: Any = work  # until it is done
        self._cancel = threading.Event()
        self._thread = None
        self._query = None
        self._offer = None
        self._started = time.monotonic()
        self.done = 0.0
        self.message = ""
        self.compiling = False
        self._compiles: Compiling | None = None
        self.result: Any = None
        self.error: BaseException | None = None

    @property
    def running(self):
        """Whether the thread is at work."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def asks(self):
        """Whether a query of the thread waits for its answer."""
        return self._query is not None

    @property
    def canceling(self):
        """Whether `cancel` was called."""
        return self._cancel.is_set()

    @property
    def remaining(self):
        """Estimated seconds left; None at the start, when there is too little to estimate from."""
        elapsed = time.monotonic() - self._started
        if elapsed < 1 or self.done < 0.05:
            return None
        return elapsed * (1 - self.done) / self.done

    def start(self):
        """Run in a new thread."""
        self._thread = threading.Thread(target=self.run, name="HoloPath", daemon=True)
        self._thread.start()

    def run(self):
        """Run in this thread. Raises nothing."""
        try:
            self.result = self._work(self._progress)
        except BaseException as error:  # for whoever waits for the job
            _free_frames(error)
            self.error = error
        finally:
            self._work = None

    def cancel(self):
        """Stop the work at its next report of progress."""
        self._cancel.set()

    def wait(self, seconds):
        """Wait for the end of the thread, for at most some seconds.

        Returns
        -------
        bool
            Whether it has ended.
        """
        if self._thread is not None:
            self._thread.join(seconds)
        return not self.running

    def query(self, function):
        """Have `answer_query` call a function on the main thread, and wait for it. The work calls this.

        Parameters
        ----------
        function : callable
            Called without arguments.

        Returns
        -------
        object
            Result of the function, whose exceptions are raised here.

        Raises
        ------
        engine.Cancelled
            If the job is canceled meanwhile.
        """
        if threading.current_thread() is threading.main_thread():
            return function()
        answer, answered = Job(lambda progress: function()), threading.Event()
        self._query = answer, answered
        while not answered.wait(0.05):
            if self.canceling:
                raise engine.Cancelled
        if answer.error is not None:
            raise answer.error
        return answer.result

    def answer_query(self):
        """Call the function of a waiting `query`, if there is one; on the main thread."""
        query, self._query = self._query, None
        if query is not None:
            answer, answered = query
            answer.run()
            answered.set()

    def offer(self, preview):
        """Offer an object to show before the result. The work calls this."""
        self._offer = preview

    def take_offer(self):
        """Take the latest object offered since the last call, or None."""
        preview, self._offer = self._offer, None
        return preview

    def _progress(self, done, message):
        if self._cancel.is_set():
            raise engine.Cancelled
        if self._compiles is None:
            self._compiles = Compiling()
        self.done, self.message, self.compiling = done, message, self._compiles()


def _free_frames(error):
    """Free the variables in an exception's frames: the job keeps the exception, and the scene would stay with it."""
    visited = set()
    while error is not None and id(error) not in visited:
        visited.add(id(error))
        traceback.clear_frames(error.__traceback__)
        error = error.__cause__ or error.__context__
