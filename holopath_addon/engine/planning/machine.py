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

from ..memory import on_card
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
LANES, RAYS = 1 << 18, 16  # rays of each lane, which add light of so many frames from one of these grains
FRAMES, GRAINS = 24, 1 << 16
SIDE, TRANSFORMS = 1024, 4
COPIED = 1 << 22  # complex numbers


@dataclass(frozen=True)
class Slowness:
    """How many times longer than on the machine that the constants of `costs` are from things take.

    A machine with more cores, or with a graphics card, does not write programs down any faster.

    Attributes
    ----------
    core : float
        What one processor core does: Python, which writes programs down, and meshes.
    programs : float
        Dr.Jit's programs, as the sums of all frames that rays add to; what rays meet the pilot times in the scene.
    transforms : float
        Fourier transforms, by the library and where it computes, see `waves.libraries`.
    copies : float
        Copies from a graphics card's memory to the processor's, than on the card of `costs`; 0 where waves are in the
        processor's.
    """

    core: float
    programs: float
    transforms: float
    copies: float = 0.0

    def or_less(self, other: Slowness) -> Slowness:
        """The least of both, each by itself."""
        return Slowness(*map(min, astuple(self), astuple(other)))


USUAL = Slowness(0.003, 0.023, 0.027, 0.028)  # seconds of `_measured`'s work on that machine


def slowness(folder: Path | None = None, library: str | None = None) -> Slowness:
    """How slow this machine is.

    Parameters
    ----------
    folder : path, optional
        Where the figures are kept for `KEPT` seconds. Then they are measured again, and the least count: other
        programs can make a machine look slow, none can make it look fast. Where Mitsuba, Dr.Jit, the backend or the
        threads are others, nothing that was kept counts.
    library : str, optional
        By which waves are computed, see `waves.libraries`. Default: that of `libraries.choose`.

    Returns
    -------
    Slowness
    """
    return _slowness(folder, library or libraries.choose()[0], time.time() // KEPT)


@lru_cache(2)
def _slowness(folder, library, now):
    """`slowness`; a process that runs on looks again when `now` is another."""
    variant = variants.activate()
    import drjit
    import mitsuba

    versions = [getattr(module, "__version__", "") for module in (mitsuba, drjit)]
    variant = " ".join([variant, *filter(libraries.ON_CARDS.get, [library])])
    made_with = f"{versions[0]} {versions[1]} {variant} {platform.machine()} {variants.threads()} {USUAL}"
    file, least = folder and folder / FILE, Slowness(math.inf, math.inf, math.inf)
    if file is not None:
        with suppress(OSError, ValueError, KeyError, TypeError):
            kept = json.loads(file.read_text())
            before = Slowness(**kept["slowness"])
            if kept["made_with"] == made_with and all(0 <= times < 1e3 for times in astuple(before)):
                least = before
                if abs(time.time() - file.stat().st_mtime) < KEPT:
                    return least
    least = least.or_less(_process_slowness(made_with, library, now))
    if file is not None:
        with suppress(OSError):  # measured again the next time
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_name(f".part-{os.getpid()}-{FILE}")
            part.write_text(json.dumps({"made_with": made_with, "slowness": asdict(least)}))
            os.replace(part, file)
    return least


@lru_cache(2)
def _process_slowness(_made_with, library, _now):
    """What is measured once in a process, for whichever folder."""
    timed(_programs)  # compiles
    return reduce(Slowness.or_less, [_measured(library) for _ in range(3)])


def _measured(library):
    """Some of each kind of work, by the seconds that it usually takes."""
    on = libraries.empty_array(library)
    taken = _seconds(_core), timed(_programs)[0], _seconds(lambda: _transforms(on)), _copies(on)
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
    """Rays' share of the wave kernel but for what they meet: phasors of a grain at random, added for every frame."""
    import drjit as dr
    import mitsuba as mi

    from ..scene.buffers import gather_phasors, packed_phasors

    phasors = packed_phasors(np.ones((FRAMES, GRAINS), np.complex64))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, LANES)

    def body(ray, sums, sampler):
        grain = dr.minimum(mi.UInt32(sampler.next_1d() * GRAINS), GRAINS - 1)
        amplitude, parts = sampler.next_1d(), gather_phasors(phasors, grain, FRAMES)
        added = [dr.fma(amplitude, part, total) for part, total in zip(parts, sums, strict=True)]
        return ray + 1, added, sampler

    state = (mi.UInt32(0), [dr.zeros(mi.Float, LANES) for _ in range(2 * FRAMES)], sampler)
    _, sums, _ = dr.while_loop(state, lambda ray, *_: ray < RAYS, body, label="speed")
    return sums


def _transforms(on):
    waves = arrays.like(np.ones((SIDE, SIDE), np.complex64), on)
    for _ in range(TRANSFORMS):
        waves = arrays.fft2(waves, workers=variants.threads(), norm="ortho")
    arrays.on_processor(waves[:1, :1])  # a card is waited for


def _copies(on):
    """Seconds in which a card's numbers come to the processor; 0 without a card."""
    if on_card(on) is None:
        return 0.0
    waves = arrays.zeros((COPIED,), "complex64", on)
    arrays.on_processor(waves[:1])
    return _seconds(lambda: arrays.on_processor(waves))
