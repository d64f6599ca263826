"""From a scene to the wave field at the SLM: the stages in order, with progress, times and cancellation."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np

from . import baselines
from .planning import planner
from .progress import Clock, Stages, named, parts
from .scene import variants
from .settings import BASELINES, Settings
from .wavefield import WaveField
from .waves import despeckle
from .waves.phase_fields import phasors_of, pixel_transmission, recordable_fraction
from .waves.propagation import carrier, field_of, padded_shape, spectrum, transfer_function

if TYPE_CHECKING:
    import mitsuba as mi

    from .camera import Camera
    from .hologram import Hologram
    from .light.bake_store import BakeStore
    from .light.baking import Bake
    from .plan import Plan
    from .progress import Progress

# How much of a render is done when each stage ends: of the whole with baked light and without, and of the waves with
# steps against speckle and without.
BAKED = {"planning": 0.02, "phase fields": 0.04, "baking": 0.5, "waves": 1.0}
TRACED = {"planning": 0.02, "phase fields": 0.04, "waves": 1.0}
DESPECKLED = {"radiance": 0.2, "tracing": 0.4, "despeckling": 0.97, "to the SLM": 1.0}
PLAIN = {"radiance": 0.5, "tracing": 0.97, "to the SLM": 1.0}
DESPECKLING = {"frames": 0.5, "steps": 1.0}


def render(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings | None = None,
    plan: Plan | None = None,
    progress: Progress | None = None,
    store: BakeStore | None = None,
) -> WaveField:
    """Render the wave field of a scene.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings, optional
    plan : Plan, optional
        From `plan` for the same scene and settings; made when not given.
    progress : callable, optional
        ``progress(done, message)`` with done in 0..1, called several times a second; may raise
        `Cancelled`.
    store : BakeStore, optional
        Where baked light is kept for other views and other times.

    Returns
    -------
    WaveField

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    variants.activate()
    from .scene.dispersion import tuned, wavelength_groups
    from .scene.specular_chains import optics_of
    from .tracing.recording import Recording

    settings = planner.resolved(settings or Settings())
    progress = progress or (lambda done, message: None)
    clock = Clock()
    progress(0.0, "Planning")
    if plan is None:
        with clock("plan"):
            plan = planner.plan(scene, camera, hologram, settings, store)
    if settings.method in BASELINES:
        job = baselines.BaselineInput(scene, camera, hologram, settings, plan.near, plan.z_low, plan.z_high)
        with clock(settings.method):
            field = baselines.field(job, progress)
        report = {"seconds": clock.seconds, "frames": settings.frames}
        return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)
    stages = Stages(progress, BAKED if plan.cached else TRACED)
    stages["phase fields"](0.0, "Phase fields")
    with clock("phase fields"):
        phasors = phasors_of(
            settings.phase_field, settings.frames, hologram.height, hologram.width, settings.seed
        )
    cache, baked = None, None
    if plan.cached:
        from .light.baking import bake

        with clock("bake"):
            optics = optics_of(scene, camera, plan)
            cache, baked = bake(
                scene, camera, hologram, plan, optics, settings, store=store, progress=stages["baking"]
            )
    groups = (
        (hologram.wavelengths,) if plan.traversals == 1 else wavelength_groups(scene, hologram.wavelengths)
    )
    fields, errors, passes, rays_traced = [], [], None, {}
    for group, at in zip(groups, parts(stages["waves"], len(groups)), strict=True):
        part = replace(hologram, wavelengths=group)
        with tuned(scene, group):
            baked_plan = plan
            if cache is not None:
                with clock("radiance"):
                    baked_plan = planner.once_baked(plan, scene, camera, part, settings, cache)
            with clock("optics"):
                recording = Recording(scene, camera, part, settings, baked_plan, clock, cache=cache)
            fields.append(_field_at_slm(recording, phasors, at))
            errors.append(recording.error)
            passes = recording.passes
        for name, count in recording.rays_traced.items():
            rays_traced[name] = rays_traced.get(name, 0) + count
    field = fields[0] if len(fields) == 1 else np.concatenate(fields, axis=1)
    report = {
        "seconds": clock.seconds,
        "rays": rays_traced,
        "variant": variants.activate(),
        "frames": settings.frames,
        "radiance_passes": passes,
        "foretold": {
            "seconds": {
                "plan": plan.seconds,
                "measured": sum(clock.seconds.values()) - clock.seconds.get("plan", 0.0),
            },
            "stages": plan.stages,
            "field_error": {"plan": plan.error, "measured": _error_of(errors, plan, baked)},
        },
    }
    if baked is not None:
        report["bake"] = asdict(baked)
    return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)


def _error_of(errors, plan, baked):
    """Relative standard error of the field, of the radiance map's halves and of baked light; None where unknown."""
    if None in errors:
        return None
    texels = 0.0
    if baked is not None:
        texels = plan.error if baked.error is None else 0.5 * baked.error
    return float(np.hypot(max(errors), texels))


