"""Decisions on light: paths of this view or baked light, their number, and the radiance map."""

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
from .fixable import GLOSSY_BINS, MAX_SLABS
from .planes import columns_of
from .probe import MIN_VIEW_FRACTION

if TYPE_CHECKING:
    from ..light.bake_store import BakeStore
    from .survey import Survey

MAX_ONE_BIN_TURN = 0.5  # widths of the sharpest lobe; below, bins differ by less than the noise
MAX_MAP_BYTES = 1 << 30  # of the radiance map's index, and of its pupil bins
CACHED_PASSES, TYPICAL_CACHED_PASSES = 4, 6  # minimum and typical paths a pixel where diffuse light is baked
TEXEL_NOISE_RATIO = 0.45  # noise of a texel's samples over that of as many random paths
SMOOTHING_GROUPS = 600  # groups of texels over which light from other surfaces is averaged, typically
MAX_BAKING_RATIO = (
    0.8  # of the time of baking over that of paths, for which light is baked: estimates are rough
)
MIN_DIFFUSE_FRACTION = 0.1  # of the view, for which light is baked
MAX_GRAY_CHROMA = 0.01  # difference of the channels over the radiance, below which they are one


def decide_diffuse_light(
    survey: Survey, margin: int, store: BakeStore | None
) -> Decided[dict[str, float] | None]:
    """Decide whether diffuse light comes from the radiance cache, by the shorter time unless a method is requested.

    Parameters
    ----------
    survey : Survey
    margin : int
        Pixels of the radiance map beyond each edge of the hologram.
    store : BakeStore or None
        Where light may have been baked before.

    Returns
    -------
    Decided of dict of str to float, or of None
        Seconds of the cache's stages; None without it.
    """
    settings, columns = survey.settings, columns_of(survey, margin)
    if settings.method == "direct" or settings.max_depth < 2:
        return Decided(None)
    requested = settings.method == "fast"
    reason = "" if requested else _reason_for_paths(survey)
    if reason:
        return Decided(None, (Decision("diffuse light", "paths of this view", reason),))
    rays = noise.estimated_rays(settings, survey.light)
    paths = costs.radiance_map_seconds(survey.light, survey.slowness, columns, *rays)
    if settings.radiance == "ray":
        paths = math.inf
    limit = math.inf if requested else paths
    cache = _CacheCosts(survey, columns, limit)
    baked_fraction = None
    if store is not None:
        texel_noise, max_passes = noise.texel_noise(settings), noise.max_passes(settings)
        request = BakeRequest(
            survey.scene, survey.camera, survey.hologram, survey.near, survey.chains.image_finder, settings,
            texel_noise, max_passes,
        )  # fmt: skip
        baked_fraction = found_in(store, request, cache.load_if_worthwhile)
    limit *= MAX_BAKING_RATIO if baked_fraction is None else 1
    stages = cache.stage_seconds(baked_fraction, limit)
    seconds = cache.loading_seconds + sum(stages.values())
    comparison = "to be baked" if baked_fraction is None else "light baked before"
    if baked_fraction is not None and baked_fraction < 1:
        comparison += (
            f" for {baked_fraction:.0%} of the view" if baked_fraction >= 0.005 else " for other views"
        )
    comparison += f", {'about' if cache.timed else 'more than'} {seconds:.1f} s"
    comparison += f", paths of this view about {paths:.1f} s"
    if requested:
        return Decided(stages, (Decision("diffuse light", "radiance cache", f"as asked; {comparison}"),))
    bake = seconds < limit
    saving = f"about {abs(paths - seconds):.0f} s" if abs(paths - seconds) >= 1 else ""
    value = "radiance cache" if bake else "paths of this view"
    return Decided(stages if bake else None, (Decision("diffuse light", value, comparison, saving),))


