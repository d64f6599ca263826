"""Looks at the scene and decides how much has to be modelled, and says why."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import InvalidInput
from ..hologram import AerialImage
from ..mapping import DepthMapping, traced
from ..memory import available, on_card, shortage
from ..plan import CARD_STAGES, Decided, Decision, Plan, gathered_on
from ..progress import named
from ..scene import variants
from ..scene.meshes.joining import MANY_INSTANCES, instances_cost
from ..scene.variants import chunks_at_once
from ..settings import BASELINES, Settings
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
    from collections.abc import Mapping, Sequence

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..light.radiance_cache import RadianceCache
    from ..plan import RecordingPlane
    from ..progress import Progress
    from .survey import Survey

RAY_OFFSET = 9e-5  # that Mitsuba starts rays above surfaces, times 1 m + their largest coordinate
MOST_OFFSET = 0.03  # of the near end's depth: 0.5 dB
# columns that the radiance map's filter ends at
FILTER_REACH = {"draft": 2, "preview": 4, "balanced": 4, "high": 4}
FEW_LEVELS = 64  # of a draft's or preview's kernel tables at least
TO_THE_SLM = CARD_STAGES[:2]  # stages whose waves stay where they are until the SLM
CHUNK_BYTES = 128 << 20  # of the sums of pixels that are traced at once, at most


def plan(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings | None = None,
    store: BakeStore | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Decide what to compute for a scene on a display; computes nothing but a few probe rays.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings, optional
        Its `fixed` overrides decisions, see `FIXABLE`.
    store : BakeStore, optional
        Where baked light may be found.
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
    """
    variants.activate_for(scene)
    from .unmodelled import refuse_method, unmodelled

    told = named(progress or (lambda done, message: None), "Planning")
    told(0.0)
    requested = settings or Settings()
    check_fixed(requested.fixed)
    settings = resolved(requested)
    warnings, view = unmodelled(scene), traced(camera, hologram)
    refuse_method(scene, settings.method)
    if settings.method in BASELINES:
        if hologram.in_air is not hologram:
            raise InvalidInput(
                f"The method {settings.method} is made for light without a lens behind the SLM: leave out the lens, or "
                "choose the method auto."
            )
        # the least that tells the depths in view
        least = replace(settings, method="direct", radiance="ray", fixed={"max_depth": settings.max_depth})
        least = resolved(replace(least, phase_field="designed", randomness=None))
        looked = _planned(scene, *view, least, None, [], told)
        plan = _of_baseline(looked, settings, warnings)
    else:
        plan = _planned(scene, *view, settings, store, warnings, told)
    return replace(plan, requested=requested)


def _planned(scene, camera, hologram, settings, store, warnings, progress):
    """The plan of HoloPath's own methods, of resolved settings; see `plan`."""
    from . import costs, light, noise
    from .planes import margin_of, recording_planes
    from .survey import look_at

    survey = look_at(scene, camera, hologram, settings, store and store.speed, progress)
    planes = recording_planes(survey)
    margin = margin_of(planes.value, survey)
    progress(0.9)
    baking = light.diffuse_light(survey, margin, store)
    progress(1.0)
    cached = baking.value is not None
    bounces = light.light_bounces(survey, cached)
    paths = light.radiance_paths(survey, cached)
    cells = light.radiance_map(survey, margin)
    rays = light.wavelengths(survey)
    frames, padding, free = _frames(survey), _padding(survey.hologram, planes.value), _free_on_card()
    chunk = _chunk(settings, free)
    (passes, error), (slabs, bins), (grey, traversals) = paths.value, cells.value, rays.value
    what = planes.value, margin, slabs, bins, cached
    on = {} if free is None else costs.card_memory(survey, *what, chunk.value, free)
    whole = on and costs.card_memory(survey, *what, chunk.value, math.inf)
    library = _library(on, [stage for stage in on if on[stage] < whole[stage]], free)
    choices = (
        _depth(survey),
        _window(survey),
        survey.hits,
        planes,
        baking,
        bounces,
        paths,
        cells,
        rays,
        frames,
        chunk,
        _propagation(survey.hologram),
        padding,
        library,
    )
    memory, batch_bytes = (costs.memory(each, *what) for each in (survey, costs.refine_batch(survey)))
    warnings += [warning for choice in choices for warning in choice.warnings]
    warnings += _cautions(survey) + shortage(memory, "This hologram")
    chains, most = survey.chains, noise.most_passes(settings)
    rendering, encoding = (
        survey if all(on[stage] <= free for stage in stages) else _by_processor(survey)
        for stages in (on and TO_THE_SLM, on.keys() - CARD_STAGES)
    )
    taken = costs.stages(rendering, planes.value, margin, traversals, baking.value)
    return Plan(
        near=survey.near,
        z_low=survey.z_low,
        z_high=survey.z_high,
        planes=planes.value,
        rays_per_pixel=sum(plane.rays for plane in planes.value),
        passes=passes,
        most_passes=passes if "passes" in settings.fixed else most,
        wanted_error=0.5 * noise.wanted_noise(settings),
        white=survey.light.bright,
        grey=grey,
        traversals=traversals,
        margin=margin,
        slabs=slabs,
        bins=bins,
        regions=by_region(settings),
        cached=cached,
        texel_noise=noise.texel_noise(settings),
        texel_samples=most,
        max_depth=bounces.value,
        radiance_limit=noise.radiance_limit(settings, survey.light, passes),
        chain=chains.longest,
        splits=chains.splits,
        virtual_image=chains.virtual_image,
        pupil=chains.pupil,
        coherent=survey.seen.coherent,
        cone=CONE[settings.quality],
        levels=FEW_LEVELS if settings.quality in ("draft", "preview") else LEVELS[0],
        reach=FILTER_REACH[settings.quality] if settings.fixed.get("filter", 1) else 0,
        textures=noise.asked_textures(settings),
        chunk=chunk.value,
        stages=costs.compiled(survey, taken),
        phases=costs.phases(encoding, planes.value, traversals, taken),
        phases_memory=costs.phases_memory(survey, batch_bytes),
        error=error,
        memory_bytes=memory,
        requested=settings,
        settings=settings,
        decisions=tuple(decision for choice in choices for decision in choice.decisions),
        warnings=tuple(warnings),
        library=library.value,
        beside=survey.beside,
        card_memory=on,
    )


