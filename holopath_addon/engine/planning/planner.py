"""The planner: surveys a scene, decides what to compute, and gives a reason for each decision.

From top to bottom: `plan`, settings that it resolves, decisions on memory, reports that decide nothing, and warnings.
Decisions on chains are in `survey`, on recording planes in `planes`, and on light in `light`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import InvalidInput
from ..hologram import AerialImage
from ..mapping import DepthMapping, traced
from ..memory import available, gigabytes, on_card, shortage
from ..plan import CARD_STAGES, Decided, Decision, Plan, gathered_on
from ..progress import named
from ..scene import variants
from ..scene.meshes.joining import MANY_INSTANCES, instances_cost
from ..scene.variants import chunks_at_once
from ..settings import Settings
from ..settings.choices import BASELINES
from ..tracing.kernel_table import LEVELS
from ..waves import despeckle, libraries
from ..waves.lens import behind_lens
from ..waves.phase_fields import (
    FEW_FRAMES,
    REACH,
    SETS,
    frames_for,
    speckle_contrast,
    straight_share,
)
from ..waves.propagation import padded_shape
from .fixable import check_fixed
from .layouts import CONE, by_region
from .machine import slowness

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..light.radiance_cache import RadianceCache
    from ..plan import RecordingPlane
    from ..progress import PartProgress, Progress
    from .costs import CostModel
    from .survey import Survey

RAY_OFFSET = 9e-5  # distance from surfaces at which Mitsuba starts rays, over 1 m + their largest coordinate
MAX_RAY_OFFSET = 0.03  # fraction of the near end's depth, which costs 0.5 dB
FILTER_REACH = {"draft": 2, "preview": 4, "balanced": 4, "high": 4}  # columns to either side
FEW_LEVELS = 64  # minimum of a draft's or preview's kernel tables
TO_THE_SLM = CARD_STAGES[:2]  # stages whose waves stay in one memory until the SLM
MAX_CHUNK_BYTES, MIN_CHUNK_BYTES = 128 << 20, 1 << 20  # of the sums of pixels that are traced at once


def plan(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings | None = None,
    store: BakeStore | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Decide what to compute for a scene on a display, from a few probe rays and paths.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings, optional
        `Settings.fixed` overrides decisions, see `FIXABLE`. Default: `Settings()`.
    store : BakeStore, optional
        Store that may have baked light, and keeps the speed of this machine.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    Plan

    Raises
    ------
    InvalidInput
        If nothing is in view, or the machine has too little memory.
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
    >>> plan = engine.plan(scene, camera, hologram, engine.Settings(frames=3))
    >>> round(plan.near, 3), plan.settings.frames  # meters to the nearest surface
    (1.0, 3)
    """
    variants.activate_for(scene)
    from .survey import survey_scene
    from .unmodeled import check_method, unmodeled_warnings

    on_progress = named(progress or (lambda done, message: None), "Planning")
    on_progress(0.0)
    requested = settings or Settings()
    check_fixed(requested.fixed)
    settings = resolved(requested)
    warnings = unmodeled_warnings(scene) + despeckling_caution(requested)
    warnings += filter(None, [hologram.optics.zero_order_note(hologram.pitch, hologram.wavelengths)])
    eye, grid = traced(camera, hologram)
    check_method(scene, settings.method)
    if settings.method in BASELINES:
        if hologram.in_air is not hologram:
            raise InvalidInput(
                f"The method {settings.method} is made for light without a lens behind the SLM. Leave out the lens, or "
                "choose the method auto."
            )
        survey = survey_scene(scene, eye, grid, _baseline_survey_settings(settings), None, on_progress)
        plan = _plan_baseline(survey, settings, warnings, on_progress)
    else:
        survey = survey_scene(scene, eye, grid, settings, store and store.speed, on_progress)
        plan = _plan_survey(survey, store, warnings, on_progress)
    return replace(plan, requested=requested)


