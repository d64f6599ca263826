"""From a scene to refocused pictures in one call: what the command line and Blender share. Imports no bpy."""

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

COARSER = 1.5  # times larger texels than pixels show
MOST_NAMES = 8  # in one line
MIN_PREVIEW_SECONDS = 2.0  # seconds within which no preview is needed
PREVIEW_SHARE = 0.1  # of the planned time, or of the draft's where there is one
# Times a draft's foretold seconds that the hologram has to take for a draft to be worth them: where that much is
# foretold it takes three to five times as long. The default cube takes twice as long, and goes without.
MIN_DRAFT_RATIO = 2.5
COMPILED = 3.0  # times as long as its plan a draft's programs are compiled, where some of the plan's were
MAX_DRAFT_FRAMES = 4  # most
DRAFTED = {"auto", "full", "fast"}  # methods that a draft resembles
BEGUN = 0.02, 0.5  # of the work, least and most, is said to be done when the plan is made


@dataclass
class Result:
    """What `compute` brings.

    Attributes
    ----------
    plan : engine.Plan
    field : engine.WaveField
    focus : list of float
        World depths of the pictures, metres.
    images : numpy.ndarray, float32, shape (focus, y, x, wavelength)
    seconds : dict of str to float
        Of each stage.
    """

    plan: engine.Plan
    field: engine.WaveField
    focus: list
    images: np.ndarray = field(repr=False)
    seconds: dict


def diopters_in_view(plan, camera, hologram):
    """Nearest and farthest depth in view, in dioptres; 0 is infinity.

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
    """Three world depths spread evenly in dioptres over what is in view: near, middle and far, metres.

    Parameters
    ----------
    plan, camera, hologram
        See `diopters_in_view`.

    Returns
    -------
    list of float
        Nearest first, `math.inf` where the view reaches infinity; fewer where depths coincide.
    """
    near, far = diopters_in_view(plan, camera, hologram)
    depths = []
    for dioptres in (near, (near + far) / 2, far):
        depth = float(f"{1 / dioptres:.3g}") if dioptres > 1e-6 else math.inf
        if depth not in depths:
            depths.append(depth)
    return depths


def center_depth(scene, camera):
    """Depth of what is in the middle of the view, as an autofocus finds it.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : engine.Camera

    Returns
    -------
    float or None
        World depth in metres: the median over the middle tenth of the view; None where nothing is.
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
    """What to know of baked light, a line each.

    Parameters
    ----------
    bake : dict or None
        An `engine.baking.Bake`, as `WaveField.report` has it.

    Returns
    -------
    list of str
    """
    if bake is None:
        return []
    from ..engine.light.unwrapping import LACKING

    notes = [note for note in (bake["note"], LACKING) if note]
    if bake["coarser"] > COARSER:
        notes.append(
            f"The texels of the baked light are {bake['coarser']:.1f} times larger than pixels, to bound memory: "
            f"shadows are softer; the method full has none of that."
        )
    if bake["traced"]:
        count = len(bake["traced"])
        names = ", ".join(bake["traced"][:MOST_NAMES]) + (", ..." if count > MOST_NAMES else "")
        things = "1 shape's" if count == 1 else f"{count} shapes'"
        notes.append(f"{things} diffuse light is traced, not baked: {names}.")
    return notes


def _planned(field):
    """What a field was rendered by; None where there is none, or another version planned it."""
    if field is None:
        return None
    try:
        return engine.Plan.from_dict(field.plan)
    except (KeyError, TypeError):
        return None


def _check_view(plan, camera, hologram, focus, pupil):
    """Refuse what `engine.reconstruct` would, before the long work."""
    from ..engine.viewing.reconstruction import pupil_mask

    mapping = DepthMapping.of(hologram, camera, plan.near)
    mapping.depth_to_z(list(focus))
    if pupil is not None:
        for wavelength in hologram.wavelengths:
            grid = hologram.in_air.raster(wavelength)
            pupil_mask(grid.shape, grid.pitch, wavelength, mapping, pupil, hologram.optics)


def _begun(started, plan):
    """Share of the whole time that has passed since then, by what the plan foretells; of baselines that is nothing."""
    least, most = BEGUN
    spent = time.monotonic() - started
    return min(max(least, spent / (spent + plan.seconds)), most) if plan.seconds else least


