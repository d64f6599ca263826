"""Progress of work, durations of its stages, and detection of compilation."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

# ``progress(done, message)``, done in 0..1; it may raise `Cancelled`, which stops the work.
Progress = Callable[[float, str], None]
# ``progress(done)`` of work whose message the caller adds, see `named`.
PartProgress = Callable[[float], None]
MIN_EXTRAPOLATED = 5.0  # seconds of work from which the remaining time is extrapolated
OFTEN = 0.2  # seconds between two calls of progress, where work can be divided accordingly

# Fraction of each kind of work that is done when its stages end, in order: roughly by their time. Stages that are
# skipped cost nothing.
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

    def on_progress(done, message):
        done = min(max(done, 0.0), 1.0)
        progress(start * (1 - done) + end * done, message)  # exact at both ends, where the next stage begins

    return on_progress


def parts(progress: Progress, count: int) -> list[Progress]:
    """Split progress into `count` equal parts, one after another."""
    return [stage(progress, number / count, (number + 1) / count) for number in range(count)]


def duration(seconds: float) -> str:
    """Duration in words: ``40 s``, ``3 min``, ``2 h 5 min``."""
    if seconds < 60:
        return f"{math.ceil(seconds)} s"
    hours, minutes = divmod(math.ceil(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def with_time_left(progress: Progress) -> Progress:
    """Progress callback that adds the remaining time to messages, by extrapolation after `MIN_EXTRAPOLATED`."""
    start = time.monotonic()

    def on_progress(done, message):
        elapsed = time.monotonic() - start
        if elapsed > MIN_EXTRAPOLATED and 0 < done < 1:
            message = f"{message}, {duration(elapsed * (1 / done - 1))} left"
        progress(done, message)

    return on_progress


def named(progress: Progress, message: str) -> PartProgress:
    """Progress callback with a fixed message."""
    return lambda done: progress(done, message)


class Stages:
    """Progress callbacks of the stages of some work, by name; each goes from 0 to 1.

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
        self._stages = {name: stage(progress, *each) for name, each in zip(ends, bounds, strict=True)}

    def __getitem__(self, name: str) -> Progress:
        return self._stages[name]


class Pace:
    """Number of units of work in one launch, so that progress is reported several times a second.

    It starts small, doubles after short launches and halves after long ones. Larger launches are faster: a program is
    recorded in Python before it runs, which on a fast graphics card takes ten times as long as to run one unit.

    Parameters
    ----------
    max_units : int
        Largest number of units, because later ones may take longer.
    first : int
        Number of units at first.

    Attributes
    ----------
    together : int
        Number of units for the next launch.
    """

    def __init__(self, max_units: int, first: int = 1) -> None:
        self.together, self._max_units = first, max_units

    @contextmanager
    def __call__(self) -> Iterator[None]:
        """Measure the units that are computed inside, and adapt their number."""
        start = time.perf_counter()
        yield
        self.adapt(time.perf_counter() - start)

    def adapt(self, elapsed: float) -> None:
        """Adapt the number of units to the seconds that a launch took."""
        if elapsed < OFTEN:
            self.together = min(2 * self.together, self._max_units)
        elif elapsed > 2 * OFTEN:
            self.together = max(self.together // 2, 1)


def paced(units: range, max_units: int, at_first: int = 1) -> Iterator[range]:
    """Split units of work into launches, see `Pace`.

    Parameters
    ----------
    units : range
        Numbers of all units.
    max_units, at_first : int
        Largest and first number of units in a launch.

    Yields
    ------
    range
        Units to compute before the next one is taken.
    """
    pace, first = Pace(max_units, at_first), units.start
    while first < units.stop:
        part = range(first, min(first + pace.together, units.stop))
        start = time.perf_counter()
        yield part  # outside of a context, whose exit would swallow Ctrl-C when an unfinished generator is closed
        pace.adapt(time.perf_counter() - start)
        first = part.stop


class Clock:
    """Seconds spent in each stage, summed over its visits.

    Attributes
    ----------
    seconds : dict of str to float
        By stage.
    """

    def __init__(self) -> None:
        self.seconds = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time of the block to a stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


class Compiling:
    """Detector of programs that Dr.Jit compiled since the last call and that were not in its cache.

    Call it in the thread that computes: in another one it waits until a program is compiled.
    """

    def __init__(self) -> None:
        self._compiled = _compiled()

    def __call__(self) -> bool:
        """Whether any program was compiled since the last call."""
        before, self._compiled = self._compiled, _compiled()
        return self._compiled > before


def _compiled() -> int:
    """Number of programs compiled since Dr.Jit started, without those from its caches; does not start Dr.Jit."""
    detail = getattr(sys.modules.get("drjit"), "detail", None)  # another thread may be about to import it
    return 0 if detail is None else detail.launch_stats()[2]
