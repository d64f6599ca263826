"""How many recording planes there are, and where: the layout with the least work for what it is worth."""

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

MOST_PLANES, DRAFT_PLANES = 12, 3  # that are chosen where no number is asked for
# Work beside rays, in rays a pixel: what all planes share, and for each plane, its tables and silhouette, and the two
# transforms of each frame and wavelength.
SHARED_WORK, PLANE_WORK, MOVE_WORK = 80.0, 3.0, 0.6
LEAST_SHADOWS = 1e-4  # of the light: less is not told of


def recording_planes(survey: Survey) -> Decided[tuple[RecordingPlane, ...]]:
    """How many recording planes there are, and where, see `chosen`; and the rays that they need."""
    settings, scenery = survey.settings, Scenery(survey)
    if settings.method == "direct":
        planes, reason = scenery.plane(0.0), "the SLM itself: method direct"
    elif settings.wrp != "auto":
        planes, reason = scenery.plane(float(settings.wrp)), "as asked"
    else:
        layouts = candidates(scenery)
        layout = chosen(layouts, survey)
        planes, reason = scenery.planes(layout), _reason(scenery, layout, layouts[0])
    decisions = (
        Decision("recording planes", _names(planes.value, survey.hologram.origin), reason),
        _rays(settings, planes.value),
        *([_regions(planes.value, scenery.branches)] if by_region(settings) else []),
    )
    return Decided(planes.value, decisions, planes.warnings)


def candidates(scenery: Scenery) -> list[Layout]:
    """Layouts to choose from, the first of which has one plane."""
    settings = scenery.settings
    most = DRAFT_PLANES if settings.quality == "draft" else MOST_PLANES
    one, *more = scenery.layouts(most if settings.planes == "auto" else settings.planes)
    # none that needs more rays than one plane, which all pixels have the same of where tiles are not told apart
    able = by_region(settings) or settings.planes != "auto"
    return [one, *(layout for layout in more if able and layout.rays <= one.rays)]


def chosen(layouts: list[Layout], survey: Survey) -> Layout:
    """The layout with the least work for what it is worth.

    Noise falls as the work grows, so that work times the squared error, of speckle and of shadows, is what an error
    costs that all could reach. Where a number of planes is asked for, only the layouts of the most compete.
    """
    settings = survey.settings
    if settings.planes != "auto":
        count = max(len(layout.parts) for layout in layouts)
        layouts = [layout for layout in layouts if len(layout.parts) == count]
    # out of focus smooth fields ring, about as much as designed ones speckle
    smooth = settings.phase_field == "smooth"
    kind = "designed" if smooth else settings.phase_field
    # phases of few frames are found towards the mean of many: shadows of one frame would stay in them
    noise = speckle_contrast(kind, max(settings.frames, SETS[-1]) if smooth else settings.frames) ** 2
    moves = settings.frames * len(survey.hologram.wavelengths)

    def worth(layout):
        work = SHARED_WORK + layout.rays + len(layout.parts) * (PLANE_WORK + MOVE_WORK * moves)
        return work * (noise + layout.shadows)

    return min(layouts, key=worth)


def mean_rays(planes: Sequence[RecordingPlane], branches: int) -> tuple[float, float]:
    """Rays a pixel, means, of all planes: plain ones, and chained, which have so many branches each."""
    chained = (plane.chained * (1 if plane.sees == "surfaces" else max(branches, 1)) for plane in planes)
    return sum(plane.plain for plane in planes), sum(chained)


def margin_of(planes: Sequence[RecordingPlane], survey: Survey) -> int:
    """Pixels beyond each edge of the hologram that rays from the planes reach."""
    hologram, middle = survey.hologram, middle_of(planes)
    farthest = max(survey.z_high - middle, middle - survey.z_low)
    reach = 1.02 * CONE[survey.settings.quality] * hologram.widest_slope * farthest
    return math.ceil(reach / hologram.pitch) + 3


def columns_of(survey: Survey, margin: int) -> int:
    """Pixels of the radiance map."""
    return (survey.hologram.width + 2 * margin) * (survey.hologram.height + 2 * margin)


def _names(planes, origin):
    """Where planes are, in words."""
    where = {"all": "", "surfaces": "", "images": "images in mirrors and glass at "}
    parts = []
    for sees in where:
        places = ", ".join(f"{plane.z * 1e3:.2f}" for plane in planes if plane.sees == sees)
        if places:
            parts.append(where[sees] + places)
    return f"{'; '.join(parts)} mm from {origin}"


def _reason(scenery, layout, one):
    """Why a layout was chosen, in words."""
    reasons = list(dict.fromkeys(part.reason for part in layout.parts))
    if len(layout.parts) > 1:
        share = layout.rays / max(one.rays, 1e-9)
        reasons.append(f"{len(layout.parts)} planes need {share:.0%} of the rays of one")
        if one.shadows > LEAST_SHADOWS:
            reasons.append(
                f"light on the wrong side of edges falls from {one.shadows:.2%} to {layout.shadows:.2%}"
            )
    return "; ".join(reasons)


def _rays(settings, planes):
    """The `Decision` on rays a pixel."""
    rays = sum(plane.rays for plane in planes)
    reason = "random directions, the paper's estimator"
    if settings.estimator != "paper":
        limit, cone = max(plane.depth_limit for plane in planes) * 1e3, CONE[settings.quality]
        reason = f"one a grain at {limit:.2f} mm from the recording plane, cone {cone:g} of the recordable"
    return Decision("rays a pixel", str(rays), reason)


def _regions(planes, branches):
    """The `Decision` on rays of tiles."""
    rays, plain, chained = (
        sum(getattr(plane, kind) for plane in planes) for kind in ("rays", "plain", "chained")
    )
    value = f"{plain + chained:.0f} of {rays} rays a pixel on average"
    if branches:
        value += f", {chained / max(plain + chained, 1e-9):.0%} of them followed over mirrors"
    share = 1 - (plain + chained) / rays
    reason = "tiles that see no light have none, others one a grain at their own farthest surface"
    return Decision("regions", value, reason, f"{share:.0%} of the rays" if share > 0.005 else "", 0.0)
