"""Units of work of a job. Their results in the job's folder decide what is done, whoever did it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from ..engine.progress import Progress


@dataclass(frozen=True)
class Unit:
    """A unit of work, whose result on disk appears complete or not at all; making it twice is harmless.

    Attributes
    ----------
    name : str
        Unique in its folder, and valid as a file name.
    make : callable
        ``make(progress)`` makes the result; only the process that holds the unit's claim calls it.
    done : callable
        ``done()`` quickly returns whether the result of this job is there.
    needs : tuple of str
        Names of units to be done before.
    prepares : bool
        Whether it only prepares requested units, and is not counted among them.
    """

    name: str
    make: Callable[[Progress], None]
    done: Callable[[], bool]
    needs: tuple[str, ...] = ()
    prepares: bool = False


def progress_units(units: Iterable[Unit]) -> set[str]:
    """Names of the units that count for progress: those that do not prepare, unless there are no others."""
    units = list(units)
    return {unit.name for unit in units if not unit.prepares} or {unit.name for unit in units}
