"""Many more frames of the light of a rendered field: what their mean shows has hardly any speckle."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import InvalidInput
from ..memory import AT_ONCE
from ..planning import planner
from ..progress import Clock, Stages, named, parts, stage
from ..scene import variants
from ..settings import BASELINES
from ..waves.phase_fields import SETS, designed_phasors
from .fields import Tracing, at_slm
from .planned import PlannedRender

if TYPE_CHECKING:
    from collections.abc import Iterator

    import mitsuba as mi
    import numpy as np

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..plan import Plan
    from ..progress import Progress
    from ..settings import Settings

FRAMES = 8 * SETS[-1]  # of which a hologram's own are none
BAKED = 0.2  # of the work is done when light is baked
LIT = {"radiance": 0.3, "waves": 1.0}


def many_frames(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings,
    plan: Plan,
    progress: Progress,
    store: BakeStore | None = None,
    count: int = FRAMES,
    at_once: int | None = None,
) -> Iterator[tuple[list[int], np.ndarray]]:
    """Fields of frames with other phases than a hologram's, a batch at a time; paths are found once for all.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
        With which the hologram was rendered.
    plan : Plan
        By which it was.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.
    store : BakeStore, optional
        Where baked light is kept.
    count : int
    at_once : int, optional
        Most frames of a batch, for one who may want no more of them. Default: as many as memory allows.

    Yields
    ------
    (list of int, numpy.ndarray)
        Numbers of wavelengths, and a field at the SLM, complex64, shape (frame, these wavelengths, y, x).

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    if settings.method in BASELINES:
        raise InvalidInput(
            f"The encoding refine needs many frames, which the method {settings.method} has not: choose joint."
        )
    variants.activate()
    settings = replace(planner.resolved(settings), despeckle=0)
    planned = PlannedRender(scene, camera, hologram, settings, plan, Clock())
    planned.bake(store, stage(progress, 0.0, BAKED))
    phasors = designed_phasors(count, seed=1)  # seed 0 has the hologram's own
    pixel_bytes = 8 * len(hologram.wavelengths)
    batch = max(SETS[-1], AT_ONCE // (hologram.height * hologram.width * pixel_bytes))
    batch = min(batch, at_once or batch)
    starts = range(0, count, math.ceil(count / math.ceil(count / batch)))
    groups = planned.groups
    for group, at in zip(groups, parts(stage(progress, BAKED, 1.0), len(groups)), strict=True):
        stages = Stages(at, LIT)
        numbers = [hologram.wavelengths.index(wavelength) for wavelength in group]
        with planned.recording(group) as recording:
            radiance = recording.radiance(named(stages["radiance"], "Radiance"))
            for start, told in zip(starts, parts(stages["waves"], len(starts)), strict=True):
                some = phasors[start : start + starts.step]
                yield numbers, at_slm(recording, Tracing(recording, radiance, some), told)