def _plan_survey(
    survey: Survey, store: BakeStore | None, warnings: list[str], progress: PartProgress
) -> Plan:
    """Plan the render of a scene that was surveyed."""
    from . import light, noise
    from .costs import CostModel
    from .planes import decide_planes, margin_of

    settings, hologram, chains = survey.settings, survey.hologram, survey.chains
    planes = decide_planes(survey)
    margin = margin_of(planes.value, survey)
    progress(0.9)
    baking = light.decide_diffuse_light(survey, margin, store)
    progress(1.0)
    cached = baking.value is not None
    bounces = light.decide_bounces(survey, cached)
    paths = light.decide_paths(survey, cached)
    radiance_map = light.decide_radiance_map(survey, margin)
    wavelengths = light.decide_wavelengths(survey)
    (passes, error), (slabs, bins), (gray, traversals) = paths.value, radiance_map.value, wavelengths.value
    costs = CostModel(
        survey=survey,
        planes=planes.value,
        margin=margin,
        slabs=slabs,
        bins=bins,
        traversals=traversals,
        baking_seconds=baking.value,
    )
    free_bytes = _free_card_bytes()
    chunk = decide_chunk(settings, free_bytes)
    card_bytes, in_batches = _card_bytes(costs, chunk.value, free_bytes)
    library = decide_library(card_bytes, in_batches, free_bytes)
    choices = (
        report_depth(survey),
        report_window(survey),
        survey.chain_decision,
        planes,
        baking,
        bounces,
        paths,
        radiance_map,
        wavelengths,
        report_frames(survey),
        chunk,
        report_propagation(hologram),
        report_padding(hologram, planes.value),
        library,
    )
    memory_bytes = costs.render_bytes()
    warnings += [warning for choice in choices for warning in choice.warnings]
    warnings += _scene_warnings(survey) + shortage(memory_bytes, "This hologram")
    too_large = {stage for stage, needed in card_bytes.items() if needed > (free_bytes or 0)}
    stages = _on_fitting_device(costs, too_large & set(TO_THE_SLM)).stage_seconds()
    encodings = _on_fitting_device(costs, too_large - set(CARD_STAGES))
    return Plan(
        near=survey.near,
        z_low=survey.z_low,
        z_high=survey.z_high,
        planes=planes.value,
        rays_per_pixel=sum(plane.rays for plane in planes.value),
        passes=passes,
        max_passes=passes if "passes" in settings.fixed else noise.max_passes(settings),
        target_error=0.5 * noise.target_noise(settings),
        white=survey.light.bright,
        gray=gray,
        traversals=traversals,
        margin=margin,
        slabs=slabs,
        bins=bins,
        regions=by_region(settings),
        cached=cached,
        texel_noise=noise.texel_noise(settings),
        texel_samples=noise.max_passes(settings),
        max_depth=bounces.value,
        radiance_limit=noise.radiance_limit(settings, survey.light, passes),
        chain=chains.longest,
        splits=chains.splits,
        virtual_image=chains.virtual_image,
        pupil=chains.pupil,
        coherent=survey.probe.coherent,
        cone=CONE[settings.quality],
        levels=FEW_LEVELS if settings.quality in ("draft", "preview") else LEVELS[0],
        reach=FILTER_REACH[settings.quality] if settings.fixed.get("filter", 1) else 0,
        textures=noise.requested_texture_rays(settings),
        chunk=chunk.value,
        stages=costs.with_compiling(stages),
        phases=encodings.encoding_seconds(stages),
        phases_memory=costs.encoding_bytes(),
        error=error,
        memory_bytes=memory_bytes,
        requested=settings,
        settings=settings,
        decisions=tuple(decision for choice in choices for decision in choice.decisions),
        warnings=tuple(warnings),
        library=library.value,
        beside=survey.beside,
        card_memory=card_bytes,
    )