def _reason_for_paths(survey):
    """Reason for paths of this view without a comparison of times; empty where there is none."""
    if survey.settings.method == "full" or survey.settings.radiance == "ray":
        return "as asked"
    diffuse = survey.probe.diffuse
    return f"only {diffuse:.0%} of the view is diffuse" if diffuse < MIN_DIFFUSE_FRACTION else ""


class _CacheCosts:
    """Seconds that the radiance cache would take; short paths are timed only where they may decide.

    `limit` is the seconds for which the cache is worthwhile.
    """

    def __init__(self, survey, columns, limit):
        self._survey, self._columns, self._limit = survey, columns, limit
        textures = noise.estimated_texture_rays(survey.settings, survey.light, TYPICAL_CACHED_PASSES)
        self._rays = TYPICAL_CACHED_PASSES, textures
        shapes = surfaces_of(survey.scene)
        self._triangles = sum(shape.primitive_count() for shape in shapes if shape.is_mesh())
        self.loading_seconds = 0.0  # 0 once the light is loaded

    def load_if_worthwhile(self, texels):
        """Whether to load so many texels; the caller then does it."""
        self.loading_seconds = costs.loading_seconds(texels, self._triangles, self._survey.slowness)
        if self.loading_seconds + sum(self.stage_seconds(1.0, self._limit).values()) > self._limit:
            return False
        self.loading_seconds = 0.0
        return True

    def stage_seconds(self, baked_fraction, limit):
        """Seconds of each stage; a lower bound where they exceed the limit."""
        stages = self._estimate(baked_fraction)
        if self.timed or self.loading_seconds + sum(stages.values()) > limit:
            return stages
        survey = self._survey
        light = survey.pilot.with_short_paths(survey.light, survey.chains.image_finder)
        self._survey = replace(survey, light=light)
        return self._estimate(baked_fraction)

    @property
    def timed(self):
        """Whether short paths are timed."""
        return math.isfinite(self._survey.light.short_per_second)

    def _estimate(self, baked_fraction):
        return costs.baking_seconds(self._survey, self._columns, self._rays, baked_fraction, self._triangles)


def decide_bounces(survey: Survey, cached: bool) -> Decided[int]:
    """Decide on the vertices of a radiance path: as many as add light, or all where diffuse light is baked."""
    light, limit = survey.light, survey.settings.max_depth
    if cached:
        value, reason = f"{limit} vertices", "the radiance cache has them all"
        return Decided(limit, (Decision("light bounces", value, reason),))
    if "max_depth" in survey.settings.fixed:
        reason = "as asked"
    elif light.max_depth < limit:
        reason = f"more add {light.lost:.1%} of the light"
    else:
        reason = "as many as are allowed"
    saving = f"{limit - light.max_depth} vertices of {limit}" if light.max_depth < limit else ""
    value = f"{light.max_depth} vertices"
    return Decided(light.max_depth, (Decision("light bounces", value, reason, saving, light.lost_error),))


def decide_paths(survey: Survey, cached: bool) -> Decided[tuple[int, float]]:
    """Decide on the radiance paths a pixel; the second value is the relative error of the field by their noise."""
    settings, light = survey.settings, survey.light
    if settings.radiance == "ray":
        reason = "as asked" if cached else "as asked; dark where light is indirect"
        return Decided((0, 0.0), (Decision("radiance", f"{settings.paths} paths a ray", reason),))
    variance, limit = noise.path_variance(settings, light), noise.max_passes(settings)
    passes = noise.passes_for(settings, variance)
    textures = noise.estimated_texture_rays(settings, light, passes)
    error = math.sqrt(variance / passes + noise.texture_variance(settings, light, passes + textures))
    speckle = speckle_contrast("random", settings.frames)
    if cached:
        variance = light.direct + max(light.noise - light.direct, 0) / SMOOTHING_GROUPS
        error = min(noise.texel_noise(settings), TEXEL_NOISE_RATIO * math.sqrt(variance / ROUND))
    value = f"{CACHED_PASSES} to {passes}" if cached else str(passes)
    value += f", and about {textures} rays that see textures alone" if textures else ""
    if "passes" in settings.fixed:
        reason = "as asked"
    elif cached:
        reason = "as many as emitters and mirrors need once diffuse light is baked"
    else:
        reason = (
            f"leave {error:.1%} noise in a grain's mean where frames of random phase leave {speckle:.0%} speckle; "
            "more if their halves differ by more"
        )
    saving = (
        f"{1 - passes / limit:.0%} of the paths that may be taken" if passes < limit and not cached else ""
    )
    decision = Decision("radiance paths a pixel", value, reason, saving, 0.5 * error)
    return Decided((passes, 0.5 * error), (decision,))