def _preview(request, plan, focus, seconds, progress, offer):
    """Offer pictures through a thin lens, ever finer: one, and more for so long."""
    start = time.monotonic()
    camera, hologram, pupil = request.camera, request.hologram, request.pupil
    mapping = DepthMapping.of(hologram, camera, plan.near)
    aperture = float(np.mean([mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths]))
    aperture *= hologram.optics.opening[2]
    channels = [channel(w) for w in hologram.wavelengths]
    camera, hologram = squared(camera, hologram)
    size, centre = (hologram.width, hologram.height), (0.0, 0.0)
    if pupil is not None:
        aperture, centre = min(aperture, pupil.diameter / 2), (pupil.x, pupil.y)
    vertices = request.settings.max_depth
    picture = engine.Preview(request.scene, camera, *size, focus, aperture, vertices, centre=centre)
    # each picture has twice the paths of the last, and takes as long as all before
    while 2 * (time.monotonic() - start) < seconds or not picture.spp:
        light = picture.refine(max(1, picture.spp), progress)
        offer(engine.to_rgb(light[..., channels], hologram.wavelengths))


@dataclass(frozen=True)
class _Draft:
    """A hologram of less quality that is there in a fraction of the time."""

    plan: engine.Plan
    seconds: float  # foretold


def _draft(request, plan):
    """The `_Draft` of a planned hologram; None where waiting for the hologram itself is as good."""
    settings = request.settings
    if settings.method not in DRAFTED or settings.quality == "draft":
        return None
    settings = resolved(settings)
    settings = replace(
        settings,
        quality="draft",
        method="full",  # what a draft bakes would serve the hologram, and change it
        frames=min(settings.frames, MAX_DRAFT_FRAMES),
        speckle=None,
        spp=None,
        despeckle=0,
    )
    compiles, started = Compiling(), time.monotonic()
    drafted = engine.plan(request.scene, request.camera, request.hologram, settings, request.store)
    stages = {name: min(own, plan.stages.get(name, own)) for name, own in drafted.stages.items()}
    if "radiance" in stages and plan.passes and not plan.cached:
        # The wanted plan has looked at more paths, and knows better how long they take.
        stages["radiance"] = min(stages["radiance"], plan.stages["radiance"] * drafted.passes / plan.passes)
    seconds = sum(stages.values())
    if compiles():
        seconds += COMPILED * (time.monotonic() - started)
    return _Draft(drafted, seconds) if MIN_DRAFT_RATIO * seconds <= plan.seconds else None


def _drafted(request, draft, depths, progress):
    """The `Result` of a draft."""
    view = request.scene, request.camera, request.hologram

    def told(done, message):
        progress(done, f"Draft: {message}")

    stages = Stages(told, "images")
    field = engine.render(*view, plan=draft.plan, progress=stages["field"], store=request.store)
    images, notes = reconstruct(field, depths, request.pupil, stages["images"])
    return Result(_warned(draft.plan, *notes), field, depths, images, field.report["seconds"])


