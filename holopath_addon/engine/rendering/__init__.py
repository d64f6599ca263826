"""Rendering from a scene to the wave field at the SLM: all stages in order, with progress, times and cancellation."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np

from .. import baselines
from ..errors import InvalidInput
from ..mapping import traced, widened
from ..planning import planner
from ..progress import Clock, Stages, named, parts, stage
from ..scene import variants
from ..settings import Settings
from ..settings.choices import BASELINES
from ..wavefield import WaveField
from ..waves import libraries
from .extra_frames import co_traced_phasors
from .fields import Tracing, at_slm
from .render_context import RenderContext, report_of

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..light.baking import Bake
    from ..plan import Plan
    from ..progress import Progress

MAX_BAKED_SIZE = 2048  # pixels along a side of the image of `baked_picture`


def render(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings | None = None,
    plan: Plan | None = None,
    progress: Progress | None = None,
    store: BakeStore | None = None,
    extra_frames: int = 0,
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
        Result of `plan` for the same scene, camera and hologram. Its decisions stay, whichever settings of the
        same kind of method, radiance and estimator are given beside it. Default: a new plan.
    progress : callable, optional
        ``progress(done, message)`` with done in 0..1, called several times a second; may raise `Cancelled`.
    store : BakeStore, optional
        Store of baked light for other views and later renders.
    extra_frames : int
        Number of extra frames that are co-traced for an encoding, see `extra_frame_count`; `WaveField.extra_frames`
        has them.

    Returns
    -------
    WaveField

    Raises
    ------
    InvalidInput
        If nothing is in view, settings contradict each other or the plan, or the machine has too little memory.
    BackendUnavailable
        If Mitsuba cannot compute here.
    Cancelled

    Examples
    --------
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> _ = engine.variants.activate()  # before Mitsuba is imported
    >>> import mitsuba as mi
    >>> wall = {"type": "rectangle", "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 0.5}}}
    >>> scene = mi.load_dict({"type": "scene", "wall": wall})
    >>> place = np.eye(4)
    >>> place[2, 3] = 1.0  # 1 m before the wall
    >>> camera, hologram = engine.Camera(place, 0.5), engine.Hologram(32, 32, 8e-6, (516.5e-9,))
    >>> field = engine.render(scene, camera, hologram, engine.Settings(frames=3))
    >>> field.data.shape  # frame, wavelength, y, x
    (3, 1, 32, 32)
    """
    variants.activate_for(scene)
    progress = progress or (lambda done, message: None)
    clock = Clock()
    progress(0.0, "Planning")
    if plan is None:
        with clock("plan"):
            plan = planner.plan(scene, camera, hologram, settings, store, stage(progress, 0.0, 0.0))
    elif settings is not None and settings != plan.requested:
        _check_same_kind(settings, plan)
        plan = replace(plan, requested=settings, settings=planner.resolved(settings))
    settings = plan.settings
    if settings.method in BASELINES:
        job = baselines.BaselineInput(scene, camera, hologram, settings, plan.near, plan.z_low, plan.z_high)
        with clock(settings.method):
            field = baselines.field(job, progress)
        plan = replace(plan, warnings=(*plan.warnings, *job.notes))
        report = {"seconds": clock.seconds, "frames": settings.frames}
        return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)
    context = RenderContext(scene, camera, hologram, plan, clock)
    stages = Stages(progress, "render, baked" if plan.cached else "render")
    stages["phase fields"](0.0, "Phase fields")
    sets = (context.phasors, co_traced_phasors(extra_frames)) if extra_frames else (context.phasors,)
    context.bake(store, stages["baking"])
    fields, errors, passes, rays = [], [], None, Counter()
    for group, part in zip(context.groups, parts(stages["waves"], len(context.groups)), strict=True):
        with context.recording(group) as recording:
            fields.append(_waves(recording, sets, context.straight, hologram, part))
        if recording.plan.library != plan.library:
            plan = replace(plan, library=recording.plan.library, warnings=(*plan.warnings, libraries.RAN_OUT))
        errors.append(recording.error)
        passes = recording.passes
        rays.update(recording.rays_traced)
    field = fields[0] if len(fields) == 1 else np.concatenate(fields, axis=1)
    baked = None if context.baked is None else asdict(context.baked)
    report = report_of(plan, clock.seconds, dict(rays), passes, context.error(errors), baked)
    # a view would keep the extra frames in memory
    own = field[: settings.frames].copy() if extra_frames else field
    rendered = WaveField(own, hologram, camera, plan.near, plan.to_dict(), report)
    return replace(rendered, extra_frames=field[settings.frames :]) if extra_frames else rendered


def _check_same_kind(settings, plan):
    """Refuse settings that need other decisions than those of a plan."""
    for name in ("method", "radiance", "estimator"):
        given, planned = getattr(planner.resolved(settings), name), getattr(plan.settings, name)
        if given != planned and (name != "method" or {given, planned} & set(BASELINES)):
            raise InvalidInput(
                f"The plan is for the {name} {planned}, not {given}. Plan with these settings, or give no plan."
            )


def _waves(recording, sets, straight, display, progress):
    """Wave field at the SLM of a `Recording`'s wavelengths; by the processor where a card's memory runs out."""
    stages = Stages(progress, "waves, despeckled" if recording.plan.settings.despeckle else "waves")
    on_radiance = named(stages["radiance"], "Radiance")
    on_radiance(0.0)
    radiance = recording.radiance(on_radiance)
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
) -> tuple[np.ndarray, Bake]:
    """Bake the light in a camera's view, and draw the texture.

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

    Returns
    -------
    image : numpy.ndarray, float32, shape (y, x, 3)
        Linear; row 0 is the top. At most `MAX_BAKED_SIZE` pixels along a side.
    baked : Bake

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    variants.activate_for(scene)
    from ..light.baking import bake

    settings = replace(settings, method="fast")
    plan = planner.plan(scene, camera, hologram, settings, store, progress and stage(progress, 0.0, 0.0))
    camera, hologram = widened(*traced(camera, hologram), plan.beside)
    cache, baked = bake(scene, camera, hologram, plan, store=store, progress=progress, anew=anew)
    return cache.picture(MAX_BAKED_SIZE), baked