def decide_radiance_map(survey: Survey, margin: int) -> Decided[tuple[int, int]]:
    """Decide on depth slabs and pupil bins along each axis of the radiance map, within `MAX_MAP_BYTES`."""
    columns = columns_of(survey, margin)
    settings, probe, fixed = survey.settings, survey.probe, survey.settings.fixed
    if settings.radiance == "ray":
        return Decided((1, 1))
    draft = settings.quality == "draft"
    glossy = not draft and (probe.sharpest > MAX_ONE_BIN_TURN or probe.specular > MIN_VIEW_FRACTION)
    bins = min(GLOSSY_BINS[0] + math.floor(1.5 * probe.turn), GLOSSY_BINS[1]) if glossy else 1
    max_bins = MAX_MAP_BYTES / (columns * costs.CELLS_PER_COLUMN * probe.binned * costs.CELL_BYTES)
    bins = max(1, min(fixed.get("bins", bins), math.floor(math.sqrt(max_bins))))
    max_slabs = min(MAX_SLABS, MAX_MAP_BYTES // (4 * columns << survey.chains.splits))
    slabs = math.ceil((survey.z_high - survey.z_low) / survey.pilot.slab)
    slabs = max(1, min(max_slabs, fixed.get("slabs", slabs)))
    if draft:
        reason = "drafts look alike from all over the pupil"
    elif probe.sharpest:
        reason = f"across the pupil the view turns {probe.sharpest:.2g} widths of the sharpest gloss"
    else:
        reason = "mirrors and clear surfaces are in view" if glossy else "all surfaces in view are diffuse"
    cells, max_cells = slabs * bins**2, MAX_SLABS * GLOSSY_BINS[1] ** 2
    saving = f"{1 - cells / max_cells:.0%} of the largest map" if cells < max_cells else ""
    value = f"{slabs} depth slabs, {bins} x {bins} pupil bins"
    return Decided((slabs, bins), (Decision("radiance map", value, reason, saving),))


def decide_wavelengths(survey: Survey) -> Decided[tuple[bool, int]]:
    """Decide whether all wavelengths share one radiance, and how many times rays are traced."""
    fixed, colors, chroma = survey.settings.fixed, len(survey.hologram.wavelengths), survey.light.chroma
    groups = len(wavelength_groups(survey.scene, survey.hologram.wavelengths))
    if not fixed.get("dispersion", bool(survey.chains.longest)):
        groups = 1
    behind_lens = isinstance(survey.hologram, AerialImage)
    if behind_lens:
        groups = colors
    if colors == 1:
        return Decided((False, groups))
    gray = bool(fixed.get("gray", chroma < MAX_GRAY_CHROMA)) and survey.settings.radiance == "grain"
    value = "rays for each" if groups > 1 else "rays once for all"
    reason = "glass in view disperses" if groups > 1 else "no glass that disperses is in view"
    if behind_lens:
        reason = "behind a lens each has pixels of its own size"
    if gray:
        value, reason = f"{value}, one radiance", f"{reason}; colors differ by {chroma:.1%}"
    saving = f"{colors - 1} of {colors} tracings" if groups == 1 else ""
    decision = Decision("wavelengths", value, reason, saving, 0.5 * chroma if gray else 0.0)
    return Decided((gray, groups), (decision,))
