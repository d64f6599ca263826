"""Making of units by the workers of a Dask cluster: functions in a worker, and their supervision.

A task is the words of a command and the name of a unit, and its result is a few numbers: the folder has the unit's
result. So a task that Dask loses with a worker is simply repeated, and other processes may work in the folder, too.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import platform
import signal
import socket
import sys
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from ..engine import InvalidInput
from ..engine.progress import Progress
from ..workflow import failures
from .claims import FOLDER, Claims
from .errors import FarmFailed, WorkerDied
from .units import Unit, progress_units
from .worker import VISIBLE_TIMEOUT, Child

# Packages on which results, and Dask's messages, depend.
PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "bpy", "distributed")
# The death of a child is an error of its task, and counts as one of these. That of a Dask worker does not: see
# allowed-failures of `cluster.CONFIGURATION`.
RETRIES = 3
CANCEL_TIMEOUT = 60.0  # seconds in which canceled units must stop
WORKERS_INTERVAL = 2.0  # seconds between looks at the list of workers
ACTIVE = ("pending", "lost")  # states of tasks; one whose result is lost with its worker is repeated
POLL = 0.1  # seconds between looks at their results


def versions() -> dict[str, str | None]:
    """Versions of HoloPath's code, Python and the `PACKAGES`, without importing them."""
    code, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        code.update(path.read_bytes())
    result: dict[str, str | None] = {
        "holopath": code.hexdigest()[:8],
        "python": ".".join(platform.python_version_tuple()[:2]),
    }
    for name in PACKAGES:
        try:
            result[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            result[name] = None
    return result


def resource(of_versions: dict) -> str:
    """Name of the Dask resource of workers with some versions; each has one, so it makes one unit at a time."""
    return f"holopath {hashlib.sha256(json.dumps(of_versions, sort_keys=True).encode()).hexdigest()[:12]}"


# -- in a Dask worker


@dataclass
class _Post:
    """State of a Dask worker: its child, the job of its current unit, and canceled jobs."""

    child: Child | None = None
    busy: str | None = None
    canceled: set[str] = field(default_factory=set)


_posts: dict[str, _Post] = {}  # by id of the Dask worker; a process may have several


async def _announce(private: bool, dask_worker: Any = None) -> dict:
    """Announce this worker's versions to the scheduler, once; `private`: the worker is a child of the client."""
    from distributed.core import Status

    own = versions()
    name = resource(own)
    if name not in dask_worker.state.total_resources:
        if private:
            # The terminal sends these to all processes of the group; the client acts on them.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        await dask_worker.set_resources(**{name: 1})
        # The scheduler assigns waiting tasks to workers that start to run, not to those with new resources.
        dask_worker.status = Status.paused
        dask_worker.status = Status.running
    return {"versions": own, "host": socket.gethostname()}


def _make(task: dict, module: str, topic: str, *previous: dict) -> dict:
    """Make a unit by this worker's child, in a thread, so that the worker can talk to the scheduler meanwhile."""
    from distributed import get_worker

    for result in previous:
        if "failure" in result:
            return result
    worker = get_worker()
    post = _posts.setdefault(worker.id, _Post())

    def report(line):
        worker.log_event(topic, {"worker": worker.address, "unit": task["unit"], **line})

    start = time.monotonic()
    post.busy = topic
    try:
        if topic in post.canceled:
            return {"failure": "Canceled.", "status": failures.FAILED}
        report({"progress": 0.0, "message": "Starting"})
        answer = _child(post, module, worker.state.nthreads).work(task, report)
        if answer.get("canceled") and topic not in post.canceled:
            raise WorkerDied("a signal ended it")
    finally:
        post.busy = None
    return {"unit": task["unit"], "worker": worker.address, "seconds": time.monotonic() - start, **answer}


async def _prepare(task: dict, module: str, dask_worker: Any = None) -> None:
    """Open a job in this worker's child, while others make the units that all need."""
    post = _posts.setdefault(dask_worker.id, _Post())
    if post.busy is None:
        _child(post, module, dask_worker.state.nthreads).prepare(task)


def _child(post, module, threads):
    if post.child is None or not post.child.alive:
        post.child = Child([sys.executable, "-m", module, "worker"], threads)
    return post.child


async def _cancel(topic: str, patience: float, dask_worker: Any = None) -> None:
    """Stop the unit of a job in this worker's child."""
    post = _posts.setdefault(dask_worker.id, _Post())
    post.canceled.add(topic)
    end = time.monotonic() + patience
    while post.busy == topic and time.monotonic() < end:
        if post.child is not None:
            post.child.cancel()
        await asyncio.sleep(POLL)


# -- in the client


@dataclass
class _Row:
    """A worker's row in the table."""

    host: str
    unit: str = ""
    done: float = 0.0
    message: str = ""
    made: int = 0
    seconds: float = 0.0

    def line(self):
        activity = f"{self.unit} {self.done:4.0%} {self.message}" if self.unit else "waits"
        each = f"{self.seconds / self.made:.1f} s each" if self.made else ""
        return f"{self.host:<24.24} {activity:<44.44} {self.made:>5} done {each:>14}"


class ClusterExecutor:
    """Executor of a job's units on the workers of a cluster.

    Parameters
    ----------
    client : distributed.Client
    private : bool
        Whether the workers are child processes on this machine.
    words : list of str
        Words of the command, by which a child opens the job.
    progress : callable
        ``progress(done, message)`` of all units.
    say : callable
        ``say(text)`` prints a note.
    show : callable
        ``show(lines)`` shows a table of the workers; called continually.
    module : str
        Module of children: ``python -m MODULE worker``.
    """

    def __init__(
        self,
        client: Any,
        private: bool,
        words: list[str],
        progress: Progress,
        say: Callable[[str], None],
        show: Callable[[list[str]], None],
        module: str = __name__.rsplit(".", 2)[0],
    ) -> None:
        self._client, self._private, self._words, self._module = client, private, words, module
        self._progress, self._say, self._show = progress, say, show
        self._topic = f"holopath-{uuid.uuid4().hex}"
        self._mine = versions()
        self._rows: dict[str, _Row] = {}  # of usable workers by address
        self._problems: dict[str, str] = {}  # of unusable workers by address
        self._todo: dict[str, Unit] = {}  # by name
        self._counted: set[str] = set()  # names of units that count for progress

    def work_off(self, folder: Path | str, units: list[Unit], tag: str) -> list[str]:
        """Make all units that are not done.

        Parameters
        ----------
        folder, units, tag :
            See `work.work_off`.

        Returns
        -------
        list of str
            Names of the units that were made.

        Raises
        ------
        engine.InvalidInput, FarmFailed
        """
        folder, mark = Path(folder).absolute(), f".cluster-{self._topic}"
        self._todo = {}
        for unit in units:  # one that needs another may be done no more once that is made anew
            if not unit.done() or any(n in self._todo and not self._todo[n].prepares for n in unit.needs):
                self._todo[unit.name] = unit
        self._counted, start = progress_units(units), time.monotonic()
        before = len(self._counted - self._todo.keys())
        futures: dict[str, Any] = {}
        with Claims(folder, tag) as claims, claims.claim(mark):
            try:
                self._client.subscribe_topic(self._topic, self._hear)
                look_time = self._look()
                job = {"words": self._words, "folder": os.getcwd(), "mark": str(folder / FOLDER / mark)}
                if self._private:
                    workers = list(self._rows)[: len(self._todo)]
                    self._client.run(_prepare, job, self._module, workers=workers)
                for unit in self._todo.values():
                    previous = [futures[name] for name in unit.needs if name in futures]
                    futures[unit.name] = self._submit({**job, "unit": unit.name}, previous, len(futures))
                while self._todo:
                    for name, unit in list(self._todo.items()):
                        if futures[name].status not in ACTIVE and self._finish(futures[name], unit):
                            del self._todo[name]
                            if unit.prepares:  # its time does not count for the estimate of others
                                start = time.monotonic()
                    if time.monotonic() - look_time > WORKERS_INTERVAL:
                        look_time = self._look()
                    self._report(before, time.monotonic() - start)
                    time.sleep(POLL)
            except BaseException as error:
                self._stop(list(futures.values()))
                if isinstance(error, _connection_errors()) and self._client.status != "running":
                    raise FarmFailed(
                        f"The Dask scheduler is gone. Finished units are in {folder}: run the same command to go on."
                    ) from error
                raise
            finally:
                self._show([])
        return list(futures)

    def _submit(self, task, previous, number):
        return self._client.submit(
            _make,
            task,
            self._module,
            self._topic,
            *previous,
            key=f"{self._topic}-{task['unit']}",
            resources={resource(self._mine): 1},
            retries=RETRIES,
            priority=-number,
            pure=False,
        )

    def _hear(self, event):
        """Process a child's report, in a thread of Dask's."""
        _, line = event
        row = self._rows.get(line["worker"])
        if row is None or line["unit"] not in self._todo:
            return
        if "say" in line:
            self._say(f"{row.host}: {line['say']}")
        elif "progress" in line:
            row.unit, row.done, row.message = line["unit"], line["progress"], line["message"]

    def _finish(self, future, unit):
        """Process the result of a unit's task; False if its worker ends before it sends the result.

        Dask repeats the task then, maybe on a worker that has not been checked, so this does not wait for it.
        """
        from distributed import KilledWorker

        try:
            result = future.result(timeout=WORKERS_INTERVAL)
        except TimeoutError:
            return False
        except (KilledWorker, WorkerDied) as error:
            raise FarmFailed(
                f"{unit.name} failed, as several workers died making it, the last because {_why(error)}. Check that "
                "they have enough memory."
            ) from error
        if "failure" in result:
            raise (InvalidInput if result["status"] == failures.BAD_INPUT else FarmFailed)(result["failure"])
        row = self._rows.get(result["worker"])
        if row is not None:
            row.made, row.seconds = row.made + 1, row.seconds + result["seconds"]
            if row.unit == unit.name:
                row.unit = ""
        end = time.monotonic() + VISIBLE_TIMEOUT
        while not unit.done():  # network file systems show files of other machines late
            if time.monotonic() > end:
                raise FarmFailed(
                    f"{row.host if row else 'A worker'} reports {unit.name} as done, but its result is not in the "
                    "folder. Check that all machines share it."
                )
            time.sleep(POLL)
        return True

    def _look(self):
        """Update the lists of usable and unusable workers, and return the time."""
        addresses = set(self._client.nthreads())
        for address in self._rows.keys() - addresses:
            del self._rows[address]
        for address in self._problems.keys() - addresses:
            del self._problems[address]
        new = list(addresses - self._rows.keys() - self._problems.keys())
        answers = self._client.run(_announce, self._private, workers=new, on_error="return") if new else {}
        for address, answer in answers.items():
            problem = self._problem(answer)
            if problem is None:
                self._rows[address] = _Row(f"{answer['host']}:{address.rpartition(':')[2]}")
            elif not isinstance(answer, OSError):  # that of a worker which has ended meanwhile
                self._problems[address] = problem
                self._say(f"note: the worker {address} is not used, for {problem}.")
        if self._problems and not self._rows:
            address, problem = next(iter(self._problems.items()))
            raise InvalidInput(
                f"No worker of this cluster can be used: {problem} at {address}. Install the same versions everywhere."
            )
        return time.monotonic()

    def _problem(self, answer):
        """Reason why a worker with this answer is unusable; None if it is usable."""
        if isinstance(answer, BaseException):
            return f"HoloPath cannot be imported there ({failures.one_line(answer)})"
        if answer["versions"] == self._mine:
            return None
        others = [
            f"{name} {answer['versions'].get(name) or 'is missing'} there, {mine or 'missing'} here"
            for name, mine in self._mine.items()
            if answer["versions"].get(name) != mine
        ]
        return ", ".join(others)

    def _report(self, before, elapsed):
        rows = list(self._rows.values())
        parts = sum(row.done for row in rows if row.unit in self._counted)
        count = len(self._counted) - before
        made = count - len(self._todo.keys() & self._counted)
        remaining = f", {_duration(elapsed * (count - made - parts) / (made + parts))} left" if made else ""
        workers = f"{len(rows)} worker{'' if len(rows) == 1 else 's'}" if rows else "waiting for workers"
        message = f"{made + before} of {count + before} done, {workers}{remaining}"
        self._progress(min((before + made + parts) / (before + count), 0.999), message)
        self._show([row.line() for row in rows])

    def _stop(self, futures):
        """Cancel all units, and wait until they have released their claims."""
        if self._client.status != "running":
            return
        with suppress(OSError, TimeoutError):
            self._client.cancel(futures)
            self._client.run(
                _cancel, self._topic, CANCEL_TIMEOUT, workers=list(self._rows), on_error="ignore"
            )


def _connection_errors():
    """Errors of a client that has lost its scheduler."""
    from distributed import CancelledError

    return (CancelledError, OSError, TimeoutError)


def _why(error):
    return failures.one_line(error) if isinstance(error, WorkerDied) else "its Dask worker ended"


def _duration(seconds):
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02} min"
    return f"{minutes} min {seconds:02} s" if minutes else f"{seconds} s"
