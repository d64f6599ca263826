"""Looks at the scene and decides how much has to be modelled, and says why."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..mapping import DepthMapping
from ..memory import available, shortage
from ..plan import Decision, Plan, gathered_on, middle_of
from ..scene import variants
from ..settings import BASELINES, Settings
from ..tracing.kernel_table import LEVELS
from ..waves import despeckle
from ..waves.phase_fields import REACH, SETS, frames_for, speckle_contrast
from ..waves.propagation import grid_bytes, padded_shape
from . import costs
from .layouts import CONE, DRAFT_PLANES, MOST_PLANES, Scenery, by_region, chosen
from .machine import slowness
from .pilot import LEAST_SHARE, Pilot, near_end, vergence_range

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..light.radiance_cache import RadianceCache
    from .pilot import Light

GRAIN_NOISE = {
    "draft": 1.0,
    "preview": 0.5,
    "balanced": 0.35,
    "full": 0.15,
}  # of a grain's mean, as a share of the random speckle of as many frames as these
USUAL_FRAMES = 8
# power of the frames by which less is wanted: not all errors fall with them, as speckle does by 1/2
LESS_NOISE = 1 / 3
PASSES = {
    "draft": (4, 4),
    "preview": (8, 64),
    "balanced": (16, 256),
    "full": (32, 1024),
}  # fewest and most radiance paths a pixel
LEAST_SHADOWS = 1e-4  # of the light: less is not told of
FIREFLY = (
    2.0  # times the bright parts of the view: most that one indirect path may add to a mean of the fewest
)
SLAB = 0.15  # of the depth of focus
MOST_SLABS = 48
GLOSSY_BINS = (2, 6)  # fewest and most along each axis of the pupil
GLOSSY_TURN = 0.15  # of a lobe's width across the pupil: less is not seen
ONE_BIN = 0.5  # of the sharpest lobe's width: what bins would tell apart is less than noise then
RAY_OFFSET = 9e-5  # that Mitsuba starts rays above surfaces, times 1 m + their largest coordinate
MOST_OFFSET = 0.03  # of the near end's depth: 0.5 dB
IMAGE_LIMITS = (-1.5, 1.5)  # of the near end's vergence: images beyond, as of caustics, are put there
MAP_BYTES = 1 << 30  # largest index of the radiance map, and its largest pupil bins
CACHED_PASSES = 4  # fewest where light is looked up
LIKELY_CACHED = 6  # that are taken then, roughly
EVENLY = 0.45  # noise of a texel's samples over that of as many paths at random
SMOOTHED = 600  # groups of texels over which light from other surfaces is averaged, roughly
FILTERED = 16.0  # times less variance, textures apart, where grains share their light; halves tell where it is not so
UNTOLD = 1.2, 2.0  # times the variances that the pilot finds, of light and of textures, over ten scenes
CLEARLY = 0.8  # times as long as paths of this view has to be what is baked: estimates are rough
CUT_OFF = 0.01  # of the view: more that chains do not reach is told of
LEAST_DIFFUSE = 0.1  # of the view: the cache is for more
FILTER_REACH = {
    "draft": 2,
    "preview": 4,
    "balanced": 4,
    "full": 4,
}  # columns that the radiance map's filter ends at
FEW_LEVELS = 64  # of a draft's or preview's kernel tables at least
GREY = 0.01  # of the radiance: channels that differ less are one
CHUNK_BYTES = 128 << 20  # of the sums of pixels that are traced at once, at most

# What `Settings.fixed` may fix: lowest and highest value, and what it is.
FIXABLE = {
    "chain": (0, 64, "longest chain of mirrors and clear surfaces"),
    "splits": (0, 2, "hits of a chain at which more than one way on is followed"),
    "max_depth": (1, 1 << 16, "vertices of a radiance path"),
    "passes": (1, 1 << 16, "radiance paths a pixel, without a look at their noise"),
    "slabs": (1, MOST_SLABS, "depth slabs of the radiance map"),
    "bins": (1, GLOSSY_BINS[1], "pupil bins along each axis of the radiance map"),
    "textures": (0, 1 << 16, "rays a pixel that see textures alone"),
    "filter": (0, 1, "whether grains of one surface share their light"),
    "grey": (0, 1, "whether all wavelengths share one radiance"),
    "dispersion": (0, 1, "whether each wavelength has rays of its own where glass disperses"),
    "regions": (0, 1, "whether each tile has as many rays as it needs"),
    "chunk": (1, 1 << 40, "bytes of the sums of pixels that are traced at once"),
    "steps": (1, 1 << 20, "steps of baselines that find phases by descent"),
}


def plan(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings | None = None,
    store: BakeStore | None = None,
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

    Returns
    -------
    Plan

    Raises
    ------
    InvalidInput
        If nothing is in view, or the machine has too little memory.
    BackendUnavailable
        If Mitsuba cannot compute here.
    """
    variants.activate()
    from ..light.path_tracer import PathTracer
    from ..scene.specular_chains import FirstHits
    from .unmodelled import unmodelled

    settings = resolved(settings or Settings())
    check_fixed(settings.fixed)
    if settings.method in BASELINES:
        # the least that tells the depths in view
        least = replace(settings, method="direct", fixed={"max_depth": settings.max_depth})
        return _of_baseline(plan(scene, camera, hologram, least), settings, unmodelled(scene))
    fixed, decisions, warnings = settings.fixed, [], unmodelled(scene)
    near = near_end(scene, camera, hologram, settings.seed)
    mapping = DepthMapping.of(hologram, camera, near)
    pilot = Pilot.of(scene, hologram, camera, mapping, settings)
    seen, optics = pilot.first_hits(), FirstHits(sky=camera.sees_sky)
    chain, splits, image, pupil = 0, 0, settings.virtual_image, 0.0
    if seen.specular + seen.nearly > LEAST_SHARE or fixed.get("chain"):
        seen, optics, chain, splits, image, pupil = _chains(
            scene, camera, settings, pilot, seen, decisions, warnings
        )
    if not chain and seen.specular > LEAST_SHARE:
        what = (
            f"{seen.specular:.0%} of the view is mirror or clear glass: it is shown as a picture on its own "
            f"surface, not at the depth of what it reflects"
        )
        if settings.quality == "draft" and settings.most_hits:
            decisions.append(Decision("specular hits", "none", f"{what}, as drafts do"))
        else:
            warnings.append(f"{what}; allow chains of mirrors to change that.")
    most_depth = fixed.get("max_depth", settings.max_depth)
    least_depth = most_depth if "max_depth" in fixed else 1
    light = pilot.light(PathTracer, optics, most_depth, least_depth, slab_of(hologram), firefly_of(settings))
    low, high = vergence_range(seen, chain)
    if chain:
        low, high = (min(max(end, IMAGE_LIMITS[0] / near), IMAGE_LIMITS[1] / near) for end in (low, high))
    z_low, z_high = mapping.z_far + mapping.beta * low, mapping.z_far + mapping.beta * high
    decisions.insert(
        0,
        Decision(
            "depth",
            f"{near:.3g} m to {'infinity' if z_low <= mapping.z_far else f'{mapping.z_to_depth(z_low):.3g} m'} "
            f"at {z_high * 1e3:.2f} to {z_low * 1e3:.2f} mm from the SLM",
            "the volume ends at the nearest surface in view"
            if hologram.depth_mapping == "fit" and not hologram.near
            else f"{hologram.depth_mapping} mapping",
        ),
    )
    places = replace(seen.places, z=np.clip(seen.places.z, z_low, z_high))
    if seen.turn <= GLOSSY_TURN or settings.quality == "draft":  # it looks alike from all over the pupil
        seen = replace(seen, gloss=np.empty(0))
    gloss = mapping.z_far + mapping.beta * seen.gloss
    bent = np.clip(mapping.z_far + mapping.beta * seen.images, z_low, z_high)
    edges = pilot.edges(optics, slab_of(hologram))
    scenery = Scenery(
        hologram, settings, places, (z_low, z_high), edges, gloss, bent, 1 << splits if chain else 0
    )
    planes = _planes(scenery, decisions, warnings)
    rays = sum(plane.rays for plane in planes)
    middle = middle_of(planes)
    reach = 1.02 * CONE[settings.quality] * hologram.widest_slope * max(z_high - middle, middle - z_low)
    margin = math.ceil(reach / hologram.pitch) + 3
    columns = (hologram.width + 2 * margin) * (hologram.height + 2 * margin)
    slow = slowness(store and store.folder)
    view = near, optics
    texture = _texture(
        scene, camera, hologram, settings, view, pilot, seen, light, columns, store, slow, decisions
    )
    max_depth = _bounces(settings, light, most_depth, texture, decisions)
    passes, slabs, bins, error = _radiance(
        hologram, settings, seen, light, columns, z_high - z_low, texture, splits, decisions
    )
    grey, traversals = _wavelengths(scene, hologram, settings, chain, light, decisions)
    ends = (z_low, z_high, mapping.z_far, float(mapping.depth_to_z(near)))
    _frames(hologram, settings, max(ends) - min(ends), decisions)
    chunk = fixed.get("chunk") or min(CHUNK_BYTES, max(1 << 20, (available() or CHUNK_BYTES << 3) >> 3))
    reason = "as asked" if "chunk" in fixed else "an eighth of what is free at most"
    decisions.append(Decision("memory of a chunk", f"{chunk / 1e6:.0f} MB", reason))
    farthest = abs(gathered_on(planes).z)
    padded = padded_shape(
        (hologram.height, hologram.width), hologram.pitch, max(hologram.wavelengths), farthest
    )
    decisions.append(
        Decision(
            "padding",
            f"{padded[1]} x {padded[0]} pixels",
            f"the least that {farthest * 1e3:.3g} mm to the SLM need without wrapping around",
            f"{4 * hologram.width * hologram.height / (padded[0] * padded[1]):.1f} x against twice the size"
            if padded[0] * padded[1] < 3.6 * hologram.width * hologram.height
            else "",
            0.0,
        )
    )
    offset = RAY_OFFSET * (1 + abs(camera.position).max())
    if offset > MOST_OFFSET * near:
        warnings.append(
            f"Mitsuba's rays start {offset:.1g} m off surfaces here, much for a scene {near:.2g} m from the camera: "
            f"mirrors shift and light leaks; move the scene to the origin, or enlarge it."
        )
    captured = captured_share(hologram, 0.5 * (z_low + z_high))
    if captured < 0.75:
        warnings.append(
            f"Only {captured:.0%} of the light fits through the SLM's aperture at {z_high * 1e3:.0f} mm: edges darken; "
            f"bring the depth range nearer to the SLM or use more pixels."
        )
    plain, chained = scenery.mean_rays(planes, "plain"), scenery.mean_rays(planes, "chained")
    images = any(plane.sees == "images" for plane in planes)
    work = costs.Work(
        columns, plain, chained, *_likely(settings, light), texture, traversals, len(planes), images
    )
    stages = costs.stages(hologram, settings, seen, light, work, slow)
    memory = costs.memory(hologram, settings, work, margin, slabs, bins, _binned(seen), splits)
    size, farthest = (hologram.height, hologram.width), max(abs(z_low), abs(z_high))
    memory += max(grid_bytes(size, hologram.pitch, w, farthest) for w in hologram.wavelengths)
    warnings += shortage(memory, "This hologram")
    return Plan(
        near=near,
        z_low=z_low,
        z_high=z_high,
        planes=planes,
        rays_per_pixel=rays,
        passes=passes,
        most_passes=passes if "passes" in fixed else PASSES[settings.quality][1],
        wanted_error=0.5 * wanted_noise(settings),
        white=light.bright,
        grey=grey,
        traversals=traversals,
        margin=margin,
        slabs=slabs,
        bins=bins,
        regions=by_region(settings),
        cached=texture is not None,
        texel_noise=texel_noise(settings),
        texel_samples=PASSES[settings.quality][1],
        max_depth=max_depth,
        radiance_limit=FIREFLY * light.bright * (passes or PASSES[settings.quality][1]) * sharing(settings),
        chain=chain,
        splits=splits,
        virtual_image=image,
        pupil=pupil,
        coherent=seen.coherent,
        cone=CONE[settings.quality],
        levels=FEW_LEVELS if settings.quality in ("draft", "preview") else LEVELS[0],
        reach=FILTER_REACH[settings.quality] if settings.fixed.get("filter", 1) else 0,
        textures=asked_textures(settings),
        chunk=chunk,
        stages=stages,
        error=error,
        memory_bytes=memory,
        decisions=tuple(decisions),
        warnings=tuple(warnings),
    )


