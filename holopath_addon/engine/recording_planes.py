"""Where rays start: recording planes in the scene's depths, and how many rays each needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .errors import InvalidInput
from .kernel_table import Lattice, directions_of
from .regions import IMAGE_REACH, TILE, limit_of
from .slabs import EVERYWHERE, RAMP, Slab, binned, overlapping, partitions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .hologram import Hologram, Settings
    from .probing import Edges, Places

CONE = {
    "preview": 1.0,
    "balanced": 1.15,
    "full": 1.3,
}  # of the recordable slope: how much of the kernel's tails
PAPER_RAYS = {"preview": 256, "balanced": 1024, "full": 4096}
PLACES = 64  # beside gloss and images that are tried
MOST_DEPTHS = 400  # of gloss, and of images, that are looked at
MOST_REACH = 256  # pixels: beyond, the kernel table would outgrow memory
BESIDE = 0.75  # depths of focus that a plane is put beside images in curved mirrors and lenses...
BENT_NEAR = 0.1  # ... where they would fill more of the view nearer to it
COMPACT = 1.5  # depths of focus: images over more have their plane in their middle
BENT_SPREAD = 0.07  # ... and lie at depths that differ by more depths of focus, at 90 % of their places
LOOKS = 64  # probe rays in a tile

MOST_PLANES = 12  # that the plan chooses by itself,
MOST_SLABS, MOST_IMAGES = (
    8,
    3,
)  # and of these with mirrors: of surfaces, and of what the mirrors of each slab show
LEAST_SHOWN = 1e-4  # of the view: fewer images are not worth a plane
FIT_BINS = 48  # of depth, that slabs are fitted to
CELLS = 20  # of the view along its longer side, for which the rays are foretold
CHAIN_RAYS = 2.5  # rays that one over mirrors and clear surfaces takes as long as, for each branch
# Work beside rays, in rays a pixel: what all planes share, and for each plane, its tables and silhouette, and the two
# transforms of each frame and wavelength.
SHARED_WORK, PLANE_WORK, MOVE_WORK = 80.0, 3.0, 0.6
RIM = 0.25  # of the light in as many pixels along a shadow's edge as waves there spread over


@dataclass(frozen=True)
class RecordingPlane:
    """A plane that rays start from, and the slab of the volume that it records. Distances from the SLM in metres.

    Attributes
    ----------
    z : float
        Of the plane.
    sees : {'all', 'surfaces', 'images'}
        What it records: everything, what rays meet straight on, or what they meet over mirrors and clear surfaces.
    slab : Slab
        Depths of the first surfaces that its rays meet.
    images : Slab
        Depths of what it records of what these show.
    low : float
        Where what lies wholly beyond the farther planes' slabs begins, and with it the silhouette.
    depth_limit : float
        Largest distance of a surface from the plane.
    rays : int
        A pixel, where it needs most.
    plain, chained : float
        Estimated rays a pixel that no mirror or clear surface is in view of, and others, means over all pixels.
    """

    z: float
    sees: str
    slab: Slab
    images: Slab
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


@dataclass(frozen=True)
class Part:
    """What one plane records, `sees`, `slab` and `images` as of `RecordingPlane`: depths from `low` to `high`; where it
    is put, z, and why; metres from the SLM.
    """

    sees: str
    slab: Slab
    images: Slab
    low: float
    high: float
    z: float
    reason: str


@dataclass(frozen=True)
class Layout:
    """Recording planes for a scene, and what they cost.

    Attributes
    ----------
    parts : tuple of Part
        From the far end to the near one; images follow the surfaces that show them.
    rays : float
        Estimated rays a pixel, a mean; one over mirrors counts as many as it takes as long as.
    shadows : float
        Estimated share of the light that straight rays put on the wrong side of shadows' edges.
    """

    parts: tuple[Part, ...]
    rays: float
    shadows: float


class Scenery:
    """What a probe saw of a scene, as far as recording planes go.

    Parameters
    ----------
    hologram : Hologram
    settings : Settings
    places : Places
        Depths clipped to the volume in view,
    ends : (float, float)
        which lies between these.
    edges : Edges
    gloss, bent : numpy.ndarray
        Depths of glossy surfaces, and of images in curved mirrors and lenses.
    branches : int
        Of rays over mirrors and clear surfaces; 0 where none are followed.
    """

    def __init__(
        self,
        hologram: Hologram,
        settings: Settings,
        places: Places,
        ends: tuple[float, float],
        edges: Edges,
        gloss: np.ndarray,
        bent: np.ndarray,
        branches: int,
    ) -> None:
        self.hologram, self.settings, self.places, self.edges = hologram, settings, places, edges
        self.branches, self.ends = branches, ends
        self.gloss, self.bent = (depths[:: len(depths) // MOST_DEPTHS + 1] for depths in (gloss, bent))
        # images that do not matter: a share of the view, of which only some are looked at
        self._few = BENT_NEAR * len(places.z) * len(self.bent) / max(len(bent), 1)
        self._slope, self._cone = max_slope(hologram), CONE[settings.quality]
        self._exists = np.isfinite(places.z)
        self._kinds = {
            "all": self._exists,
            "surfaces": self._exists & ~places.chains,
            "images": self._exists & places.chains,
        }

    def layouts(self, most: int) -> list[Layout]:
        """Layouts of `most` planes at most, each of which needs few rays; the first has one plane."""
        if not self._exists.any():
            (low, high), reason = self.ends, "in the middle of the volume"
            nothing = Part("all", EVERYWHERE, EVERYWHERE, low, high, 0.5 * (low + high), reason)
            return [Layout((nothing,), 0.0, 0.0)]
        (rays, ranges), *more = self._fits(self._exists, "all", 1 if self.branches else most)
        found = [self._layout([(rays, ranges)], "all")]
        if not self.branches:
            return found + [self._layout([fit], "all") for fit in more]
        for rays, ranges in self._fits(np.isfinite(self.places.first), "surfaces", min(most - 1, MOST_SLABS)):
            slabs = overlapping([(low, high) for low, high, *_ in ranges])
            shown = [self._kinds["images"] & slab.holds(self.places.first) for slab in slabs]
            fits = [
                self._fits(where, "images", MOST_IMAGES) if where.sum() > LEAST_SHOWN * where.size else []
                for where in shown
            ]
            counts = [min(1, len(fit)) for fit in fits]
            while len(slabs) + sum(counts) <= most:
                taken = [
                    fit[count - 1] if count else (0.0, []) for fit, count in zip(fits, counts, strict=True)
                ]
                found.append(self._layout([(rays, ranges), *taken], "surfaces"))
                gains = [
                    fit[count - 1][0] - fit[count][0] if 0 < count < len(fit) else 0.0
                    for fit, count in zip(fits, counts, strict=True)
                ]
                if not max(gains) > 0:
                    break
                counts[int(np.argmax(gains))] += 1
        return found

    def _layout(self, fits, sees):
        """A `Layout` of fits: of surfaces, and of what each of their slabs shows."""
        (_, ranges), *images = fits
        slabs, parts = overlapping([(low, high) for low, high, *_ in ranges]), []
        for number, (slab, surface) in enumerate(zip(slabs, ranges, strict=True)):
            parts.append(Part(sees, slab, EVERYWHERE, *surface))
            if images and images[number][1]:
                shown = images[number][1]
                bounds = overlapping([(low, high) for low, high, *_ in shown])
                parts += [
                    Part("images", slab, bound, *each) for bound, each in zip(bounds, shown, strict=True)
                ]
        return Layout(tuple(parts), sum(rays for rays, _ in fits), self._shadows(parts))

    def planes(self, layout: Layout, warnings: list[str]) -> tuple[RecordingPlane, ...]:
        """The planes of a layout."""
        planes, places = [], self.places
        for part in layout.parts:
            first, low, high = places.first, part.low, part.high
            held = places.z[self._held(part)]
            if len(held):
                low, high = float(held.min()), float(held.max())
            # what is shared with other planes may lie beyond
            z = part.z + 0.5 * (low - part.low + high - part.high)
            beyond = first[(first > part.slab.far[1]) & part.slab.holds(first)]
            planes.append(
                self.plane(
                    z, part, (low, high), float(beyond.min(initial=part.high)), len(layout.parts), warnings
                )
            )
        return tuple(planes)

    def mean_rays(self, planes: Sequence[RecordingPlane], *kinds: str) -> float:
        """Rays a pixel, a mean, of all planes: 'plain' ones, or 'chained', or both; branches of rays count."""
        branches = {"plain": 1, "chained": max(self.branches, 1)}
        return sum(
            getattr(plane, kind) * (1 if plane.sees == "surfaces" else branches[kind])
            for plane in planes
            for kind in kinds or branches
        )

    def _held(self, part):
        """The places of what a plane records."""
        held = self._kinds[part.sees] & part.slab.holds(self.places.first)
        return held & part.images.holds(self.places.z)

    def plane(
        self, z: float, part: Part, ends: tuple[float, float], beyond: float, planes: int, warnings: list[str]
    ) -> RecordingPlane:
        """A plane at z, one of several, for a `Part` whose depths have some `ends`."""
        hologram, thickness = self.hologram, max(ends[1] - z, z - ends[0])
        images = bool(self.branches) and part.sees != "surfaces"
        if images:
            thickness = max(thickness, IMAGE_REACH * hologram.pitch / (self._cone * self._slope))
        limit, rays = _rays(hologram, self.settings, thickness, warnings, planes)
        plain, chained = float(not images), float(images)
        if by_region(self.settings):
            plain, chained = self._shares(z, limit, part)
        return RecordingPlane(
            z, part.sees, part.slab, part.images, beyond, limit, rays, plain * rays, chained * rays
        )

    def _shares(self, z, limit, part):
        """Rays that the tiles need, plain ones and others with mirrors in view, of those of whole planes."""
        hologram, places = self.hologram, self.places
        tiles = hologram.width * hologram.height / TILE**2
        cell = TILE * max(1, math.ceil(math.sqrt(tiles * LOOKS / len(places.z))))
        size, images = (hologram.width, hologram.height), part.sees != "surfaces"
        look = places.look(z, limit, *size, cell, self._held(part), images)
        whole = directions_of(self._slope, limit, hologram.pitch, self._cone)
        steps = look.steps(whole)
        reach = directions_of(self._slope, limit_of(steps, limit), hologram.pitch, self._cone)
        share = np.where(steps < 0, 0.0, (reach / whole) ** 2)
        return float((share * ~look.chains).mean()), float((share * look.chains).mean())

    def _fits(self, where, sees, most):
        """Rays, and lowest and highest depth, plane and reason of each, of the best 1, 2, ... slabs for some places."""
        places = self.places
        z = (places.first if sees == "surfaces" else places.z)[where]
        first, last, number = binned(z, FIT_BINS)
        cell, cells = self._cells(z, where)
        bins, chained = len(first), np.zeros(cells, bool)
        held = np.zeros((bins, cells), bool)
        shown = np.ones(len(z), bool) if sees != "surfaces" else ~places.chains[where]
        held[number[shown], cell[shown]] = True
        chained[cell[places.chains[where]]] = sees != "surfaces"
        work = np.where(chained, CHAIN_RAYS * max(self.branches, 1), 1.0)
        # the first bin from i on, and the last one up to j, in which a cell holds anything
        index = np.arange(bins)[:, None]
        after = np.minimum.accumulate(np.where(held, index, bins)[::-1], axis=0)[::-1]
        before = np.maximum.accumulate(np.where(held, index, -1), axis=0)
        lows, highs = np.append(first, np.inf)[after], last[before]
        mirror = float(np.median(places.first[where]))
        cost, place, why = np.full((bins, bins), np.inf), np.zeros((bins, bins)), {}
        for i in range(bins):
            there, thickness = after[i] <= index[i:], last[i:] - first[i]
            z = first[i] + 0.5 * thickness
            for k, high in enumerate(last[i:]):
                beside = self._beside(first[i], high, sees, mirror)
                if beside is not None:
                    z[k], why[i, i + k] = beside
            limit = np.maximum(highs[i:] - z[:, None], z[:, None] - lows[i]) + RAMP * thickness[:, None]
            rays = there * work * self._rays(np.where(there, limit, 0), chained)
            cost[i, i:], place[i, i:] = rays.mean(1), z
        usual = "in the middle of what it sees"
        return [
            (
                float(sum(cost[part] for part in parts)),
                [
                    (float(first[i]), float(last[j]), float(place[i, j]), why.get((i, j), usual))
                    for i, j in parts
                ],
            )
            for parts in partitions(cost, most)
        ]

    def _cells(self, z, where):
        """Which cell of the view each place lies in, and how many there are."""
        places, size = self.places, (self.hologram.width, self.hologram.height)
        side, walk = max(size) / CELLS, (z - places.z_far) / places.pitch
        columns, rows = (math.ceil(n / side) for n in size)
        across = places.column[where] + places.slope_x[where] * walk
        down = places.row[where] - places.slope_y[where] * walk
        across, down = (
            np.clip((at + 0.5) // side, 0, n - 1).astype(int) for at, n in ((across, columns), (down, rows))
        )
        return down * columns + across, columns * rows

    def _rays(self, limit, chained):
        """Rays a pixel where the farthest surface is `limit` from the plane."""
        reach = directions_of(self._slope, limit, self.hologram.pitch, self._cone)
        return math.pi * np.where(chained, np.maximum(reach, IMAGE_REACH), reach) ** 2

    def _beside(self, low, high, sees, mirror):
        """Where a plane is put beside gloss or images in a slab, and why; None where the middle serves.

        A mirror's outline cuts what is seen in it, at the mirror's depth: what a part of the pupil sees must not lie in
        the plane, see `_shadows`.
        """
        middle, depth = 0.5 * (low + high), depth_of_focus(self.hologram)
        gloss = self.gloss[(self.gloss >= low) & (self.gloss <= high)]
        if len(gloss):
            reason = "a depth of focus beside gloss, which looks different across the pupil"
            return _beside(low, high, gloss, depth, 0.01 * len(gloss)), reason
        if sees == "surfaces":
            return None
        if sees == "images" and high - low < COMPACT * depth:
            reason = "beside what is seen in mirrors and glass, towards their outlines"
            return float(np.clip(mirror, low - depth, high + depth)), reason
        bent = self.bent[(self.bent >= low) & (self.bent <= high)]
        spread = np.ptp(np.quantile(bent, (0.05, 0.95))) if len(bent) else 0.0
        if spread <= BENT_SPREAD * depth or (abs(bent - middle) < BESIDE * depth).sum() <= self._few:
            return None
        reason = (
            "beside the images of curved mirrors and lenses, whose depths differ from direction to direction"
        )
        return _beside(low, high, bent, BESIDE * depth, self._few), reason

    def _shadows(self, parts):
        """Share of the light that is lost or on the wrong side where near things stand before others of their slab.

        Rays cut the wave from behind an edge where they cross the recording plane, at a distance d from the edge. By
        then it has spread over sqrt(wavelength d) (Fresnel). And what is seen by a part f of the pupil, as it is over
        the edge's penumbra, shines with f^2 instead of f where it lies in the plane itself: there a grain is one pixel,
        which all directions add up in. Between slabs silhouettes cut the wave where the edge is.
        """
        edges, hologram, spread = self.edges, self.hologram, 0.0
        penumbra = 2 * self._slope * abs(edges.front - edges.seen) / hologram.pitch
        for part in parts:
            within = part.slab.holds(edges.front) & part.slab.holds(edges.behind)
            if part.sees != "all":
                within &= edges.images == (part.sees == "images")
            width = np.sqrt(max(hologram.wavelengths) * abs(edges.front - part.z)) / hologram.pitch
            beside = np.maximum(1 - abs(edges.seen - part.z) / depth_of_focus(hologram), 0)
            spread += float((within * (RIM * width + beside * penumbra / 6)).sum())
        return spread * edges.length / (hologram.width * hologram.height)


def gathered_on(planes: Sequence[RecordingPlane]) -> RecordingPlane:
    """The plane that the waves of all planes are brought together on: the nearest to the viewer of surfaces."""
    return [plane for plane in planes if plane.sees != "images"][-1]


def middle_of(planes: Sequence[RecordingPlane]) -> float:
    """Middle of the planes, from which the radiance map is seen."""
    places = [plane.z for plane in planes]
    return 0.5 * (min(places) + max(places))


def by_region(settings: Settings) -> bool:
    """Whether the tiles of planes can be traced by what each needs."""
    able = settings.radiance == "grain" and settings.estimator == "lattice"
    return able and bool(settings.fixed.get("regions", 1))


def chosen(layouts: list[Layout], noise: float, moves: int) -> Layout:
    """The layout with the least work for what it is worth.

    Noise falls as the work grows, so that work times the squared error, of speckle and of shadows, is what an error
    costs that all could reach.

    Parameters
    ----------
    layouts : list of Layout
        To choose from.
    noise : float
        Variance of the frames' speckle relative to the squared mean.
    moves : int
        Frames times wavelengths.
    """

    def worth(layout):
        work = SHARED_WORK + layout.rays + len(layout.parts) * (PLANE_WORK + MOVE_WORK * moves)
        return work * (noise + layout.shadows)

    return min(layouts, key=worth)


def _beside(low, high, depths, distance, few):
    """The place nearest to the middle that has no more than a few of some depths within a distance.

    Gloss nearer than about a depth of focus has all directions of a grain in one pixel, which cannot hold that they
    differ. Images whose depths differ by as much as their distance from the plane leave too many rays for some grains
    and too few for others: up to a tenth of the light.
    """
    middle = 0.5 * (low + high)
    candidates = np.linspace(low - 1.05 * distance, high + 1.05 * distance, PLACES)
    candidates = candidates[np.argsort(abs(candidates - middle), kind="stable")]
    near = (abs(depths - candidates[:, None]) < distance).sum(1)
    return float(candidates[np.argmax(near <= few)])


def _limit(hologram, thickness):
    """Depth limit for surfaces up to `thickness` from the plane."""
    # rays between the probe's may meet surfaces a little beyond what it saw
    return 1.02 * thickness + 0.1 * hologram.pitch / max_slope(hologram)


def _rays(hologram, settings, thickness, warnings, planes):
    """Depth limit of a plane, one of several, with surfaces up to `thickness` away, and its rays a pixel."""
    slope, cone, limit = max_slope(hologram), CONE[settings.quality], _limit(hologram, thickness)
    if settings.estimator == "paper":
        return limit, settings.spp or PAPER_RAYS[settings.quality]
    if directions_of(slope, limit, hologram.pitch, cone) > MOST_REACH:
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
