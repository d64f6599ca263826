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
    ends : dict of str to float
        How much of the whole is done when each stage ends, in order: shares of the time, roughly.
    """

    def __init__(self, progress: Progress, ends: dict[str, float]) -> None:
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