def resolved(settings: Settings) -> Settings:
    """Settings with what the method implies, `direct` the paper's estimator, and a wished speckle the frames.

    Raises
    ------
    InvalidInput
        If no number of frames has so little speckle.
    """
    estimator = "paper" if settings.method == "direct" else settings.estimator
    frames = settings.frames
    if settings.speckle is not None:
        frames = frames_for(settings.phase_field, settings.speckle)
    return replace(settings, estimator=estimator, frames=frames)


def once_baked(
    plan: Plan,
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings,
    cache: RadianceCache,
) -> Plan:
    """The plan with the radiance paths that are needed with baked light: what is not cached decides.

    Parameters
    ----------
    plan : Plan
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
    cache : RadianceCache

    Returns
    -------
    Plan
    """
    from ..light.path_tracer import PathTracer
    from ..scene.specular_chains import optics_of

    if settings.radiance == "ray" or "passes" in settings.fixed:
        return plan
    pilot = Pilot.of(scene, hologram, camera, DepthMapping.of(hologram, camera, plan.near), settings)
    tracer, optics, most = (
        PathTracer(plan.max_depth, plan.radiance_limit, cache),
        optics_of(scene, camera, plan),
        plan.max_depth,
    )
    light = pilot.light(lambda _: tracer, optics, most, most, slab_of(hologram), firefly_of(settings))
    passes = passes_for(settings, noise_left(settings, light), CACHED_PASSES)
    return replace(plan, passes=min(passes, plan.passes))


