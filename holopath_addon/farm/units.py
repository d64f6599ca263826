"""A job as pieces of work. The folder that they are made in is the truth: it tells what is done, whoever did it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from ..engine.progress import Progress


@dataclass(frozen=True)
class Unit:
    """A piece of work whose result on disk appears whole or not at all; to make it twice does no harm.

    Attributes
    ----------
    name : str
        Unique in its folder, and fit to be a file's name.
    make : callable
        ``make(progress)`` has the result there; called by one process at a time, which holds the unit's claim.
    done : callable
        ``done()`` tells in no time whether the result is there, as this job asks for it.
    needs : tuple of str
        Names of units that have to be done before.
    prepares : bool
        Whether it only makes ready for those that were asked for, and is not counted among them.
    """

    name: str
    make: Callable[[Progress], None]
    done: Callable[[], bool]
    needs: tuple[str, ...] = ()
    prepares: bool = False


def counted(units: Iterable[Unit]) -> set[str]:
    """Names of those whose number tells how far all is: but for what prepares, unless there is nothing else."""
    units = list(units)
    return {unit.name for unit in units if not unit.prepares} or {unit.name for unit in units}