def _plan_baseline(survey: Survey, settings: Settings, warnings: list[str], progress: PartProgress) -> Plan:
    """Plan a render by a baseline: the depths in view, the method and warnings, without estimates."""
    plan = _plan_survey(survey, None, [], progress)
    _, label, meaning = BASELINES[settings.method]
    method = Decision("method", label, f"{meaning}; as asked, to be compared with HoloPath's own")
    frames = Decision("frames", str(settings.frames), "as asked")
    return replace(
        plan,
        settings=settings,
        decisions=(*plan.decisions[:2], method, frames),
        warnings=tuple(warnings),
        stages={},
        phases={},
        phases_memory={},
        card_memory={},
        error=0.0,
    )


def _baseline_survey_settings(settings: Settings) -> Settings:
    """Settings that need the least work to find the depths in view."""
    fixed = {"max_depth": settings.max_depth}
    settings = replace(settings, method="direct", radiance="ray", fixed=fixed)
    return resolved(replace(settings, phase_field="designed", randomness=None))


def replan_after_bake(
    plan: Plan, scene: mi.Scene, camera: Camera, hologram: Hologram, cache: RadianceCache
) -> Plan:
    """Plan with the radiance paths that are needed once diffuse light is baked: for emitters, mirrors and gloss.

    Parameters
    ----------
    plan : Plan
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    cache : RadianceCache

    Returns
    -------
    Plan
    """
    from ..light.path_tracer import PathTracer
    from ..scene.specular_chains import image_finder_of
    from . import noise
    from .light import CACHED_PASSES
    from .pilot import Pilot

    settings = plan.settings
    if settings.radiance == "ray" or "passes" in settings.fixed:
        return plan
    pilot = Pilot.of(scene, hologram, camera, DepthMapping.of(hologram, camera, plan.near), settings)
    tracer = PathTracer(plan.max_depth, plan.radiance_limit, cache)
    image_finder = image_finder_of(scene, camera, plan)
    light = pilot.light(tracer, image_finder, plan.max_depth, plan.max_depth, noise.firefly_limit(settings))
    passes = noise.passes_for(settings, noise.path_variance(settings, light), CACHED_PASSES)
    return replace(plan, passes=min(passes, plan.passes))


def resolved(settings: Settings) -> Settings:
    """Settings with everything that they imply.

    The method `direct` implies the paper's estimator, and a target speckle the frames. Phase fields follow from the
    frames, and so does their randomness, which only smooth ones have. Fixed vertices of a path are the maximum, too.

    Parameters
    ----------
    settings : Settings

    Returns
    -------
    Settings

    Raises
    ------
    InvalidInput
        If no number of frames has so little speckle, or phase fields, randomness and estimator do not go together.
    """
    estimator = "paper" if settings.method == "direct" else settings.estimator
    kind, randomness, frames = settings.phase_field, settings.randomness, settings.frames
    if kind == "auto" and randomness is not None:
        kind = "smooth"
    if settings.speckle is not None:
        # only many frames have little speckle
        kind = "designed" if kind == "auto" else kind
        frames = frames_for(kind, settings.speckle, randomness)
    if kind == "auto":
        # despeckling gains most on designed fields, and spoils smooth ones
        smooth = frames < FEW_FRAMES and estimator == "lattice" and not settings.despeckle
        kind = "smooth" if smooth else "designed"
    if kind == "smooth" and settings.method not in BASELINES:
        if estimator == "paper":
            raise InvalidInput(
                "Smooth phase fields need the estimator lattice. Leave out the method direct or the estimator paper, "
                "or choose the phase fields random."
            )
        randomness = randomness or 0.0
    elif randomness is not None and settings.method not in BASELINES:
        raise InvalidInput(
            f"A randomness is a property of smooth phase fields, not of {kind} ones. Leave it out, or choose the phase "
            "fields smooth."
        )
    return replace(
        settings,
        estimator=estimator,
        frames=frames,
        max_depth=settings.fixed.get("max_depth", settings.max_depth),
        phase_field=kind,
        randomness=randomness,
    )


