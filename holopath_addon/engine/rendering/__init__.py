"""From a scene to the wave field at the SLM: the stages in order, with progress, times and cancellation."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np

from .. import baselines
from ..mapping import traced, widened
from ..planning import planner
from ..progress import Clock, Stages, named, parts, stage
from ..scene import variants
from ..settings import BASELINES, Settings
from ..wavefield import WaveField
from ..waves import libraries
from .fields import Tracing, at_slm
from .many import along
from .planned import PlannedRender, added, report_of

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..light.baking import Bake
    from ..plan import Plan
    from ..progress import Progress


def render(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings | None = None,
    plan: Plan | None = None,
    progress: Progress | None = None,
    store: BakeStore | None = None,
    more: int = 0,
) -> WaveField:
    """Render the wave field of a scene.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings, optional
        Default: those of the plan, or `Settings()`.
    plan : Plan, optional
        From `plan` for the same scene, camera and hologram; made when not given. What it decided stays, whichever
        settings are given beside it.
    progress : callable, optional
        ``progress(done, message)`` with done in 0..1, called several times a second; may raise
        `Cancelled`.
    store : BakeStore, optional
        Where baked light is kept for other views and other times.
    more : int
        Frames that are traced along with the hologram's own for an encoding, see `WaveField.more`; as many as
        `frames_along` says.

    Returns
    -------
    WaveField

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    variants.activate_for(scene)
    progress = progress or (lambda done, message: None)
    clock = Clock()
    progress(0.0, "Planning")
    if plan is None:
        with clock("plan"):
            plan = planner.plan(scene, camera, hologram, settings, store, stage(progress, 0.0, 0.0))
    elif settings is not None and settings != plan.requested:
        plan = replace(plan, requested=settings, settings=planner.resolved(settings))
    settings = plan.settings
    if settings.method in BASELINES:
        job = baselines.BaselineInput(scene, camera, hologram, settings, plan.near, plan.z_low, plan.z_high)
        with clock(settings.method):
            field = baselines.field(job, progress)
        plan = replace(plan, warnings=(*plan.warnings, *job.notes))
        report = {"seconds": clock.seconds, "frames": settings.frames}
        return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)
    planned = PlannedRender(scene, camera, hologram, plan, clock)
    stages = Stages(progress, "render, baked" if plan.cached else "render")
    stages["phase fields"](0.0, "Phase fields")
    sets = (planned.phasors, along(more)) if more else (planned.phasors,)
    planned.bake(store, stages["baking"])
    fields, errors, passes, rays = [], [], None, {}
    for group, at in zip(planned.groups, parts(stages["waves"], len(planned.groups)), strict=True):
        with planned.recording(group) as recording:
            fields.append(_waves(recording, sets, planned.straight, hologram, at))
        if recording.plan.library != plan.library:
            plan = replace(plan, library=recording.plan.library, warnings=(*plan.warnings, libraries.RAN_OUT))
        errors.append(recording.error)
        passes, rays = recording.passes, added(rays, recording.rays_traced)
    field = fields[0] if len(fields) == 1 else np.concatenate(fields, axis=1)
    baked = None if planned.baked is None else asdict(planned.baked)
    error = planned.error(errors)
    report = report_of(plan, settings.frames, clock.seconds, rays, passes, error, baked)
    own = field[: settings.frames].copy() if more else field  # a view would keep the others in memory
    rendered = WaveField(own, hologram, camera, plan.near, plan.to_dict(), report)
    return replace(rendered, more=field[settings.frames :]) if more else rendered


def _waves(recording, sets, straight, display, progress):
    """The wave field at the SLM of the wavelengths that a `Recording` is for."""
    stages = Stages(progress, "waves, despeckled" if recording.plan.settings.despeckle else "waves")
    lighting = named(stages["radiance"], "Radiance")
    lighting(0.0)
    radiance = recording.radiance(lighting)
    tracing = Tracing(recording, radiance, *sets, straight=straight)
    try:
        return at_slm(recording, tracing, display, stages["fields"])
    except Exception as error:
        if not libraries.out_of_memory(error):
            raise
    recording.plan = replace(recording.plan, library=libraries.NUMPY)
    return at_slm(recording, tracing, display, stages["fields"])


def baked_picture(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings,
    store: BakeStore | None = None,
    progress: Progress | None = None,
    anew: bool = False,
    most: int = 2048,
) -> tuple[np.ndarray, Bake]:
    """Bake what a camera sees, and show the texture.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
    store : BakeStore, optional
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.
    anew : bool
        See `bake`.
    most : int
        Pixels along a side of the picture.

    Returns
    -------
    picture : numpy.ndarray, float32, shape (y, x, 3)
        Linear; row 0 is the top.
    done : Bake

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    variants.activate_for(scene)
    from ..light.baking import bake
    from ..scene.specular_chains import optics_of

    settings = replace(settings, method="fast")
    planned = planner.plan(scene, camera, hologram, settings, store, progress and stage(progress, 0.0, 0.0))
    camera, hologram = widened(*traced(camera, hologram), planned.beside)
    optics = optics_of(scene, camera, planned)
    cache, done = bake(scene, camera, hologram, planned, optics, store=store, progress=progress, anew=anew)
    return cache.picture(most), done
