"""From a scene to the wave field at the SLM: the stages in order, with progress, times and cancellation."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from . import backend, baselines, despeckle, planner
from .clock import Clock
from .hologram import Settings
from .kernel_table import LEVELS, Lattice, directions_of, kernel_table
from .mapping import DepthMapping
from .phase_fields import phasors_of, pixel_transmission, recordable_fraction
from .propagation import carrier, field_of, padded_shape, spectrum, transfer_function
from .wavefield import WaveField

if TYPE_CHECKING:
    import mitsuba as mi

    from .bake_store import BakeStore
    from .baking import Bake
    from .camera import Camera
    from .chains import FirstHits, SpecularChains
    from .grains import RadianceMap
    from .hologram import Hologram
    from .planner import Plan
    from .progress import PartProgress, Progress
    from .radiance import PathsPerRay
    from .radiance_cache import RadianceCache
    from .recording_planes import RecordingPlane

SIDE = 4  # rays across a pixel that a silhouette's edge is found by
FEW_LEVELS = 64  # of a draft's or preview's kernel tables at least


def render(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings | None = None,
    plan: Plan | None = None,
    progress: Progress | None = None,
    store: BakeStore | None = None,
) -> WaveField:
    """Render the wave field of a scene.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings, optional
    plan : Plan, optional
        From `plan` for the same scene and settings; made when not given.
    progress : callable, optional
        ``progress(done, message)`` with done in 0..1, called several times a second; may raise
        `Cancelled`.
    store : BakeStore, optional
        Where baked light is kept for other views and other times.

    Returns
    -------
    WaveField

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    backend.activate()
    from .dispersion import tuned, wavelength_groups

    settings = (settings or Settings()).resolved()
    progress = progress or (lambda done, message: None)
    clock = Clock()
    progress(0.0, "Planning")
    if plan is None:
        with clock("plan"):
            plan = planner.plan(scene, camera, hologram, settings, store)
    if settings.method in baselines.BASELINES:
        job = baselines.Job(scene, camera, hologram, settings, plan.near, plan.z_low, plan.z_high)
        with clock(settings.method):
            field = baselines.field(job, progress)
        report = {"seconds": clock.seconds, "frames": settings.frames}
        return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)
    progress(0.02, "Phase fields")
    with clock("phase fields"):
        phasors = phasors_of(
            settings.phase_field, settings.frames, hologram.height, hologram.width, settings.seed
        )

    cache, baked, start = None, None, 0.04
    if plan.cached:
        from .baking import bake

        with clock("bake"):
            cache, baked = bake(
                scene,
                camera,
                hologram,
                plan,
                optics_of(scene, camera, plan),
                settings,
                store,
                lambda done, message: progress(0.04 + 0.46 * done, message),
            )
        start = 0.5
    groups = (
        (hologram.wavelengths,) if plan.traversals == 1 else wavelength_groups(scene, hologram.wavelengths)
    )
    fields, errors, passes, rays_traced = [], [], None, {}
    for number, group in enumerate(groups):
        part = replace(hologram, wavelengths=group)

        def at(done, message, number=number):
            progress(start + (1 - start) * (number + done) / len(groups), message)

        with tuned(scene, group):
            with clock("optics"):
                recording = Recording(scene, camera, part, settings, plan, clock, cache)
            fields.append(_field_at_slm(recording, phasors, at))
            errors.append(recording.error)
            passes = recording.passes
        for name, count in recording.rays_traced.items():
            rays_traced[name] = rays_traced.get(name, 0) + count
    field = fields[0] if len(fields) == 1 else np.concatenate(fields, axis=1)
    report = {
        "seconds": clock.seconds,
        "rays": rays_traced,
        "variant": backend.activate(),
        "frames": settings.frames,
        "radiance_passes": passes,
        "foretold": {
            "seconds": {
                "plan": plan.seconds,
                "measured": sum(clock.seconds.values()) - clock.seconds.get("plan", 0.0),
            },
            "stages": plan.stages,
            "field_error": {"plan": plan.error, "measured": _error_of(errors, plan, baked)},
        },
    }
    if baked is not None:
        report["bake"] = asdict(baked)
    return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)


