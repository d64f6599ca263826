"""Computation of a hologram from a scene to refocused images and phases."""

import math
import time
from dataclasses import dataclass, field, replace

import numpy as np

from .. import engine
from ..engine.hologram import channel
from ..engine.mapping import DepthMapping, squared
from ..engine.memory import encoding_on_card, on_processor, refocusing_on_card
from ..engine.planning.planner import resolved
from ..engine.progress import SHARES, Clock, Compiling, Stages, stage
from ..engine.waves import libraries
from .request import CENTER

MAX_TEXEL_PIXEL_RATIO = 1.5  # size of a texel over that of a pixel, above which shadows are visibly softer
MAX_NAMES = 8  # names in one line
MIN_PREVIEW_SECONDS = 2.0  # estimated time of a render from which on it has previews
PREVIEW_FRACTION = 0.1  # of the estimated time of the hologram, or of its draft
# Ratio of the hologram's to the draft's estimated seconds from which on a draft pays off: the measured ratio is then
# three to five. The default cube has a ratio of two, and no draft.
MIN_DRAFT_RATIO = 2.5
DRAFT_COMPILE_RATIO = (
    3.0  # time to compile a draft's programs over that of its plan, if the plan compiled any
)
MAX_DRAFT_FRAMES = 4
DRAFT_METHODS = {"auto", "full", "fast"}  # methods whose hologram a draft resembles
PLANNING_PROGRESS_RANGE = 0.02, 0.5  # bounds of the fraction of the work that is done after planning


@dataclass
class Result:
    """Result of `compute`.

    Attributes
    ----------
    plan : engine.Plan
    field : engine.WaveField
    focus : list of float
        World depths of the images, meters.
    images : numpy.ndarray, float32, shape (focus, y, x, wavelength)
    seconds : dict of str to float
        Seconds of each stage.
    """

    plan: engine.Plan
    field: engine.WaveField
    focus: list
    images: np.ndarray = field(repr=False)
    seconds: dict


def diopters_in_view(plan, camera, hologram):
    """Nearest and farthest visible depth, diopters; 0 is infinity.

    Parameters
    ----------
    plan : engine.Plan
    camera : engine.Camera
    hologram : engine.Hologram

    Returns
    -------
    (float, float)
    """
    mapping = DepthMapping.of(hologram, camera, plan.near)
    return tuple(1 / float(mapping.z_to_depth(z)) for z in (plan.z_high, plan.z_low))


def default_focus(plan, camera, hologram):
    """Near, middle and far depth of the view, evenly spaced in diopters.

    Parameters
    ----------
    plan, camera, hologram
        See `diopters_in_view`.

    Returns
    -------
    list of float
        World depths, meters, nearest first; `math.inf` if the view reaches infinity. Fewer if depths coincide.
    """
    near, far = diopters_in_view(plan, camera, hologram)
    depths = []
    for diopters in (near, (near + far) / 2, far):
        depth = float(f"{1 / diopters:.3g}") if diopters > 1e-6 else math.inf
        if depth not in depths:
            depths.append(depth)
    return depths


def center_depth(scene, camera):
    """Depth of the surfaces in the middle of the view, for autofocus.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : engine.Camera

    Returns
    -------
    float or None
        Median world depth over the middle tenth of the view, meters; None if most of it is empty.
    """
    from ..engine.viewing.depth import depths_along

    tangent = math.tan(camera.fov_x / 2)
    offsets = np.linspace(-0.1, 0.1, 15) * tangent
    across, upward = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    depths = depths_along(
        scene, camera, across + 2 * tangent * camera.shift_x, upward + 2 * tangent * camera.shift_y
    )
    found = depths[np.isfinite(depths)]
    return float(f"{np.median(found):.3g}") if len(found) >= len(depths) / 10 else None


def bake_notes(bake):
    """Notes for the user on baked light.

    Parameters
    ----------
    bake : dict or None
        Entries of an `engine.baking.Bake`, as in `WaveField.report`; None without baked light.

    Returns
    -------
    list of str
        A line each.
    """
    if bake is None:
        return []
    from ..engine.light.unwrapping import LACKING

    notes = [note for note in (bake["note"], LACKING) if note]
    if bake["coarser"] > MAX_TEXEL_PIXEL_RATIO:
        notes.append(
            f"To limit memory, texels of the baked light are {bake['coarser']:.1f} times larger than pixels, and "
            "shadows softer. The method full has sharp ones."
        )
    if bake["traced"]:
        count = len(bake["traced"])
        names = ", ".join(bake["traced"][:MAX_NAMES]) + (", ..." if count > MAX_NAMES else "")
        shapes = "1 shape's" if count == 1 else f"{count} shapes'"
        notes.append(f"{shapes} diffuse light is traced, not baked: {names}.")
    return notes


