"""A child process that makes units, and its parent's side. They exchange lines of JSON.

Blender and Mitsuba need a process's main thread, block it for minutes and may crash the process, so they do not run in
the process that talks to a cluster. That parent writes tasks to the child's standard input, as ``{"words": [...],
"folder": ..., "unit": ..., "mark": ...}``, or ``{"cancel": true}``. The child writes its progress to its standard
output, and last the outcome of each unit. A task without a unit only opens the job, and has no answer. The end of its
standard input ends the child at once.
"""

from __future__ import annotations

import json
import os
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ..engine import Cancelled, InvalidInput
from ..engine.progress import Progress
from ..workflow import failures
from . import standard_input
from .errors import WorkerDied

Make = Callable[[str, Progress], None]  # ``make(name, progress)`` of a unit of a job

IDLE_TIMEOUT = 60.0  # seconds without a task, after which a child ends to free Blender's memory
VISIBLE_TIMEOUT = 60.0  # seconds within which any network file system shows a file of another machine
PROGRESS_INTERVAL = 0.5  # seconds


def serve(open_job: Callable[[list[str], Callable[[str], None]], Make]) -> None:
    """Make the units of tasks on standard input, until it ends.

    Parameters
    ----------
    open_job : callable
        ``open_job(words, say)`` opens the job of a command's words, with ``say(text)`` for notes, and returns a
        function to make its units, which serves all tasks of the same command.
    """
    answer = _take_standard_output()
    tasks: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(tasks,), name="holopath listen", daemon=True).start()
    current, make = None, None
    while True:
        try:
            task, canceled = tasks.get(timeout=IDLE_TIMEOUT)
        except queue.Empty:
            return
        try:
            progress = _progress(answer, canceled)
            _check_shared(task["mark"], progress)
            # of each command anew, which may find other files: its mark is its own
            request = (task["folder"], task["words"], task["mark"])
            if current != request:
                current, make = None, None  # free the previous scene before opening the next one
                _enter(task["folder"])
                make = open_job(task["words"], lambda text: answer(say=text))
                current = request
            assert make is not None
            if "unit" in task:
                make(task["unit"], progress)
                answer(done=True)
        except (Exception, KeyboardInterrupt) as error:
            is_cancellation = failures.cancelled(error)
            if "unit" in task:  # otherwise the first unit fails with the same error
                answer(
                    failure=failures.sentence(error), status=failures.status(error), canceled=is_cancellation
                )
            if is_cancellation and not canceled.is_set():
                return  # a signal: the batch system ends this process


def _take_standard_output():
    """Make ``answer(**entries)``, which writes a line to standard output; prints go to standard error instead."""
    sys.stdout.flush()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def answer(**entries):
        answers.write(json.dumps(entries) + "\n")
        answers.flush()

    return answer


def _listen(tasks):
    """Read tasks from standard input, each with the event of its cancellation; end the process with it."""
    canceled = threading.Event()
    for line in standard_input.lines():
        task = json.loads(line)
        if "cancel" in task:
            canceled.set()
        else:
            canceled = threading.Event()
            tasks.put((task, canceled))
    os._exit(0)  # even during a kernel, as nobody waits for the result


def _enter(folder):
    """Change to the folder of the command, as its words may have relative paths."""
    try:
        os.chdir(folder)
    except OSError as error:
        raise InvalidInput(
            f"The folder {folder} does not exist on this machine ({error.strerror}). Start from a folder with the same "
            "path on all machines."
        ) from error


def _check_shared(mark, progress):
    """Check that this machine sees the parent's folder, by a file there."""
    wait_until(lambda: os.path.exists(mark), Path(mark).parents[1], progress)


def wait_until(is_visible: Callable[[], bool], folder: Path, progress: Progress) -> None:
    """Wait until a file of another machine is visible in the folder of the results.

    Parameters
    ----------
    is_visible : callable
        ``is_visible()`` returns whether it is.
    folder : path
        The folder, for the message.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.

    Raises
    ------
    InvalidInput
        If the file is not visible after `VISIBLE_TIMEOUT`.
    """
    end = time.monotonic() + VISIBLE_TIMEOUT
    while not is_visible():
        if time.monotonic() > end:
            raise InvalidInput(
                f"{socket.gethostname()} does not see the results in {folder}. Choose a folder that all machines "
                "share, under the same path."
            )
        progress(0.0, "Waiting for the folder")
        time.sleep(PROGRESS_INTERVAL)


def _progress(answer, canceled):
    last = -PROGRESS_INTERVAL

    def progress(done, message):
        nonlocal last
        if canceled.is_set():
            raise Cancelled
        if time.monotonic() - last >= PROGRESS_INTERVAL:
            last = time.monotonic()
            answer(progress=min(max(float(done), 0.0), 1.0), message=message)

    return progress


class Child:
    """A child process, see `serve`, as its parent uses it.

    Parameters
    ----------
    command : list of str
        Command that starts the child.
    threads : int
        Maximum number of threads.
    """

    def __init__(self, command: list[str], threads: int) -> None:
        bounds = ("HOLOPATH_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        environment = {**os.environ, **dict.fromkeys(bounds, str(threads))}
        # Dask makes its workers free memory at once, which costs large arrays a third more time.
        environment.pop("MALLOC_TRIM_THRESHOLD_", None)
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
            encoding="utf-8",
            start_new_session=True,  # Ctrl-C in a terminal is for the client, and arrives as a line
        )

    @property
    def alive(self) -> bool:
        """Whether the child runs."""
        return self._process.poll() is None

    def prepare(self, task: dict) -> None:
        """Open a job, by `words`, `folder` and `mark`, ahead of a unit."""
        with suppress(OSError):
            self._write(task)

    def work(self, task: dict, on_line: Callable[[dict], None]) -> dict:
        """Make a unit.

        Parameters
        ----------
        task : dict
            Its `words`, `folder`, `unit` and `mark`.
        on_line : callable
            ``on_line(line)`` for each answer before the last one.

        Returns
        -------
        dict
            The last answer: ``{"done": true}``, or `failure`, `status` and whether it was `canceled`.

        Raises
        ------
        WorkerDied
        """
        try:
            self._write(task)
            assert self._process.stdout is not None
            for line in self._process.stdout:
                answer = json.loads(line)
                if "done" in answer or "failure" in answer:
                    return answer
                on_line(answer)
        except (OSError, ValueError):  # broken pipes, or an incomplete last line
            pass
        code = self._process.wait()
        raise WorkerDied(f"its process ended with {f'signal {-code}' if code < 0 else f'status {code}'}")

    def cancel(self) -> None:
        """Stop the current unit soon; `work` then returns its answer."""
        with suppress(OSError):
            self._write({"cancel": True})

    def _write(self, line):
        with self._lock:
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps(line) + "\n")
            self._process.stdin.flush()
