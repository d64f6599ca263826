"""A sweep across an edge at which models break: what is measured, what should stay flat, what the program does."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from holopath_addon.engine.errors import InvalidInput

LIMITS = {"psnr": 1.0, "brightness": 0.05}  # largest step between neighbors: dB, and share


@dataclass(frozen=True)
class Sweep:
    """One parameter, from one side of an edge to the other.

    Attributes
    ----------
    name : str
        Short, lower case.
    edge : str
        What is crossed, in a sentence.
    parameter : str
        With its unit.
    values : tuple
        Of the parameter, dense.
    measure : callable
        ``measure(value)`` gives a dict of figures; "psnr" (dB against a reference made for the same value) and
        "brightness" (ratio to it) are held to `LIMITS`, others are only shown.
    then : str
        Where it breaks, and what the program then does: switches the model, warns, refuses.
    quick : tuple
        Values for the tests of every day.
    log : bool
        Whether the parameter spans orders of magnitude.
    limits : dict
        Instead of `LIMITS`.
    rises : tuple of str
        Figures that physics lets rise with the parameter: only falls count.
    """

    name: str
    edge: str
    parameter: str
    values: tuple
    measure: Callable
    then: str
    quick: tuple = ()
    log: bool = False
    limits: dict = field(default_factory=lambda: dict(LIMITS))
    rises: tuple = ()


def walk(sweep, values=None, progress=None):
    """Measure a sweep.

    Parameters
    ----------
    sweep : Sweep
    values : sequence, optional
        Default: all of them.
    progress : callable, optional
        ``progress(value, figures)`` after each.

    Returns
    -------
    list of (value, dict)
        In place of figures ``{"refused": sentence}`` where the program refuses, in a sentence, what it cannot do.
    """
    rows = []
    for value in sweep.values if values is None else values:
        try:
            figures = sweep.measure(value)
        except InvalidInput as error:
            figures = {"refused": str(error)}
        rows.append((value, figures))
        if progress:
            progress(value, figures)
    return rows


def faults(sweep, rows):
    """What must not be: figures that are no numbers, and steps between neighbors beyond the limits, as sentences."""
    found = []
    for value, figures in rows:
        for name, figure in figures.items():
            if name not in ("refused", "warned") and not math.isfinite(figure):
                found.append(f"{sweep.name}: {name} is {figure} at {value:g} {sweep.parameter}")
    for name, limit in sweep.limits.items():
        for (a, before), (b, after), step in steps(sweep, rows, name):
            if step > limit:
                step = f"{name} steps from {before:.4g} to {after:.4g}"
                found.append(f"{sweep.name}: {step} between {a:g} and {b:g} {sweep.parameter}")
    return found


def steps(sweep, rows, name):
    """Steps of a figure between neighbors.

    Returns
    -------
    list of ((value, figure), (value, figure), step)
        dB for "psnr", else a share; a rise that physics allows is none.
    """
    known = [(value, figures[name]) for value, figures in rows if name in figures]
    found = []
    for (a, before), (b, after) in zip(known[:-1], known[1:], strict=True):
        step = after - before if name == "psnr" else after / before - 1
        found.append(((a, before), (b, after), max(-step, 0.0) if name in sweep.rises else abs(step)))
    return found