def decide_chunk(settings: Settings, free_card_bytes: int | None) -> Decided[int]:
    """Decide on the bytes of the sums of pixels that are traced at once: an eighth of the free memory.

    Parameters
    ----------
    settings : Settings
    free_card_bytes : int or None
        Free memory of the card that computes waves; None without one.
    """
    requested = settings.fixed.get("chunk")
    if requested:
        chunk, reason = requested, "as asked"
    elif settings.radiance == "ray" or settings.estimator == "paper":
        chunk, reason = MAX_CHUNK_BYTES, "the same everywhere, as random numbers are drawn by chunks"
    else:
        if free_card_bytes is None:
            free = available() or MAX_CHUNK_BYTES << 3
        else:
            free = free_card_bytes // chunks_at_once()
        chunk = min(MAX_CHUNK_BYTES, max(MIN_CHUNK_BYTES, free >> 3))
        reason = "an eighth of what is free at most"
    return Decided(chunk, (Decision("memory of a chunk", f"{chunk / 1e6:.0f} MB", reason),))


def decide_library(
    card_bytes: Mapping[str, float], in_batches: Iterable[str] = (), free_bytes: int | None = None
) -> Decided[str]:
    """Decide which library computes waves and phases; without a card there is nothing to report.

    Parameters
    ----------
    card_bytes : dict of str to float
        Bytes of the card's memory that stages need, see `Plan.card_memory`.
    in_batches : iterable of str
        Encodings in it that work on smaller batches because of the free memory.
    free_bytes : int or None
        Free memory of the card; None where waves are in the processor's memory.
    """
    name, advice = libraries.choose()
    if name == libraries.NUMPY:
        return Decided(name, warnings=(advice,) if advice else ())
    known = libraries.ON_CARDS[name]
    waves = Decision("waves", known, "fields and phases stay in the memory where it computes")
    if free_bytes is None:
        return Decided(name, (waves,))
    waves_bytes = max(card_bytes[stage] for stage in TO_THE_SLM)
    if waves_bytes > free_bytes:
        reason = (
            f"{known} would need {gigabytes(waves_bytes)} of the card's memory, of which {gigabytes(free_bytes)} are "
            "free"
        )
        name, waves = libraries.NUMPY, Decision("waves", "processor", reason)
    too_large = [stage for stage in card_bytes if stage not in TO_THE_SLM and card_bytes[stage] > free_bytes]
    smaller = [stage for stage in in_batches if stage not in too_large]
    notes = [f"left to the processor: {', '.join(too_large)}"] if too_large else []
    notes += [f"in smaller batches, which fit: {', '.join(smaller)}"] if smaller else []
    stages = ", ".join(f"{stage} {gigabytes(needed)}" for stage, needed in card_bytes.items())
    reason = "; ".join(notes) or ("all else fits" if waves_bytes > free_bytes else "all fit")
    return Decided(
        name, (waves, Decision("card's memory", f"{stages}; {gigabytes(free_bytes)} free", reason))
    )


def _free_card_bytes() -> int | None:
    """Free memory of the card on which waves are computed, bytes; None where they are not."""
    memory = on_card(libraries.empty_array(libraries.choose()[0]))
    return memory[1] if memory else None


def _card_bytes(
    costs: CostModel, chunk_bytes: int, free_bytes: int | None
) -> tuple[dict[str, float], list[str]]:
    """`CostModel.card_bytes`, and the encodings whose batches are smaller by what is free; empty without a card."""
    if free_bytes is None:
        return {}, []
    limited, unlimited = (costs.card_bytes(chunk_bytes, free) for free in (free_bytes, math.inf))
    return limited, [stage for stage in limited if limited[stage] < unlimited[stage]]


def _on_fitting_device(costs: CostModel, too_large: Iterable[str]) -> CostModel:
    """Costs of the processor where some stages are too large for the card."""
    if not too_large:
        return costs
    return replace(costs, survey=replace(costs.survey, slowness=slowness(None, libraries.NUMPY)))