def _field_at_slm(recording, phasors, progress):
    """The wave field at the SLM of the wavelengths that a `Recording` is for."""
    hologram = recording.hologram
    steps = recording.settings.despeckle
    stages = Stages(progress, DESPECKLED if steps else PLAIN)
    lighting = named(stages["radiance"], "Radiance")
    lighting(0.0)
    radiance = recording.radiance(lighting)
    field = _field_in_scene(recording, radiance, phasors, stages["tracing"])
    if steps:
        _despeckle(recording, radiance, field, stages["despeckling"])
    with recording.clock("propagation"):
        for k, m, wave in _moved(field, hologram, -recording.plan.z_gathered):
            field[m, k] = wave
            step = (k * len(field) + m + 1) / (len(field) * len(hologram.wavelengths))
            stages["to the SLM"](step, "To the SLM")
    beyond = recording.beyond
    return field[..., beyond : beyond + hologram.height, beyond : beyond + hologram.width]


def _field_in_scene(recording, radiance, phasors, progress):
    """The wave field at `Plan.z_gathered`, of all that lies before and behind it.

    Its scale makes a plane of radiance L refocus to intensity L. Between planes the carrier is left out, for then the
    shares of a surface that two planes record add up, whatever the wavelength.
    """
    hologram, planes = recording.hologram, recording.plan.planes
    shape = len(phasors), len(hologram.wavelengths), *recording.canvas
    field, z = np.zeros(shape, np.complex64), planes[0].z
    for number, (plane, told) in enumerate(zip(planes, parts(progress, len(planes)), strict=True)):
        tracing, moving = named(told, "Wave tracing"), named(told, "Between planes")
        if plane.sees == "images":
            # straight rays tell which of them are seen
            images = np.zeros_like(field)
            recording.record(plane, radiance, phasors, tracing, images)
            with recording.clock("propagation"):
                for k, m, wave in _moved(images, hologram, z - plane.z, carried=False):
                    moving(1.0)
                    field[m, k] += wave
            continue
        if number:
            # what lies behind passes the surfaces of this slab as a wave, there where they begin
            with recording.clock("silhouettes"):
                clear = np.sqrt(1 - recording.silhouette(plane))
            with recording.clock("propagation"):
                for k, m, wave in _moved(field, hologram, plane.low - z, carried=False):
                    moving(0.0)
                    field[m, k] = wave * clear
                for k, m, wave in _moved(field, hologram, plane.z - plane.low, carried=False):
                    moving(0.0)
                    field[m, k] = wave
        z = plane.z
        recording.record(plane, radiance, phasors, tracing, field)
    with recording.clock("phase fields"):
        recordable = recordable_fraction(phasors)
    if recording.settings.estimator == "paper":
        recordable *= pixel_transmission()
    field *= np.float32(1 / np.sqrt(recordable))
    return field


def _despeckle(recording, radiance, field, progress):
    """Take speckle out of the field on the plane nearest to the viewer, in place; the same paths, more frames."""
    hologram, plan, settings = recording.hologram, recording.plan, recording.settings
    low, high = (z - plan.z_gathered for z in (plan.z_low, plan.z_high))
    targets = [
        despeckle.targets(field.shape[-2:], hologram.pitch, wavelength, low, high, settings.seed)
        for wavelength in hologram.wavelengths
    ]
    stages = Stages(progress, DESPECKLING)
    for number, told in enumerate(parts(stages["frames"], despeckle.BATCHES)):
        many = _field_in_scene(recording, radiance, despeckle.batch_phasors(number), told)
        with recording.clock("despeckle"):
            for k, target in enumerate(targets):
                target.add(many[:, k])
    with recording.clock("despeckle"):
        for k, (target, told) in enumerate(zip(targets, parts(stages["steps"], len(targets)), strict=True)):
            field[:, k] = despeckle.despeckle(
                field[:, k], target, settings.despeckle, settings.seed, named(told, "Despeckling")
            )


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
    variants.activate()
    from .light.baking import bake
    from .scene.specular_chains import optics_of

    settings = replace(settings, method="fast")
    planned = planner.plan(scene, camera, hologram, settings, store)
    optics = optics_of(scene, camera, planned)
    cache, done = bake(
        scene, camera, hologram, planned, optics, settings, store=store, progress=progress, anew=anew
    )
    return cache.picture(most), done


def _moved(field, hologram, distance, carried=True):
    """Wavelength number, frame number and the field moved by a distance, with its carrier or without, of a stack."""
    shape = field.shape[-2:]
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(shape, hologram.pitch, wavelength, distance)
        transfer = transfer_function(padded, hologram.pitch, wavelength, distance)
        if carried:
            transfer = transfer * carrier(wavelength, distance)
        for m in range(len(field)):
            yield k, m, field_of(spectrum(field[m, k], padded) * transfer, shape)