def _error_of(errors, plan, baked):
    """Relative standard error of the field, of the radiance map's halves and of baked light; None where unknown."""
    if None in errors:
        return None
    texels = 0.0
    if baked is not None:
        texels = plan.error if baked.error is None else 0.5 * baked.error
    return float(np.hypot(max(errors), texels))


def _field_at_slm(recording, phasors, progress):
    """The wave field at the SLM of the wavelengths that a `Recording` is for."""
    hologram = recording.hologram
    steps = recording.settings.despeckle
    # shares of the time, roughly
    lit, traced, moved = (0.2, 0.4, 0.97) if steps else (0.5, 0.97, 0.97)
    progress(0.0, "Radiance")
    radiance = recording.radiance(lambda done: progress(lit * done, "Radiance"))
    field = _field_in_scene(
        recording, radiance, phasors, lambda done, what: progress(lit + (traced - lit) * done, what)
    )
    if steps:
        _despeckle(
            recording, radiance, field, lambda done, what: progress(traced + (moved - traced) * done, what)
        )
    with recording.clock("propagation"):
        for k, m, wave in _moved(field, hologram, -recording.plan.z_gathered):
            field[m, k] = wave
            step = (k * len(field) + m + 1) / (len(field) * len(hologram.wavelengths))
            progress(moved + (1 - moved) * step, "To the SLM")
    beyond = recording.beyond
    return field[..., beyond : beyond + hologram.height, beyond : beyond + hologram.width]


def _field_in_scene(recording, radiance, phasors, progress):
    """The wave field at `Plan.z_gathered`, of all that lies before and behind it.

    Its scale makes a plane of radiance L refocus to intensity L. Between planes the carrier is left out, for then the
    shares of a surface that two planes record add up, whatever the wavelength.
    """
    hologram, planes = recording.hologram, recording.plan.planes
    shape = len(phasors), len(hologram.wavelengths), *recording.canvas
    field, z, share = np.zeros(shape, np.complex64), planes[0].z, 1 / len(planes)

    def moved(waves, distance, number):
        for k, m, wave in _moved(waves, hologram, distance, carried=False):
            progress(share * number, "Between planes")
            yield m, k, wave

    def record(plane, number, out):
        def told(part):
            progress(share * (number + part), "Wave tracing")

        recording.record(plane, radiance, phasors, told, out)
        return out

    for number, plane in enumerate(planes):
        if plane.sees == "images":
            # straight rays tell which of them are seen
            images = record(plane, number, np.zeros_like(field))
            with recording.clock("propagation"):
                for m, k, wave in moved(images, z - plane.z, number + 1):
                    field[m, k] += wave
            continue
        if number:
            # what lies behind passes the surfaces of this slab as a wave, there where they begin
            with recording.clock("silhouettes"):
                clear = np.sqrt(1 - recording.silhouette(plane))
            with recording.clock("propagation"):
                for m, k, wave in moved(field, plane.low - z, number):
                    field[m, k] = wave * clear
                for m, k, wave in moved(field, plane.z - plane.low, number):
                    field[m, k] = wave
        z = plane.z
        record(plane, number, field)
    with recording.clock("phase fields"):
        recordable = recordable_fraction(phasors)
    if recording.settings.estimator == "paper":
        recordable *= pixel_transmission()
    field *= np.float32(1 / np.sqrt(recordable))
    return field


