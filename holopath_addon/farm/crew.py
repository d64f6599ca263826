"""Units made by the workers of a Dask cluster: what happens in a worker, and who hands out and watches.

A task is words and the name of a unit, and its result is a few numbers: the folder holds what was made, and is the
truth. So a task that Dask loses with a worker is only made again, and a plain process may work in the folder, too.
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
from .units import Unit, counted
from .worker import SEEN, Child

# What results depend on, and what Dask's messages do.
PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "bpy", "distributed")
# A child that dies of itself is an error of its task, which `retries` repeat. A Dask worker that dies with its child is
# none to Dask: how often a task may see that is for the scheduler to say, see `cluster.CONFIGURATION`.
RETRIES = 3
ENDING = 60.0  # seconds that units have to stop in when they are cancelled
LOOK = 2.0  # seconds between two looks at the workers
IN_WORK = ("pending", "lost")  # a task whose result is lost with its worker is done again
POLL = 0.1  # seconds between two looks at what came from them


def versions() -> dict[str, str | None]:
    """Of HoloPath's own code, Python and the `PACKAGES`, which are not imported for it."""
    code, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        code.update(path.read_bytes())
    found: dict[str, str | None] = {
        "holopath": code.hexdigest()[:8],
        "python": ".".join(platform.python_version_tuple()[:2]),
    }
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found


def resource(found: dict) -> str:
    """Dask's name of what workers of such versions offer: one unit at a time each, whatever their threads."""
    return f"holopath {hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()[:12]}"


# In a Dask worker.


@dataclass
class _Post:
    """What a Dask worker does for us: its child, the job whose unit is made, and jobs that were cancelled."""

    child: Child | None = None
    busy: str | None = None
    ended: set[str] = field(default_factory=set)


_posts: dict[str, _Post] = {}  # by the id of the Dask worker; a process may have several


async def _announce(private: bool, dask_worker: Any = None) -> dict:
    """Offer this worker's versions to the scheduler, once; a `private` worker belongs to who started it all."""
    from distributed.core import Status

    found = versions()
    name = resource(found)
    if name not in dask_worker.state.total_resources:
        if private:
            # Sent to all our processes, these are for the client to act on.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        await dask_worker.set_resources(**{name: 1})
        # The scheduler gives tasks that wait for a worker to one that begins to run, not to one that offers more.
        dask_worker.status = Status.paused
        dask_worker.status = Status.running
    return {"versions": found, "host": socket.gethostname()}


def _make(task: dict, module: str, topic: str, *needed: dict) -> dict:
    """Have this worker's child make a unit; in a thread, so that the worker speaks with the scheduler meanwhile."""
    from distributed import get_worker

    for before in needed:
        if "failure" in before:
            return before
    worker = get_worker()
    post = _posts.setdefault(worker.id, _Post())

    def told(line):
        worker.log_event(topic, {"worker": worker.address, "unit": task["unit"], **line})

    start = time.monotonic()
    post.busy = topic
    try:
        if topic in post.ended:
            return {"failure": "Cancelled.", "status": failures.FAILED}
        told({"progress": 0.0, "message": "Starting"})
        answer = _child(post, module, worker.state.nthreads).work(task, told)
        if answer.get("cancelled") and topic not in post.ended:
            raise WorkerDied("a signal ended it")
    finally:
        post.busy = None
    return {"unit": task["unit"], "worker": worker.address, "seconds": time.monotonic() - start, **answer}


async def _ready(task: dict, module: str, dask_worker: Any = None) -> None:
    """Have this worker's child open a job while others make what all need."""
    post = _posts.setdefault(dask_worker.id, _Post())
    if post.busy is None:
        _child(post, module, dask_worker.state.nthreads).ready(task)


def _child(post, module, threads):
    if post.child is None or not post.child.alive:
        post.child = Child([sys.executable, "-m", module, "worker"], threads)
    return post.child


async def _cancel(topic: str, patience: float, dask_worker: Any = None) -> None:
    """Stop what the child of this worker makes for a job."""
    post = _posts.setdefault(dask_worker.id, _Post())
    post.ended.add(topic)
    end = time.monotonic() + patience
    while post.busy == topic and time.monotonic() < end:
        if post.child is not None:
            post.child.cancel()
        await asyncio.sleep(POLL)


# Where it was asked for.


@dataclass
class _Row:
    """What a worker does, for the table."""

    host: str
    unit: str = ""
    done: float = 0.0
    message: str = ""
    made: int = 0
    seconds: float = 0.0

    def line(self):
        doing = f"{self.unit} {self.done:4.0%} {self.message}" if self.unit else "waits"
        each = f"{self.seconds / self.made:.1f} s each" if self.made else ""
        return f"{self.host:<24.24} {doing:<44.44} {self.made:>5} done {each:>14}"


