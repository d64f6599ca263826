"""A full HD hologram by stages, and how its rays compare with a bare loop of intersections over as many."""

import time
from dataclasses import dataclass

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


@dataclass
class Rendered:
    """A render of demo:suzanne in three colors, the second of two: programs are compiled by then.

    Attributes
    ----------
    view : tuple
        Scene, camera, hologram and settings.
    plan : Plan
    field : WaveField
    lines : list of str
        Seconds of each stage, and million rays a second of the wave rays and of the bare loop.
    """

    view: tuple
    plan: engine.Plan
    field: engine.WaveField
    lines: list


def rendered(resolution, frames):
    """A `Rendered` of a resolution such as ``"64x36"``."""
    width, height = map(int, resolution.split("x"))
    demo.build("suzanne")
    exported = export_scene(bpy.context.evaluated_depsgraph_get(), (width, height))
    scene, camera = exported.scene, exported.camera
    display = engine.DISPLAYS["pluto-2"]
    hologram = engine.Hologram(
        width, height, display.pitch, depth_far=display.depth_range[0], depth_near=display.depth_range[1]
    )
    view = scene, camera, hologram, engine.Settings(frames=frames, method="full")
    plan = engine.plan(*view)
    for _ in range(2):
        start = time.perf_counter()
        field = engine.render(*view, plan)
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
    lines = [
        f"{width} x {height} pixels, {frames} frames, three colors, {mi.variant()}, waves: {plan.library}"
    ]
    lines += [row(name, value) for name, value in [*stages.items(), ("all", seconds)]]
    lines += [
        f"  {'wave rays':24s} {traced:8.0f} Mray/s",
        f"  {'ray_intersect loop':24s} {limit:8.0f} Mray/s",
        f"  wave rays / loop         {traced / limit:8.2f}",
    ]
    return Rendered(view, plan, field, lines)


def row(name, seconds, digits=2):
    """A line of a table of seconds."""
    return f"  {name:24s} {seconds:8.{digits}f} s"


def run(resolution="1920x1080"):
    """Seconds of each stage of `rendered`, as text."""
    return "\n".join(rendered(resolution, FRAMES).lines)
