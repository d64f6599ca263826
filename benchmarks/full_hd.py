"""A full HD hologram by stages, and how its rays compare with a bare loop of intersections over as many."""

import time

import bpy
import drjit as dr
import mitsuba as mi

from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.scene.rays import Rays
from holopath_addon.engine.tracing.kernel_table import Lattice
from holopath_addon.export import export_scene

from .kernel import bare_loop, full_hit, timed

FRAMES = 24


def run(resolution="1920x1080"):
    """Seconds of each stage of demo:suzanne in three colours, the second time of two: programs are compiled by then.

    Parameters
    ----------
    resolution : str
        Pixels, such as ``"64x36"``.

    Returns
    -------
    str
        The variant, a row a stage, and million rays a second of the wave rays and of the bare loop.
    """
    width, height = map(int, resolution.split("x"))
    demo.build("suzanne")
    exported = export_scene(bpy.context.evaluated_depsgraph_get(), (width, height))
    scene, camera = exported.scene, exported.camera
    display = engine.DISPLAYS["pluto-2"]
    hologram = engine.Hologram(
        width, height, display.pitch, depth_far=display.depth_range[0], depth_near=display.depth_range[1]
    )
    settings = engine.Settings(frames=FRAMES, method="full")
    plan = engine.plan(scene, camera, hologram, settings)
    for _ in range(2):
        start = time.perf_counter()
        field = engine.render(scene, camera, hologram, settings, plan)
        dr.sync_thread()
        seconds = time.perf_counter() - start
    stages, rays = field.report["seconds"], field.report["rays"]["wave rays"]

    plane, wavelength = max(plan.planes, key=lambda plane: plane.depth_limit), min(hologram.wavelengths)
    mapping = DepthMapping.of(hologram, camera, plan.near)
    lattice = Lattice.of(hologram.max_slope(wavelength), plane.depth_limit, hologram.pitch, plan.cone)

    def bare():
        bare_loop(scene, Rays(hologram, camera, mapping, plane.z), lattice, hologram, full_hit)

    bare()
    limit = width * height * lattice.rays / timed(bare) / 1e6
    traced = rays / stages["wave tracing"] / 1e6
    lines = [f"full HD: {width} x {height} pixels, {FRAMES} frames, three colors, {mi.variant()}"]
    lines += [f"  {name:24s} {value:8.2f} s" for name, value in stages.items()]
    lines += [
        f"  {'all':24s} {seconds:8.2f} s",
        f"  {'wave rays':24s} {traced:8.0f} Mray/s",
        f"  {'ray_intersect loop':24s} {limit:8.0f} Mray/s",
        f"  wave rays / loop         {traced / limit:8.2f}",
    ]
    return "\n".join(lines)
