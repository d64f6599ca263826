"""Workers that make the units of a job in one shared folder: events one after the other, no clock but their own."""

from __future__ import annotations

import random
from bisect import insort
from collections import Counter
from dataclasses import dataclass
from heapq import heappop, heappush

from holopath_addon.farm import work
from holopath_addon.farm.claims import STALE_AFTER

OPENED = 3  # operations of a file that is opened: open, read or write, close
PRESENT = 3  # claims of a process that holds no unit
LISTED = 100  # names that a file server tells at once
LEAST = 0.02  # of a server that hearts take up whole


@dataclass(frozen=True)
class Step:
    """A unit: seconds, bytes written, seconds that the first of its kind takes besides, and operations of `done`."""

    name: str
    kind: str
    seconds: float
    written: float = 0.0
    first_seconds: float = 0.0
    done: float = 0.0
    needs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Rules:
    """File operations of a process, by what it does.

    Attributes
    ----------
    join, join_each, leave, leave_each : float
        To begin and end work in a folder; and for each other process.
    visit, visit_each : float
        The same of a unit that Dask hands out.
    look, look_held, look_waiting : float
        One look at what others do; and for each unit that others make, and that cannot begin yet.
    unit : float
        To claim a unit, see that it is not done, and give it back.
    refused : float
        To find that another one has it.
    beat : float
        A second, for others to see that it lives.
    crowd : int
        As `work.CROWD`; 0 where all look once a second, begin with the same unit, and ask for every claim each time.
    """

    join: float = 0.0
    join_each: float = 0.0
    leave: float = 0.0
    leave_each: float = 0.0
    visit: float = 0.0
    visit_each: float = 0.0
    look: float = 0.0
    look_held: float = 0.0
    look_waiting: float = 0.0
    unit: float = 0.0
    refused: float = 0.0
    beat: float = 0.0
    crowd: int = work.CROWD


@dataclass(frozen=True)
class Folder:
    """What a file server does in a second, for all together."""

    name: str
    bytes: float
    operations: float


@dataclass(frozen=True)
class Dask:
    """Seconds for a task: of the scheduler, which has one at a time, and until a worker has it."""

    serial: float
    latency: float


@dataclass(frozen=True)
class Result:
    """Seconds until all units are there and until all have ended; what workers did until then; what was asked for."""

    seconds: float
    ended: float
    spent: Counter
    operations: float
    bytes: float

    @property
    def limit(self) -> str:
        """What takes the most of the workers' time besides making units; nothing where that is less than a tenth."""
        others = Counter({what: time for what, time in self.spent.items() if what != "compute"})
        what, time = max(others.items(), key=lambda item: item[1], default=("", 0.0))
        return what if time > 0.1 * self.spent.total() else "-"


class _Server:
    """One after the other, as fast as it can."""

    def __init__(self, rate):
        self.rate, self.free, self.asked = rate, 0.0, 0.0

    def take(self, now, amount, rate=None):
        """When it has done so much more."""
        self.asked += amount
        self.free = max(self.free, now) + amount / (rate or self.rate)
        return self.free


class _Farm:
    def __init__(self, steps, folder, rules):
        self.now, self.rules, self.folder = 0.0, rules, folder
        self.steps = {step.name: step for step in steps}
        self.order = {name: number for number, name in enumerate(self.steps)}
        self.left = {step.name: len(step.needs) for step in steps}
        self.then = {name: [] for name in self.steps}
        for step in steps:
            for name in step.needs:
                self.then[name].append(step)
        self.ready = [step for step in steps if not step.needs]  # in order, and nobody's
        self.free = {step.name for step in self.ready}
        self.held = {}
        self.done, self.done_operations, self.seconds, self.present = 0, 0.0, 0.0, 0
        self.operations, self.wire = _Server(folder.operations), _Server(folder.bytes)
        self.parked = []

    @property
    def claims(self):
        return PRESENT * self.present + len(self.held)

    def ask(self, operations):
        hearts = self.present * self.rules.beat
        rate = max(self.folder.operations - hearts, LEAST * self.folder.operations)
        return "operations", self.operations.take(self.now, operations, rate)

    def carry(self, amount):
        return "bytes", self.wire.take(self.now, amount)

    def claim(self, step):
        """Whether nobody else has it."""
        if step.name not in self.free:
            return False
        self.free.remove(step.name)
        self.ready.remove(step)
        self.held[step.name] = step
        return True

    def make(self, step, kinds):
        """Events of a worker that has claimed a step; `kinds` are those that it has made before."""
        first = step.kind not in kinds
        kinds.add(step.kind)
        yield "compute", self.now + step.seconds
        if first and step.first_seconds:
            yield "start", self.now + step.first_seconds
        if step.written:
            yield self.carry(step.written)
        yield self.ask(self.rules.unit - OPENED)
        del self.held[step.name]
        self.done, self.seconds = self.done + 1, self.now
        if self.then[step.name] or not self.rules.crowd:  # else it is seen in the folder
            self.done_operations += step.done
        for after in self.then[step.name]:
            self.left[after.name] -= 1
            if not self.left[after.name]:
                insort(self.ready, after, key=lambda each: self.order[each.name])
                self.free.add(after.name)

    def waited(self):
        """What those wait for that have nothing to make."""
        return f"waits: {next(iter(self.held.values())).kind}" if self.held else "waits"