def _plan_of(field):
    """The `Plan` that a field was rendered by; None without a field, or if another version made the plan."""
    if field is None:
        return None
    try:
        return engine.Plan.from_dict(field.plan)
    except (KeyError, TypeError, engine.InvalidInput):
        return None


def _check_view(plan, camera, hologram, focus, pupil):
    """Raise the errors of `engine.reconstruct` before the render starts."""
    from ..engine.viewing.reconstruction import pupil_mask

    mapping = DepthMapping.of(hologram, camera, plan.near)
    mapping.depth_to_z(list(focus))
    if pupil is not None:
        for wavelength in hologram.wavelengths:
            grid = hologram.in_air.raster(wavelength)
            pupil_mask(grid.shape, grid.pitch, wavelength, mapping, pupil, hologram.optics)


def _elapsed_fraction(start, plan):
    """Fraction of the whole time that has passed since `start`, by the plan's estimate, which baselines lack."""
    low, high = PLANNING_PROGRESS_RANGE
    elapsed = time.monotonic() - start
    return min(max(low, elapsed / (elapsed + plan.seconds)), high) if plan.seconds else low


def _preview(request, plan, focus, seconds, progress, offer):
    """Offer ever finer images through a thin lens for about that many seconds, at least one."""
    start = time.monotonic()
    camera, hologram, pupil = request.camera, request.hologram, request.pupil
    mapping = DepthMapping.of(hologram, camera, plan.near)
    reach = float(np.mean([mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths]))
    x, y, aperture = (reach * value for value in hologram.optics.stop_circle)
    channels = [channel(w) for w in hologram.wavelengths]
    camera, hologram = squared(camera, hologram)
    size, center = (hologram.width, hologram.height), (x, y)
    if pupil is not None:
        aperture, center = min(aperture, pupil.diameter / 2), (pupil.x, pupil.y)
    vertices = request.settings.max_depth
    preview = engine.Preview(request.scene, camera, *size, focus, aperture, vertices, center=center)
    # Each image has twice the paths of the last one, and takes as long as all before.
    while 2 * (time.monotonic() - start) < seconds or not preview.spp:
        light = preview.refine(max(1, preview.spp), progress)
        offer(engine.to_rgb(light[..., channels], hologram.wavelengths))


@dataclass(frozen=True)
class _Draft:
    """Plan of a hologram of draft quality, which takes a fraction of the time."""

    plan: engine.Plan
    seconds: float  # estimated


def _draft(request, plan):
    """The `_Draft` of a planned hologram; None if it would save too little time."""
    settings = request.settings
    if settings.method not in DRAFT_METHODS or settings.quality == "draft":
        return None
    settings = resolved(settings)
    settings = replace(
        settings,
        quality="draft",
        method="full",  # the hologram would use a draft's baked light, and change by it
        frames=min(settings.frames, MAX_DRAFT_FRAMES),
        speckle=None,
        spp=None,
        despeckle=0,
    )
    compiles, start = Compiling(), time.monotonic()
    draft = engine.plan(request.scene, request.camera, request.hologram, settings, request.store)
    stages = {name: min(own, plan.stages.get(name, own)) for name, own in draft.stages.items()}
    if "radiance" in stages and plan.passes and not plan.cached:
        # The hologram's plan has traced more paths, so its estimate of their time is better.
        stages["radiance"] = min(stages["radiance"], plan.stages["radiance"] * draft.passes / plan.passes)
    seconds = sum(stages.values())
    if compiles():
        seconds += DRAFT_COMPILE_RATIO * (time.monotonic() - start)
    return _Draft(draft, seconds) if MIN_DRAFT_RATIO * seconds <= plan.seconds else None


def _render_draft(request, plan, depths, progress):
    """The `Result` of a draft by its plan."""
    stages = Stages(lambda done, message: progress(done, f"Draft: {message}"), "images")
    field = engine.render(
        request.scene,
        request.camera,
        request.hologram,
        plan=plan,
        progress=stages["field"],
        store=request.store,
    )
    images, notes = reconstruct(field, depths, request.pupil, stages["images"])
    return Result(_with_warnings(plan, notes), field, depths, images, field.report["seconds"])