def report_depth(survey: Survey) -> Decided[None]:
    """Report the visible depth range and the pupil. Makes no decision."""
    hologram, mapping, z_low, z_high = survey.hologram, survey.mapping, survey.z_low, survey.z_high
    end = "infinity" if z_low <= mapping.z_far else f"{mapping.z_to_depth(z_low):.3g} m"
    value = (
        f"{survey.near:.3g} m to {end} at {z_high * 1e3:.2f} to {z_low * 1e3:.2f} mm from {hologram.origin}"
    )
    nearest = hologram.depth_mapping == "fit" and not hologram.near
    reason = (
        "the volume ends at the nearest surface in view" if nearest else f"{hologram.depth_mapping} mapping"
    )
    lens = hologram.optics.lens
    if lens is not None:
        half_width = (hologram.width - 2 * survey.beside) * hologram.pitch / 2
        picture, camera = (2 * math.degrees(math.atan(half_width / f)) for f in (lens.focal, mapping.focal))
        reason = (
            f"eyepiece mapping by a lens of {lens.focal * 1e3:g} mm, through which the picture is {picture:.2g} "
            f"degrees wide of the camera's {camera:.2g}"
        )
    opening = hologram.optics.stop_circle[2]
    radii = [1e3 * opening * mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths]
    width = f"{2 * min(radii):.3g} mm wide"
    if max(radii) > 1.01 * min(radii):
        width += f" for all colors, {2 * max(radii):.3g} mm for the reddest"
    cone = "the cone of light that the pixels record, in the scene's scale"
    if hologram.optics.stopped:
        cone = f"the largest circle in the stop, {opening:.0%} as wide as the cone that the pixels record"
    return Decided(None, (Decision("depth", value, reason), Decision("pupil", width, cone)))


def report_window(survey: Survey) -> Decided[None]:
    """Report the pixels that are traced beyond the edges of the picture."""
    if not survey.beside:
        return Decided(None)
    window = survey.hologram
    picture = (window.width - 2 * survey.beside) * (window.height - 2 * survey.beside)
    reason = (
        f"light from {survey.beside} pixels beside the picture crosses the aperture, too, for "
        f"{window.width * window.height / picture - 1:.0%} more rays"
    )
    return Decided(None, (Decision("window", f"{window.width} x {window.height} pixels", reason),))


def report_frames(survey: Survey) -> Decided[None]:
    """Report the frames, the speckle that they leave over the depth range, and steps of despeckling."""
    hologram, settings, mapping = survey.hologram, survey.settings, survey.mapping
    ends = survey.z_low, survey.z_high, mapping.z_far, float(mapping.depth_to_z(survey.near))
    speckle = speckle_contrast(settings.phase_field, settings.frames, settings.randomness)
    contrast = (f"a speckle contrast of about {speckle:.0%}" if speckle else "no speckle") + " in the field"
    smooth = settings.phase_field == "smooth"
    degree = f" of randomness {settings.randomness:g}" if smooth else ""
    reason = f"{settings.phase_field} phase fields{degree} leave {contrast}"
    if smooth:
        straight = straight_share(settings.randomness)
        reason += f"; {straight:.0%} of its light goes straight on, to the middle of the eyebox"
    reach = REACH * hologram.pitch**2 / max(hologram.wavelengths)
    if settings.phase_field == "designed" and reach < max(ends) - min(ends):
        reason += f" up to {reach * 1e3:.2g} mm from focus, {speckle_contrast('random', settings.frames):.0%} beyond"
    if settings.speckle is not None:
        reason += f", at most {settings.speckle:.0%} as asked"
    decisions = [Decision("frames", str(settings.frames), reason)]
    if settings.despeckle:
        reason = f"towards the mean of {despeckle.BATCHES * SETS[-1]} frames of the same paths, which are traced too"
        decisions.append(Decision("despeckling", f"{settings.despeckle} steps", reason))
    return Decided(None, tuple(decisions))