def resolved(settings: Settings) -> Settings:
    """Settings with what the method implies, `direct` the paper's estimator, and a wished speckle the frames.

    Phase fields are chosen by the frames, and their randomness, which is none but of smooth ones. Vertices of a path
    that are fixed are the most, too.

    Raises
    ------
    InvalidInput
        If no number of frames has so little speckle, or phase fields, randomness and estimator do not go together.
    """
    estimator = "paper" if settings.method == "direct" else settings.estimator
    kind, randomness = settings.phase_field, settings.randomness
    if kind == "auto" and randomness is not None:
        kind = "smooth"
    frames = settings.frames
    if settings.speckle is not None:
        # what little speckle is wished for is of many frames
        kind = "designed" if kind == "auto" else kind
        frames = frames_for(kind, settings.speckle, randomness)
    if kind == "auto":
        # steps against speckle gain most on designed ones, and spoil what is smooth
        smooth = frames < FEW_FRAMES and estimator == "lattice" and not settings.despeckle
        kind = "smooth" if smooth else "designed"
    if kind == "smooth" and settings.method not in BASELINES:
        if estimator == "paper":
            raise InvalidInput(
                "Smooth phase fields need the estimator lattice: leave out the method direct or the estimator paper, "
                "or choose the phase fields random."
            )
        randomness = randomness or 0.0
    elif randomness is not None and settings.method not in BASELINES:
        raise InvalidInput(
            f"A randomness is of smooth phase fields, not of {kind} ones: leave it out, or choose the phase fields "
            "smooth."
        )
    most = settings.fixed.get("max_depth", settings.max_depth)
    return replace(
        settings,
        estimator=estimator,
        frames=frames,
        max_depth=most,
        phase_field=kind,
        randomness=randomness,
    )


