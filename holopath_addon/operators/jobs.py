"""Work in a thread that reports progress and can be cancelled, and work that only the main thread may do."""

import threading
import time
import traceback
from typing import Any

import bpy

from .. import engine
from ..engine.progress import Compiling

# The main thread may be busy with a dialog, or wait for this very thread.
PATIENCE = 10.0  # seconds


def on_main_thread(work):
    """Have something done where Blender's data may be changed, and wait for it.

    Parameters
    ----------
    work : callable
        Without arguments.

    Returns
    -------
    object
        What `work` returns or raises. Where the main thread does not take it up, it is done in this one.
    """
    if threading.current_thread() is threading.main_thread():
        return work()
    taken, finished = threading.Lock(), threading.Event()
    job = Job(lambda progress: work())

    def run():
        if taken.acquire(blocking=False):
            job.run()
            finished.set()

    bpy.app.timers.register(run)
    if not finished.wait(PATIENCE) and taken.acquire(blocking=False):
        job.run()
    else:
        finished.wait()
    if job.error is not None:
        raise job.error
    return job.result


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
    compiling : bool
        Whether programs are compiled for that, which takes its time once on each machine.
    result : object or None
    error : BaseException or None
    """

    def __init__(self, work):
        self._work: Any = work  # until it is done
        self._cancel = threading.Event()
        self._thread = None
        self._question = None
        self._picture = None
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
    def cancelling(self):
        """Whether `cancel` was called."""
        return self._cancel.is_set()

    @property
    def remaining(self):
        """Seconds left, as the work so far tells; None while that is too little."""
        elapsed = time.monotonic() - self._started
        if elapsed < 1 or self.done < 0.05:
            return None
        return elapsed * (1 - self.done) / self.done

    def start(self):
        """Run in a thread of its own."""
        self._thread = threading.Thread(target=self.run, name="HoloPath", daemon=True)
        self._thread.start()

    def run(self):
        """Run in this thread; never raises."""
        try:
            self.result = self._work(self._progress)
        except BaseException as error:  # whatever it is belongs to whoever waits for the job
            _let_go(error)
            self.error = error
        finally:
            self._work = None

    def cancel(self):
        """Ask the work to stop at its next report of progress."""
        self._cancel.set()

    def wait(self, seconds):
        """Wait for the end of the thread; True if it has ended."""
        if self._thread is not None:
            self._thread.join(seconds)
        return not self.running

    def ask(self, question):
        """Called by the work: have `question()` answered where `serve` is called; what it returns or raises.

        Raises
        ------
        engine.Cancelled
            If the job is cancelled meanwhile.
        """
        if threading.current_thread() is threading.main_thread():
            return question()
        answer, answered = Job(lambda progress: question()), threading.Event()
        self._question = answer, answered
        while not answered.wait(0.05):
            if self.cancelling:
                raise engine.Cancelled
        if answer.error is not None:
            raise answer.error
        return answer.result

    def serve(self):
        """Answer what the work asks, if it does; on the main thread."""
        question, self._question = self._question, None
        if question is not None:
            answer, answered = question
            answer.run()
            answered.set()

    def offer(self, picture):
        """Called by the work: what can be looked at until there is a result."""
        self._picture = picture

    def take(self):
        """What was offered since the last time, or None."""
        picture, self._picture = self._picture, None
        return picture

    def _progress(self, done, message):
        if self._cancel.is_set():
            raise engine.Cancelled
        if self._compiles is None:
            self._compiles = Compiling()
        self.done, self.message, self.compiling = done, message, self._compiles()


def _let_go(error):
    """Free what the frames of an exception hold: the job keeps the exception, and would keep the scene with it."""
    seen = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        traceback.clear_frames(error.__traceback__)
        error = error.__cause__ or error.__context__