def _of_baseline(plan, settings, warnings):
    """A plan as a baseline has it: the depths in view, the method and what to know; nothing is foretold."""
    _, label, what = BASELINES[settings.method]
    own = Decision("method", label, f"{what}; as asked, to be compared with HoloPath's own")
    frames = Decision("frames", str(settings.frames), "as asked")
    decisions = plan.decisions[0], own, frames
    return replace(plan, decisions=decisions, stages={}, error=0.0, warnings=tuple(warnings))


def parse_fixed(text: str) -> dict:
    """Decisions to fix, from words as ``chain=4 passes=64``, with or without commas between; see `FIXABLE`.

    Parameters
    ----------
    text : str

    Returns
    -------
    dict

    Raises
    ------
    InvalidInput
    """
    fixed = {}
    for word in text.replace(",", " ").split():
        name, _, value = word.partition("=")
        try:
            fixed[name] = int(value)
        except ValueError:
            raise InvalidInput(
                f"'{word}' fixes no decision: write NAME=NUMBER, for example chain=4."
            ) from None
    check_fixed(fixed)
    return fixed


def check_fixed(fixed: dict) -> None:
    """Refuse names and values that no decision has."""
    for name, value in fixed.items():
        if name not in FIXABLE:
            raise InvalidInput(f"There is no decision '{name}' to fix: choose one of {', '.join(FIXABLE)}.")
        low, high, what = FIXABLE[name]
        if not (isinstance(value, int) and low <= value <= high):
            raise InvalidInput(
                f"The fixed {name} ({what}) must be a whole number from {low} to {high}, not {value}."
            )


