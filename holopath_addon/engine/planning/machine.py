"""How fast this machine is, for what a plan cannot measure in the scene; the fastest measured is kept on disk."""

from __future__ import annotations

import json
import math
import os
import platform
import threading
import time
from contextlib import suppress
from dataclasses import asdict, astuple, dataclass
from functools import lru_cache, reduce
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..scene import variants
from ..waves import arrays, libraries

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_Result = TypeVar("_Result")
_timing = threading.Lock()  # history and profiling are the process's

FILE = "speed.json"
KEPT = 600  # seconds
STEPS = 100_000  # of Python
LANES, READ = 1 << 20, 64  # numbers that each lane reads
SIDE, TRANSFORMS = 1024, 4


@dataclass(frozen=True)
class Slowness:
    """How many times longer than on the machine that the constants of `costs` are from things take.

    A machine with more cores, or with a graphics card, does not write programs down any faster.

    Attributes
    ----------
    core : float
        What one processor core does: Python, which writes programs down, and meshes.
    programs : float
        Dr.Jit's programs; those that follow rays the pilot times in the scene.
    transforms : float
        Fourier transforms.
    """

    core: float
    programs: float
    transforms: float

    def or_less(self, other: Slowness) -> Slowness:
        """The least of both, each by itself."""
        return Slowness(*map(min, astuple(self), astuple(other)))


USUAL = Slowness(0.003, 0.045, 0.027)  # seconds of `_measured`'s work on that machine


def slowness(folder: Path | None = None) -> Slowness:
    """How slow this machine is.

    Parameters
    ----------
    folder : path, optional
        Where the figures are kept for `KEPT` seconds. Then they are measured again, and the least count: other
        programs can make a machine look slow, none can make it look fast. Where Mitsuba, Dr.Jit, the backend or the
        threads are others, nothing that was kept counts.

    Returns
    -------
    Slowness
    """
    return _slowness(folder, time.time() // KEPT)


@lru_cache(1)
def _slowness(folder, now):
    """`slowness`; a process that runs on looks again when `now` is another."""
    variant = variants.activate()
    import drjit
    import mitsuba

    versions = [getattr(module, "__version__", "") for module in (mitsuba, drjit)]
    variant = " ".join([variant, *filter(libraries.ON_CARDS.get, libraries.chosen()[:1])])
    made_with = f"{versions[0]} {versions[1]} {variant} {platform.machine()} {variants.threads()} {USUAL}"
    file, least = folder and folder / FILE, Slowness(math.inf, math.inf, math.inf)
    if file is not None:
        with suppress(OSError, ValueError, KeyError, TypeError):
            kept = json.loads(file.read_text())
            before = Slowness(**kept["slowness"])
            if kept["made_with"] == made_with and all(0 < times < 1e3 for times in astuple(before)):
                least = before
                if abs(time.time() - file.stat().st_mtime) < KEPT:
                    return least
    least = least.or_less(_process_slowness(made_with, now))
    if file is not None:
        with suppress(OSError):  # measured again the next time
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_name(f".part-{os.getpid()}-{FILE}")
            part.write_text(json.dumps({"made_with": made_with, "slowness": asdict(least)}))
            os.replace(part, file)
    return least


@lru_cache(1)
def _process_slowness(_made_with, _now):
    """What is measured once in a process, for whichever folder."""
    timed(_programs)  # compiles
    return reduce(Slowness.or_less, [_measured() for _ in range(3)])


def _measured():
    """Some of each kind of work, by the seconds that it usually takes."""
    taken = _seconds(_core), timed(_programs)[0], _seconds(_transforms)
    return Slowness(*(seconds / usual for seconds, usual in zip(taken, astuple(USUAL), strict=True)))


def timed(work: Callable[[], _Result]) -> tuple[float, float, _Result]:
    """Seconds that the programs of some work run, without what Python takes to write them down.

    Parameters
    ----------
    work : callable
        ``work()`` returns what Dr.Jit is to compute.

    Returns
    -------
    seconds, compiling : float
        That programs ran, and that they took to compile.
    result
        Of the work.
    """
    import drjit as dr

    with _timing:
        dr.kernel_history()  # what others left
        try:
            with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
                result = work()
                dr.eval(result)
                dr.sync_thread()
            programs = dr.kernel_history()
        finally:
            variants.stop_profiling()
    seconds = 1e-3 * sum(each["execution_time"] for each in programs)
    compiling = 1e-3 * sum(each.get("backend_time", 0.0) for each in programs)
    return max(seconds, 1e-6), compiling, result


def _seconds(work):
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _core():
    sum(number * number for number in range(STEPS))


def _programs():
    """Random numbers, with reads from memory."""
    import drjit as dr
    import mitsuba as mi

    table = mi.Float(np.ones(LANES, np.float32))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, LANES)

    def body(number, total, sampler):
        at = dr.minimum(mi.UInt32(sampler.next_1d() * LANES), LANES - 1)
        return number + 1, total + dr.sin(dr.gather(mi.Float, table, at)), sampler

    state = (mi.UInt32(0), mi.Float(0), sampler)
    _, total, _ = dr.while_loop(state, lambda number, *_: number < READ, body, label="speed")
    return total


def _transforms():
    on = libraries.beginning(libraries.chosen()[0])
    waves = arrays.like(np.ones((SIDE, SIDE), np.complex64), on)
    for _ in range(TRANSFORMS):
        waves = arrays.fft2(waves, workers=variants.threads(), norm="ortho")
    arrays.on_processor(waves[:1, :1])  # a card is waited for
