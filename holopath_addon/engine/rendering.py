"""From a scene to the wave field at the SLM: the stages in order, with progress, times and cancellation."""

import time

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
    from .chains import FirstHits, SpecularChains
    from .estimators import LatticeEstimator, RandomEstimator
    from .grains import GrainGrid, measure_grains
    from .rays import Rays
    from .tracer import trace_field

    settings = (settings or Settings()).resolved()
    progress = progress or (lambda done, message: None)
    seconds, rays_traced = {}, {}
    clock = time.perf_counter()

    def lap(stage):
        nonlocal clock
        now = time.perf_counter()
        seconds[stage] = now - clock
        clock = now

    progress(0.0, "Planning")
    if plan is None:
        plan = planner.plan(scene, camera, hologram, settings)
    lap("plan")
    mapping = DepthMapping.of(hologram, camera, plan.near)
    rays = Rays(hologram, camera, mapping, plan.wrp, plan.depth_limit)
    max_slope = max(hologram.max_slope(w) for w in hologram.wavelengths)

    progress(0.02, "Random phases")
    phasors = random_phasors(settings.frames, hologram.height, hologram.width, settings.seed)
    recordable = recordable_fraction(phasors)
    lap("phase fields")

    progress(0.04, "Kernel tables")
    if settings.estimator == "lattice":
        lattice = Lattice.of(max_slope, plan.depth_limit, hologram.pitch, plan.cone, plan.rays_per_pixel)
        tables = [kernel_table(lattice, hologram.pitch, w) for w in hologram.wavelengths]
        estimator = LatticeEstimator(hologram, lattice, tables)
    else:
        estimator = RandomEstimator(hologram, plan.rays_per_pixel, settings.seed)
        recordable *= pixel_transmission()
    lap("kernel tables")

    optics = SpecularChains(settings.virtual_image, plan.chain, plan.splits) if plan.chain else FirstHits()
    radiance = None
    if settings.radiance == "grain":
        depths = (plan.z_low - plan.wrp, plan.z_high - plan.wrp)
        size = (hologram.width, hologram.height)
        grid = GrainGrid(
            *size, plan.margin, plan.slabs, plan.bins, *depths, plan.cone * max_slope, optics.branches
        )
        colours, depth, seed = hologram.wavelengths, settings.max_depth, settings.seed
        radiance = measure_grains(
            scene,
            rays,
            optics,
            grid,
            colours,
            plan.passes,
            depth,
            seed,
            lambda done: progress(0.05 + 0.4 * done, "Radiance"),
        )
        rays_traced["radiance paths"] = grid.columns * grid.rows * plan.passes
        lap("radiance")
    field = trace_field(
        scene,
        rays,
        hologram,
        estimator,
        optics,
        radiance,
        phasors,
        settings.max_depth,
        settings.seed,
        lambda done: progress(0.45 + 0.45 * done, "Wave tracing"),
    )
    rays_traced["wave rays"] = hologram.width * hologram.height * plan.rays_per_pixel * optics.branches
    lap("wave tracing")

    # plane to SLM, in place; the scale makes a plane of radiance L refocus to intensity L
    shape = field.shape[-2:]
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(shape, hologram.pitch, wavelength, plan.wrp)
        transfer = transfer_function(padded, hologram.pitch, wavelength, -plan.wrp)
        transfer *= carrier(wavelength, -plan.wrp) / np.float32(np.sqrt(recordable))
        for m in range(len(field)):
            field[m, k] = field_of(spectrum(field[m, k], padded) * transfer, shape)
            progress(
                0.9 + 0.1 * (k * len(field) + m + 1) / (len(field) * len(hologram.wavelengths)),
                "To the SLM",
            )
    lap("propagation")
    report = {
        "seconds": seconds,
        "rays": rays_traced,
        "variant": backend.activate(),
        "frames": settings.frames,
    }
    return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)
