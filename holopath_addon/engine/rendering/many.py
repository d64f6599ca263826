"""Many more frames of the light of a rendered field: what their mean shows has hardly any speckle."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..memory import AT_ONCE
from ..planning.phases import LEAST, first_of
from ..progress import Clock, Stages, named, parts
from ..scene import variants
from ..settings import BASELINES
from ..waves.phase_fields import SETS, designed_phasors
from .fields import Tracing, at_slm
from .planned import PlannedRender

if TYPE_CHECKING:
    from collections.abc import Iterator

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..plan import Plan
    from ..progress import Progress

FRAMES = 8 * SETS[-1]
# Of their phases, and of those of the first batch by the clock: no settings have these, so none is a hologram's own.
SEEDS = (1 << 62) + 1, (1 << 62) + 2


def many_frames(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    plan: Plan,
    progress: Progress,
    store: BakeStore | None = None,
    count: int = FRAMES,
    begin: int = 0,
    clocked: bool = False,
) -> Iterator[tuple[list[int], np.ndarray]]:
    """Fields of frames with other phases than a hologram's, a batch at a time; paths are found once for all.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    plan : Plan
        By which the hologram was rendered.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.
    store : BakeStore, optional
        Where baked light is kept.
    count : int
    begin : int
        How many there are already, see `along`.
    clocked : bool
        In batches of a set, or `phases.LEAST` in the first, for one who may want no more of them. Default: as many at
        once as memory allows.

    Yields
    ------
    (list of int, numpy.ndarray)
        Numbers of wavelengths, and a field at the SLM, complex64, shape (frame, these wavelengths, y, x).

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    if plan.settings.method in BASELINES:
        raise InvalidInput(
            f"The encoding refine needs many frames, which the method {plan.settings.method} has not: choose joint."
        )
    variants.activate_for(scene)
    together = 0 if begin or clocked else first_of(count, plan, hologram)
    plan = replace(plan, settings=replace(plan.settings, despeckle=0))
    planned = PlannedRender(scene, camera, hologram, plan, Clock())
    stages = Stages(progress, "extra frames")
    planned.bake(store, stages["baking"])
    batches = _batches(count, begin, clocked, hologram)
    groups, left = planned.groups, list(range(len(hologram.wavelengths)))
    for group, at in zip(groups, parts(stages["waves"], len(groups)), strict=True):
        of_group = Stages(at, "waves of extra frames")
        numbers = []
        for wavelength in group:  # two may be equal
            numbers.append(next(k for k in left if hologram.wavelengths[k] == wavelength))
            left.remove(numbers[-1])
        with planned.recording(group) as recording:
            radiance = recording.radiance(named(of_group["radiance"], "Radiance"))
            # the first are apart, as when a render traced them along: then all that is made of them is the same
            first = together
            for phasors, told in zip(batches, parts(of_group["waves"], len(batches)), strict=True):
                sets = [some for some in np.split(phasors, [first]) if len(some)]
                fields = at_slm(recording, Tracing(recording, radiance, *sets), hologram, told)
                for part in np.split(fields, [first]) if len(sets) > 1 else [fields]:
                    yield numbers, part
                first = 0


def along(count: int) -> np.ndarray:
    """Phasors of the first of many frames, for a render that traces them with a hologram's own.

    Parameters
    ----------
    count : int

    Returns
    -------
    numpy.ndarray, complex64, shape (count, rows, columns)
    """
    return designed_phasors(count, seed=SEEDS[0])


def _batches(count, begin, clocked, hologram):
    """Phasors of each batch."""
    size, some = SETS[-1], []
    if not clocked:
        size = max(size, AT_ONCE // (8 * hologram.height * hologram.width * len(hologram.wavelengths)))
    elif not begin:
        some, count = [designed_phasors(LEAST, seed=SEEDS[1])], count - LEAST
    if begin >= count:
        return some
    ends = range(size, count, size)
    return some + np.split(along(count)[begin:], [end - begin for end in ends if end > begin])
