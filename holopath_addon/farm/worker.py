"""A process that makes units as it is told, and whoever tells it. Both speak lines of JSON.

Blender and Mitsuba want a process's main thread, keep it for minutes and may bring the process down, so none of it
happens in the process that speaks with a cluster. That one writes tasks to the child's standard input, as ``{"words":
[...], "folder": ..., "unit": ..., "mark": ...}``, or ``{"cancel": true}``. The child answers on its standard output how
far it is, and last for each unit what became of it. A task without a unit is only made ready for, which has no answer.
The end of its standard input ends it at once.
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
from .errors import WorkerDied

Make = Callable[[str, Progress], None]  # ``make(name, progress)`` of a unit of a job

IDLE = 60.0  # seconds without a task, after which a child ends: Blender holds memory that others may need
SEEN = 60.0  # seconds after which any network file system shows a file that another machine has made
OFTEN = 0.5  # seconds between two lines of progress


def serve(open_job: Callable[[list[str], Callable[[str], None]], Make]) -> None:
    """Make the units that standard input names, until it ends.

    Parameters
    ----------
    open_job : callable
        ``open_job(words, say)`` of a command's words, and ``say(text)`` of what is to be known; what it returns is kept
        for as long as the words stay the same.
    """
    answer = _take_standard_output()
    tasks: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(tasks,), name="holopath listen", daemon=True).start()
    asked, make = None, None
    while True:
        try:
            task, cancelled = tasks.get(timeout=IDLE)
        except queue.Empty:
            return
        try:
            progress = _progress(answer, cancelled)
            _check_shared(task["mark"], progress)
            if asked != (task["folder"], task["words"]):
                asked, make = None, None  # the scene before goes before the next one comes
                _enter(task["folder"])
                make = open_job(task["words"], lambda text: answer(say=text))
                asked = (task["folder"], task["words"])
            assert make is not None
            if "unit" in task:
                make(task["unit"], progress)
                answer(done=True)
        except (Exception, KeyboardInterrupt) as error:
            stopped = failures.cancelled(error)
            if "unit" in task:  # else the first unit fails alike
                answer(failure=failures.sentence(error), status=failures.status(error), cancelled=stopped)
            if stopped and not cancelled.is_set():
                return  # by a signal: the batch system ends this process


def _take_standard_output():
    """``answer(**entries)`` writes a line there; what Blender and others print goes to standard error instead."""
    sys.stdout.flush()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def answer(**entries):
        answers.write(json.dumps(entries) + "\n")
        answers.flush()

    return answer


def _listen(tasks):
    """Tasks from standard input, each with the event of its cancellation; ends the process with it."""
    cancelled = threading.Event()
    with open(0, "rb", closefd=False) as lines:
        for line in lines:
            task = json.loads(line)
            if "cancel" in task:
                cancelled.set()
            else:
                cancelled = threading.Event()
                tasks.put((task, cancelled))
    os._exit(0)  # in the middle of a kernel, too: nobody waits for the result


def _enter(folder):
    """Words name files as seen from the folder where they were said."""
    try:
        os.chdir(folder)
    except OSError as error:
        raise InvalidInput(
            f"There is no folder {folder} on this machine ({error.strerror}): start from a folder that all machines "
            "see under one name."
        ) from error


def _check_shared(mark, progress):
    """That this machine sees the folder of those that it works with, by a file of theirs."""
    wait_until(lambda: os.path.exists(mark), Path(mark).parents[1], progress)


def wait_until(seen: Callable[[], bool], folder: Path, progress: Progress) -> None:
    """Wait for what another machine has made in a folder of the results, as long as file systems take to show it.

    Parameters
    ----------
    seen : callable
        ``seen()`` tells whether it is there.
    folder : path
        Which, for the message.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.

    Raises
    ------
    InvalidInput
        If it does not show.
    """
    end = time.monotonic() + SEEN
    while not seen():
        if time.monotonic() > end:
            raise InvalidInput(
                f"{socket.gethostname()} does not see the folder of the results: {folder} must be one that all "
                "machines share, under the same name."
            )
        progress(0.0, "Waiting for the folder")
        time.sleep(OFTEN)


def _progress(answer, cancelled):
    last = -OFTEN

    def progress(done, message):
        nonlocal last
        if cancelled.is_set():
            raise Cancelled
        if time.monotonic() - last >= OFTEN:
            last = time.monotonic()
            answer(progress=min(max(float(done), 0.0), 1.0), message=message)

    return progress


class Child:
    """Such a process, as its parent has it.

    Parameters
    ----------
    command : list of str
        That starts it.
    threads : int
        With which it may compute.
    """

    def __init__(self, command: list[str], threads: int) -> None:
        bounds = ("HOLOPATH_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        environment = {**os.environ, **dict.fromkeys(bounds, str(threads))}
        # Dask has its workers give back memory at once. For our large arrays that is a third more time.
        environment.pop("MALLOC_TRIM_THRESHOLD_", None)
        self._task = None
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
            encoding="utf-8",
            start_new_session=True,  # Ctrl-C in a terminal is for who started it all, and arrives as a line
        )

    @property
    def alive(self) -> bool:
        """Whether it takes tasks."""
        return self._process.poll() is None

    @property
    def task(self) -> dict | None:
        """What it does now."""
        return self._task

    def ready(self, task: dict) -> None:
        """Have it open a job, by `words`, `folder` and `mark`, ahead of a unit."""
        with suppress(OSError):
            self._write(task)

    def work(self, task: dict, told: Callable[[dict], None]) -> dict:
        """Have it make a unit.

        Parameters
        ----------
        task : dict
            Its `words`, `folder` and `unit`.
        told : callable
            ``told(line)`` of each answer before the last.

        Returns
        -------
        dict
            The last answer: ``{"done": true}``, or `failure`, `status` and whether it was `cancelled`.

        Raises
        ------
        WorkerDied
        """
        self._task = task
        try:
            self._write(task)
            assert self._process.stdout is not None
            for line in self._process.stdout:
                answer = json.loads(line)
                if "done" in answer or "failure" in answer:
                    return answer
                told(answer)
        except (OSError, ValueError):  # its pipes broke, or its last line did
            pass
        finally:
            self._task = None
        code = self._process.wait()
        raise WorkerDied(f"its process ended with {f'signal {-code}' if code < 0 else f'status {code}'}")

    def cancel(self) -> None:
        """Have it stop what it makes, soon; what waits in `work` is answered then."""
        with suppress(OSError):
            self._write({"cancel": True})

    def close(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.wait()

    def _write(self, line):
        with self._lock:
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps(line) + "\n")
            self._process.stdin.flush()
