"""How work tells how far it is, how long its stages took, and whether programs are compiled meanwhile."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

# ``progress(done, message)``, done in 0..1; it may raise `Cancelled`, which stops the work.
Progress = Callable[[float, str], None]
# ``progress(done)`` of work whose caller knows what to call it.
PartProgress = Callable[[float], None]
FORETOLD = 5.0  # seconds after which work is taken to go on as it did
OFTEN = 0.2  # seconds between two looks at progress and cancel, where work can be divided so

# Fraction of each kind of work that is done when its stages end, in order: roughly the time that they take. Stages that
# are left out cost nothing.
SHARES = {
    "still": {"export": 0.05, "still": 1.0},
    "files": {"field": 0.93, "phases": 0.94, "images": 0.95, "extras": 0.98},
    "files, phases": {"field": 0.4, "phases": 0.93, "images": 0.95, "extras": 0.98},
    "files, extras": {"field": 0.68, "phases": 0.69, "images": 0.7, "extras": 0.98},
    "files, phases, extras": {"field": 0.4, "phases": 0.68, "images": 0.7, "extras": 0.98},
    "extras": {"reference": 0.7, "rgbd": 0.77, "light field": 0.92, "quilt": 0.96, "contact sheet": 1.0},
    "images": {"field": 0.95, "images": 1.0},
    "encode": {"scene": 0.05, "phases": 0.9, "files": 0.99},
    "render": {"planning": 0.02, "phase fields": 0.04, "baking": 0.04, "waves": 1.0},
    "render, baked": {"planning": 0.02, "phase fields": 0.04, "baking": 0.5, "waves": 1.0},
    "waves": {"radiance": 0.5, "fields": 1.0},
    "waves, despeckled": {"radiance": 0.2, "fields": 1.0},
    "fields": {"tracing": 0.94, "to the SLM": 1.0},
    "fields, despeckled": {"tracing": 0.25, "despeckling": 0.97, "to the SLM": 1.0},
    "despeckling": {"frames": 0.5, "steps": 1.0},
    "extra frames": {"baking": 0.2, "waves": 1.0},
    "waves of extra frames": {"radiance": 0.3, "waves": 1.0},
    "points": {"image": 0.3, "waves": 1.0},
    "plane of points": {"points": 0.7, "propagation": 1.0},
    "supervised": {"images": 0.4, "phases": 1.0},
    "joint": {"single frames": 0.1, "all frames": 1.0},
    "refine": {"single frames": 0.1, "extra frames": 0.4, "all frames": 1.0},
}


def stage(progress: Progress, start: float, end: float) -> Progress:
    """Progress callback of a part of the work that runs from `start` to `end` of the whole (0..1)."""

    def told(done, message):
        done = min(max(done, 0.0), 1.0)
        progress(start * (1 - done) + end * done, message)  # exact at both ends, where the next stage begins

    return told


def parts(progress: Progress, count: int) -> list[Progress]:
    """Progress callbacks of so many equal parts of the work, one after another."""
    return [stage(progress, number / count, (number + 1) / count) for number in range(count)]


def duration(seconds: float) -> str:
    """``40 s``, ``3 min``, ``2 h 5 min``."""
    if seconds < 60:
        return f"{math.ceil(seconds)} s"
    hours, minutes = divmod(math.ceil(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def with_time_left(progress: Progress) -> Progress:
    """Of work that goes on evenly: once it took a while the message ends with what it will take yet."""
    begun = time.monotonic()

    def told(done, message):
        spent = time.monotonic() - begun
        if spent > FORETOLD and 0 < done < 1:
            message = f"{message}, {duration(spent * (1 / done - 1))} left"
        progress(done, message)

    return told


def named(progress: Progress, message: str) -> PartProgress:
    """Progress callback of work that does not know what it is called."""
    return lambda done: progress(done, message)


class Stages:
    """Progress callbacks of the stages of some work, by name: each tells of itself, from 0 to 1.

    Parameters
    ----------
    progress : callable
        ``progress(done, message)`` of the whole.
    work : str or dict of str to float
        A kind of work in `SHARES`, or the fraction that is done when each stage ends, in order.
    """

    def __init__(self, progress: Progress, work: str | dict[str, float]) -> None:
        ends = SHARES[work] if isinstance(work, str) else work
        bounds = pairwise([0.0, *ends.values()])
        self._told = {name: stage(progress, *each) for name, each in zip(ends, bounds, strict=True)}

    def __getitem__(self, name: str) -> Progress:
        return self._told[name]


class Pace:
    """How many units of work to do at a time, for progress to be told, and cancel heard, several times a second.

    Few at first, twice as many as before where these took little time, and half as many where they took long: programs
    are written down in Python before they run, which takes a fast graphics card ten times as long as to run one unit.

    Parameters
    ----------
    most : int
        Units at a time, at most: those to come may be dearer.
    first : int
        Units at first.

    Attributes
    ----------
    together : int
        Units to do next.
    """

    def __init__(self, most: int, first: int = 1) -> None:
        self.together, self._most = first, most

    @contextmanager
    def __call__(self) -> Iterator[None]:
        """Units are done inside."""
        begun = time.perf_counter()
        yield
        elapsed = time.perf_counter() - begun
        if elapsed < OFTEN:
            self.together = min(2 * self.together, self._most)
        elif elapsed > 2 * OFTEN:
            self.together = max(self.together // 2, 1)


def paced(units: range, most: int, at_first: int = 1) -> Iterator[range]:
    """Units of work in parts that are done at a time, see `Pace`."""
    pace, first = Pace(most, at_first), units.start
    while first < units.stop:
        part = range(first, min(first + pace.together, units.stop))
        with pace():
            yield part
        first = part.stop


class Clock:
    """Seconds spent in each stage, summed over its visits."""

    def __init__(self) -> None:
        self.seconds = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Count what is done inside towards a stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


class Compiling:
    """Whether Dr.Jit compiles programs that this machine has not had: told by those since the last question.

    To be asked in the thread that computes. In another one the answer waits until a program is compiled.
    """

    def __init__(self) -> None:
        self._compiled = _compiled()

    def __call__(self) -> bool:
        """Whether it does."""
        before, self._compiled = self._compiled, _compiled()
        return self._compiled > before


def _compiled() -> int:
    """Programs that were neither in memory nor on disk, since Dr.Jit was started; this does not start it."""
    detail = getattr(sys.modules.get("drjit"), "detail", None)  # another thread may be about to import it
    return 0 if detail is None else detail.launch_stats()[2]