def _chains(scene, camera, settings, pilot, seen, decisions, warnings):
    """How mirrors and clear surfaces are followed: what is seen by them, the optics, the longest chain, the hits that
    divide it, how images are placed, and the pupil's radius where there are nearly smooth mirrors.
    """
    from ..scene.specular_chains import SPLITS, FirstHits, SpecularChains

    fixed, image = settings.fixed, settings.virtual_image
    most = fixed.get("chain", 0 if settings.quality == "draft" else settings.most_hits)
    if not most:
        return seen, FirstHits(sky=camera.sees_sky), 0, 0, image, 0.0
    pupil = pilot.pupil if seen.nearly > LEAST_SHARE else 0.0

    def optics_of(hits, splits=SPLITS):
        return SpecularChains(scene, image, hits, splits, sky=camera.sees_sky, pupil=pupil)

    optics = optics_of(most)
    seen = pilot.images(seen, optics)
    chain, lost = (most, 0.0) if "chain" in fixed else pilot.longest_chain(optics_of, most)
    if seen.cut > CUT_OFF:
        warnings.append(
            f"{seen.cut:.0%} of the view is seen by way of more than {most} mirrors and clear surfaces and stays "
            "black: follow more of them (--most-hits, Mirrors, Glass)."
        )
    splits = fixed.get("splits", seen.splits)
    exact = not seen.bent and "chain" not in fixed
    reason = f"{seen.specular + seen.nearly:.1%} of the view mirrors or lets through; images by "
    reason += "optical path" if image == "opl" or exact else "curvature"
    reason += ", which is exact here" if exact and image != "opl" else ""
    reason += f"; {1 << splits} branches of each ray" if splits else ""
    saving = f"{most - chain} hits of {most}" if chain < most else ""
    decisions.append(Decision("specular hits", f"up to {chain}", reason, saving, math.sqrt(lost)))
    image = "opl" if exact else image
    return seen, optics_of(chain, splits), chain, splits, image, pupil


