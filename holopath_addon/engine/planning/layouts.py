"""Layouts of recording planes in the depths of a scene, and the rays that each plane needs."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InvalidInput
from ..plan import Decided, RecordingPlane
from ..slabs import EVERYWHERE, RAMP_FRACTION, Slab, bin_depths, overlapping_slabs, partitions
from ..tracing.kernel_table import Lattice, directions_of
from ..tracing.regions import IMAGE_REACH, TILE, limit_of

if TYPE_CHECKING:
    from ..settings import Settings
    from .survey import Survey

# Half-angle of the lattice over the recordable slope: how much of the kernel's tails is sampled
CONE = {"draft": 1.0, "preview": 1.0, "balanced": 1.15, "high": 1.3}
PAPER_RAYS = {"draft": 64, "preview": 256, "balanced": 1024, "high": 4096}  # a pixel
# Mean rays a pixel of drafts; with 25, views through the pupil's rim are up to 4 dB worse (docs/measurements.md).
DRAFT_RAYS = 100
MAX_REACH = 256  # pixels from the axis to a ray's origin; beyond, the kernel table would outgrow memory

MAX_SURFACE_PLANES, MAX_IMAGE_PLANES = (
    8,
    3,
)  # where mirrors are: of surfaces, and of the images in each of their slabs
MIN_IMAGE_FRACTION = 1e-4  # of the view: fewer images are not worth a plane
FIT_BINS = 48  # bins of depth to which slabs are fitted
VIEW_CELLS = 20  # cells of the view along its longer side, for which rays are estimated
CHAIN_RAY_COST = 2.5  # time of a ray that is followed over mirrors, for each branch, over that of a plain one
PROBE_RAYS_PER_TILE = 64

PLACES = 64  # places of a plane that are tried beside gloss and images
MAX_DEPTHS = 400  # depths of gloss, and of images, that are compared with each place
# Curved mirrors and lenses: depths of focus between a plane and their images, where more than so large a fraction of
# the view would be nearer, ...
BENT_DISTANCE, MAX_NEAR_FRACTION = 0.75, 0.1
MIN_BENT_SPREAD = 0.07  # ... and where 90 % of the images spread over more depths of focus than this
COMPACT_DEPTH = (
    1.5  # depths of focus; images over less have their plane at the mirror, others in their middle
)
REASONS = (
    "in the middle of what it records",
    "a depth of focus beside gloss, which looks different across the pupil",
    "beside the images in mirrors and glass, towards their outlines",
    "beside the images of curved mirrors and lenses, whose depths differ from direction to direction",
)
EDGE_LIGHT_FRACTION = 0.25  # of the light, in as many pixels along a shadow's edge as waves spread over there


class DepthRange(NamedTuple):
    """Depths from `low` to `high` that a plane records, its z, and the reason for it; meters from the SLM."""

    low: float
    high: float
    z: float
    reason: str


class Fit(NamedTuple):
    """Depth ranges for some number of planes, from the far end to the near one, and the rays a pixel that they need."""

    rays: float
    ranges: list[DepthRange]


@dataclass(frozen=True)
class PlannedPlane:
    """Plane of a layout; distances in meters from the SLM.

    Attributes
    ----------
    sees, slab, images
        See `RecordingPlane`.
    depths : DepthRange
    """

    sees: str
    slab: Slab
    images: Slab
    depths: DepthRange


@dataclass(frozen=True)
class Layout:
    """Recording planes for a scene, and their costs.

    Attributes
    ----------
    parts : tuple of PlannedPlane
        From the far end to the near one; images follow the surfaces that show them.
    rays : float
        Estimated mean rays a pixel; those over mirrors count by `CHAIN_RAY_COST`.
    shadows : float
        Estimated fraction of the light that straight rays put on the wrong side of shadows' edges.
    """

    parts: tuple[PlannedPlane, ...]
    rays: float
    shadows: float


class Scenery:
    """Depths, images, gloss and edges of a scene, for which recording planes are laid out.

    Parameters
    ----------
    survey : Survey
    """

    def __init__(self, survey: Survey) -> None:
        hologram, settings, probe, mapping = survey.hologram, survey.settings, survey.probe, survey.mapping
        self.ends = z_low, z_high = survey.z_low, survey.z_high
        places = replace(probe.places, z=np.clip(probe.places.z, z_low, z_high))
        gloss = mapping.z_far + mapping.beta * probe.gloss
        bent = np.clip(mapping.z_far + mapping.beta * probe.images, z_low, z_high)
        self.hologram, self.settings, self.places = hologram, settings, places
        self.edges = survey.pilot.edges(survey.chains.image_finder)
        self.branches = survey.chains.branches
        self.gloss, self.bent = (depths[:: len(depths) // MAX_DEPTHS + 1] for depths in (gloss, bent))
        # images that may be near a plane, of those that are compared
        self._max_near = MAX_NEAR_FRACTION * len(places.z) * len(self.bent) / max(len(bent), 1)
        self._slope, self._cone = hologram.widest_slope, CONE[settings.quality]
        self._exists = np.isfinite(places.z)
        self._kinds = {
            "all": self._exists,
            "surfaces": self._exists & ~places.chains,
            "images": self._exists & places.chains,
        }

    def layouts(self, max_planes: int) -> list[Layout]:
        """Layouts of up to `max_planes` planes, each with few rays; the first has one plane."""
        if not self._exists.any():
            (low, high), reason = self.ends, "in the middle of the volume"
            depths = DepthRange(low, high, 0.5 * (low + high), reason)
            return [Layout((PlannedPlane("all", EVERYWHERE, EVERYWHERE, depths),), 0.0, 0.0)]
        fits = self._fits(self._exists, "all", 1 if self.branches else max_planes)
        layouts = [self._layout(fit, [], "all") for fit in fits]
        return layouts + self._layouts_with_images(max_planes) if self.branches else layouts

    def _layouts_with_images(self, max_planes):
        """Layouts with planes of surfaces, and planes of the images that these show, added where they save most."""
        layouts, images_of = [], {}  # by slab, as layouts share many
        surfaces = np.isfinite(self.places.first)
        for fit in self._fits(surfaces, "surfaces", min(max_planes - 1, MAX_SURFACE_PLANES)):
            slabs = overlapping_slabs([(depths.low, depths.high) for depths in fit.ranges])
            for slab in slabs:
                if slab not in images_of:
                    images_of[slab] = self._image_fits(slab)
            fits = [images_of[slab] for slab in slabs]
            counts = [min(1, len(of_slab)) for of_slab in fits]
            while len(slabs) + sum(counts) <= max_planes:
                images = [
                    of_slab[n - 1] if n else Fit(0.0, []) for of_slab, n in zip(fits, counts, strict=True)
                ]
                layouts.append(self._layout(fit, images, "surfaces"))
                savings = [
                    of_slab[n - 1].rays - of_slab[n].rays if 0 < n < len(of_slab) else 0.0
                    for of_slab, n in zip(fits, counts, strict=True)
                ]
                if not max(savings) > 0:
                    break
                counts[int(np.argmax(savings))] += 1
        return layouts

    def _image_fits(self, slab):
        """Fits of images that the surfaces of a slab show; none where there are hardly any."""
        where = self._kinds["images"] & slab.holds(self.places.first)
        enough = where.sum() > MIN_IMAGE_FRACTION * where.size
        return self._fits(where, "images", MAX_IMAGE_PLANES) if enough else []

    def _layout(self, surfaces, images, sees):
        """`Layout` of the fit of surfaces, and of a fit of the images in each of their slabs, if any."""
        parts = []
        slabs = overlapping_slabs([(depths.low, depths.high) for depths in surfaces.ranges])
        for number, (slab, depths) in enumerate(zip(slabs, surfaces.ranges, strict=True)):
            parts.append(PlannedPlane(sees, slab, EVERYWHERE, depths))
            if images and images[number].ranges:
                ranges = images[number].ranges
                bounds = overlapping_slabs([(depths.low, depths.high) for depths in ranges])
                parts += [
                    PlannedPlane("images", slab, bound, each)
                    for bound, each in zip(bounds, ranges, strict=True)
                ]
        rays = sum(fit.rays for fit in (surfaces, *images))
        return Layout(tuple(parts), rays, self._shadows(parts))

    def planes(self, layout: Layout) -> Decided[tuple[RecordingPlane, ...]]:
        """Recording planes of a layout, with their rays."""
        return self._with_rays([self._fitted(part) for part in layout.parts])

    def plane(self, z: float) -> Decided[tuple[RecordingPlane, ...]]:
        """One recording plane for everything, z meters from the SLM, with its rays."""
        part = PlannedPlane("all", EVERYWHERE, EVERYWHERE, DepthRange(*self.ends, z, ""))
        return self._with_rays([(part, self.ends[0])])

    def _fitted(self, part):
        """The part with the depths that its plane records, and where surfaces beyond them begin."""
        first, (low, high, z, reason) = self.places.first, part.depths
        recorded = self.places.z[self._recorded(part)]
        if len(recorded):
            low, high = float(recorded.min()), float(recorded.max())
        # surfaces that are shared with other planes may lie beyond
        z += 0.5 * (low - part.depths.low + high - part.depths.high)
        beyond = first[(first > part.slab.far[1]) & part.slab.holds(first)]
        fitted = replace(part, depths=DepthRange(low, high, z, reason))
        return fitted, float(beyond.min(initial=part.depths.high))

    def _with_rays(self, parts):
        """Recording planes with their rays; the tiles that need most have fewer where a mean is requested.

        `parts` has a `PlannedPlane` and a `RecordingPlane.low` for each.
        """
        settings = self.settings
        limits = [self._limit(part) for part, _ in parts]
        full = [self._rays_of(limit) for limit in limits]
        tiles = [self._tiles(part, limit) for (part, _), limit in zip(parts, limits, strict=True)]
        needed = [fraction * rays for (fraction, _), rays in zip(tiles, full, strict=True)]

        def mean_rays(max_rays):
            return sum(np.minimum(of_tiles, max_rays).mean() for of_tiles in needed)

        max_rays = max(full)
        target = settings.spp or (DRAFT_RAYS if settings.quality == "draft" else math.inf)
        if settings.estimator == "lattice" and mean_rays(max_rays) > target:
            max_rays = max(1, bisect_right(range(1, max_rays), target, key=mean_rays))
        rays = [self._rays_of(limit, max_rays) for limit in limits]
        planes = []
        for (part, beyond), limit, count, of_tiles, (_, chains) in zip(
            parts, limits, rays, needed, tiles, strict=True
        ):
            means = (float((np.minimum(of_tiles, max_rays) * kind).mean()) for kind in (~chains, chains))
            planes.append(
                RecordingPlane(part.depths.z, part.sees, part.slab, part.images, beyond, limit, count, *means)
            )
        too_few = (
            f"{max(rays)} rays a pixel are fewer than the {max(full)} that this depth range needs: the farthest "
            f"depths show their middle views only; raise the rays a pixel or reduce the depth range."
        )
        return Decided(tuple(planes), warnings=(too_few,) if settings.spp and max(rays) < max(full) else ())

    def _recorded(self, part):
        """Mask of the places that a plane records."""
        recorded = self._kinds[part.sees] & part.slab.holds(self.places.first)
        return recorded & part.images.holds(self.places.z)

    def _limit(self, part):
        """Maximum distance of a recorded surface from the plane of a part, meters."""
        hologram, (low, high, z, _) = self.hologram, part.depths
        thickness = max(high - z, z - low)
        if self.branches and part.sees != "surfaces":
            thickness = max(thickness, IMAGE_REACH * hologram.pitch / (self._cone * self._slope))
        # rays between the probe's may meet surfaces a little farther away
        return 1.02 * thickness + 0.1 * hologram.pitch / self._slope

    def _rays_of(self, limit, max_rays=None):
        """Rays a pixel of a plane with surfaces up to `limit` away, at most `max_rays`."""
        hologram, settings = self.hologram, self.settings
        if settings.estimator == "paper":
            return settings.spp or PAPER_RAYS[settings.quality]
        if directions_of(self._slope, limit, hologram.pitch, self._cone) > MAX_REACH:
            raise InvalidInput(
                f"The recording plane is {limit * 1e3:.1f} mm from a surface, which would need over "
                f"{math.pi * MAX_REACH**2:.0f} rays a pixel. Put it nearer to the scene (auto does), reduce the depth "
                f"range, or use the paper's estimator."
            )
        return Lattice.of(self._slope, limit, hologram.pitch, self._cone, max_rays).rays

    def _tiles(self, part, limit):
        """Fraction of the plane's rays that each tile needs, and whether mirrors are in its view."""
        hologram, places, images = self.hologram, self.places, part.sees != "surfaces"
        if not by_region(self.settings):
            return np.ones(1), np.array([bool(self.branches) and images])
        tiles = hologram.width * hologram.height / TILE**2
        cell = TILE * max(1, math.ceil(math.sqrt(tiles * PROBE_RAYS_PER_TILE / len(places.z))))
        size = hologram.width, hologram.height
        sightings = places.sightings(part.depths.z, limit, size, cell, self._recorded(part), images)
        whole = directions_of(self._slope, limit, hologram.pitch, self._cone)
        steps = sightings.steps(whole)
        reach = directions_of(self._slope, limit_of(steps, limit), hologram.pitch, self._cone)
        return np.where(steps < 0, 0.0, (reach / whole) ** 2), sightings.chains

    def _fits(self, where, sees, max_planes):
        """`Fit` of 1, 2, ... up to `max_planes` planes for some places, each with the fewest rays."""
        places = self.places
        z = places.first if sees == "surfaces" else places.z
        first, last, bin_of = bin_depths(z[where], FIT_BINS)
        cell, cells = self._cells(z, where)
        bins, chained = len(first), np.zeros(cells, bool)
        held = np.zeros((bins, cells), bool)
        recorded = np.ones(len(cell), bool) if sees != "surfaces" else ~places.chains[where]
        held[bin_of[recorded], cell[recorded]] = True
        chained[cell[places.chains[where]]] = sees != "surfaces"
        work = np.where(chained, CHAIN_RAY_COST * max(self.branches, 1), 1.0)
        # in each cell the first bin from i on, and the last one up to j, that holds anything
        index = np.arange(bins)[:, None]
        after = np.minimum.accumulate(np.where(held, index, bins)[::-1], axis=0)[::-1]
        before = np.maximum.accumulate(np.where(held, index, -1), axis=0)
        lows, highs = np.append(first, np.inf)[after], last[before]
        mirror = float(np.median(places.first[where]))
        cost, place = np.full((bins, bins), np.inf), np.zeros((bins, bins))
        reason, pairs = np.zeros((bins, bins), int), np.triu_indices(bins)
        place[pairs], reason[pairs] = self._place(first[pairs[0]], last[pairs[1]], sees, mirror)
        for i in range(bins):
            there, thickness = after[i] <= index[i:], last[i:] - first[i]
            z = place[i, i:, None]
            limit = np.maximum(highs[i:] - z, z - lows[i]) + RAMP_FRACTION * thickness[:, None]
            rays = there * work * self._estimated_rays(np.where(there, limit, 0), chained)
            cost[i, i:] = rays.mean(1)

        def depths(i, j):
            return DepthRange(float(first[i]), float(last[j]), float(place[i, j]), REASONS[reason[i, j]])

        return [
            Fit(float(sum(cost[part] for part in parts)), [depths(*part) for part in parts])
            for parts in partitions(cost, max_planes)
        ]

    def _cells(self, z, where):
        """Cell of the view in which each place lies, and the number of cells."""
        size = self.hologram.width, self.hologram.height
        side = max(size) / VIEW_CELLS
        columns, rows = (math.ceil(n / side) for n in size)
        across, down = (
            np.clip(at[where] // side, 0, n - 1).astype(int)
            for at, n in zip(self.places.on_plane(z), (columns, rows), strict=True)
        )
        return down * columns + across, columns * rows

    def _estimated_rays(self, limit, chained):
        """Rays a pixel where the farthest surface is `limit` meters from the plane."""
        reach = directions_of(self._slope, limit, self.hologram.pitch, self._cone)
        return math.pi * np.where(chained, np.maximum(reach, IMAGE_REACH), reach) ** 2

    def _place(self, low, high, sees, mirror):
        """Place planes for slabs between some depths: z of each, and the index of its reason in `REASONS`.

        A mirror's outline cuts its images at the mirror's depth. Light that only a part of the pupil receives must not
        lie in the plane, see `_shadows`.
        """
        middle, focus = 0.5 * (low + high), self.hologram.depth_of_focus
        gloss, bent = _InSlabs(self.gloss, low, high), _InSlabs(self.bent, low, high)
        glossy = gloss.count > 0
        z = np.where(glossy, gloss.beside(focus, 0.01 * gloss.count), middle)
        reason = np.where(glossy, 1, 0)
        if sees == "surfaces":
            return z, reason
        compact = (reason == 0) & (sees == "images") & (high - low < COMPACT_DEPTH * focus)
        z, reason = np.where(compact, np.clip(mirror, low - focus, high + focus), z), reason + 2 * compact
        apart = (reason == 0) & (bent.spread > MIN_BENT_SPREAD * focus)
        apart &= bent.count_near(middle, BENT_DISTANCE * focus) > self._max_near
        return np.where(apart, bent.beside(BENT_DISTANCE * focus, self._max_near), z), reason + 3 * apart

    def _shadows(self, parts):
        """Fraction of the light lost, or on the wrong side of edges, where near things cover others of their slab.

        Rays cut the wave from behind an edge where they cross the recording plane, at a distance d from the edge. There
        it has spread over sqrt(wavelength d) (Fresnel). A surface in the plane itself that a fraction f of the pupil
        sees, as in the penumbra of the edge, shines with f^2 instead of f, as all directions add up in one pixel.
        Between slabs silhouettes cut the wave at the edge itself.
        """
        edges, hologram, spread = self.edges, self.hologram, 0.0
        penumbra = 2 * self._slope * abs(edges.front - edges.visible) / hologram.pitch
        for part in parts:
            within = part.slab.holds(edges.front) & part.slab.holds(edges.behind)
            if part.sees != "all":
                within &= edges.images == (part.sees == "images")
            width = np.sqrt(max(hologram.wavelengths) * abs(edges.front - part.depths.z)) / hologram.pitch
            beside = np.maximum(1 - abs(edges.visible - part.depths.z) / hologram.depth_of_focus, 0)
            spread += float((within * (EDGE_LIGHT_FRACTION * width + beside * penumbra / 6)).sum())
        return spread * edges.length / (hologram.width * hologram.height)


def by_region(settings: Settings) -> bool:
    """Whether each tile of a plane can have as many rays as it needs."""
    able = settings.radiance == "grain" and settings.estimator == "lattice"
    return able and bool(settings.fixed.get("regions", 1))


class _InSlabs:
    """Depths that lie in each of many slabs, from `low` to `high`."""

    def __init__(self, depths, low, high):
        self._depths, self._low, self._high = np.sort(depths), low, high
        self._begin = np.searchsorted(self._depths, low)
        self._end = np.searchsorted(self._depths, high, "right")
        self.count = self._end - self._begin

    @property
    def spread(self):
        """Spread of nine tenths of the depths in each slab."""
        if not len(self._depths):
            return np.zeros(self._low.shape)
        places, last = np.arange(len(self._depths)), np.maximum(self.count - 1, 0)
        ends = [np.interp(self._begin + part * last, places, self._depths) for part in (0.05, 0.95)]
        return np.where(self.count > 0, ends[1] - ends[0], 0.0)

    def count_near(self, place, distance):
        """Number of depths within a distance of a place, for each slab."""
        extra = (...,) + (None,) * (np.ndim(place) - self._low.ndim)
        begin, end = self._begin[extra], self._end[extra]
        first = np.clip(np.searchsorted(self._depths, place - distance, "right"), begin, end)
        return np.clip(np.searchsorted(self._depths, place + distance), begin, end) - first

    def beside(self, distance, max_count):
        """Place nearest to the slab's middle with at most `max_count` depths within a distance.

        A grain of gloss nearer than about a depth of focus has all directions in one pixel, which cannot record their
        differences. Images whose depths differ by as much as their distance from the plane leave too many rays for some
        grains and too few for others: up to a tenth of the light.
        """
        reach, middle = 1.05 * distance, 0.5 * (self._low + self._high)[:, None]
        places = np.linspace(self._low - reach, self._high + reach, PLACES, axis=-1)
        places = np.take_along_axis(places, np.argsort(abs(places - middle), axis=-1, kind="stable"), -1)
        fits = self.count_near(places, distance) <= np.reshape(max_count, (-1, 1))
        return np.take_along_axis(places, np.argmax(fits, axis=-1)[:, None], -1)[:, 0]
