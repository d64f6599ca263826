"""Making of units that no other process makes, until all are done."""

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
from .units import Unit, progress_units

POLL = 1.0  # seconds between looks at the units of other processes
RETRY = (
    0.1  # first maximum of seconds after another process was faster to claim a unit; it doubles up to `POLL`
)
CROWD = 300  # claims, of about a hundred processes; with more of them each process looks less often


@dataclass(frozen=True)
class Work:
    """The units of a command.

    Attributes
    ----------
    folder : pathlib.Path
        Folder of the results.
    job : SharedJob
        The job to join before making a unit.
    units : dict of str to Unit
        Units by name. They hold what they need, such as an open scene.
    made : list of str
        Names of units that this process has made so far.
    """

    folder: Path
    job: SharedJob
    units: dict[str, Unit]
    made: list[str]


def work_off(
    folder: Path | str, units: Iterable[Unit], tag: str, progress: Progress, say: Callable[[str], None]
) -> None:
    """Make units in order, except those that other processes make, until all are done.

    Parameters
    ----------
    folder : path
        Existing folder of the results; a result has its unit's name.
    units : iterable of Unit
        The units that they need must be among them, or done.
    tag : str
        Tag of the job, see `SharedJob.tag`.
    progress : callable
        ``progress(done, message)``, may raise `engine.Cancelled`.
    say : callable
        ``say(text)`` reports units that were already done.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled, OSError
        Errors of making a unit; its claim is released.
    """
    folder, todo = Path(folder), {unit.name: unit for unit in units}
    names, counted, reason = set(todo), progress_units(todo.values()), "done before, skipped"

    def done_without(*others):
        return 1 - len((todo.keys() & counted) - set(others)) / max(1, len(counted))

    retry, needs = RETRY, {name for unit in todo.values() for name in unit.needs}
    with Claims(folder, tag) as claims:
        earlier = {*os.listdir(folder), *files.unfinished(folder)}
        while todo:
            before, claim_names, is_late = len(todo), claims.names(), False
            # All processes here have this job, so new results are right. Those that other units need are checked.
            results = set(os.listdir(folder)) - earlier - needs
            for unit in in_turn(todo.values(), set(claim_names)):
                if not todo.keys().isdisjoint(unit.needs):
                    continue
                if unit.name in claim_names:
                    if claims.alive(unit.name):
                        continue
                elif unit.name in results or unit.done():
                    if not unit.prepares:
                        say(f"{unit.name}: {reason}")
                    del todo[unit.name]
                    continue
                at = stage(progress, done_without(), done_without(unit.name))
                if _make(folder, unit, claims, at):
                    del todo[unit.name]
                    break  # that took time: list the claims again
                if unit.name not in claim_names:
                    is_late = True
                    break
            if is_late:
                time.sleep(random.uniform(0.0, retry))
                retry = min(2 * retry, POLL)
                continue
            retry = RETRY
            if todo and len(todo) == before:
                reason = "done by another process"
                _wait(pause(len(claim_names)), progress, done_without(), next(iter(todo)))
        for name in files.unfinished(folder) & names:
            with claims.claim(name) as is_mine:
                if is_mine:
                    files.sweep(folder / name)


def in_turn(units: Iterable[Unit], claim_names: set[str]) -> list[Unit]:
    """Order units for attempts: in their order, but with a random start among many processes.

    Parameters
    ----------
    units : iterable of Unit
    claim_names : set of str
        Names of units that others may be making, which come last.

    Returns
    -------
    list of Unit
    """
    free = [unit for unit in units if unit.name not in claim_names]
    others = [unit for unit in units if unit.name in claim_names]
    first = free[: 1 + 2 * len(others)]
    return [*random.sample(first, len(first)), *free[len(first) :], *others]


def pause(claims: int) -> float:
    """Seconds between looks at a folder with a number of claims.

    All processes together look at most a hundred times a second, at random times.
    """
    return POLL * max(1.0, claims / CROWD) * random.uniform(0.75, 1.25)


def _wait(seconds, progress, done, name):
    end = time.monotonic() + seconds
    while (seconds := end - time.monotonic()) > 0:
        progress(done, f"Waiting for {name}, made by another process")  # may raise Cancelled
        time.sleep(min(seconds, POLL))


def _make(folder, unit, claims, progress):
    """Make a unit; False if another process makes it."""
    with claims.claim(unit.name) as is_mine:
        if not is_mine:
            return False
        files.sweep(folder / unit.name)
        if not unit.done():
            try:
                unit.make(progress)
            except BaseException as error:
                is_lost = claims.is_lost(unit.name)
                if not is_lost:
                    files.sweep(folder / unit.name)
                elif isinstance(error, (OSError, InvalidInput)):
                    return False  # another process took this one for dead and removed its files
                raise
        return True
