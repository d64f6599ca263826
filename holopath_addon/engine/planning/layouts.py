"""Where rays start: recording planes in the scene's depths, and how many rays each needs."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..plan import Decided, RecordingPlane
from ..slabs import EVERYWHERE, RAMP, Slab, binned, overlapping, partitions
from ..tracing.kernel_table import Lattice, directions_of
from ..tracing.regions import IMAGE_REACH, TILE, limit_of

if TYPE_CHECKING:
    from ..settings import Settings
    from .survey import Survey

# of the recordable slope: how much of the kernel's tails
CONE = {"draft": 1.0, "preview": 1.0, "balanced": 1.15, "high": 1.3}
PAPER_RAYS = {"draft": 64, "preview": 256, "balanced": 1024, "high": 4096}
PLACES = 64  # beside gloss and images that are tried
MOST_DEPTHS = 400  # of gloss, and of images, that are looked at
MOST_REACH = 256  # pixels: beyond, the kernel table would outgrow memory
BESIDE = 0.75  # depths of focus that a plane is put beside images in curved mirrors and lenses...
BENT_NEAR = 0.1  # ... where they would fill more of the view nearer to it
COMPACT = 1.5  # depths of focus: images over more have their plane in their middle
BENT_SPREAD = 0.07  # ... and lie at depths that differ by more depths of focus, at 90 % of their places
LOOKS = 64  # probe rays in a tile
# A pixel, on average; with 25 views through the pupil's rim were up to 4 dB worse (docs/measurements.md).
DRAFT_RAYS = 100

MOST_SURFACES, MOST_IMAGES = 8, 3  # planes where mirrors are: of surfaces, and of what each slab's show
LEAST_SHOWN = 1e-4  # of the view: fewer images are not worth a plane
FIT_BINS = 48  # of depth, that slabs are fitted to
CELLS = 20  # of the view along its longer side, for which the rays are foretold
CHAIN_RAYS = 2.5  # rays that one over mirrors and clear surfaces takes as long as, for each branch
WHY = (
    "in the middle of what it sees",
    "a depth of focus beside gloss, which looks different across the pupil",
    "beside what is seen in mirrors and glass, towards their outlines",
    "beside the images of curved mirrors and lenses, whose depths differ from direction to direction",
)  # a plane is where it is
RIM = 0.25  # of the light in as many pixels along a shadow's edge as waves there spread over


@dataclass(frozen=True)
class PlannedPlane:
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
    parts : tuple of PlannedPlane
        From the far end to the near one; images follow the surfaces that show them.
    rays : float
        Estimated rays a pixel, a mean; one over mirrors counts as many as it takes as long as.
    shadows : float
        Estimated share of the light that straight rays put on the wrong side of shadows' edges.
    """

    parts: tuple[PlannedPlane, ...]
    rays: float
    shadows: float


