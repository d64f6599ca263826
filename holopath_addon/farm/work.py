"""To make what nobody else makes, until all is there."""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from ..engine import InvalidInput, files
from ..engine.progress import Progress, stage
from .claims import Claims
from .job import SharedJob
from .units import Unit, counted

POLL = 1.0  # seconds from one look at what others make to the next
HURRY = 0.1  # at most where another process was quicker to take what was free; longer, where it is again and again
CROWD = 300  # claims, of about a hundred processes; with more of them each looks less often


@dataclass(frozen=True)
class Work:
    """What some words ask for, in pieces; what it needs to make them, as an open scene, it holds.

    Attributes
    ----------
    folder : pathlib.Path
        Of the results.
    job : SharedJob
        To be joined before a unit is made.
    units : dict of str to Unit
        By name.
    made : list of str
        Names of units that were not there when they were asked for; it grows.
    """

    folder: Path
    job: SharedJob
    units: dict[str, Unit]
    made: list[str]


def work_off(
    folder: Path | str, units: Iterable[Unit], tag: str, progress: Progress, say: Callable[[str], None]
) -> None:
    """Have units made: those that no other process makes by this one, in order.

    Parameters
    ----------
    folder : path
        Which there is, of the units' results: what appears at a unit's name while this runs is its result.
    units : iterable of Unit
        What they need is among them, or done.
    tag : str
        Of the job that they are of, see `SharedJob.tag`.
    progress : callable
        ``progress(done, message)``, may raise `engine.Cancelled`.
    say : callable
        ``say(text)`` of what was there before, and what is waited for.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled, OSError
        What a unit's making raises; its claim is given back.
    """
    folder, todo = Path(folder), {unit.name: unit for unit in units}
    names, of, found = set(todo), counted(todo.values()), "done before, skipped"

    def done_without(*others):
        return 1 - len((todo.keys() & of) - set(others)) / max(1, len(of))

    hurry, needed = HURRY, {name for unit in todo.values() for name in unit.needs}
    with Claims(folder, tag) as claims:
        earlier = {*os.listdir(folder), *files.unfinished(folder)}
        while todo:
            before, claimed, refused = len(todo), claims.names(), False
            # All who work here do so on this job. What others need is looked into all the same.
            results = set(os.listdir(folder)) - earlier - needed
            for unit in in_turn(todo.values(), set(claimed)):
                if not todo.keys().isdisjoint(unit.needs):
                    continue
                if unit.name in claimed:
                    if claims.alive(unit.name):
                        continue
                elif unit.name in results or unit.done():
                    if not unit.prepares:
                        say(f"{unit.name}: {found}")
                    del todo[unit.name]
                    continue
                at = stage(progress, done_without(), done_without(unit.name))
                if _made(folder, unit, claims, at):
                    del todo[unit.name]
                    break  # it took its time: who holds what is looked up anew
                if unit.name not in claimed:
                    refused = True
                    break
            if refused:
                time.sleep(random.uniform(0.0, hurry))
                hurry = min(2 * hurry, POLL)
                continue
            hurry = HURRY
            if todo and len(todo) == before:
                found = "done by another process"
                _wait(pause(len(claimed)), progress, done_without(), next(iter(todo)))
        for name in files.unfinished(folder) & names:
            with claims.claim(name) as held:
                if held:
                    files.sweep(folder / name)


def in_turn(units: Iterable[Unit], claimed: set[str]) -> list[Unit]:
    """Units in the order in which to try them: the first ones first, but in a crowd each process begins elsewhere.

    Parameters
    ----------
    units : iterable of Unit
    claimed : set of str
        Names of those that others may be making: they come last.

    Returns
    -------
    list of Unit
    """
    free = [unit for unit in units if unit.name not in claimed]
    others = [unit for unit in units if unit.name in claimed]
    first = free[: 1 + 2 * len(others)]
    return [*random.sample(first, len(first)), *free[len(first) :], *others]


def pause(claims: int) -> float:
    """Seconds from one look at a folder with so many claims to the next.

    A hundred looks a second in all are the most, however many processes there are, and not all at one time.
    """
    return POLL * max(1.0, claims / CROWD) * random.uniform(0.75, 1.25)


def _wait(seconds, progress, done, name):
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        progress(done, f"Waiting for {name}, made by another process")  # which may cancel
        time.sleep(min(left, POLL))


def _made(folder, unit, claims, progress):
    """Whether a unit is done now; not if another process makes it."""
    with claims.claim(unit.name) as held:
        if not held:
            return False
        files.sweep(folder / unit.name)
        if not unit.done():
            try:
                unit.make(progress)
            except BaseException as error:
                lost = claims.lost(unit.name)
                if not lost:
                    files.sweep(folder / unit.name)
                elif isinstance(error, (OSError, InvalidInput)):
                    return False  # taken for gone, this process had what it was writing swept away
                raise
        return True