def compute(request, progress=None, rendered=None, offer=None):
    """Plan, render and refocus.

    Parameters
    ----------
    request : Request
        Frames that its encoding goes towards are traced along.
    progress : callable, optional
        ``progress(done, message)``, may raise `engine.Cancelled`.
    rendered : engine.WaveField, optional
        Of the same scene and settings, to be refocused instead of rendering it again.
    offer : callable, optional
        ``offer(picture)`` with pictures, array [y, x, 3], to look at meanwhile; ``offer(picture, draft)`` with the
        `Result` of quality draft that it is of, where the hologram takes several times as long. The hologram is the
        same with and without.

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
    started, clock = time.monotonic(), Clock()
    progress(0.0, "Planning")
    with clock("plan"):
        at = stage(progress, 0.0, 0.0)
        plan = _planned(rendered) or engine.plan(scene, camera, hologram, settings, request.store, at)
    depths = _depths(request, plan)
    _check_view(plan, camera, hologram, depths, request.pupil)
    if rendered is None:
        begun = _begun(started, plan)
        if offer is not None and plan.seconds >= MIN_PREVIEW_SECONDS:
            begun = _early(request, plan, depths, started, clock, progress, offer)
        encoding = request.encoding
        along = engine.frames_along(plan, hologram, encoding.method, encoding.seconds)
        at = stage(progress, begun, SHARES["images"]["field"])
        rendered = engine.render(scene, camera, hologram, None, plan, at, request.store, along)
        clock.seconds.update(rendered.report["seconds"])
    with clock("refocusing"):
        images, notes = reconstruct(rendered, depths, request.pupil, Stages(progress, "images")["images"])
    plan = _warned(plan, *rendered.plan.get("warnings", ()), *notes)
    return Result(plan, rendered, depths, images, clock.seconds)


def _depths(request, plan):
    """World depths of the images, metres, each once."""
    focus, view = request.focus, (request.camera, request.hologram)
    asked = [focus] if focus == "centre" else list(focus) if focus else default_focus(plan, *view)
    if "centre" in asked:
        centre = center_depth(request.scene, request.camera) or default_focus(plan, *view)[0]
        asked = [centre if depth == "centre" else depth for depth in asked]
    return list(dict.fromkeys(asked))


def _early(request, plan, depths, started, clock, progress, offer):
    """Offer previews, and a draft where the hologram takes several times as long; the progress that is then reached."""
    progress(_begun(started, plan), "Draft: Planning")
    with clock("draft"):
        draft = _draft(request, plan)
    share = PREVIEW_SHARE * (plan.seconds if draft is None else draft.seconds)
    begun = _begun(started, plan)
    with clock("preview"):
        _preview(request, plan, depths[0], share, stage(progress, begun, begun), offer)
    begun = max(begun, _begun(started, plan))
    if draft is not None:
        drawn = _begun(started - draft.seconds, plan)
        with clock("draft"):
            early = _drafted(request, draft, depths, stage(progress, begun, drawn))
        offer(engine.to_rgb(early.images[0], request.hologram.wavelengths), early)
        begun = max(drawn, _begun(started, plan))
    return begun


def _warned(plan, *warnings):
    """The plan with warnings of what came of it, which it may have already."""
    return replace(plan, warnings=tuple(dict.fromkeys((*plan.warnings, *warnings))))


def reconstruct(field, focus, pupil, progress):
    """`engine.reconstruct` by the card where one computes waves.

    Returns
    -------
    images : numpy.ndarray
    notes : list of str
        A sentence where the card's memory ran out.
    """

    def pictures(data):
        return on_processor(engine.reconstruct(replace(field, data=data), focus, pupil, progress))

    needed = refocusing_on_card(field.data.nbytes, 4 * len(focus) * field.data[0].size)
    images, note = libraries.by_card(pictures, field.data, needed)
    return images, [note] * bool(note)


def phases_by_card(work, data, needed=None):
    """Phases that are found by the card where one computes waves; NumPy's.

    Parameters
    ----------
    work : callable
        ``work(data)`` gives an `engine.PhaseHologram` of the library of the data.
    data : numpy.ndarray
        Of a field, or of phases.
    needed : float, optional
        Bytes of the card's memory that it takes. Default: `encoding_on_card`.

    Returns
    -------
    engine.PhaseHologram
        Where the card's memory ran out, a sentence in the advice of its report says so.
    """

    def found(data):
        try:
            return _of_numpy(work(data))
        except Exception as error:
            kept = getattr(error, "kept", None)
            if kept is not None:
                vars(error)["kept"] = _of_numpy(kept)
            raise

    phase, note = libraries.by_card(found, data, needed or encoding_on_card(data.nbytes))
    if note:
        phase.report["advice"] = " ".join(filter(None, (phase.report.get("advice"), note)))
    return phase


def _of_numpy(phase):
    return replace(phase, data=on_processor(phase.data))


def _encoded(field, method, progress, needed=None, **options):
    """`engine.encode` by the card where one computes waves; NumPy's phases."""
    return phases_by_card(
        lambda data: engine.encode(replace(field, data=data, more=None), method, progress, **options),
        field.data,
        needed,
    )


def encode(field, encoding, progress, scene=None, settings=None, store=None, **options):
    """Encode a field, with many more frames of its scene where the method wants them.

    Parameters
    ----------
    field : engine.WaveField
    encoding : Encoding
        What it begins with, `before`, is left to the `options`.
    progress : callable
        ``progress(done, message)``, may raise `engine.Cancelled`.
    scene : mitsuba.Scene, optional
        That the field was rendered of. Without it and its settings `auto` is that of `engine.encode`.
    settings : engine.Settings, optional
        With which it was.
    store : engine.BakeStore, optional
        Where baked light is kept.
    options
        Others of `engine.encode`.

    Returns
    -------
    engine.PhaseHologram
        Its `report` has the `engine.EncodingPlan`, too.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled
    """
    seconds = encoding.seconds
    options |= {**encoding.options, "seconds": seconds}
    if scene is None or settings is None:
        return _encoded(field, encoding.method, progress, eyebox=encoding.eyebox, **options)
    view = scene, field.camera, field.hologram
    plan = _planned(field) or engine.plan(*view, settings, store, stage(progress, 0.0, 0.0))
    along = 0 if field.more is None else len(field.more)
    chosen = engine.plan_encoding(plan, encoding.method, seconds, along, encoding.eyebox)
    options |= {"randomness": chosen.randomness, "eyebox": chosen.eyebox}
    if chosen.steps:
        options.setdefault("max_steps", chosen.steps)

    def many(progress):
        if along:
            yield list(range(len(field.hologram.wavelengths))), field.more
        if chosen.frames > along:
            clocked = seconds is not None
            yield from engine.many_frames(*view, plan, progress, store, chosen.frames, along, clocked)

    try:
        needed = plan.card_memory.get(chosen.method)
        phase = _encoded(field, chosen.method, progress, needed, many=many, **options)
    except engine.Cancelled as error:
        if error.kept is not None:
            error.kept.report["plan"] = chosen.to_dict()
        raise
    phase.report["plan"] = chosen.to_dict()
    return phase