def _planes(scenery, decisions, warnings):
    """The recording planes."""
    hologram, settings = scenery.hologram, scenery.settings
    if settings.method == "direct" or settings.wrp != "auto":
        z = 0.0 if settings.method == "direct" else float(settings.wrp)
        reason = "the SLM itself: method direct" if settings.method == "direct" else "as asked"
        planes = (scenery.plane(z, warnings),)
    else:
        most = DRAFT_PLANES if settings.quality == "draft" else MOST_PLANES
        layouts = scenery.layouts(most if settings.planes == "auto" else settings.planes)
        # none that needs more rays than one plane, which all pixels have the same of where tiles are not told apart
        one, able = layouts[0], by_region(settings) or settings.planes != "auto"
        layouts = [layout for layout in layouts if layout is one or (able and layout.rays <= one.rays)]
        if settings.planes != "auto":
            count = max(len(layout.parts) for layout in layouts)
            layouts = [layout for layout in layouts if len(layout.parts) == count]
        noise = speckle_contrast(settings.phase_field, settings.frames) ** 2
        layout = chosen(layouts, noise, settings.frames * len(hologram.wavelengths))
        planes, reason = scenery.planes(layout, warnings), _reason(scenery, layout, one)
    decisions.append(Decision("recording planes", _names(planes), reason))
    decisions.append(_ray_decision(settings, planes))
    if by_region(settings):
        rays, plain, chained = (
            sum(getattr(plane, kind) for plane in planes) for kind in ("rays", "plain", "chained")
        )
        value = f"{plain + chained:.0f} of {rays} rays a pixel on average"
        if scenery.branches:
            value += f", {chained / max(plain + chained, 1e-9):.0%} of them followed over mirrors"
        share = 1 - (plain + chained) / rays
        reason = "tiles that see no light have none, others one a grain at their own farthest surface"
        saving = f"{share:.0%} of the rays" if share > 0.005 else ""
        decisions.append(Decision("regions", value, reason, saving, 0.0))
    return planes


def _names(planes):
    """Where planes are, in words."""
    where = {"all": "", "surfaces": "", "images": "images in mirrors and glass at "}
    parts = []
    for sees in where:
        places = ", ".join(f"{plane.z * 1e3:.2f}" for plane in planes if plane.sees == sees)
        if places:
            parts.append(where[sees] + places)
    return f"{'; '.join(parts)} mm from the SLM"


def _reason(scenery, layout, one):
    """Why a layout was chosen, in words."""
    reasons = list(dict.fromkeys(part.reason for part in layout.parts))
    if len(layout.parts) > 1:
        many, few = (scenery.mean_rays(scenery.planes(each, [])) for each in (one, layout))
        reasons.append(f"{len(layout.parts)} planes need {few / max(many, 1e-9):.0%} of the rays of one")
        if one.shadows > LEAST_SHADOWS:
            reasons.append(
                f"light on the wrong side of edges falls from {one.shadows:.2%} to {layout.shadows:.2%}"
            )
    return "; ".join(reasons)


def _ray_decision(settings, planes):
    rays = sum(plane.rays for plane in planes)
    if settings.estimator == "paper":
        return Decision("rays a pixel", str(rays), "random directions, the paper's estimator")
    limit = max(plane.depth_limit for plane in planes)
    cone = CONE[settings.quality]
    reason = f"one a grain at {limit * 1e3:.2f} mm from the recording plane, cone {cone:g} of the recordable"
    return Decision("rays a pixel", str(rays), reason)