def compute(request, progress=None, rendered=None, offer=None):
    """Plan, render and refocus a hologram.

    Parameters
    ----------
    request : Request
        The extra frames that its encoding needs are traced along with the field's.
    progress : callable, optional
        ``progress(done, message)``, may raise `engine.Cancelled`.
    rendered : engine.WaveField, optional
        Field of the same scene and settings, to refocus instead of rendering again.
    offer : callable, optional
        ``offer(image)`` is called with previews, linear RGB of shape (y, x, 3), and ``offer(image, draft)`` with that
        of a draft and its `Result`, if the hologram takes several times as long. The hologram does not depend on it.

    Returns
    -------
    Result

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled
    """
    progress = progress or (lambda done, message: None)
    if request.method is not None:
        request = replace(request, settings=replace(request.settings, method=request.method))
    scene, camera, hologram, settings = request.scene, request.camera, request.hologram, request.settings
    start, clock = time.monotonic(), Clock()
    progress(0.0, "Planning")
    with clock("plan"):
        plan = _plan_of(rendered) or engine.plan(
            scene, camera, hologram, settings, request.store, stage(progress, 0.0, 0.0)
        )
    depths = _depths(request, plan)
    _check_view(plan, camera, hologram, depths, request.pupil)
    if rendered is None:
        encoding = request.encoding
        extra_frames = engine.extra_frame_count(
            plan, hologram, encoding.method, encoding.seconds, encoding.eyebox
        )
        if encoding.is_requested:  # refused now rather than after the render
            phases = engine.plan_encoding(
                plan, encoding.method, encoding.seconds, extra_frames, encoding.eyebox
            )
            plan = _with_warnings(plan, _shortage(plan, phases))
        done = _elapsed_fraction(start, plan)
        if offer is not None and plan.seconds >= MIN_PREVIEW_SECONDS:
            done = _offer_early(request, plan, depths, start, clock, progress, offer)
        render_progress = stage(progress, done, SHARES["images"]["field"])
        rendered = engine.render(
            scene, camera, hologram, None, plan, render_progress, request.store, extra_frames
        )
        clock.seconds.update(rendered.report["seconds"])
    with clock("refocusing"):
        images, notes = reconstruct(rendered, depths, request.pupil, Stages(progress, "images")["images"])
    plan = _with_warnings(plan, [*rendered.plan.get("warnings", ()), *notes])
    return Result(plan, rendered, depths, images, clock.seconds)


def _depths(request, plan):
    """World depths of the images, meters, each once."""
    focus, camera, hologram = request.focus, request.camera, request.hologram
    depths = [focus] if focus == CENTER else list(focus or default_focus(plan, camera, hologram))
    if CENTER in depths:
        center = center_depth(request.scene, camera) or default_focus(plan, camera, hologram)[0]
        depths = [center if depth == CENTER else depth for depth in depths]
    return list(dict.fromkeys(depths))


def _offer_early(request, plan, depths, start, clock, progress, offer):
    """Offer previews, and a draft if it pays off; the fraction of the work that is then done."""
    progress(_elapsed_fraction(start, plan), "Draft: Planning")
    with clock("draft"):
        draft = _draft(request, plan)
    seconds = PREVIEW_FRACTION * (plan.seconds if draft is None else draft.seconds)
    done = _elapsed_fraction(start, plan)
    with clock("preview"):
        _preview(request, plan, depths[0], seconds, stage(progress, done, done), offer)
    done = max(done, _elapsed_fraction(start, plan))
    if draft is not None:
        end = _elapsed_fraction(start - draft.seconds, plan)
        with clock("draft"):
            result = _render_draft(request, draft.plan, depths, stage(progress, done, end))
        offer(engine.to_rgb(result.images[0], request.hologram.wavelengths), result)
        done = max(end, _elapsed_fraction(start, plan))
    return done


def _shortage(plan, phases):
    """Warnings of an `EncodingPlan`, where no card encodes; raise where the machine has too little memory."""
    return [] if phases.method in plan.card_memory else phases.memory_warnings()


def _with_warnings(plan, warnings):
    """The plan with further warnings, each once."""
    return replace(plan, warnings=tuple(dict.fromkeys((*plan.warnings, *warnings))))


def reconstruct(field, focus, pupil, progress):
    """Refocus a field, on the graphics card if one computes waves.

    Parameters
    ----------
    field : engine.WaveField
    focus : sequence of float
        World depths, meters.
    pupil : engine.Pupil or None
        Part of the viewer's pupil; None for all of it.
    progress : callable
        ``progress(done, message)``, may raise `engine.Cancelled`.

    Returns
    -------
    images : numpy.ndarray, float32, shape (focus, y, x, wavelength)
    notes : list of str
        A sentence if the card's memory ran out.

    Raises
    ------
    engine.InvalidInput, engine.Cancelled
        See `engine.reconstruct`.
    """

    def refocus(data):
        return on_processor(engine.reconstruct(replace(field, data=data), focus, pupil, progress))

    needed = refocusing_on_card(field.data.nbytes, 4 * len(focus) * field.data[0].size)
    images, note = libraries.by_card(refocus, field.data, needed)
    return images, [note] * bool(note)