def report_propagation(hologram: Hologram) -> Decided[None]:
    """Report the transform from the image behind a lens to the SLM; without a lens there is none."""
    if not isinstance(hologram, AerialImage):
        return Decided(None)
    transform = behind_lens(hologram.panel, hologram.shortest)
    assert transform is not None
    pixels = f"{hologram.pitch * 1e6:.3g} µm"
    if len(hologram.wavelengths) > 1:
        longest, shortest = max(hologram.wavelengths), hologram.shortest
        pixels += (
            f" at {shortest * 1e9:.4g} nm to {hologram.pitch_at(longest) * 1e6:.3g} at {longest * 1e9:.4g}"
        )
    reason = (
        "a lens has the SLM's far field near its focal plane, in pixels that are as fine as its aperture resolves, "
        f"{pixels}; angular spectra go on from there"
    )
    return Decided(None, (Decision("propagation", f"{transform.kind} transform", reason),))


def report_padding(hologram: Hologram, planes: Sequence[RecordingPlane]) -> Decided[None]:
    """Report the padding that `padded_shape` gives the longest propagation of a field."""
    farthest, pixels = abs(gathered_on(planes).z), hologram.width * hologram.height
    size = hologram.height, hologram.width
    rows, columns = padded_shape(size, hologram.pitch, max(hologram.wavelengths), farthest)
    reason = f"the minimum for {farthest * 1e3:.3g} mm to {hologram.origin} without wrapping around"
    ratio = 4 * pixels / (rows * columns)
    saving = f"{ratio:.1f} x against twice the size" if rows * columns < 3.6 * pixels else ""
    return Decided(None, (Decision("padding", f"{columns} x {rows} pixels", reason, saving, 0.0),))


def _scene_warnings(survey: Survey) -> list[str]:
    """Warnings about the places of scene, camera and display."""
    warnings, near = [], survey.near
    offset = RAY_OFFSET * (1 + abs(survey.camera.position).max())
    if offset > MAX_RAY_OFFSET * near:
        warnings.append(
            f"Mitsuba's rays start {offset:.1g} m off surfaces here, much for a scene {near:.2g} m from the camera: "
            f"mirrors shift and light leaks. Move the scene to the origin, or enlarge it."
        )
    warnings += instances_caution(survey.scene)
    farthest = max(survey.z_low, survey.z_high, key=abs)
    lost = survey.hologram.lost_light(farthest)
    if lost:
        warnings.append(
            f"{lost}; bring the depth range nearer to {survey.hologram.origin} or use more pixels."
        )
    return warnings


def despeckling_caution(requested: Settings) -> list[str]:
    """Warning about steps of despeckling that take smooth phases from the field of few frames; empty elsewhere.

    Parameters
    ----------
    requested : Settings

    Returns
    -------
    list of str
    """
    if not requested.despeckle or requested.method in BASELINES:
        return []
    without, chosen = resolved(replace(requested, despeckle=0)), resolved(requested)
    if without.phase_field != "smooth" or chosen.phase_field == "smooth":
        return []
    frames = "1 frame" if chosen.frames == 1 else f"{chosen.frames} frames"
    return [
        f"With {frames} steps of despeckling replace smooth phases, which leave no speckle in the field, by designed "
        "ones, which leave some: set Despeckle to 0."
    ]


def instances_caution(scene: mi.Scene) -> list[str]:
    """Warning about many instances in a scene, with what they cost; empty where there are few.

    Parameters
    ----------
    scene : mitsuba.Scene

    Returns
    -------
    list of str
    """
    from ..light.atlas import INSTANCE

    count = sum(shape.shape_type() == INSTANCE for shape in scene.shapes())
    if count < MANY_INSTANCES:
        return []
    return [
        f"The scene has {count} instances: for them each launch of rays takes about {instances_cost(count):.2g} s on a "
        "slow core, and four times that for twice as many. Join them (in Blender Make Instances Real, then Ctrl J), "
        "or show fewer."
    ]
