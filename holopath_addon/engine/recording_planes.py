"""Where rays start: recording planes in the scene's depths, and how many rays each needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .errors import InvalidInput
from .kernel_table import Lattice, directions_of
from .regions import IMAGE_REACH, TILE, limit_of

if TYPE_CHECKING:
    from .hologram import Hologram, Settings
    from .probing import Places

CONE = {
    "preview": 1.0,
    "balanced": 1.15,
    "full": 1.3,
}  # of the recordable slope: how much of the kernel's tails
PAPER_RAYS = {"preview": 256, "balanced": 1024, "full": 4096}
DEPTH_BINS = 128  # that recording planes are fitted to
MOST_REACH = 256  # pixels: beyond, the kernel table would outgrow memory
CANDIDATES = 9  # places of a plane that are compared
WORTH = 0.85  # of the rays: a place off the middle must need less
BESIDE = 0.75  # depths of focus that a plane is put beside images in curved mirrors and lenses...
BENT_NEAR = 0.1  # ... where they would fill more of the view nearer to it
BENT_SPREAD = 0.07  # ... and lie at depths that differ by more depths of focus, at 90 % of their places
LOOKS = 64  # probe rays in a tile


@dataclass(frozen=True)
class RecordingPlane:
    """A plane that rays start from, and the slab of the volume that it records. Distances from the SLM in metres.

    Attributes
    ----------
    z : float
        Of the plane.
    far, near : float
        Ends of the slab, within which its rays see surfaces; infinite for the outermost.
    low : float
        Depth of its farthest surface.
    depth_limit : float
        Largest distance of a surface from the plane.
    rays : int
        A pixel, where it needs most.
    plain, chained : float
        Estimated rays a pixel that no mirror or clear surface is in view of, and others, means over all pixels.
    """

    z: float
    far: float
    near: float
    low: float
    depth_limit: float
    rays: int
    plain: float
    chained: float


def max_slope(hologram: Hologram) -> float:
    """Slope of the widest recordable cone."""
    return max(hologram.max_slope(w) for w in hologram.wavelengths)


def depth_of_focus(hologram: Hologram) -> float:
    """Depth of focus 2 wavelength / slope^2 in metres, of the wavelength that has the longest."""
    return max(2 * w / hologram.max_slope(w) ** 2 for w in hologram.wavelengths)


def slab_planes(
    hologram: Hologram, settings: Settings, depths: np.ndarray, warnings: list[str]
) -> tuple[RecordingPlane, ...]:
    """Planes in the middles of slabs fitted to the depths in view, `settings.planes` at most."""
    slabs = depth_slabs(depths, settings.planes)
    ends = [-math.inf, *(0.5 * (a[1] + b[0]) for a, b in pairwise(slabs)), math.inf]
    planes = []
    for (low, high), far, near in zip(slabs, ends[:-1], ends[1:], strict=True):
        limit, rays = _rays(hologram, settings, 0.5 * (high - low), warnings, len(slabs))
        planes.append(RecordingPlane(0.5 * (low + high), far, near, low, limit, rays, rays, 0.0))
    return tuple(planes)


def plane_at(
    hologram: Hologram,
    settings: Settings,
    z: float,
    z_low: float,
    z_high: float,
    chain: int,
    places: Places,
    by_region: bool,
    warnings: list[str],
) -> RecordingPlane:
    """One plane for all depths, at a distance from the SLM."""
    thickness = max(z_high - z, z - z_low)
    if chain:
        thickness = max(
            thickness, IMAGE_REACH * hologram.pitch / (CONE[settings.quality] * max_slope(hologram))
        )
    limit, rays = _rays(hologram, settings, thickness, warnings)
    plain, chained = (
        _shares(hologram, settings, z, limit, places) if by_region else (1 - bool(chain), bool(chain))
    )
    return RecordingPlane(z, -math.inf, math.inf, z_low, limit, rays, plain * rays, chained * rays)


def best_place(
    hologram: Hologram,
    settings: Settings,
    z_low: float,
    z_high: float,
    gloss: np.ndarray,
    bent: np.ndarray,
    places: Places,
    by_region: bool,
) -> tuple[float, str]:
    """Distance from the SLM at which a plane for all depths needs the fewest rays, and why, in words."""
    middle, depth = 0.5 * (z_low + z_high), depth_of_focus(hologram)
    if len(gloss):
        reason = "a depth of focus beside gloss, which looks different across the pupil"
        return _beside(z_low, z_high, gloss, depth, 0.01 * len(gloss)), reason
    few = BENT_NEAR * len(places.z)
    spread = np.ptp(np.quantile(bent, (0.05, 0.95))) if len(bent) else 0.0
    if spread > BENT_SPREAD * depth and (abs(bent - middle) < BESIDE * depth).sum() > few:
        reason = (
            "beside the images of curved mirrors and lenses, whose depths differ from direction to direction"
        )
        return _beside(z_low, z_high, bent, BESIDE * depth, few), reason
    reason = "the middle of the depths in view needs the fewest rays"
    if not by_region or z_high - z_low < 0.1 * depth:
        return middle, reason

    def needed(z):
        limit = _limit(hologram, max(z_high - z, z - z_low))
        return _reach(hologram, settings, limit) ** 2 * sum(_shares(hologram, settings, z, limit, places))

    candidates = np.linspace(z_low, z_high, CANDIDATES)
    rays = [needed(z) for z in candidates]
    best = int(np.argmin(rays))
    share = rays[best] / max(needed(middle), 1e-30)
    if share > WORTH:
        return middle, reason
    return float(
        candidates[best]
    ), f"most of the view needs few rays from there: {share:.0%} of those from the middle"


def _shares(hologram, settings, z, limit, places):
    """Rays that the tiles need, plain ones and others with mirrors in view, of those of whole planes."""
    tiles = hologram.width * hologram.height / TILE**2
    cell = TILE * max(1, math.ceil(math.sqrt(tiles * LOOKS / len(places.z))))
    look = places.look(z, limit, hologram.width, hologram.height, cell)
    whole = _reach(hologram, settings, limit)
    steps = look.steps(whole)
    share = np.where(steps < 0, 0.0, (_reach(hologram, settings, limit_of(steps, limit)) / whole) ** 2)
    return float((share * ~look.chains).mean()), float((share * look.chains).mean())


def _beside(z_low, z_high, depths, distance, few):
    """The plane nearest to the middle that has no more than a few of some depths within a distance.

    Gloss nearer than about a depth of focus has all directions of a grain in one pixel, which cannot hold that they
    differ. Images whose depths differ by as much as their distance from the plane leave too many rays for some grains
    and too few for others: up to a tenth of the light.
    """
    middle = 0.5 * (z_low + z_high)
    candidates = np.linspace(z_low - 1.05 * distance, z_high + 1.05 * distance, DEPTH_BINS)
    candidates = candidates[np.argsort(abs(candidates - middle), kind="stable")]
    near = [(abs(depths - z) < distance).sum() for z in candidates]
    return float(candidates[np.argmax(np.array(near) <= few)])


def depth_slabs(depths: np.ndarray, count: int) -> list[tuple[float, float]]:
    """Split depths into at most `count` slabs that need the fewest rays, whose number goes as the thickness squared.

    Parameters
    ----------
    depths : numpy.ndarray
    count : int

    Returns
    -------
    list of (float, float)
        Lowest and highest depth in each slab, from low to high.
    """
    low, high = float(depths.min()), float(depths.max())
    bins = np.minimum(((depths - low) / max(high - low, 1e-12) * DEPTH_BINS).astype(int), DEPTH_BINS - 1)
    used = np.unique(bins)
    first = np.array([depths[bins == b].min() for b in used])
    last = np.array([depths[bins == b].max() for b in used])
    cost = (last[None, :] - first[:, None]) ** 2  # of one slab from bin i to bin j
    best, cuts = cost[0], []
    for _ in range(min(count, len(used)) - 1):
        options = best[:-1, None] + cost[1:]
        options[np.tril_indices_from(options)] = np.inf
        cuts.append(options.argmin(0))
        best = options.min(0)
    slabs, end = [], len(used) - 1
    for cut in cuts[::-1]:
        begin = cut[end] + 1
        slabs.append((float(first[begin]), float(last[end])))
        end = cut[end]
    return [(float(first[0]), float(last[end])), *slabs[::-1]]


def _limit(hologram, thickness):
    """Depth limit for surfaces up to `thickness` from the plane."""
    # rays between the probe's may meet surfaces a little beyond what it saw
    return 1.02 * thickness + 0.1 * hologram.pitch / max_slope(hologram)


def _reach(hologram, settings, limit):
    """Directions along the radius of a lattice, one a pixel or more."""
    return directions_of(max_slope(hologram), limit, hologram.pitch, CONE[settings.quality])


def _rays(hologram, settings, thickness, warnings, planes=1):
    """Depth limit of a plane, one of several, with surfaces up to `thickness` away, and its rays a pixel."""
    slope, cone, limit = max_slope(hologram), CONE[settings.quality], _limit(hologram, thickness)
    if settings.estimator == "paper":
        return limit, settings.spp or PAPER_RAYS[settings.quality]
    if _reach(hologram, settings, limit) > MOST_REACH:
        raise InvalidInput(
            f"The recording plane is {limit * 1e3:.1f} mm from a surface, which would need over "
            f"{math.pi * MOST_REACH**2:.0f} rays a pixel: put it nearer to the scene (auto does), reduce the depth "
            f"range, or use the paper's estimator."
        )
    whole = Lattice.of(slope, limit, hologram.pitch, cone)
    most = settings.spp and max(1, settings.spp // planes)
    lattice = Lattice.of(slope, limit, hologram.pitch, cone, most)
    if lattice.rays < whole.rays:
        warnings.append(
            f"{lattice.rays} rays a pixel are fewer than the {whole.rays} that this depth range needs: the farthest "
            f"depths lose contrast; raise the rays a pixel or reduce the depth range."
        )
    return limit, lattice.rays
