"""Speed of this machine, for work that a plan cannot time in the scene; the fastest measured is kept on disk."""

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
_timing = threading.Lock()  # as the process has one kernel history

FILE = "speed.json"
MAX_AGE_SECONDS = 600  # after which the speed is measured again
STEPS = 100_000  # of a loop in Python
LANES, RAYS = 1 << 18, 16  # parallel lanes of the timed program, and rays of each
FRAMES, GRAINS = 24, 1 << 16  # frames to which each ray adds the light of one of these grains
SIDE, TRANSFORMS = 1024, 4  # pixels along a side of the timed Fourier transforms, and their number
COPIED = 1 << 22  # complex numbers


@dataclass(frozen=True)
class Slowness:
    """Times of this machine over those of the reference machine, on which the constants of `costs` were measured.

    More cores, or a graphics card, do not make `core` any faster.

    Attributes
    ----------
    core : float
        Work of one processor core: Python, which traces programs, and meshes.
    programs : float
        Programs of Dr.Jit that add up light for all frames. The intersection of rays is timed in the scene.
    transforms : float
        Fourier transforms, by the library and where it computes, see `waves.libraries`.
    copies : float
        Copies from a graphics card's memory to the processor's; 0 where waves are in the processor's.
    """

    core: float
    programs: float
    transforms: float
    copies: float = 0.0

    def minimum(self, other: Slowness) -> Slowness:
        """Minimum of both, each attribute by itself."""
        return Slowness(*map(min, astuple(self), astuple(other)))


REFERENCE = Slowness(
    0.003, 0.023, 0.027, 0.028
)  # seconds that `_measured`'s work takes on the reference machine


def slowness(folder: Path | None = None, library: str | None = None) -> Slowness:
    """Slowness of this machine.

    Parameters
    ----------
    folder : path, optional
        Folder that keeps the figures for `MAX_AGE_SECONDS`. Later they are measured again, and the minimum counts:
        other programs can make a machine look slow, but not fast. Figures of another version of Mitsuba or Dr.Jit, of
        another backend or number of threads, or of another machine, are discarded.
    library : str, optional
        Library that computes waves, see `waves.libraries`. Default: that of `libraries.choose`.

    Returns
    -------
    Slowness
    """
    library, now = library or libraries.choose()[0], time.time() // MAX_AGE_SECONDS
    return _slowness(folder, library, variants.activate(), variants.threads(), now)


@lru_cache(4)
def _slowness(folder, library, variant, threads, now):
    """`slowness`; a running process measures again when `now`, the backend or its threads change."""
    import drjit
    import mitsuba

    versions = [getattr(module, "__version__", "") for module in (mitsuba, drjit)]
    variant = " ".join([variant, *filter(libraries.ON_CARDS.get, [library])])
    made_with = (
        f"{versions[0]} {versions[1]} {variant} {platform.machine()} {platform.node()} {threads} {REFERENCE}"
    )
    file, fastest = folder and folder / FILE, Slowness(math.inf, math.inf, math.inf)
    if file is not None:
        with suppress(OSError, ValueError, KeyError, TypeError):
            kept = json.loads(file.read_text())
            before = Slowness(**kept["slowness"])
            if kept["made_with"] == made_with and all(0 <= times < 1e3 for times in astuple(before)):
                fastest = before
                if abs(time.time() - file.stat().st_mtime) < MAX_AGE_SECONDS:
                    return fastest
    fastest = fastest.minimum(_process_slowness(made_with, library, now))
    if file is not None:
        with suppress(OSError):  # measured again the next time
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_name(f".part-{os.getpid()}-{FILE}")
            part.write_text(json.dumps({"made_with": made_with, "slowness": asdict(fastest)}))
            os.replace(part, file)
    return fastest


@lru_cache(2)
def _process_slowness(_made_with, library, _now):
    """Measure once in a process, for all folders."""
    timed(_programs)  # compiles
    return reduce(Slowness.minimum, [_measured(library) for _ in range(3)])


def _measured(library):
    """Time some of each kind of work, in units of `REFERENCE`."""
    on = libraries.empty_array(library)
    taken = _seconds(_core), timed(_programs)[0], _seconds(lambda: _transforms(on)), _copies(on)
    return Slowness(*(seconds / usual for seconds, usual in zip(taken, astuple(REFERENCE), strict=True)))


def timed(work: Callable[[], _Result]) -> tuple[float, float, _Result]:
    """Time the programs of some work, without the tracing in Python.

    Parameters
    ----------
    work : callable
        ``work()`` returns the arrays that Dr.Jit is to compute.

    Returns
    -------
    seconds, compiling : float
        Seconds that programs ran, and that they took to compile.
    result
        Result of the work.
    """
    import drjit as dr

    with _timing:
        dr.kernel_history()  # clears that of earlier work
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
    """Part of the wave kernel without intersections: rays add the phasors of a random grain to every frame."""
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
    arrays.on_processor(waves[:1, :1])  # waits for a card


def _copies(on):
    """Time a copy from a card to the processor, seconds; 0 without a card."""
    if on_card(on) is None:
        return 0.0
    waves = arrays.zeros((COPIED,), "complex64", on)
    arrays.on_processor(waves[:1])
    return _seconds(lambda: arrays.on_processor(waves))