def firefly_of(settings: Settings) -> float:
    """Most that one path may count, in radiances of the bright parts of the view, where there are the fewest."""
    return FIREFLY * PASSES[settings.quality][0]


def slab_of(hologram: Hologram) -> float:
    """Thickness of the radiance map's depth slabs in metres."""
    return SLAB * hologram.depth_of_focus


def wanted_noise(settings: Settings) -> float:
    """Relative standard error of a grain's mean radiance that hardly shows in pictures of so many frames."""
    usual = GRAIN_NOISE[settings.quality] * speckle_contrast("random", USUAL_FRAMES)
    return usual * (USUAL_FRAMES / settings.frames) ** LESS_NOISE


def texel_noise(settings: Settings) -> float:
    """The same of a texel that is baked; baked light serves any number of frames, so that of many counts."""
    return GRAIN_NOISE[settings.quality] * speckle_contrast("random", SETS[-1])


def passes_for(settings: Settings, noise: float, fewest: int | None = None) -> int:
    """Radiance paths a pixel where one has a relative variance of `noise`."""
    if "passes" in settings.fixed:
        return settings.fixed["passes"]
    least, most = PASSES[settings.quality]
    return min(max(fewest or least, math.ceil(noise / wanted_noise(settings) ** 2)), most)


def noise_left(settings: Settings, light: Light) -> float:
    """Relative variance of a grain's mean, times its paths, textures apart where grains share their light."""
    shared = sharing(settings)
    return light.noise if shared == 1 else max(light.noise - light.texture, 0) / shared


def sharing(settings: Settings) -> float:
    """Times as many paths as its own that a grain's mean is of, roughly."""
    return FILTERED if settings.fixed.get("filter", 1) else 1.0


def asked_textures(settings: Settings) -> int | None:
    """Rays a pixel that see textures alone; None where the first paths tell how many."""
    return settings.fixed.get("textures", 0 if settings.quality == "draft" else None)


def _likely(settings, light):
    """Radiance paths a pixel that will be taken, and rays that see its texture alone, roughly: halves differ by more
    than the pilot's few paths tell.
    """
    passes = passes_for(settings, UNTOLD[0] * noise_left(settings, light))
    return passes, _likely_textures(settings, light, passes)


def _texture_left(settings, light, rays):
    """Relative variance of a grain's mean by its texture, of which so many rays tell."""
    return 0.0 if sharing(settings) == 1 else UNTOLD[1] * light.texture / rays


def _likely_textures(settings, light, passes):
    """Rays a pixel that see its texture alone, roughly."""
    from ..tracing.grains import rays_for_textures

    if sharing(settings) == 1:
        return 0
    error = 0.5 * math.sqrt(_texture_left(settings, light, passes))
    asked = asked_textures(settings)
    return rays_for_textures(error, 0.5 * wanted_noise(settings), passes) if asked is None else asked


