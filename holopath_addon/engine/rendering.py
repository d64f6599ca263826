"""From a scene to the wave field at the SLM: the stages in order, with progress, times and cancellation."""

import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from . import backend, planner
from .hologram import Settings
from .kernel_table import Lattice, kernel_table
from .mapping import DepthMapping
from .phase_fields import pixel_transmission, random_phasors, recordable_fraction
from .propagation import carrier, field_of, padded_shape, spectrum, transfer_function
from .wavefield import WaveField


def render(scene, camera, hologram, settings=None, plan=None, progress=None):
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
    with clock("plan"):
        plan = plan or planner.plan(scene, camera, hologram, settings)
    progress(0.02, "Random phases")
    with clock("phase fields"):
        phasors = random_phasors(settings.frames, hologram.height, hologram.width, settings.seed)
        recordable = recordable_fraction(phasors)
        if settings.estimator == "paper":
            recordable *= pixel_transmission()

    groups = wavelength_groups(scene, hologram.wavelengths)
    fields, rays_traced = [], {}
    for number, group in enumerate(groups):
        part = replace(hologram, wavelengths=group)

        def at(done, message, number=number):
            progress(0.04 + 0.96 * (number + done) / len(groups), message)

        with tuned(scene, group):
            recording = Recording(scene, camera, part, settings, plan, clock)
            fields.append(_field_at_slm(recording, phasors, recordable, at))
        for name, count in recording.rays_traced.items():
            rays_traced[name] = rays_traced.get(name, 0) + count
    field = fields[0] if len(fields) == 1 else np.concatenate(fields, axis=1)
    report = {
        "seconds": clock.seconds,
        "rays": rays_traced,
        "variant": backend.activate(),
        "frames": settings.frames,
    }
    return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)


def _field_at_slm(recording, phasors, recordable, progress):
    """The wave field at the SLM of the wavelengths that a `Recording` is for."""
    hologram, planes = recording.hologram, recording.plan.planes
    progress(0.0, "Radiance")
    radiance = recording.radiance(lambda done: progress(0.4 * done, "Radiance"))
    field, share = None, 0.5 / len(planes)
    for number, plane in enumerate(planes):
        recorded = recording.field(
            plane,
            radiance,
            phasors,
            lambda part, done=0.4 + number * share: progress(done + share * part, "Wave tracing"),
        )
        if field is None:
            field = recorded
            continue
        # what lies behind passes the surfaces of this slab as a wave, there where they begin
        clear = 1 - recording.silhouette(plane)
        with recording.clock("propagation"):
            for k, m, wave in _moved(field, hologram, plane.low - planes[number - 1].z):
                field[m, k] = wave * clear
            for k, m, wave in _moved(field, hologram, plane.z - plane.low):
                field[m, k] = wave + recorded[m, k]
                progress(0.4 + (number + 1) * share, "Between planes")
    with recording.clock("propagation"):
        # the scale makes a plane of radiance L refocus to intensity L
        scale = np.float32(1 / np.sqrt(recordable))
        for k, m, wave in _moved(field, hologram, -planes[-1].z):
            field[m, k] = scale * wave
            step = (k * len(field) + m + 1) / (len(field) * len(hologram.wavelengths))
            progress(0.9 + 0.1 * step, "To the SLM")
    return field


class Clock:
    """Seconds spent in each stage, summed over its visits."""

    def __init__(self):
        self.seconds = {}

    @contextmanager
    def __call__(self, stage):
        """Count what is done inside towards a stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


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
    """

    def __init__(self, scene, camera, hologram, settings, plan, clock):
        from .chains import FirstHits, SpecularChains
        from .radiance import PathTracer

        self.scene, self.camera, self.hologram = scene, camera, hologram
        self.settings, self.plan, self.clock = settings, plan, clock
        self.mapping = DepthMapping.of(hologram, camera, plan.near)
        self.max_slope = max(hologram.max_slope(w) for w in hologram.wavelengths)
        self.tracer = PathTracer(settings.max_depth, plan.radiance_limit)
        self.rays_traced = {}
        if plan.chain:
            self.optics = SpecularChains(scene, plan.virtual_image, plan.chain, plan.splits, plan.coherent)
        else:
            self.optics = FirstHits(plan.coherent)

    def _rays(self, plane):
        from .rays import Rays

        span = (plane.far, plane.near)
        return Rays(self.hologram, self.camera, self.mapping, plane.z, plane.depth_limit, span)

    def radiance(self, progress):
        """Where the radiance of rays comes from: a map of grains, or paths of their own."""
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
        middle = 0.5 * (plan.planes[0].z + plan.planes[-1].z)
        ends = ((plane.z - middle, plane.depth_limit) for plane in plan.planes)
        limit = max(abs(offset) + reach for offset, reach in ends)
        rays = Rays(hologram, self.camera, self.mapping, middle, limit)
        self.rays_traced["radiance paths"] = grid.columns * grid.rows * plan.passes
        with self.clock("radiance"):
            return measure_grains(
                self.scene,
                rays,
                self.optics,
                self.tracer,
                grid,
                hologram.wavelengths,
                plan.passes,
                settings.seed,
                progress,
            )

    def field(self, plane, radiance, phasors, progress):
        """The wave field on a recording plane, as `tracer.trace_field`."""
        from .chains import FirstHits
        from .estimators import LatticeEstimator, RandomEstimator
        from .tracer import trace_field

        hologram, optics = self.hologram, self.optics
        if plane.far > self.mapping.z_far:
            optics = FirstHits(self.plan.coherent, sky=False)
        with self.clock("kernel tables"):
            if self.settings.estimator == "lattice":
                lattice = Lattice.of(
                    self.max_slope, plane.depth_limit, hologram.pitch, self.plan.cone, plane.rays
                )
                tables = [kernel_table(lattice, hologram.pitch, w) for w in hologram.wavelengths]
                estimator = LatticeEstimator(hologram, lattice, tables)
            else:
                estimator = RandomEstimator(hologram, plane.rays, self.settings.seed)
        count = hologram.width * hologram.height * plane.rays * optics.branches
        self.rays_traced["wave rays"] = self.rays_traced.get("wave rays", 0) + count
        with self.clock("wave tracing"):
            return trace_field(
                self.scene,
                self._rays(plane),
                hologram,
                estimator,
                optics,
                radiance,
                phasors,
                self.settings.seed,
                progress,
            )

    def silhouette(self, plane):
        """Where the surfaces of a plane's slab block what lies behind: 1 or 0 for each pixel.

        The silhouette method (Matsushima, Appl. Opt. 44, 4607, 2005): exact for surfaces at one depth.
        """
        import drjit as dr
        import mitsuba as mi

        from .rays import intersect

        hologram = self.hologram
        rays = self._rays(plane)
        index = dr.arange(mi.UInt32, hologram.width * hologram.height)
        place = rays.place(mi.Float(index % hologram.width), mi.Float(index // hologram.width))
        ray, _ = rays.world(*place, mi.Float(0), mi.Float(0))
        blocked = np.asarray(intersect(self.scene, ray, self.plan.coherent).is_valid())
        return blocked.reshape(hologram.height, hologram.width).astype(np.float32)


def _moved(field, hologram, distance):
    """Wavelength number, frame number and the field moved by a distance, for each of a stack of fields."""
    shape = field.shape[-2:]
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(shape, hologram.pitch, wavelength, distance)
        transfer = transfer_function(padded, hologram.pitch, wavelength, distance) * carrier(
            wavelength, distance
        )
        for m in range(len(field)):
            yield k, m, field_of(spectrum(field[m, k], padded) * transfer, shape)