def phases_by_card(work, data, needed=None):
    """Compute phases on the graphics card if one computes waves.

    Parameters
    ----------
    work : callable
        ``work(data)`` gives an `engine.PhaseHologram` in the array library of the data. Its exceptions may keep one in
        their attribute `kept`.
    data : numpy.ndarray
        Data of a field, or of phases.
    needed : float, optional
        Bytes of the card's memory that `work` takes. Default: `encoding_on_card`.

    Returns
    -------
    engine.PhaseHologram
        In NumPy's arrays. If the card's memory ran out, the advice in its report says so.
    """

    def compute_phases(data):
        try:
            return _in_numpy(work(data))
        except Exception as error:
            kept = getattr(error, "kept", None)
            if kept is not None:
                vars(error)["kept"] = _in_numpy(kept)
            raise

    phase, note = libraries.by_card(compute_phases, data, needed or encoding_on_card(data.nbytes))
    if note:
        phase.report["advice"] = " ".join(filter(None, (phase.report.get("advice"), note)))
    return phase


def encoding_notes(phase):
    """Notes for the user on phases: what more seconds would bring, and the encoder's own advice.

    Parameters
    ----------
    phase : engine.PhaseHologram

    Returns
    -------
    list of str
        Sentences.
    """
    plan, own, notes = phase.report.get("plan"), phase.report.get("advice"), []
    if plan and plan["advice"]:
        short = "" if plan["method"] == "refine" else f"The encoding is {plan['method']}: {plan['reason']}. "
        notes.append(f"{short}{plan['advice']} See --encode-seconds.")
    return notes + [own] * bool(own)


def _in_numpy(phase):
    return replace(phase, data=on_processor(phase.data))


def _encode(field, method, progress, needed=None, **options):
    """Phases of `engine.encode`, by `phases_by_card`."""
    return phases_by_card(
        lambda data: engine.encode(replace(field, data=data, extra_frames=None), method, progress, **options),
        field.data,
        needed,
    )


def encode(field, encoding, progress, scene=None, settings=None, store=None, **options):
    """Encode a field, with extra frames of its scene if the method needs them.

    Parameters
    ----------
    field : engine.WaveField
    encoding : Encoding
        Its `previous` has no effect: `options` may have a `start`.
    progress : callable
        ``progress(done, message)``, may raise `engine.Cancelled`.
    scene : mitsuba.Scene, optional
        Scene of the field. Without it and its settings the method `auto` is that of `engine.encode`.
    settings : engine.Settings, optional
        Settings of the field.
    store : engine.BakeStore, optional
        Store of baked light.
    options
        Other arguments of `engine.encode`.

    Returns
    -------
    engine.PhaseHologram
        With a scene its `report` also has the `engine.EncodingPlan`.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled
    """
    seconds = encoding.seconds
    options |= {**encoding.options, "seconds": seconds}
    if scene is None or settings is None:
        return _encode(field, encoding.method, progress, eyebox=encoding.eyebox, **options)
    camera, hologram = field.camera, field.hologram
    plan = _plan_of(field) or engine.plan(scene, camera, hologram, settings, store, stage(progress, 0.0, 0.0))
    n_traced = 0 if field.extra_frames is None else len(field.extra_frames)
    chosen = engine.plan_encoding(plan, encoding.method, seconds, n_traced, encoding.eyebox)
    _shortage(plan, chosen)  # raises where the machine has too little
    options |= {"randomness": chosen.randomness, "eyebox": chosen.eyebox}
    if chosen.steps:
        options.setdefault("max_steps", chosen.steps)

    def extra_frames(progress):
        if n_traced:
            yield list(range(len(hologram.wavelengths))), field.extra_frames
        if chosen.frames > n_traced:
            has_limit = seconds is not None
            yield from engine.extra_frames(
                scene, camera, hologram, plan, progress, store, chosen.frames, n_traced, has_limit
            )

    try:
        needed = plan.card_memory.get(chosen.method)
        phase = _encode(field, chosen.method, progress, needed, extra_frames=extra_frames, **options)
    except engine.Cancelled as error:
        if error.kept is not None:
            error.kept.report["plan"] = chosen.to_dict()
        raise
    phase.report["plan"] = chosen.to_dict()
    return phase
