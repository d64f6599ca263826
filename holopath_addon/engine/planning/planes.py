"""Number and places of recording planes: the layout whose rays and error together cost least."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..plan import Decided, Decision, middle_of
from ..waves.phase_fields import SETS, speckle_contrast
from .layouts import CONE, Scenery, by_region

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..plan import RecordingPlane
    from .layouts import Layout
    from .survey import Survey

MAX_PLANES, MAX_DRAFT_PLANES = 12, 3  # where the number of planes is `auto`
# Work beside rays, in rays a pixel: for the whole render, for the tables and silhouette of each plane, and for its two
# transforms of each frame and wavelength
SHARED_WORK, PLANE_WORK, PROPAGATION_WORK = 80.0, 3.0, 0.6
MIN_SHADOWS = 1e-4  # fraction of the light, from which the reason names it


def decide_planes(survey: Survey) -> Decided[tuple[RecordingPlane, ...]]:
    """Decide on recording planes, see `best_layout`, and on the rays that each needs.

    Parameters
    ----------
    survey : Survey

    Returns
    -------
    Decided of tuple of RecordingPlane
        From the far end to the near one.
    """
    settings, scenery = survey.settings, Scenery(survey)
    if settings.method == "direct":
        planes, reason = scenery.plane(0.0), "the SLM itself: method direct"
    elif settings.wrp != "auto":
        planes, reason = scenery.plane(float(settings.wrp)), "as asked"
    else:
        layouts = candidates(scenery)
        layout = best_layout(layouts, survey)
        planes, reason = scenery.planes(layout), _reason(layout, layouts[0])
    decisions = (
        Decision("recording planes", _places(planes.value, survey.hologram.origin), reason),
        _rays_decision(settings, planes.value),
        *([_regions_decision(planes.value, scenery.branches)] if by_region(settings) else []),
    )
    return Decided(planes.value, decisions, planes.warnings)


def candidates(scenery: Scenery) -> list[Layout]:
    """Layouts to choose from; the first has one plane, and others need no more rays."""
    settings = scenery.settings
    max_planes = MAX_DRAFT_PLANES if settings.quality == "draft" else MAX_PLANES
    one, *more = scenery.layouts(max_planes if settings.planes == "auto" else settings.planes)
    # without regions all pixels of a plane have as many rays, so that more planes save nothing
    allowed = by_region(settings) or settings.planes != "auto"
    return [one, *(layout for layout in more if allowed and layout.rays <= one.rays)]


def best_layout(layouts: list[Layout], survey: Survey) -> Layout:
    """Layout with the minimum of work times squared error, of speckle and of shadows.

    Noise falls as the work grows, so that this product is the cost of an error that all layouts could reach. Where a
    number of planes is requested, only the layouts with the most planes compete.
    """
    settings = survey.settings
    if settings.planes != "auto":
        count = max(len(layout.parts) for layout in layouts)
        layouts = [layout for layout in layouts if len(layout.parts) == count]
    # out of focus smooth fields ring, about as much as designed ones speckle
    smooth = settings.phase_field == "smooth"
    kind = "designed" if smooth else settings.phase_field
    # phases of few frames approximate the mean of many frames, in which shadows of each would stay
    noise = speckle_contrast(kind, max(settings.frames, SETS[-1]) if smooth else settings.frames) ** 2
    fields = settings.frames * len(survey.hologram.wavelengths)

    def cost(layout):
        work = SHARED_WORK + layout.rays + len(layout.parts) * (PLANE_WORK + PROPAGATION_WORK * fields)
        return work * (noise + layout.shadows)

    return min(layouts, key=cost)


def mean_rays(planes: Sequence[RecordingPlane], branches: int) -> tuple[float, float]:
    """Mean rays a pixel of all planes: plain ones, and chained ones times their branches."""
    chained = (plane.chained * (1 if plane.sees == "surfaces" else max(branches, 1)) for plane in planes)
    return sum(plane.plain for plane in planes), sum(chained)


def margin_of(planes: Sequence[RecordingPlane], survey: Survey) -> int:
    """Margin of the radiance map: pixels beyond each edge of the hologram that rays from the planes reach."""
    hologram, middle = survey.hologram, middle_of(planes)
    farthest = max(survey.z_high - middle, middle - survey.z_low)
    reach = 1.02 * CONE[survey.settings.quality] * hologram.widest_slope * farthest
    return math.ceil(reach / hologram.pitch) + 3


def columns_of(survey: Survey, margin: int) -> int:
    """Number of pixels of the radiance map."""
    return (survey.hologram.width + 2 * margin) * (survey.hologram.height + 2 * margin)


def _places(planes, origin):
    """Places of planes in words."""
    parts = []
    for sees, label in {"all": "", "surfaces": "", "images": "images in mirrors and glass at "}.items():
        places = ", ".join(f"{plane.z * 1e3:.2f}" for plane in planes if plane.sees == sees)
        if places:
            parts.append(label + places)
    return f"{'; '.join(parts)} mm from {origin}"


def _reason(layout, one):
    """Reason for a layout in words, compared with that of one plane."""
    reasons = list(dict.fromkeys(part.depths.reason for part in layout.parts))
    if len(layout.parts) > 1:
        fraction = layout.rays / max(one.rays, 1e-9)
        reasons.append(f"{len(layout.parts)} planes need {fraction:.0%} of the rays of one")
        if one.shadows > MIN_SHADOWS:
            reasons.append(
                f"light on the wrong side of edges falls from {one.shadows:.2%} to {layout.shadows:.2%}"
            )
    return "; ".join(reasons)


def _rays_decision(settings, planes):
    """`Decision` on rays a pixel."""
    rays = sum(plane.rays for plane in planes)
    reason = "random directions, the paper's estimator"
    if settings.estimator != "paper":
        limit, cone = max(plane.depth_limit for plane in planes) * 1e3, CONE[settings.quality]
        reason = f"one a grain at {limit:.2f} mm from the recording plane, cone {cone:g} of the recordable"
    return Decision("rays a pixel", str(rays), reason)


def _regions_decision(planes, branches):
    """`Decision` on rays of tiles."""
    rays, plain, chained = (
        sum(getattr(plane, kind) for plane in planes) for kind in ("rays", "plain", "chained")
    )
    value = f"{plain + chained:.0f} of {rays} rays a pixel on average"
    if branches:
        value += f", {chained / max(plain + chained, 1e-9):.0%} of them followed over mirrors"
    saved = 1 - (plain + chained) / rays
    reason = "tiles without light have none, others one a grain at their own farthest surface"
    return Decision("regions", value, reason, f"{saved:.0%} of the rays" if saved > 0.005 else "", 0.0)
