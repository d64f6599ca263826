"""How work tells how far it is, how long its stages took, and whether programs are compiled meanwhile."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# ``progress(done, message)``, done in 0..1; it may raise `Cancelled`, which stops the work.
Progress = Callable[[float, str], None]
# ``progress(done)`` of work whose caller knows what to call it.
PartProgress = Callable[[float], None]


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