class Crew:
    """The workers of a cluster that make the units of a job.

    Parameters
    ----------
    client : distributed.Client
    private : bool
        Whether the workers are processes of ours on this machine.
    words : list of str
        Of the command, by which a child opens the job.
    progress : callable
        ``progress(done, message)`` of all units.
    say : callable
        ``say(text)`` of what is to be known.
    show : callable
        ``show(lines)`` of a table of the workers; called all the time.
    module : str
        That children run: ``python -m MODULE worker``.
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
        self._rows: dict[str, _Row] = {}  # of the workers that are used, by address
        self._refused: dict[str, str] = {}  # why others are not
        self._waiting: dict[str, Unit] = {}  # for what is to be made, by name
        self._of: set[str] = set()  # names of what is counted

    def work_off(self, folder: Path | str, units: list[Unit], tag: str) -> list[str]:
        """Have all units made that are not done.

        Parameters
        ----------
        folder, units, tag :
            See `work.work_off`.

        Returns
        -------
        list of str
            Names of those that were not done before.

        Raises
        ------
        engine.InvalidInput, FarmFailed
        """
        folder, mark = Path(folder).absolute(), f".cluster-{self._topic}"
        self._waiting = {unit.name: unit for unit in units if not unit.done()}
        self._of, start = counted(units), time.monotonic()
        before = len(self._of - self._waiting.keys())
        futures: dict[str, Any] = {}
        with Claims(folder, tag) as claims, claims.claim(mark):
            try:
                self._client.subscribe_topic(self._topic, self._hear)
                looked = self._look()
                job = {"words": self._words, "folder": os.getcwd(), "mark": str(folder / FOLDER / mark)}
                if self._private:
                    workers = list(self._rows)[: len(self._waiting)]
                    self._client.run(_ready, job, self._module, workers=workers)
                for unit in self._waiting.values():
                    needed = [futures[name] for name in unit.needs if name in futures]
                    futures[unit.name] = self._submit({**job, "unit": unit.name}, needed, len(futures))
                while self._waiting:
                    for name, unit in list(self._waiting.items()):
                        if futures[name].status not in IN_WORK and self._taken(futures[name], unit):
                            del self._waiting[name]
                            if unit.prepares:  # how long that took says nothing of the others
                                start = time.monotonic()
                    if time.monotonic() - looked > LOOK:
                        looked = self._look()
                    self._tell(before, time.monotonic() - start)
                    time.sleep(POLL)
            except BaseException as error:
                self._stop(list(futures.values()))
                if isinstance(error, _gone()) and self._client.status != "running":
                    raise FarmFailed(
                        f"The Dask scheduler is gone: what is done is in {folder}, and the same command goes on "
                        "after it."
                    ) from error
                raise
            finally:
                self._show([])
        return list(futures)

    def _submit(self, task, needed, number):
        return self._client.submit(
            _make,
            task,
            self._module,
            self._topic,
            *needed,
            key=f"{self._topic}-{task['unit']}",
            resources={resource(self._mine): 1},
            retries=RETRIES,
            priority=-number,
            pure=False,
        )

    def _hear(self, event):
        """What a child tells; in a thread of Dask's."""
        _, line = event
        row = self._rows.get(line["worker"])
        if row is None or line["unit"] not in self._waiting:
            return
        if "say" in line:
            self._say(f"{row.host}: {line['say']}")
        elif "progress" in line:
            row.unit, row.done, row.message = line["unit"], line["progress"], line["message"]

    def _taken(self, future, unit):
        """Whether a unit's task has come to its end; not if its worker ends before it tells the result.

        The task is done again then, by a worker that may still have to be looked at, so it is not waited for here.
        """
        from distributed import KilledWorker

        try:
            result = future.result(timeout=LOOK)
        except TimeoutError:
            return False
        except (KilledWorker, WorkerDied) as error:
            raise FarmFailed(
                f"{unit.name} was given up after several workers died making it, the last because {_why(error)}: "
                "see whether they have enough memory."
            ) from error
        if "failure" in result:
            raise (InvalidInput if result["status"] == failures.BAD_INPUT else FarmFailed)(result["failure"])
        row = self._rows.get(result["worker"])
        if row is not None:
            row.made, row.seconds = row.made + 1, row.seconds + result["seconds"]
            if row.unit == unit.name:
                row.unit = ""
        end = time.monotonic() + SEEN
        while not unit.done():  # the file system may be slow to show what another machine has written
            if time.monotonic() > end:
                raise FarmFailed(
                    f"{unit.name} is done, says {row.host if row else 'a worker'}, but its result is not here."
                )
            time.sleep(POLL)
        return True

    def _look(self):
        """See which workers there are, and which of them have our versions; when that was."""
        found = set(self._client.nthreads())
        for gone in self._rows.keys() - found:
            del self._rows[gone]
        for gone in self._refused.keys() - found:
            del self._refused[gone]
        new = list(found - self._rows.keys() - self._refused.keys())
        answers = self._client.run(_announce, self._private, workers=new, on_error="return") if new else {}
        for address, answer in answers.items():
            problem = self._problem(answer)
            if problem is None:
                self._rows[address] = _Row(f"{answer['host']}:{address.rpartition(':')[2]}")
            elif not isinstance(answer, OSError):  # which is one that ended meanwhile
                self._refused[address] = problem
                self._say(f"note: the worker {address} is not used, for {problem}.")
        if self._refused and not self._rows:
            address, problem = next(iter(self._refused.items()))
            raise InvalidInput(
                f"No worker of this cluster can be used: {problem} at {address}. Install the same versions everywhere."
            )
        return time.monotonic()

    def _problem(self, answer):
        """Why a worker that answers so is not used; None if it is."""
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

    def _tell(self, before, spent):
        rows = list(self._rows.values())
        parts = sum(row.done for row in rows if row.unit in self._of)
        count = len(self._of) - before
        made = count - len(self._waiting.keys() & self._of)
        left = f", {_duration(spent * (count - made - parts) / (made + parts))} left" if made else ""
        workers = f"{len(rows)} worker{'' if len(rows) == 1 else 's'}" if rows else "waiting for workers"
        message = f"{made + before} of {count + before} done, {workers}{left}"
        self._progress(min((before + made + parts) / (before + count), 0.999), message)
        self._show([row.line() for row in rows])

    def _stop(self, futures):
        """Leave nothing running, and no claim."""
        if self._client.status != "running":
            return
        with suppress(OSError, TimeoutError):
            self._client.cancel(futures)
            self._client.run(_cancel, self._topic, ENDING, workers=list(self._rows), on_error="ignore")


def _gone():
    """What the client raises when it has lost its scheduler."""
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
