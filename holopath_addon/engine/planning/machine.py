"""How fast this machine is, for what a plan cannot measure in the scene; the fastest measured is kept on disk."""

from __future__ import annotations

import json
import math
import os
import platform
import time
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..scene import variants

if TYPE_CHECKING:
    from pathlib import Path

FILE = "speed.json"
KEPT = 600  # seconds
USUAL = 0.064  # seconds of `_work` on the machine that the constants of `costs` are from
LANES, STEPS = 1 << 20, 64
SIDE, TRANSFORMS = 1024, 4


def slowness(folder: Path | None = None) -> float:
    """How many times longer than on that machine things take here.

    Parameters
    ----------
    folder : path, optional
        Where the figure is kept for `KEPT` seconds. Then it is measured again, and the least counts: other programs
        can make a machine look slow, none can make it look fast. Where Mitsuba, Dr.Jit, the backend or the threads are
        others, nothing that was kept counts.

    Returns
    -------
    float
    """
    return _slowness(folder, time.time() // KEPT)


@lru_cache(1)
def _slowness(folder, _now):
    """`slowness`; a process that runs on looks again when `_now` is another."""
    variant = variants.activate()
    import drjit
    import mitsuba

    versions = [getattr(module, "__version__", "") for module in (mitsuba, drjit)]
    made_with = f"{versions[0]} {versions[1]} {variant} {platform.machine()} {variants.threads()}"
    file, least = folder and folder / FILE, math.inf
    if file is not None:
        with suppress(OSError, ValueError, KeyError, TypeError):
            kept = json.loads(file.read_text())
            if kept["made_with"] == made_with and 0 < kept["slowness"] < 1e3:
                least = float(kept["slowness"])
                if abs(time.time() - file.stat().st_mtime) < KEPT:
                    return least
    _work()  # compiles
    found = min(least, *(_seconds() / USUAL for _ in range(3)))
    if file is not None:
        with suppress(OSError):  # measured again the next time
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_name(f".part-{os.getpid()}-{FILE}")
            part.write_text(json.dumps({"made_with": made_with, "slowness": found}))
            os.replace(part, file)
    return found


def _seconds():
    start = time.perf_counter()
    _work()
    return time.perf_counter() - start


def _work():
    """Some of what renders do besides following rays: random numbers with reads from memory, and transforms."""
    import drjit as dr
    import mitsuba as mi

    table = mi.Float(np.ones(LANES, np.float32))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, LANES)

    def body(number, total, sampler):
        at = dr.minimum(mi.UInt32(sampler.next_1d() * LANES), LANES - 1)
        return number + 1, total + dr.sin(dr.gather(mi.Float, table, at)), sampler

    state = (mi.UInt32(0), mi.Float(0), sampler)
    _, total, _ = dr.while_loop(state, lambda number, *_: number < STEPS, body, label="speed")
    dr.eval(total)
    dr.sync_thread()
    waves = np.ones((SIDE, SIDE), np.complex64)
    for _ in range(TRANSFORMS):
        waves = scipy.fft.fft2(waves, workers=-1, norm="ortho")