def _texture(scene, camera, hologram, settings, view, pilot, seen, light, columns, store, slow, decisions):
    """Seconds of the radiance cache by stage, None where it is not used."""
    if settings.method == "direct" or settings.max_depth < 2:
        return None
    if settings.method == "full":
        decisions.append(Decision("diffuse light", "paths of this view", "as asked"))
        return None
    asked = settings.method == "fast"
    if not asked and (seen.diffuse < LEAST_DIFFUSE or settings.radiance == "ray"):
        reason = (
            "as asked" if settings.radiance == "ray" else f"only {seen.diffuse:.0%} of the view is diffuse"
        )
        decisions.append(Decision("diffuse light", "paths of this view", reason))
        return None
    from ..light.baking import found_in
    from ..light.camera_view import Request
    from ..light.path_tracer import PathTracer
    from ..scene.lobes import surfaces_of

    paths = costs.map_seconds(light, columns, *_likely(settings, light), slow)
    if settings.radiance == "ray":
        paths = math.inf
    triangles = sum(shape.primitive_count() for shape in surfaces_of(scene) if shape.is_mesh())
    few = LIKELY_CACHED, _likely_textures(settings, light, LIKELY_CACHED)
    load = 0.0  # seconds that are not spent yet

    def stages_with(baked, most):
        """Seconds with this share of the view baked, where they are no more than `most`, else a part of them."""
        nonlocal light
        stages = costs.baking(hologram, seen, light, columns, few, baked, triangles, slow)
        if math.isfinite(light.short_per_second) or load + sum(stages.values()) > most:
            return stages
        light = pilot.with_short_paths(light, PathTracer, view[1], slab_of(hologram))
        return costs.baking(hologram, seen, light, columns, few, baked, triangles, slow)

    def worth(texels):
        nonlocal load
        load = costs.loading(texels, triangles, slow)
        if not asked and load + sum(stages_with(1.0, paths).values()) > paths:
            return False
        load = 0.0
        return True

    baked = None
    if store is not None:
        near, optics = view
        noise, most = texel_noise(settings), PASSES[settings.quality][1]
        request = Request(scene, camera, hologram, near, optics, settings, noise, most)
        baked = found_in(store, request, worth)
    most = (CLEARLY if baked is None else 1) * paths
    stages = stages_with(baked, math.inf if asked else most)
    seconds = load + sum(stages.values())
    about = "about" if math.isfinite(light.short_per_second) else "more than"
    compared = f"{about} {seconds:.1f} s, paths of this view about {paths:.1f} s"
    before = "to be baked" if baked is None else "light baked before"
    if baked is not None and baked < 1:
        before += f" for {baked:.0%} of the view" if baked >= 0.005 else " for other views"
    compared = f"{before}, {compared}"
    if asked:
        decisions.append(Decision("diffuse light", "radiance cache", f"as asked; {compared}"))
        return stages
    better = seconds < most
    saving = f"about {abs(paths - seconds):.0f} s" if abs(paths - seconds) >= 1 else ""
    value = "radiance cache" if better else "paths of this view"
    decisions.append(Decision("diffuse light", value, compared, saving))
    return stages if better else None


def _bounces(settings, light, most, texture, decisions):
    """Vertices of a radiance path."""
    if texture is not None:
        decisions.append(Decision("light bounces", f"{most} vertices", "the radiance cache has them all"))
        return most
    if "max_depth" in settings.fixed:
        reason = "as asked"
    elif light.max_depth < most:
        reason = f"more add {light.lost:.1%} of the light"
    else:
        reason = "as many as are allowed"
    saving = f"{most - light.max_depth} vertices of {most}" if light.max_depth < most else ""
    decisions.append(Decision("light bounces", f"{light.max_depth} vertices", reason, saving, light.lost / 2))
    return light.max_depth


