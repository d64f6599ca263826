"""Extra frames of a rendered field's light, whose mean intensity has hardly any speckle."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..memory import AT_ONCE
from ..planning.phases import MIN_EXTRA_FRAMES, co_traced_of
from ..progress import Clock, Stages, named, parts
from ..scene import variants
from ..settings.choices import BASELINES
from ..waves.phase_fields import SETS, designed_phasors
from .fields import Tracing, at_slm
from .render_context import RenderContext

if TYPE_CHECKING:
    from collections.abc import Iterator

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..plan import Plan
    from ..progress import Progress

FRAMES = 8 * SETS[-1]
# Seeds of their phases, and of the first batch with a time limit. Settings cannot have these, so that no extra frame is
# one of the hologram's own.
SEED, FIRST_BATCH_SEED = (1 << 62) + 1, (1 << 62) + 2


def extra_frames(
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
    """Fields of frames with other phases than a hologram's, in batches; paths are traced once for all.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    plan : Plan
        Plan by which the hologram was rendered.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.
    store : BakeStore, optional
        Store of baked light.
    count : int
        Number of extra frames.
    begin : int
        Number of those that were co-traced, and are left out.
    clocked : bool
        Whether the caller may want no more after any batch: batches are sets then, and the first has
        `MIN_EXTRA_FRAMES`. Default: batches as large as memory allows.

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
            f"The encoding refine needs extra frames, which the method {plan.settings.method} does not have. "
            "Choose joint."
        )
    variants.activate_for(scene)
    plan = replace(plan, settings=replace(plan.settings, despeckle=0))
    context = RenderContext(scene, camera, hologram, plan, Clock())
    stages = Stages(progress, "extra frames")
    context.bake(store, stages["baking"])
    batches = _batches(count, begin, clocked, hologram)
    groups, left = context.groups, list(range(len(hologram.wavelengths)))
    for group, part in zip(groups, parts(stages["waves"], len(groups)), strict=True):
        of_group = Stages(part, "waves of extra frames")
        numbers = []
        for wavelength in group:  # two may be equal
            numbers.append(next(k for k in left if hologram.wavelengths[k] == wavelength))
            left.remove(numbers[-1])
        with context.recording(group) as recording:
            radiance = recording.radiance(named(of_group["radiance"], "Radiance"))
            # the first frames are a set of their own, as when a render co-traces them, for the same rounding
            first = 0 if begin or clocked else co_traced_of(count, plan, hologram)
            for phasors, of_batch in zip(batches, parts(of_group["waves"], len(batches)), strict=True):
                sets = [each for each in np.split(phasors, [first]) if len(each)]
                fields = at_slm(recording, Tracing(recording, radiance, *sets), hologram, of_batch)
                for field in np.split(fields, [first]) if len(sets) > 1 else [fields]:
                    yield numbers, field
                first = 0


def co_traced_phasors(count: int) -> np.ndarray:
    """Phasors of the first extra frames, for a render that co-traces them.

    Parameters
    ----------
    count : int

    Returns
    -------
    numpy.ndarray, complex64, shape (count, rows, columns)
    """
    return designed_phasors(count, seed=SEED)


def _batches(count, begin, clocked, hologram):
    """Phasors of each batch."""
    size, batches = SETS[-1], []
    if not clocked:
        size = max(size, AT_ONCE // (8 * hologram.height * hologram.width * len(hologram.wavelengths)))
    elif not begin:
        batches, count = [designed_phasors(MIN_EXTRA_FRAMES, seed=FIRST_BATCH_SEED)], count - MIN_EXTRA_FRAMES
    if begin >= count:
        return batches
    ends = range(size, count, size)
    return batches + np.split(co_traced_phasors(count)[begin:], [end - begin for end in ends if end > begin])
