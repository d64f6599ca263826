"""Recording planes of a render: their rays are traced as the plan says."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from ..light.path_tracer import PathsPerRay, PathTracer
from ..mapping import DepthMapping
from ..scene.buffers import loaded
from ..scene.rays import Rays, intersect
from ..scene.specular_chains import FirstHits, Images, OwnLight, image_finder_of
from ..scene.variants import threads
from .estimators import LatticeEstimator, RandomEstimator
from .grain_grid import GrainGrid
from .kernel_table import Lattice, directions_of, kernel_table
from .measurement import Measurement
from .regions import Region, regions_of
from .wave_kernel import Part, WaveKernel
from .wave_tracer import add_pixels, blocks_of, trace_blocks

if TYPE_CHECKING:
    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.radiance_cache import RadianceCache
    from ..plan import Plan, RecordingPlane
    from ..progress import Clock, PartProgress
    from ..waves.arrays import Array
    from .grains import RadianceMap

SIDE = 4  # rays along each side of a pixel at the edge of a silhouette


class Recording:
    """Waves on the recording planes of a plan, and all else of a render that needs the scene.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    plan : Plan
    clock : Clock
        Counts the seconds of each stage.
    cache : RadianceCache, optional
        Baked light.

    Attributes
    ----------
    beyond : int
        Margin of `canvas`, pixels.
    rays_traced : dict of str to int
    error, passes
        Relative error of the field that the radiances' noise leaves, and paths of a pixel; None before `radiance`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        camera: Camera,
        hologram: Hologram,
        plan: Plan,
        clock: Clock,
        *,
        cache: RadianceCache | None = None,
    ) -> None:
        self.scene, self.camera, self.hologram = scene, camera, hologram
        self.plan, self.clock = plan, clock
        self.mapping = DepthMapping.of(hologram, camera, plan.near)
        self.max_slope = hologram.widest_slope
        walk = self.max_slope * np.ptp([plane.z for plane in plan.planes]) / hologram.pitch
        self.beyond = math.ceil(walk)  # pixels
        self.tracer = PathTracer(plan.max_depth, plan.radiance_limit, cache)
        self.rays_traced = {}
        self._kept_regions, self._parts, self._estimators, self._silhouettes = {}, {}, {}, {}
        self.error: float | None = None
        self.passes: int | None = None
        self.image_finder = image_finder_of(scene, camera, plan)

    def radiance(self, progress: PartProgress) -> RadianceMap | PathsPerRay:
        """Measure the radiance of grains; or return the source of a path for each ray, if the settings say so.

        Parameters
        ----------
        progress : callable
            ``progress(done)``, may raise.
        """
        if self.plan.settings.radiance == "ray":
            return PathsPerRay(self.tracer, self.plan.settings.paths)
        with self.clock("radiance"):
            radiance = self._measurement().measure(progress)
        pixels = radiance.grid.columns * radiance.grid.rows
        self.rays_traced["radiance paths"] = pixels * radiance.passes
        self.rays_traced["texture rays"] = pixels * radiance.textures
        self.error, self.passes = radiance.error, radiance.passes
        return radiance

    def _measurement(self):
        """The `Measurement` of the map of grains."""
        plan, hologram = self.plan, self.hologram
        size, slope = (hologram.width, hologram.height), plan.cone * self.max_slope
        cells = plan.margin, plan.slabs, plan.bins, plan.z_low, plan.z_high
        grid = GrainGrid(*size, *cells, slope, self.image_finder.branches)
        middle = plan.z_middle
        ends = ((plane.z - middle, plane.depth_limit) for plane in plan.planes)
        limit = max(abs(offset) + reach for offset, reach in ends)
        rays = Rays(hologram, self.camera, self.mapping, middle, limit)
        wavelengths = hologram.wavelengths[:1] if plan.gray else hologram.wavelengths
        return Measurement(self.scene, rays, self.image_finder, self.tracer, grid, plan, wavelengths)

    @property
    def canvas(self) -> tuple[int, int]:
        """Rows and columns of fields on recording planes, with a margin for waves that leave the picture and return."""
        return self.hologram.height + 2 * self.beyond, self.hologram.width + 2 * self.beyond

    def record(
        self,
        plane: RecordingPlane,
        radiance: RadianceMap | PathsPerRay,
        phasors: np.ndarray,
        progress: PartProgress,
        out: Array,
        straight: float = 0.0,
    ) -> None:
        """Trace the wave field on a recording plane, and add it to an array.

        Parameters
        ----------
        plane : RecordingPlane
        radiance : RadianceMap or PathsPerRay
            Result of `radiance`.
        phasors : numpy.ndarray, complex64, shape (frames, rows, columns)
            One period of the phase maps.
        progress : callable
            ``progress(done)``, may raise.
        out : array, complex64, shape (frames, wavelengths, height, width)
            As large as `canvas`.
        straight : float
            Fraction of the light of even surfaces that these phasors send straight on, see `straight_share`.
        """
        regions, chunk = self._regions(plane, radiance), self.plan.chunk
        sizes = [(len(region.pixels), self._rays(plane, region)) for region in regions]
        blocks = blocks_of(sizes, len(phasors), len(self.hologram.wavelengths), chunk)
        with self.clock("kernel tables"):
            parts = [self._part(plane, radiance, number, straight) for number in range(len(regions))]
        count = sum(block.rays for block in blocks)
        self.rays_traced["wave rays"] = self.rays_traced.get("wave rays", 0) + count
        kernel = WaveKernel(self.scene, self.hologram, radiance, self.plan.settings.seed, like=out)
        with ThreadPoolExecutor(threads()) as executor, self.clock("wave tracing"):
            for block, pixels, values in trace_blocks(kernel, parts, blocks, phasors, chunk, progress):
                add_pixels(out[block.start : block.stop, ...], self.hologram, pixels, values, executor)

    def _regions(self, plane, radiance):
        """The `Region`s of a plane."""
        if plane not in self._kept_regions:
            hologram, plan = self.hologram, self.plan
            if plan.regions:
                reach = directions_of(self.max_slope, plane.depth_limit, hologram.pitch, plan.cone)
                sightings = radiance.sightings[plan.planes.index(plane)]
                size = hologram.width, hologram.height
                regions = regions_of(sightings, *size, plane.depth_limit, reach)
            else:
                pixels = np.arange(hologram.width * hologram.height, dtype=np.uint32)
                regions = [Region(pixels, plane.depth_limit, True)]
            self._kept_regions[plane] = regions
        return self._kept_regions[plane]

    def _part(self, plane, radiance, number, straight):
        """The `Part` of a region of a plane."""
        if (plane, number, straight) not in self._parts:
            region = self._regions(plane, radiance)[number]
            rays = Rays(
                self.hologram,
                self.camera,
                self.mapping,
                plane.z,
                region.depth_limit,
                plane.slab,
                plane.images,
            )
            image_finder = self._image_finder(plane, region)
            estimator = self._estimator(region.depth_limit, plane.rays, straight)
            in_phase = straight > 0 and image_finder.branches > 1
            part = Part(region.pixels, rays, estimator, image_finder, in_phase)
            self._parts[plane, number, straight] = part
        return self._parts[plane, number, straight]

    def _image_finder(self, plane, region):
        """Image finder for the rays of a region."""
        sky = self.camera.sees_sky and plane.slab.far[0] <= self.mapping.z_far
        if not region.chains:
            return FirstHits(self.plan.coherent, sky)
        if plane.sees == "images":
            return Images(self.image_finder)
        if self.plan.chain and plane.sees == "surfaces":
            return OwnLight(self.image_finder, sky)
        return self.image_finder

    def _rays(self, plane, region):
        """Rays of a pixel, branches included."""
        paper = self.plan.settings.estimator == "paper"
        rays = plane.rays if paper else self._lattice(region.depth_limit, plane.rays).rays
        return rays * self._image_finder(plane, region).branches

    def _lattice(self, depth_limit, max_rays):
        hologram, plan = self.hologram, self.plan
        return Lattice.of(self.max_slope, depth_limit, hologram.pitch, plan.cone, max_rays, plan.levels)

    def _estimator(self, depth_limit, max_rays, straight):
        hologram = self.hologram
        if self.plan.settings.estimator == "paper":
            return RandomEstimator(hologram, max_rays, self.plan.settings.seed)
        if (depth_limit, straight) not in self._estimators:
            lattice = self._lattice(depth_limit, max_rays)
            tables = [kernel_table(lattice, hologram.pitch, w, straight) for w in hologram.wavelengths]
            self._estimators[depth_limit, straight] = LatticeEstimator(hologram, lattice, tables)
        return self._estimators[depth_limit, straight]

    def silhouette(self, plane: RecordingPlane) -> np.ndarray:
        """Fraction of each pixel of the canvas that a slab's surfaces cover, beyond those that farther planes record.

        The silhouette method (Matsushima, Appl. Opt. 44, 4607, 2005): exact for surfaces at one depth. At edges a pixel
        is covered as much as the slab's own field has light there: its rays meet a pixel of a surface at places that
        are spread as far as they walk from the plane, up to the whole pixel. Computed once.

        Returns
        -------
        numpy.ndarray, float32, 0 to 1
        """
        if plane not in self._silhouettes:
            with self.clock("silhouettes"):
                self._silhouettes[plane] = self._cover(plane)
        return self._silhouettes[plane]

    def _cover(self, plane):
        hologram, (height, width) = self.hologram, self.canvas
        slab = replace(plane.slab, far=(plane.slab.far[1],) * 2)
        rays = Rays(hologram, self.camera, self.mapping, plane.z, plane.depth_limit, slab)
        across, beyond = dr.opaque(mi.UInt32, width), dr.opaque(mi.Float, self.beyond)
        walk = dr.opaque(mi.Float, 2 * self.max_slope / hologram.pitch)

        def intersected(column, row):
            ray, depth_rate = rays.world(*rays.place(column, row), mi.Float(0), mi.Float(0))
            hit = intersect(self.scene, ray, self.plan.coherent)
            return hit.is_valid(), rays.height_over_plane(hit.t, depth_rate, hit.is_valid())

        def covered(pixel):
            column, row = mi.Float(pixel % across) - beyond, mi.Float(pixel // across) - beyond
            return column, row, intersected(column, row)

        *_, (whole, _) = covered(dr.arange(mi.UInt32, width * height))
        cover = np.array(whole).reshape(height, width).astype(np.float32)
        edge = maximum_filter(cover, 3) != minimum_filter(cover, 3)
        if not edge.any():
            return cover
        pixels = loaded(mi.UInt32, np.flatnonzero(edge))
        column, row, (within, height) = covered(pixels)
        fraction = mi.Float(0)
        for j, i in np.ndindex(SIDE, SIDE):
            over, up = ((n + 0.5) / SIDE - 0.5 for n in (i, j))
            hit, dz = intersected(column + over, row + up)
            spread = dr.minimum(walk * dr.abs(dr.select(within, height, dz)), 1)
            inside = intersected(column + over * spread, row + up * spread)[0]
            fraction += dr.select((within | hit) & inside, 1 / SIDE**2, 0)
        cover[edge] = np.asarray(fraction)
        return cover
