"""The wave tracing kernel against the limit: a bare loop of intersections over the same rays."""

import time

import drjit as dr
import mitsuba as mi
import numpy as np

from holopath_addon import engine
from holopath_addon.engine.light.path_tracer import PathTracer
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.scene.buffers import gather_row, packed
from holopath_addon.engine.scene.rays import Rays
from holopath_addon.engine.scene.specular_chains import FirstHits
from holopath_addon.engine.tracing.estimators import LatticeEstimator
from holopath_addon.engine.tracing.grain_grid import GrainGrid
from holopath_addon.engine.tracing.kernel_table import Lattice, kernel_table
from holopath_addon.engine.tracing.measurement import Measurement
from holopath_addon.engine.tracing.wave_kernel import Part, WaveKernel
from holopath_addon.engine.tracing.wave_tracer import blocks_of, trace_blocks
from holopath_addon.engine.waves.arrays import PROCESSOR
from holopath_addon.engine.waves.phase_fields import random_phasors

from .scenes import FOV, GREEN, Scenes

FRAMES = (1, 8, 24)


def bare_loop(scene, rays, lattice, hologram, distance):
    """Intersections only over the lattice's rays; `distance` of a ray gives what is summed."""
    pixels = hologram.width * hologram.height
    directions = packed(lattice.indices.astype(np.float32))
    index = dr.arange(mi.UInt32, pixels)
    x, y = rays.place(mi.Float(index % hologram.width), mi.Float(index // hologram.width))

    def body(step, total):
        i, j = gather_row(directions, step, 2)
        ray, _ = rays.world(x, y, i * lattice.spacing, j * lattice.spacing)
        return step + 1, total + distance(scene, ray)

    limit = dr.opaque(mi.UInt32, lattice.rays)
    _, total = dr.while_loop((mi.UInt32(0), mi.Float(0)), lambda step, _: step < limit, body)
    dr.eval(total)
    dr.sync_thread()


def full_hit(scene, ray):
    """Distance by `scene.ray_intersect`, which also builds the surface's frame."""
    hit = scene.ray_intersect(ray)
    return dr.select(hit.is_valid(), hit.t, 0)


def distance_only(scene, ray):
    """Distance by `scene.ray_intersect_preliminary`: the least that a ray tracer can do."""
    hit = scene.ray_intersect_preliminary(ray, coherent=True)
    return dr.select(hit.is_valid(), hit.t, 0)


def timed(work):
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def run(pixels=512, repeats=5):
    """Medians over interleaved repeats of each kernel, after one warm-up, as text."""
    scene = Scenes().two_planes(Scenes().emissive)
    camera = engine.Camera(np.eye(4), FOV)
    hologram = engine.Hologram(pixels, pixels, 8e-6, (GREEN,), 1e-3, 6e-3)
    plan = engine.plan(scene, camera, hologram, engine.Settings(planes=1))
    slope = hologram.max_slope(GREEN)
    (plane,) = plan.planes
    rays = Rays(hologram, camera, DepthMapping.of(hologram, camera, plan.near), plane.z)
    lattice = Lattice.of(slope, plane.depth_limit, hologram.pitch, plan.cone)
    estimator = LatticeEstimator(hologram, lattice, [kernel_table(lattice, hologram.pitch, GREEN)])
    depths = (plan.z_low, plan.z_high)
    grid = GrainGrid(pixels, pixels, plan.margin, plan.slabs, plan.bins, *depths, plan.cone * slope)
    image_finder, tracer = FirstHits(plan.coherent), PathTracer(8)
    measurement = Measurement(scene, rays, image_finder, tracer, grid, plan, (GREEN,))
    radiance = measurement.measure(lambda done: None)
    phasors = random_phasors(max(FRAMES), pixels, pixels)
    part = Part(np.arange(pixels * pixels, dtype=np.uint32), rays, estimator, image_finder)

    def trace(frames):
        blocks = blocks_of([(pixels * pixels, part.rays_per_pixel)], frames, 1, plan.chunk)
        kernel = WaveKernel(scene, hologram, radiance, seed=0, like=PROCESSOR)
        for _ in trace_blocks(kernel, [part], blocks, phasors[:frames], plan.chunk, lambda done: None):
            pass

    works = {
        "ray_intersect loop": lambda: bare_loop(scene, rays, lattice, hologram, full_hit),
        "distance-only loop": lambda: bare_loop(scene, rays, lattice, hologram, distance_only),
    }
    works |= {f"M = {frames}": (lambda frames=frames: trace(frames)) for frames in FRAMES}
    for work in works.values():
        work()
    samples = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            samples[name].append(timed(work))
    seconds = {name: float(np.median(values)) for name, values in samples.items()}
    million = pixels * pixels * lattice.rays / 1e6
    lines = [
        f"kernel: {pixels} x {pixels} pixels, {lattice.rays} rays a pixel, two emissive planes, {mi.variant()}"
    ]
    lines += [f"  {name:24s} {million / value:6.0f} Mray/s" for name, value in seconds.items()]
    one, many = seconds["M = 1"], seconds["M = 24"]
    lines.append(f"  time at M = 24 / time at M = 1             {many / one:.2f}   (at most 2.0)")
    lines.append(
        f"  rays/s at M = 1 / ray_intersect loop       {seconds['ray_intersect loop'] / one:.2f}   (at least 0.4)"
    )
    lines.append(f"  rays/s at M = 1 / distance-only loop       {seconds['distance-only loop'] / one:.2f}")
    return "\n".join(lines)