def _despeckle(recording, radiance, field, progress):
    """Take speckle out of the field on the plane nearest to the viewer, in place; the same paths, more frames."""
    hologram, plan, settings = recording.hologram, recording.plan, recording.settings
    low, high = (z - plan.z_gathered for z in (plan.z_low, plan.z_high))
    targets = [
        despeckle.targets(field.shape[-2:], hologram.pitch, wavelength, low, high, settings.seed)
        for wavelength in hologram.wavelengths
    ]
    for number in range(despeckle.BATCHES):
        many = _field_in_scene(
            recording,
            radiance,
            despeckle.batch_phasors(number),
            lambda done, what, number=number: progress(0.5 * (number + done) / despeckle.BATCHES, what),
        )
        with recording.clock("despeckle"):
            for k, target in enumerate(targets):
                target.add(many[:, k])
    with recording.clock("despeckle"):
        for k, target in enumerate(targets):
            field[:, k] = despeckle.despeckle(
                field[:, k],
                target,
                settings.despeckle,
                settings.seed,
                lambda done, k=k: progress(0.5 + 0.5 * (k + done) / len(targets), "Despeckling"),
            )


class Recording:
    """The parts of a planned render that need the scene.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
    plan : Plan
    clock : Clock
    cache : RadianceCache, optional
    """

    def __init__(
        self,
        scene: mi.Scene,
        camera: Camera,
        hologram: Hologram,
        settings: Settings,
        plan: Plan,
        clock: Clock,
        cache: RadianceCache | None = None,
    ) -> None:
        from .radiance import PathTracer

        self.scene, self.camera, self.hologram = scene, camera, hologram
        self.settings, self.plan, self.clock = settings, plan, clock
        self.mapping = DepthMapping.of(hologram, camera, plan.near)
        self.max_slope = max(hologram.max_slope(w) for w in hologram.wavelengths)
        walk = self.max_slope * np.ptp([plane.z for plane in plan.planes]) / hologram.pitch
        self.beyond = math.ceil(walk)  # pixels
        self.tracer = PathTracer(plan.max_depth, plan.radiance_limit, cache)
        self.rays_traced, self._parts, self._estimators = {}, {}, {}
        self.error: float | None = None
        self.passes: int | None = None
        self.optics = optics_of(scene, camera, plan)

    def radiance(self, progress: PartProgress) -> RadianceMap | PathsPerRay:
        """Where the radiance of rays comes from: a map of grains, or paths of their own."""
        from .filtering import REACH
        from .grains import GrainGrid, measure_grains
        from .radiance import PathsPerRay
        from .rays import Rays

        plan, hologram, settings = self.plan, self.hologram, self.settings
        if settings.radiance == "ray":
            return PathsPerRay(self.tracer, settings.paths)
        grid = GrainGrid(
            hologram.width,
            hologram.height,
            plan.margin,
            plan.slabs,
            plan.bins,
            plan.z_low,
            plan.z_high,
            plan.cone * self.max_slope,
            self.optics.branches,
        )
        middle = plan.z_middle
        ends = ((plane.z - middle, plane.depth_limit) for plane in plan.planes)
        limit = max(abs(offset) + reach for offset, reach in ends)
        rays = Rays(hologram, self.camera, self.mapping, middle, limit)
        with self.clock("radiance"):
            passes = self._passes()
            radiance = measure_grains(
                self.scene,
                rays,
                self.optics,
                self.tracer,
                grid,
                hologram.wavelengths[:1] if plan.grey else hologram.wavelengths,
                passes,
                settings.seed,
                progress,
                plan.wanted_error,
                plan.most_passes,
                plan.white,
                plan.planes if plan.regions else (),
                REACH[settings.quality] if settings.fixed.get("filter", 1) else 0,
                planner.asked_textures(settings),
            )
        self.rays_traced["radiance paths"] = grid.columns * grid.rows * radiance.passes
        self.rays_traced["texture rays"] = grid.columns * grid.rows * radiance.textures
        self.error, self.passes = radiance.error, radiance.passes
        return radiance

    def _passes(self):
        """Radiance paths a pixel: what is not cached decides, where there is a cache."""
        cache, settings = self.tracer.cache, self.settings
        if cache is None or "passes" in settings.fixed:
            return self.plan.passes
        from .probing import Pilot

        pilot = Pilot.of(self.scene, self.hologram, self.camera, self.mapping, settings)
        most, slab, firefly = (
            self.plan.max_depth,
            planner.slab_of(self.hologram),
            planner.firefly_of(settings),
        )
        light = pilot.light(lambda _: self.tracer, self.optics, most, most, slab, firefly)
        noise = planner.noise_left(settings, light)
        return min(planner.passes_for(settings, noise, planner.CACHED_PASSES), self.plan.passes)

    @property
    def canvas(self) -> tuple[int, int]:
        """Rows and columns of fields on recording planes, with a margin for waves that come back from beyond."""
        return self.hologram.height + 2 * self.beyond, self.hologram.width + 2 * self.beyond

    def record(
        self,
        plane: RecordingPlane,
        radiance: RadianceMap | PathsPerRay,
        phasors: np.ndarray,
        progress: PartProgress,
        out: np.ndarray,
    ) -> None:
        """Add the wave field on a recording plane, as `tracer.trace_field`."""
        from .tracer import trace_field

        with self.clock("kernel tables"):
            if plane not in self._parts:
                self._parts[plane] = self._parts_of(plane, radiance)
            parts = self._parts[plane]
        count = sum(len(part.pixels) * part.rays_per_pixel for part in parts)
        self.rays_traced["wave rays"] = self.rays_traced.get("wave rays", 0) + count
        with self.clock("wave tracing"):
            trace_field(
                self.scene,
                self.hologram,
                parts,
                radiance,
                phasors,
                self.settings.seed,
                progress,
                out,
                self.plan.chunk,
            )

    def _parts_of(self, plane, radiance):
        """The `Part` of each region of a plane."""
        from .chains import FirstHits, Images, OwnLight
        from .rays import Rays
        from .regions import Region, regions_of
        from .tracer import Part

        hologram, plan = self.hologram, self.plan
        behind = plane.slab.far[0] > self.mapping.z_far
        if plan.regions:
            reach = directions_of(self.max_slope, plane.depth_limit, hologram.pitch, plan.cone)
            look = radiance.looks[plan.planes.index(plane)]
            regions = regions_of(look, hologram.width, hologram.height, plane.depth_limit, reach)
        else:
            pixels = np.arange(hologram.width * hologram.height, dtype=np.uint32)
            regions = [Region(pixels, plane.depth_limit, True)]
        parts = []
        sky = self.camera.sees_sky and not behind
        first_hits, chained = FirstHits(plan.coherent, sky), self.optics
        if plane.sees == "images":
            chained = Images(self.optics)
        elif plan.chain and plane.sees == "surfaces":
            chained = OwnLight(self.optics, sky)
        for region in regions:
            rays = Rays(
                hologram,
                self.camera,
                self.mapping,
                plane.z,
                region.depth_limit,
                plane.slab,
                plane.images,
            )
            optics = chained if region.chains else first_hits
            parts.append(Part(region.pixels, rays, self._estimator(region.depth_limit, plane.rays), optics))
        return parts

    def _estimator(self, depth_limit, most):
        from .estimators import LatticeEstimator, RandomEstimator

        hologram = self.hologram
        if self.settings.estimator == "paper":
            return RandomEstimator(hologram, most, self.settings.seed)
        if depth_limit not in self._estimators:
            levels = FEW_LEVELS if self.settings.quality in ("draft", "preview") else LEVELS[0]
            lattice = Lattice.of(self.max_slope, depth_limit, hologram.pitch, self.plan.cone, most, levels)
            tables = [kernel_table(lattice, hologram.pitch, w) for w in hologram.wavelengths]
            self._estimators[depth_limit] = LatticeEstimator(hologram, lattice, tables)
        return self._estimators[depth_limit]

    def silhouette(self, plane: RecordingPlane) -> np.ndarray:
        """What share of each pixel of the canvas a slab's surfaces cover, beyond what farther planes see, from 0 to 1.

        The silhouette method (Matsushima, Appl. Opt. 44, 4607, 2005): exact for surfaces at one depth. At edges a pixel
        is as much covered as the slab's own field has light there: its rays meet a pixel of a surface at places that
        are spread as far as they walk from the plane, up to the whole pixel.
        """
        import drjit as dr
        import mitsuba as mi

        from .buffers import loaded
        from .rays import Rays, intersect

        hologram, (height, width) = self.hologram, self.canvas
        slab = replace(plane.slab, far=(plane.slab.far[1],) * 2)
        rays = Rays(hologram, self.camera, self.mapping, plane.z, plane.depth_limit, slab)
        across, beyond = dr.opaque(mi.UInt32, width), dr.opaque(mi.Float, self.beyond)
        walk = dr.opaque(mi.Float, 2 * self.max_slope / hologram.pitch)

        def met(column, row):
            ray, depth_rate = rays.world(*rays.place(column, row), mi.Float(0), mi.Float(0))
            hit = intersect(self.scene, ray, self.plan.coherent)
            return hit.is_valid(), rays.height_over_plane(hit.t, depth_rate, hit.is_valid())

        def covered(pixel):
            column, row = mi.Float(pixel % across) - beyond, mi.Float(pixel // across) - beyond
            return column, row, met(column, row)

        *_, (whole, _) = covered(dr.arange(mi.UInt32, width * height))
        cover = np.array(whole).reshape(height, width).astype(np.float32)
        edge = maximum_filter(cover, 3) != minimum_filter(cover, 3)
        if not edge.any():
            return cover
        pixels = loaded(mi.UInt32, np.flatnonzero(edge))
        column, row, (within, height) = covered(pixels)
        share = mi.Float(0)
        for j, i in np.ndindex(SIDE, SIDE):
            over, up = ((n + 0.5) / SIDE - 0.5 for n in (i, j))
            hit, dz = met(column + over, row + up)
            spread = dr.minimum(walk * dr.abs(dr.select(within, height, dz)), 1)
            share += dr.select(
                (within | hit) & met(column + over * spread, row + up * spread)[0], 1 / SIDE**2, 0
            )
        cover[edge] = np.asarray(share)
        return cover


def optics_of(scene: mi.Scene, camera: Camera, plan: Plan) -> FirstHits | SpecularChains:
    """How rays are followed to what they see, as planned: `FirstHits` or `SpecularChains`."""
    from .chains import FirstHits, SpecularChains

    if not plan.chain:
        return FirstHits(plan.coherent, camera.sees_sky)
    return SpecularChains(
        scene, plan.virtual_image, plan.chain, plan.splits, plan.coherent, camera.sees_sky, plan.pupil
    )


def baked_picture(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings,
    store: BakeStore | None = None,
    progress: Progress | None = None,
    anew: bool = False,
    most: int = 2048,
) -> tuple[np.ndarray, Bake]:
    """Bake what a camera sees, and show the texture.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
    store : BakeStore, optional
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.
    anew : bool
        See `bake`.
    most : int
        Pixels along a side of the picture.

    Returns
    -------
    picture : numpy.ndarray, float32, shape (y, x, 3)
        Linear; row 0 is the top.
    done : Bake

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    from .baking import bake

    backend.activate()
    settings = replace(settings, method="fast")
    planned = planner.plan(scene, camera, hologram, settings, store)
    optics = optics_of(scene, camera, planned)
    cache, done = bake(scene, camera, hologram, planned, optics, settings, store, progress, anew)
    return cache.picture(most), done


def _moved(field, hologram, distance, carried=True):
    """Wavelength number, frame number and the field moved by a distance, with its carrier or without, of a stack."""
    shape = field.shape[-2:]
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(shape, hologram.pitch, wavelength, distance)
        transfer = transfer_function(padded, hologram.pitch, wavelength, distance)
        if carried:
            transfer = transfer * carrier(wavelength, distance)
        for m in range(len(field)):
            yield k, m, field_of(spectrum(field[m, k], padded) * transfer, shape)