def once_baked(
    plan: Plan,
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    cache: RadianceCache,
) -> Plan:
    """The plan with the radiance paths that are needed with baked light: what is not cached decides.

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
    from ..scene.specular_chains import optics_of
    from . import noise
    from .light import CACHED_PASSES
    from .pilot import Pilot

    settings = plan.settings
    if settings.radiance == "ray" or "passes" in settings.fixed:
        return plan
    pilot = Pilot.of(scene, hologram, camera, DepthMapping.of(hologram, camera, plan.near), settings)
    tracer, optics = PathTracer(plan.max_depth, plan.radiance_limit, cache), optics_of(scene, camera, plan)
    light = pilot.light(tracer, optics, plan.max_depth, plan.max_depth, noise.firefly(settings))
    passes = noise.passes_for(settings, noise.noise_left(settings, light), CACHED_PASSES)
    return replace(plan, passes=min(passes, plan.passes))


def _of_baseline(plan, settings, warnings):
    """A plan as a baseline has it: the depths in view, the method and what to know; nothing is foretold."""
    _, label, what = BASELINES[settings.method]
    own = Decision("method", label, f"{what}; as asked, to be compared with HoloPath's own")
    frames = Decision("frames", str(settings.frames), "as asked")
    decisions = *plan.decisions[:2], own, frames
    nothing = {"stages": {}, "phases": {}, "phases_memory": {}, "card_memory": {}, "error": 0.0}
    return replace(plan, settings=settings, decisions=decisions, warnings=tuple(warnings), **nothing)


def _depth(survey: Survey) -> Decided[None]:
    """The depths in view, which nothing is chosen of."""
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
        width = (hologram.width - 2 * survey.beside) * hologram.pitch / 2
        seen, camera = (2 * math.degrees(math.atan(width / f)) for f in (lens.focal, mapping.focal))
        reason = (
            f"eyepiece mapping by a lens of {lens.focal * 1e3:g} mm, through which the picture is {seen:.2g} degrees "
            f"wide of the camera's {camera:.2g}"
        )
    share = hologram.optics.opening[2]
    radii = [1e3 * share * mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths]
    wide = f"{2 * min(radii):.3g} mm wide"
    if max(radii) > 1.01 * min(radii):
        wide += f" for all colors, {2 * max(radii):.3g} mm for the reddest"
    cone = "the cone of light that the pixels record, in the scene's scale"
    if hologram.optics.stopped:
        cone = f"the largest circle in the stop, {share:.0%} as wide as the cone that the pixels record"
    pupil = Decision("pupil", wide, cone)
    return Decided(None, (Decision("depth", value, reason), pupil))


def _window(survey: Survey) -> Decided[None]:
    """What is traced besides the picture."""
    if not survey.beside:
        return Decided(None)
    wide = survey.hologram
    inner = (wide.width - 2 * survey.beside) * (wide.height - 2 * survey.beside)
    reason = (
        f"light from {survey.beside} pixels beside the picture crosses the aperture, too, for "
        f"{wide.width * wide.height / inner - 1:.0%} more rays"
    )
    return Decided(None, (Decision("window", f"{wide.width} x {wide.height} pixels", reason),))


def _frames(survey: Survey) -> Decided[None]:
    """Frames, what speckle they leave over the metres that eyes focus through, and steps against it."""
    hologram, settings, mapping = survey.hologram, survey.settings, survey.mapping
    ends = survey.z_low, survey.z_high, mapping.z_far, float(mapping.depth_to_z(survey.near))
    speckle = speckle_contrast(settings.phase_field, settings.frames, settings.randomness)
    contrast = f"a speckle contrast of about {speckle:.0%}" if speckle else "no speckle"
    smooth = settings.phase_field == "smooth"
    degree = f" of randomness {settings.randomness:g}" if smooth else ""
    reason = f"{settings.phase_field} phase fields{degree} leave {contrast}"
    if smooth:
        straight = straight_share(settings.randomness)
        reason += f"; {straight:.0%} of the light goes straight on, to the middle of the eyebox"
    reach = REACH * hologram.pitch**2 / max(hologram.wavelengths)
    if settings.phase_field == "designed" and reach < max(ends) - min(ends):
        reason += f" up to {reach * 1e3:.2g} mm from focus, {speckle_contrast('random', settings.frames):.0%} beyond"
    if settings.speckle is not None:
        reason += f", {settings.speckle:.0%} wished"
    frames = Decision("frames", str(settings.frames), reason)
    if not settings.despeckle:
        return Decided(None, (frames,))
    reason = (
        f"towards the mean of {despeckle.BATCHES * SETS[-1]} frames of the same paths, which are traced too"
    )
    return Decided(None, (frames, Decision("despeckling", f"{settings.despeckle} steps", reason)))


def _by_processor(survey: Survey) -> Survey:
    """A survey whose waves the processor computes although there is a card."""
    return replace(survey, slowness=slowness(None, libraries.NUMPY))


def _free_on_card() -> int | None:
    """Bytes of the card's memory that are free where waves are computed there; None where they are not."""
    memory = on_card(libraries.empty_array(libraries.choose()[0]))
    return memory[1] if memory else None


def _chunk(settings: Settings, free: int | None) -> Decided[int]:
    """Bytes of the sums of pixels that are traced at once, of which a card has so many free."""
    asked = settings.fixed.get("chunk")
    if settings.radiance == "ray" or settings.estimator == "paper":
        chunk, reason = CHUNK_BYTES, "the same everywhere, as random numbers are drawn by chunks"
    else:
        free = (free or available() or CHUNK_BYTES << 3) if free is None else free // chunks_at_once()
        chunk = min(CHUNK_BYTES, max(1 << 20, free >> 3))
        reason = "an eighth of what is free at most"
    chunk, reason = (asked, "as asked") if asked else (chunk, reason)
    return Decided(chunk, (Decision("memory of a chunk", f"{chunk / 1e6:.0f} MB", reason),))