class Scenery:
    """What was seen of a scene, as far as recording planes go."""

    def __init__(self, survey: Survey) -> None:
        hologram, settings, seen, z_far = survey.hologram, survey.settings, survey.seen, survey.mapping.z_far
        self.ends = z_low, z_high = survey.z_low, survey.z_high
        places = replace(seen.places, z=np.clip(seen.places.z, z_low, z_high))
        gloss = z_far + survey.mapping.beta * seen.gloss
        bent = np.clip(z_far + survey.mapping.beta * seen.images, z_low, z_high)
        self.hologram, self.settings, self.places = hologram, settings, places
        self.edges = survey.pilot.edges(survey.chains.optics)
        self.branches = survey.chains.branches
        self.gloss, self.bent = (depths[:: len(depths) // MOST_DEPTHS + 1] for depths in (gloss, bent))
        # images that do not matter: a share of the view, of which only some are looked at
        self._few = BENT_NEAR * len(places.z) * len(self.bent) / max(len(bent), 1)
        self._slope, self._cone = hologram.widest_slope, CONE[settings.quality]
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
            nothing = PlannedPlane("all", EVERYWHERE, EVERYWHERE, low, high, 0.5 * (low + high), reason)
            return [Layout((nothing,), 0.0, 0.0)]
        (rays, ranges), *more = self._fits(self._exists, "all", 1 if self.branches else most)
        found = [self._layout([(rays, ranges)], "all")]
        if not self.branches:
            return found + [self._layout([fit], "all") for fit in more]
        known: dict[Slab, list] = {}  # layouts share many
        for rays, ranges in self._fits(
            np.isfinite(self.places.first), "surfaces", min(most - 1, MOST_SURFACES)
        ):
            slabs = overlapping([(low, high) for low, high, *_ in ranges])
            for slab in slabs:
                if slab not in known:
                    where = self._kinds["images"] & slab.holds(self.places.first)
                    shown = where.sum() > LEAST_SHOWN * where.size
                    known[slab] = self._fits(where, "images", MOST_IMAGES) if shown else []
            fits = [known[slab] for slab in slabs]
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
            parts.append(PlannedPlane(sees, slab, EVERYWHERE, *surface))
            if images and images[number][1]:
                shown = images[number][1]
                bounds = overlapping([(low, high) for low, high, *_ in shown])
                parts += [
                    PlannedPlane("images", slab, bound, *each)
                    for bound, each in zip(bounds, shown, strict=True)
                ]
        return Layout(tuple(parts), sum(rays for rays, _ in fits), self._shadows(parts))

    def planes(self, layout: Layout) -> Decided[tuple[RecordingPlane, ...]]:
        """The planes of a layout."""
        return self._planes([self._bounds(part) for part in layout.parts])

    def plane(self, z: float) -> Decided[tuple[RecordingPlane, ...]]:
        """One plane for all."""
        part = PlannedPlane("all", EVERYWHERE, EVERYWHERE, *self.ends, z, "")
        return self._planes([(z, part, self.ends, self.ends[0])])

    def _bounds(self, part):
        """Where the plane of a part is put, the part, the depths that it sees, and where what lies beyond begins."""
        first, low, high = self.places.first, part.low, part.high
        held = self.places.z[self._held(part)]
        if len(held):
            low, high = float(held.min()), float(held.max())
        # what is shared with other planes may lie beyond
        z = part.z + 0.5 * (low - part.low + high - part.high)
        beyond = first[(first > part.slab.far[1]) & part.slab.holds(first)]
        return z, part, (low, high), float(beyond.min(initial=part.high))

    def _planes(self, bounds):
        """Planes with no more rays than are asked for on average: tiles that need the most have fewer then."""
        settings, pixel = self.settings, (self.hologram, self.settings)
        limits = [self._limit(z, part, ends) for z, part, ends, _ in bounds]
        rays = [_rays(*pixel, limit) for limit in limits]
        shares = [self._shares(z, limit, part) for (z, part, *_), limit in zip(bounds, limits, strict=True)]
        needed = [share * whole for (share, _), whole in zip(shares, rays, strict=True)]

        def on_average(most):
            return sum(np.minimum(of_tiles, most).mean() for of_tiles in needed)

        most = max(rays)
        enough = settings.spp or (DRAFT_RAYS if settings.quality == "draft" else math.inf)
        if settings.estimator == "lattice" and on_average(most) > enough:
            most = max(1, bisect_right(range(1, most), enough, key=on_average))
        few = [_rays(*pixel, limit, most) for limit in limits]
        too_few = (
            f"{max(few)} rays a pixel are fewer than the {max(rays)} that this depth range needs: the farthest "
            f"depths show their middle views only; raise the rays a pixel or reduce the depth range."
        )
        planes = []
        for (z, part, _, beyond), limit, count, of_tiles, (_, chains) in zip(
            bounds, limits, few, needed, shares, strict=True
        ):
            each = (float((np.minimum(of_tiles, most) * where).mean()) for where in (~chains, chains))
            planes.append(RecordingPlane(z, part.sees, part.slab, part.images, beyond, limit, count, *each))
        return Decided(tuple(planes), warnings=(too_few,) if settings.spp and max(few) < max(rays) else ())

    def _held(self, part):
        """The places of what a plane records."""
        held = self._kinds[part.sees] & part.slab.holds(self.places.first)
        return held & part.images.holds(self.places.z)

    def _limit(self, z, part, ends):
        """Depth limit of a plane at z for a `PlannedPlane` whose depths have some `ends`."""
        hologram, thickness = self.hologram, max(ends[1] - z, z - ends[0])
        if self.branches and part.sees != "surfaces":
            thickness = max(thickness, IMAGE_REACH * hologram.pitch / (self._cone * self._slope))
        # rays between the probe's may meet surfaces a little beyond what it saw
        return 1.02 * thickness + 0.1 * hologram.pitch / self._slope

    def _shares(self, z, limit, part):
        """Rays that tiles need, of those of whole planes, and where mirrors are in view."""
        hologram, places, images = self.hologram, self.places, part.sees != "surfaces"
        if not by_region(self.settings):
            return np.ones(1), np.array([bool(self.branches) and images])
        tiles = hologram.width * hologram.height / TILE**2
        cell = TILE * max(1, math.ceil(math.sqrt(tiles * LOOKS / len(places.z))))
        size = hologram.width, hologram.height
        seen = places.sightings(z, limit, size, cell, self._held(part), images)
        whole = directions_of(self._slope, limit, hologram.pitch, self._cone)
        steps = seen.steps(whole)
        reach = directions_of(self._slope, limit_of(steps, limit), hologram.pitch, self._cone)
        return np.where(steps < 0, 0.0, (reach / whole) ** 2), seen.chains

    def _fits(self, where, sees, most):
        """Rays, and lowest and highest depth, plane and reason of each, of the best 1, 2, ... slabs for some places."""
        places = self.places
        z = places.first if sees == "surfaces" else places.z
        first, last, number = binned(z[where], FIT_BINS)
        cell, cells = self._cells(z, where)
        bins, chained = len(first), np.zeros(cells, bool)
        held = np.zeros((bins, cells), bool)
        shown = np.ones(len(cell), bool) if sees != "surfaces" else ~places.chains[where]
        held[number[shown], cell[shown]] = True
        chained[cell[places.chains[where]]] = sees != "surfaces"
        work = np.where(chained, CHAIN_RAYS * max(self.branches, 1), 1.0)
        # the first bin from i on, and the last one up to j, in which a cell holds anything
        index = np.arange(bins)[:, None]
        after = np.minimum.accumulate(np.where(held, index, bins)[::-1], axis=0)[::-1]
        before = np.maximum.accumulate(np.where(held, index, -1), axis=0)
        lows, highs = np.append(first, np.inf)[after], last[before]
        mirror = float(np.median(places.first[where]))
        cost, place, why = np.full((bins, bins), np.inf), np.zeros((bins, bins)), np.zeros((bins, bins), int)
        pairs = np.triu_indices(bins)
        place[pairs], why[pairs] = self._put(first[pairs[0]], last[pairs[1]], sees, mirror)
        for i in range(bins):
            there, thickness = after[i] <= index[i:], last[i:] - first[i]
            z = place[i, i:, None]
            limit = np.maximum(highs[i:] - z, z - lows[i]) + RAMP * thickness[:, None]
            rays = there * work * self._rays(np.where(there, limit, 0), chained)
            cost[i, i:] = rays.mean(1)
        return [
            (
                float(sum(cost[part] for part in parts)),
                [(float(first[i]), float(last[j]), float(place[i, j]), WHY[why[i, j]]) for i, j in parts],
            )
            for parts in partitions(cost, most)
        ]

    def _cells(self, z, where):
        """Which cell of the view each place lies in, and how many there are."""
        size = self.hologram.width, self.hologram.height
        side = max(size) / CELLS
        columns, rows = (math.ceil(n / side) for n in size)
        across, down = (
            np.clip(at[where] // side, 0, n - 1).astype(int)
            for at, n in zip(self.places.on_plane(z), (columns, rows), strict=True)
        )
        return down * columns + across, columns * rows

    def _rays(self, limit, chained):
        """Rays a pixel where the farthest surface is `limit` from the plane."""
        reach = directions_of(self._slope, limit, self.hologram.pitch, self._cone)
        return math.pi * np.where(chained, np.maximum(reach, IMAGE_REACH), reach) ** 2

    def _put(self, low, high, sees, mirror):
        """Where planes are put for slabs between some depths, in the middle or beside gloss or images, and a number of
        `WHY`.

        A mirror's outline cuts what is seen in it, at the mirror's depth: what a part of the pupil sees must not lie in
        the plane, see `_shadows`.
        """
        middle, depth = 0.5 * (low + high), self.hologram.depth_of_focus
        gloss, bent = _Within(self.gloss, low, high), _Within(self.bent, low, high)
        beside = gloss.count > 0
        place = np.where(beside, gloss.beside(depth, 0.01 * gloss.count), middle)
        why = np.where(beside, 1, 0)
        if sees == "surfaces":
            return place, why
        compact = (why == 0) & (sees == "images") & (high - low < COMPACT * depth)
        place, why = np.where(compact, np.clip(mirror, low - depth, high + depth), place), why + 2 * compact
        apart = (why == 0) & (bent.spread > BENT_SPREAD * depth)
        apart &= bent.near(middle, BESIDE * depth) > self._few
        return np.where(apart, bent.beside(BESIDE * depth, self._few), place), why + 3 * apart

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
            beside = np.maximum(1 - abs(edges.seen - part.z) / hologram.depth_of_focus, 0)
            spread += float((within * (RIM * width + beside * penumbra / 6)).sum())
        return spread * edges.length / (hologram.width * hologram.height)


def by_region(settings: Settings) -> bool:
    """Whether the tiles of planes can be traced by what each needs."""
    able = settings.radiance == "grain" and settings.estimator == "lattice"
    return able and bool(settings.fixed.get("regions", 1))


class _Within:
    """Depths that lie in slabs between others, of each slab."""

    def __init__(self, depths, low, high):
        self._depths, self._low, self._high = np.sort(depths), low, high
        self._begin = np.searchsorted(self._depths, low)
        self._end = np.searchsorted(self._depths, high, "right")
        self.count = self._end - self._begin

    @property
    def spread(self):
        """Of nine tenths of them."""
        if not len(self._depths):
            return np.zeros(self._low.shape)
        places, last = np.arange(len(self._depths)), np.maximum(self.count - 1, 0)
        ends = [np.interp(self._begin + part * last, places, self._depths) for part in (0.05, 0.95)]
        return np.where(self.count > 0, ends[1] - ends[0], 0.0)

    def near(self, place, distance):
        """How many lie within a distance of a place of each slab."""
        extra = (...,) + (None,) * (np.ndim(place) - self._low.ndim)
        begin, end = self._begin[extra], self._end[extra]
        first = np.clip(np.searchsorted(self._depths, place - distance, "right"), begin, end)
        return np.clip(np.searchsorted(self._depths, place + distance), begin, end) - first

    def beside(self, distance, few):
        """The place nearest to the slab's middle that has no more than a few within a distance.

        Gloss nearer than about a depth of focus has all directions of a grain in one pixel, which cannot hold that they
        differ. Images whose depths differ by as much as their distance from the plane leave too many rays for some
        grains and too few for others: up to a tenth of the light.
        """
        reach, middle = 1.05 * distance, 0.5 * (self._low + self._high)[:, None]
        tried = np.linspace(self._low - reach, self._high + reach, PLACES, axis=-1)
        tried = np.take_along_axis(tried, np.argsort(abs(tried - middle), axis=-1, kind="stable"), -1)
        fits = self.near(tried, distance) <= np.reshape(few, (-1, 1))
        return np.take_along_axis(tried, np.argmax(fits, axis=-1)[:, None], -1)[:, 0]


def _rays(hologram, settings, limit, most=None):
    """Rays a pixel of a plane with surfaces up to `limit` away, no more than `most`."""
    slope, cone = hologram.widest_slope, CONE[settings.quality]
    if settings.estimator == "paper":
        return settings.spp or PAPER_RAYS[settings.quality]
    if directions_of(slope, limit, hologram.pitch, cone) > MOST_REACH:
        raise InvalidInput(
            f"The recording plane is {limit * 1e3:.1f} mm from a surface, which would need over "
            f"{math.pi * MOST_REACH**2:.0f} rays a pixel: put it nearer to the scene (auto does), reduce the depth "
            f"range, or use the paper's estimator."
        )
    return Lattice.of(slope, limit, hologram.pitch, cone, most).rays