def _process(farm, start):
    """A plain process, see `work.work_off`."""
    rules, kinds, seen, alive = farm.rules, set(), 0.0, {}
    yield "start", start
    yield farm.ask(rules.join + rules.join_each * farm.present)
    farm.present += 1
    while True:
        held, waiting = len(farm.held), len(farm.steps) - farm.done - len(farm.held) - len(farm.ready)
        done, seen = farm.done_operations - seen, farm.done_operations
        listed = farm.claims / LISTED if rules.crowd else 0.0
        yield farm.ask(rules.look + rules.look_held * held + rules.look_waiting * waiting + done + listed)
        if farm.done == len(farm.steps):
            break
        mine, refused = None, False
        units = (
            work.in_turn([*farm.ready, *farm.held.values()], farm.held.keys())
            if rules.crowd
            else [*farm.ready]
        )
        for step in units:
            if step.name in farm.held:
                if alive.get(step.name, 0.0) < farm.now:
                    alive[step.name] = farm.now + STALE_AFTER
                    yield farm.ask(rules.refused)
                continue
            yield farm.ask(OPENED)
            if farm.claim(step):
                mine = step
                break
            yield farm.ask(rules.refused)
            if rules.crowd:
                refused = True
                break
        if mine:
            yield from farm.make(mine, kinds)
        elif refused:
            yield "operations", farm.now + random.uniform(0.0, work.RETRY)
        else:
            yield farm.waited(), farm.now + (work.pause(farm.claims) if rules.crowd else work.POLL)
    yield farm.ask(rules.leave + rules.leave_each * farm.present)
    farm.present -= 1


def _dask_worker(farm, start, dask, scheduler):
    """A worker that a scheduler hands units to, see `executor.ClusterExecutor`."""
    rules, kinds = farm.rules, set()
    yield "start", start
    while farm.done < len(farm.steps):
        if not farm.ready:
            yield farm.waited(), None
            continue
        step = farm.ready[0]
        farm.claim(step)
        yield "scheduler", scheduler.take(farm.now, dask.serial) + dask.latency
        farm.present += 1
        yield farm.ask(rules.visit + rules.visit_each * farm.present)
        yield from farm.make(step, kinds)
        farm.present -= 1
        farm.operations.take(farm.now, step.done)  # by who asked for it all


def simulate(
    steps: list[Step],
    workers: int,
    folder: Folder,
    rules: Rules,
    start: float = 0.0,
    dask: Dask | None = None,
) -> Result:
    """What becomes of a job.

    Parameters
    ----------
    steps : list of Step
        In an order in which they can be made.
    workers : int
        That all start at once.
    folder : Folder
    rules : Rules
    start : float
        Seconds until a worker has opened the scene.
    dask : Dask, optional
        Who hands units out; else each worker is a process that looks for them itself.

    Returns
    -------
    Result
    """
    random.seed(0)
    farm, scheduler, events = _Farm(steps, folder, rules), _Server(1.0), []
    spent: Counter[str] = Counter()
    for number in range(workers):
        worker = _dask_worker(farm, start, dask, scheduler) if dask else _process(farm, start)
        heappush(events, (0.0, number, worker))
    count, parked = workers, []
    while events:
        farm.now, _, worker = heappop(events)
        before = farm.done
        for what, until in worker:
            if until is None:
                parked.append((what, farm.now, worker))
            else:
                spent.update({what: until - farm.now if farm.done < len(steps) else 0.0})
                heappush(events, (until, count := count + 1, worker))
            break
        if farm.done > before:
            for what, since, waiting in parked:
                spent.update({what: farm.now - since})
                heappush(events, (farm.now, count := count + 1, waiting))
            parked.clear()
    return Result(farm.seconds, farm.now, spent, farm.operations.asked, farm.wire.asked)
