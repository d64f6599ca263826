"""A job as pieces of work. The folder that they are made in is the truth: it tells what is done, whoever did it."""

from __future__ import annotations

from collections.abc import Callable
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
    needless : callable
        ``needless()`` tells of a unit that is done whether there is no result, as those before it say all.
    """

    name: str
    make: Callable[[Progress], None]
    done: Callable[[], bool]
    needs: tuple[str, ...] = ()
    needless: Callable[[], bool] = lambda: False
