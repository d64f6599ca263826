"""How fast this machine is, for what a plan cannot measure in the scene; measured once and kept on disk."""

from __future__ import annotations

import json
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
USUAL = 0.064  # seconds of `_work` on the machine that the constants of `costs` are from
LANES, STEPS = 1 << 20, 64
SIDE, TRANSFORMS = 1024, 4


@lru_cache
def slowness(folder: Path | None = None) -> float:
    """How many times longer than on that machine things take here.

    Parameters
    ----------
    folder : path, optional
        Where the figure is kept; it is measured anew where Mitsuba, Dr.Jit, the backend or the threads are others.

    Returns
    -------
    float
    """
    import drjit
    import mitsuba

    versions = [getattr(module, "__version__", "") for module in (mitsuba, drjit)]
    made_with = f"{versions[0]} {versions[1]} {variants.activate()} {platform.machine()} {variants.threads()}"
    file = folder and folder / FILE
    if file is not None:
        with suppress(OSError, ValueError, KeyError, TypeError):
            kept = json.loads(file.read_text())
            if kept["made_with"] == made_with and 0 < kept["slowness"] < 1e3:
                return float(kept["slowness"])
    _work()  # compiles
    found = min(_seconds() for _ in range(3)) / USUAL
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
