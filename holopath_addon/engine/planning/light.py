"""Where the light comes from: paths of this view or baked light, how many, and the radiance map that holds it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from ..hologram import AerialImage
from ..light.baking import found_in
from ..light.camera_view import BakeRequest
from ..light.gathering import ROUND
from ..plan import Decided, Decision
from ..scene.dispersion import wavelength_groups
from ..scene.lobes import surfaces_of
from ..waves.phase_fields import speckle_contrast
from . import costs, noise
from .fixable import GLOSSY_BINS, MOST_SLABS
from .planes import columns_of
from .probe import LEAST_SHARE

if TYPE_CHECKING:
    from ..light.bake_store import BakeStore
    from .survey import Survey

ONE_BIN = 0.5  # of the sharpest lobe's width: what bins would tell apart is less than noise then
MAP_BYTES = 1 << 30  # largest index of the radiance map, and its largest pupil bins
CACHED_PASSES = 4  # fewest where light is looked up
LIKELY_CACHED = 6  # that are taken then, roughly
EVENLY = 0.45  # noise of a texel's samples over that of as many paths at random
SMOOTHED = 600  # groups of texels over which light from other surfaces is averaged, roughly
CLEARLY = 0.8  # times as long as paths of this view has to be what is baked: estimates are rough
LEAST_DIFFUSE = 0.1  # of the view: the cache is for more
GREY = 0.01  # of the radiance: channels that differ less are one


def diffuse_light(survey: Survey, margin: int, store: BakeStore | None) -> Decided[dict[str, float] | None]:
    """Whether diffuse light comes from the radiance cache: then the seconds of its stages.

    The radiance map has `margin` pixels beyond each edge of the hologram.
    """
    settings, diffuse, columns = survey.settings, survey.seen.diffuse, columns_of(survey, margin)
    if settings.method == "direct" or settings.max_depth < 2:
        return Decided(None)
    asked = settings.method == "fast"
    if not asked and (settings.method == "full" or settings.radiance == "ray" or diffuse < LEAST_DIFFUSE):
        few = settings.method != "full" and settings.radiance != "ray"
        reason = f"only {diffuse:.0%} of the view is diffuse" if few else "as asked"
        return Decided(None, (Decision("diffuse light", "paths of this view", reason),))
    paths = costs.map_seconds(survey.light, columns, *noise.likely(settings, survey.light), survey.slowness)
    if settings.radiance == "ray":
        paths = math.inf
    limit = math.inf if asked else paths
    cache = _Cache(survey, columns, limit)
    baked = None
    if store is not None:
        view = survey.scene, survey.camera, survey.hologram, survey.near, survey.chains.optics
        request = BakeRequest(*view, settings, noise.texel_noise(settings), noise.most_passes(settings))
        baked = found_in(store, request, cache.worth_loading)
    limit *= CLEARLY if baked is None else 1
    stages = cache.stages(baked, limit)
    seconds = cache.loading + sum(stages.values())
    about = "about" if cache.timed else "more than"
    before = "to be baked" if baked is None else "light baked before"
    if baked is not None and baked < 1:
        before += f" for {baked:.0%} of the view" if baked >= 0.005 else " for other views"
    compared = f"{before}, {about} {seconds:.1f} s, paths of this view about {paths:.1f} s"
    if asked:
        return Decided(stages, (Decision("diffuse light", "radiance cache", f"as asked; {compared}"),))
    better = seconds < limit
    saving = f"about {abs(paths - seconds):.0f} s" if abs(paths - seconds) >= 1 else ""
    value = "radiance cache" if better else "paths of this view"
    return Decided(stages if better else None, (Decision("diffuse light", value, compared, saving),))


class _Cache:
    """Seconds that the radiance cache would take; of short paths, which are timed only where that may decide.

    `limit` is how many it is worth.
    """

    def __init__(self, survey, columns, limit):
        self._survey, self._columns, self._limit = survey, columns, limit
        self._few = LIKELY_CACHED, noise.likely_textures(survey.settings, survey.light, LIKELY_CACHED)
        shapes = surfaces_of(survey.scene)
        self._triangles = sum(shape.primitive_count() for shape in shapes if shape.is_mesh())
        self.loading = 0.0  # seconds that are not spent yet

    def worth_loading(self, texels):
        """Whether to load so many, which is then done."""
        self.loading = costs.loading(texels, self._triangles, self._survey.slowness)
        if self.loading + sum(self.stages(1.0, self._limit).values()) > self._limit:
            return False
        self.loading = 0.0
        return True

    def stages(self, baked, most):
        """Of each stage with this share of the view baked, where they are no more than `most`, else a part of them."""
        stages = self._foretold(baked)
        if self.timed or self.loading + sum(stages.values()) > most:
            return stages
        survey = self._survey
        light = survey.pilot.with_short_paths(survey.light, survey.chains.optics)
        self._survey = replace(survey, light=light)
        return self._foretold(baked)

    @property
    def timed(self):
        """Whether short paths are."""
        return math.isfinite(self._survey.light.short_per_second)

    def _foretold(self, baked):
        return costs.baking(self._survey, self._columns, self._few, baked, self._triangles)


def light_bounces(survey: Survey, cached: bool) -> Decided[int]:
    """Vertices of a radiance path."""
    light, most = survey.light, survey.settings.max_depth
    if cached:
        value, reason = f"{most} vertices", "the radiance cache has them all"
        return Decided(most, (Decision("light bounces", value, reason),))
    if "max_depth" in survey.settings.fixed:
        reason = "as asked"
    elif light.max_depth < most:
        reason = f"more add {light.lost:.1%} of the light"
    else:
        reason = "as many as are allowed"
    saving = f"{most - light.max_depth} vertices of {most}" if light.max_depth < most else ""
    value = f"{light.max_depth} vertices"
    return Decided(light.max_depth, (Decision("light bounces", value, reason, saving, light.lost / 2),))


def radiance_paths(survey: Survey, cached: bool) -> Decided[tuple[int, float]]:
    """Radiance paths a pixel, and the error that their noise leaves in the field."""
    settings, light = survey.settings, survey.light
    if settings.radiance == "ray":
        reason = "as asked" if cached else "as asked; dark where light is indirect"
        return Decided((0, 0.0), (Decision("radiance", f"{settings.paths} paths a ray", reason),))
    passes, most = noise.passes_for(settings, noise.noise_left(settings, light)), noise.most_passes(settings)
    looks = noise.likely_textures(settings, light, passes)
    error = math.sqrt(
        noise.noise_left(settings, light) / passes + noise.texture_left(settings, light, passes + looks)
    )
    speckle = speckle_contrast("random", settings.frames)
    if cached:
        variance = light.direct + max(light.noise - light.direct, 0) / SMOOTHED
        error = min(noise.texel_noise(settings), EVENLY * math.sqrt(variance / ROUND))
    value = f"{CACHED_PASSES} to {passes}" if cached else str(passes)
    value += f", and about {looks} rays that see textures alone" if looks else ""
    if "passes" in settings.fixed:
        reason = "as asked"
    elif cached:
        reason = "as many as what shines and mirrors needs once diffuse light is baked"
    else:
        reason = (
            f"leave {error:.1%} noise in a grain's mean where frames of random phase leave {speckle:.0%} speckle; "
            "more if their halves differ by more"
        )
    saving = f"{1 - passes / most:.0%} of the paths that may be taken" if passes < most and not cached else ""
    decision = Decision("radiance paths a pixel", value, reason, saving, 0.5 * error)
    return Decided((passes, 0.5 * error), (decision,))


def radiance_map(survey: Survey, margin: int) -> Decided[tuple[int, int]]:
    """Depth slabs and pupil bins of the radiance map."""
    columns = columns_of(survey, margin)
    settings, seen, fixed = survey.settings, survey.seen, survey.settings.fixed
    if settings.radiance == "ray":
        return Decided((1, 1))
    draft = settings.quality == "draft"
    glossy = not draft and (seen.sharpest > ONE_BIN or seen.specular > LEAST_SHARE)
    bins = min(GLOSSY_BINS[0] + math.floor(1.5 * seen.turn), GLOSSY_BINS[1]) if glossy else 1
    room = MAP_BYTES / (columns * costs.SURFACES * seen.binned * costs.CELL_BYTES)
    bins = max(1, min(fixed.get("bins", bins), math.floor(math.sqrt(room))))
    most_slabs = min(MOST_SLABS, MAP_BYTES // (4 * columns << survey.chains.splits))
    slabs = math.ceil((survey.z_high - survey.z_low) / survey.pilot.slab)
    slabs = max(1, min(most_slabs, fixed.get("slabs", slabs)))
    if draft:
        reason = "drafts look alike from all over the pupil"
    elif seen.sharpest:
        reason = f"across the pupil the view turns {seen.sharpest:.2g} widths of the sharpest gloss"
    else:
        reason = "mirrors and clear surfaces are in view" if glossy else "all surfaces in view are diffuse"
    cells, most = slabs * bins**2, MOST_SLABS * GLOSSY_BINS[1] ** 2
    saving = f"{1 - cells / most:.0%} of the largest map" if cells < most else ""
    value = f"{slabs} depth slabs, {bins} x {bins} pupil bins"
    return Decided((slabs, bins), (Decision("radiance map", value, reason, saving),))


def wavelengths(survey: Survey) -> Decided[tuple[bool, int]]:
    """Whether all wavelengths share one radiance, and how often rays are traced."""
    fixed, colours, chroma = survey.settings.fixed, len(survey.hologram.wavelengths), survey.light.chroma
    groups = len(wavelength_groups(survey.scene, survey.hologram.wavelengths))
    if not fixed.get("dispersion", bool(survey.chains.longest)):
        groups = 1
    behind_lens = isinstance(survey.hologram, AerialImage)
    if behind_lens:
        groups = colours
    if colours == 1:
        return Decided((False, groups))
    grey = bool(fixed.get("grey", chroma < GREY)) and survey.settings.radiance == "grain"
    value = "rays for each" if groups > 1 else "rays once for all"
    reason = "glass in view disperses" if groups > 1 else "no glass that disperses is in view"
    if behind_lens:
        reason = "behind a lens each has pixels of its own size"
    if grey:
        value, reason = f"{value}, one radiance", f"{reason}; colors differ by {chroma:.1%}"
    saving = f"{colours - 1} of {colours} tracings" if groups == 1 else ""
    decision = Decision("wavelengths", value, reason, saving, 0.5 * chroma if grey else 0.0)
    return Decided((grey, groups), (decision,))