def _radiance(hologram, settings, seen, light, columns, thickness, texture, splits, decisions):
    """Radiance paths a pixel, depth slabs, pupil bins, and the error that the paths' noise leaves in the field."""
    if settings.radiance == "ray":
        reason = "as asked" if texture is not None else "as asked; dark where light is indirect"
        decisions.append(Decision("radiance", f"{settings.paths} paths a ray", reason))
        return 0, 1, 1, 0.0
    fixed = settings.fixed
    passes = passes_for(settings, noise_left(settings, light))
    looks = _likely_textures(settings, light, passes)
    noise = math.sqrt(noise_left(settings, light) / passes + _texture_left(settings, light, passes + looks))
    speckle = speckle_contrast("random", settings.frames)
    if texture is not None:
        from ..light.gathering import ROUND

        variance = light.direct + max(light.noise - light.direct, 0) / SMOOTHED
        noise = min(texel_noise(settings), EVENLY * math.sqrt(variance / ROUND))
    draft = settings.quality == "draft"
    glossy = not draft and (seen.sharpest > ONE_BIN or seen.specular > LEAST_SHARE)
    bins = min(GLOSSY_BINS[0] + math.floor(1.5 * seen.turn), GLOSSY_BINS[1]) if glossy else 1
    room = MAP_BYTES / (columns * costs.SURFACES * _binned(seen) * costs.CELL_BYTES)
    bins = max(1, min(fixed.get("bins", bins), math.floor(math.sqrt(room))))
    most_slabs = min(MOST_SLABS, MAP_BYTES // (4 * columns << splits))
    slabs = math.ceil(thickness / slab_of(hologram))
    slabs = max(1, min(most_slabs, fixed.get("slabs", slabs)))
    most = PASSES[settings.quality][1]
    decisions.append(
        Decision(
            "radiance paths a pixel",
            (str(passes) if texture is None else f"{CACHED_PASSES} to {passes}")
            + (f", and about {looks} rays that see textures alone" if looks else ""),
            "as asked"
            if "passes" in fixed
            else "as many as what shines and mirrors needs once diffuse light is baked"
            if texture is not None
            else f"leave {noise:.1%} noise in a grain's mean where frames of random phase leave {speckle:.0%} speckle; "
            "more if their halves differ by more",
            f"{1 - passes / most:.0%} of the paths that may be taken"
            if passes < most and texture is None
            else "",
            0.5 * noise,
        )
    )
    decisions.append(
        Decision(
            "radiance map",
            f"{slabs} depth slabs, {bins} x {bins} pupil bins",
            "drafts look alike from all over the pupil"
            if draft
            else f"across the pupil the view turns {seen.sharpest:.2g} widths of the sharpest gloss"
            if seen.sharpest
            else "mirrors and clear surfaces are in view"
            if glossy
            else "all surfaces in view are diffuse",
            f"{1 - slabs * bins**2 / (MOST_SLABS * GLOSSY_BINS[1] ** 2):.0%} of the largest map"
            if slabs * bins**2 < MOST_SLABS * GLOSSY_BINS[1] ** 2
            else "",
        )
    )
    return passes, slabs, bins, 0.5 * noise


def _binned(seen):
    """Share of the occupied cells that have all pupil bins."""
    return min(1.0, max(0.01, len(seen.gloss) / max(len(seen.vergence), 1) + seen.specular))


def _wavelengths(scene, hologram, settings, chain, light, decisions):
    """Whether all wavelengths share one radiance, and how often rays are traced."""
    from ..scene.dispersion import wavelength_groups

    fixed, colours = settings.fixed, len(hologram.wavelengths)
    groups = len(wavelength_groups(scene, hologram.wavelengths))
    if not fixed.get("dispersion", bool(chain)):
        groups = 1
    grey = bool(fixed.get("grey", light.chroma < GREY)) and settings.radiance == "grain" and colours > 1
    if colours > 1:
        value = "rays for each" if groups > 1 else "rays once for all"
        reason = "glass in view disperses" if groups > 1 else "no glass that disperses is in view"
        if grey:
            value, reason = f"{value}, one radiance", f"{reason}; colors differ by {light.chroma:.1%}"
        saving = f"{colours - 1} of {colours} tracings" if groups == 1 else ""
        decisions.append(Decision("wavelengths", value, reason, saving, 0.5 * light.chroma if grey else 0.0))
    return grey, groups


def _frames(hologram, settings, focus_range, decisions):
    """Frames, what speckle they leave over the metres that eyes focus through, and steps against it."""
    speckle = speckle_contrast(settings.phase_field, settings.frames)
    reason = f"{settings.phase_field} phase fields leave a speckle contrast of about {speckle:.0%}"
    reach = REACH * hologram.pitch**2 / max(hologram.wavelengths)
    if settings.phase_field == "designed" and reach < focus_range:
        reason += f" up to {reach * 1e3:.2g} mm from focus, {speckle_contrast('random', settings.frames):.0%} beyond"
    if settings.speckle is not None:
        reason += f", {settings.speckle:.0%} wished"
    decisions.append(Decision("frames", str(settings.frames), reason))
    if settings.despeckle:
        decisions.append(
            Decision(
                "despeckling",
                f"{settings.despeckle} steps",
                f"towards the mean of {despeckle.BATCHES * SETS[-1]} frames of the same paths, which are traced too",
            )
        )


def captured_share(hologram: Hologram, distance: float) -> float:
    """Share of the recordable cones' light, from a picture at `distance`, that passes the SLM's aperture.

    Geometric: the overlap of the picture and its copies shifted by slope times distance, averaged over
    the cone of the widest wavelength.
    """
    n = 33
    axis = np.linspace(-1, 1, n)
    slope_y, slope_x = np.meshgrid(axis, axis, indexing="ij")
    disk = slope_x**2 + slope_y**2 <= 1
    walk = hologram.widest_slope * abs(distance) / hologram.pitch
    kept = np.clip(1 - np.abs(slope_x) * walk / hologram.width, 0, 1) * np.clip(
        1 - np.abs(slope_y) * walk / hologram.height, 0, 1
    )
    return float(kept[disk].mean())