def _library(
    needs: Mapping[str, float], in_batches: Sequence[str] = (), free: int | None = None
) -> Decided[str]:
    """What computes waves and phases; that the processor does it without a card needs no words.

    Parameters
    ----------
    needs : dict of str to float
        Bytes of a card's memory that stages take, see `Plan.card_memory`.
    in_batches : sequence of str
        Of these, encodings whose batches are smaller there.
    free : int or None
        Bytes that the card has; None where waves are in the processor's memory.
    """
    name, advice = libraries.choose()
    if name == libraries.NUMPY:
        return Decided(name, warnings=(advice,) if advice else ())
    known = libraries.ON_CARDS[name]
    stays = Decision("waves", known, "fields and phases stay in the memory where it computes")
    if free is None:
        return Decided(name, (stays,))
    waves = max(needs[stage] for stage in TO_THE_SLM)
    if waves > free:
        reason = f"{known} would need {_size(waves)} of the card's memory, of which {_size(free)} are free"
        name, stays = libraries.NUMPY, Decision("waves", "processor", reason)
    beside = [stage for stage in needs if stage not in TO_THE_SLM and needs[stage] > free]
    smaller = [stage for stage in in_batches if stage not in beside]
    notes = [f"left to the processor: {', '.join(beside)}"] if beside else []
    notes += [f"in smaller batches, which fit: {', '.join(smaller)}"] if smaller else []
    taken = ", ".join(f"{stage} {_size(needed)}" for stage, needed in needs.items())
    reason = "; ".join(notes) or ("all else fits" if waves > free else "all fit")
    return Decided(name, (stays, Decision("card's memory", f"{taken}; {_size(free)} free", reason)))


def _size(count):
    return f"{count / 1e9:.3g} GB"


def _propagation(hologram: Hologram) -> Decided[None]:
    """How light comes from the image behind a lens to the SLM; nothing without one, where angular spectra do it all."""
    if not isinstance(hologram, AerialImage):
        return Decided(None)
    way = behind_lens(hologram.panel, hologram.shortest)
    assert way is not None
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
    return Decided(None, (Decision("propagation", f"{way.kind} transform", reason),))


def _padding(hologram: Hologram, planes: Sequence[RecordingPlane]) -> Decided[None]:
    """The padding that `padded_shape` gives the farthest way of a field."""
    farthest, pixels = abs(gathered_on(planes).z), hologram.width * hologram.height
    size = hologram.height, hologram.width
    rows, columns = padded_shape(size, hologram.pitch, max(hologram.wavelengths), farthest)
    place = hologram.origin
    reason = f"the least that {farthest * 1e3:.3g} mm to {place} need without wrapping around"
    twice = 4 * pixels / (rows * columns)
    saving = f"{twice:.1f} x against twice the size" if rows * columns < 3.6 * pixels else ""
    return Decided(None, (Decision("padding", f"{columns} x {rows} pixels", reason, saving, 0.0),))


def _cautions(survey: Survey) -> list[str]:
    """What to warn of in where scene and display lie."""
    found, near = [], survey.near
    offset = RAY_OFFSET * (1 + abs(survey.camera.position).max())
    if offset > MOST_OFFSET * near:
        found.append(
            f"Mitsuba's rays start {offset:.1g} m off surfaces here, much for a scene {near:.2g} m from the camera: "
            f"mirrors shift and light leaks; move the scene to the origin, or enlarge it."
        )
    found += instances_caution(survey.scene)
    farthest = max(survey.z_low, survey.z_high, key=abs)
    lost = survey.hologram.lost_light(farthest)
    if lost:
        found.append(f"{lost}; bring the depth range nearer to {survey.hologram.origin} or use more pixels.")
    return found


def instances_caution(scene: mi.Scene) -> list[str]:
    """What to warn of where a scene has many instances; empty where it has not."""
    from ..light.atlas import INSTANCE

    count = sum(shape.shape_type() == INSTANCE for shape in scene.shapes())
    if count < MANY_INSTANCES:
        return []
    return [
        f"The scene has {count} instances: for them each launch of rays takes about {instances_cost(count):.2g} s on a "
        "slow core, and four times that if they are twice as many; join them (in Blender Make Instances Real, then "
        "Ctrl J), or show fewer."
    ]
