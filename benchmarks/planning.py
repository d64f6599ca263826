"""What the planner saves: six scenes, as planned and with everything switched on; what it estimated, and what came."""

import math
import sys
import time
from dataclasses import replace

import numpy as np

from holopath_addon import engine

from .parts import joined
from .scenes import FOV, Scenes

RGB = (640e-9, 516.5e-9, 455.4e-9)
SIDE, FRAMES = 512, 8
WIDE = math.radians(36)


def flat_picture(s):
    return s.scene(picture=s.plane(1.0, s.emissive(s.texture(512, 3, contrast=2))))


def diffuse(s):
    """Two balls before a wall, one lamp."""
    lamp = s.T().look_at(origin=[1.5, 2, 1], target=[0, 0, -1.5], up=[0, 1, 0]).scale(0.3)
    return s.scene(
        wall=s.plane(2.0, s.diffuse(s.texture(256, 1))),
        near=s.ball(0.06, [-0.05, -0.02, -0.6], s.diffuse(s.texture(128, 2))),
        far=s.ball(0.12, [0.12, 0.05, -1.2], s.diffuse(s.texture(128, 4))),
        lamp={"type": "rectangle", "to_world": lamp, **s.emissive(s.gray(20.0))},
    )


def mirror(s):
    """A flat mirror, what stands before it, and what it shows."""
    lamp = s.T().look_at(origin=[-1.0, 1.5, 1], target=[0, 0, -1], up=[0, 1, 0]).scale(0.4)
    behind = s.T().translate([0.9, 0, -0.6]).rotate([0, 1, 0], -70).scale([0.6, 0.5, 1])
    return s.scene(
        mirror=s.plane(1.2, {"bsdf": {"type": "conductor"}}, slant=35),
        mirrored={"type": "rectangle", "to_world": behind, **s.diffuse(s.texture(256, 5))},
        ball=s.ball(0.07, [-0.06, -0.03, -0.7], s.diffuse(s.texture(128, 2))),
        lamp={"type": "rectangle", "to_world": lamp, **s.emissive(s.gray(20.0))},
    )


def curved_glass(s):
    """A glass ball and a convex mirror before a wall."""
    lamp = s.T().look_at(origin=[1.5, 2, 1], target=[0, 0, -1.5], up=[0, 1, 0]).scale(0.4)
    return s.scene(
        wall=s.plane(2.0, s.diffuse(s.texture(256, 1))),
        glass={
            "type": "sphere",
            "center": [-0.07, 0, -0.8],
            "radius": 0.07,
            "bsdf": {"type": "dielectric"},
        },
        dome={"type": "sphere", "center": [0.12, 0, -1.1], "radius": 0.1, "bsdf": {"type": "conductor"}},
        lamp={"type": "rectangle", "to_world": lamp, **s.emissive(s.gray(20.0))},
    )


def closed_box(s):
    return s.closed_box()


def everything_at_once(s):
    """The room with a deep carpet of a million triangles."""
    v, u = np.mgrid[0:709, 0:709] / 708
    pile = 0.004 * np.sin(400 * u) * np.sin(600 * v)
    vertices = np.stack([-0.8 + 1.3 * u, -0.93 + pile, -1.6 - 2.0 * v], axis=-1)
    return s.room(pile=s.mesh(vertices, s.diffuse(s.texture(64, 15, contrast=2))))


SCENES = {
    "flat picture": (flat_picture, FOV),
    "diffuse": (diffuse, FOV),
    "mirror": (mirror, FOV),
    "curved glass": (curved_glass, FOV),
    "closed box": (closed_box, FOV),
    "all, 1 M triangles": (everything_at_once, WIDE),
}

FOCUS = {
    "flat picture": (1.0,),
    "diffuse": (0.6, 1.2, 2.0),
    "mirror": (0.7, 1.2, 2.0),
    "curved glass": (0.75, 1.0, 2.0),
    "closed box": (0.9, 2.0),
    "all, 1 M triangles": (0.9, 1.5, 4.0),
}
BORDER = 40  # of 512 pixels
MOST_PASSES = 1024
PATHS = 64  # of a pixel of the reference, in two halves: its noise does not count


def everything(settings, hologram):
    """All models, uniform rays for the whole volume, the most paths: nothing is left out because none saw a need."""
    fixed = {"chain": 8, "splits": 2, "max_depth": settings.max_depth, "passes": 256, "slabs": 48, "bins": 6}
    fixed |= {"gray": 0, "dispersion": 1, "regions": 0}
    middle = 0.5 * (hologram.depth_far + hologram.depth_near)
    return replace(settings, method="full", wrp=middle, fixed=fixed)


def timed(scene, camera, hologram, settings):
    """Seconds of planning and rendering, the field, and the plan."""
    start = time.perf_counter()
    plan = engine.plan(scene, camera, hologram, settings)
    field = engine.render(scene, camera, hologram, settings, plan)
    return time.perf_counter() - start, field, plan


def warmed(settings):
    """The same kernels with hardly any work."""
    return replace(settings, spp=1, fixed=settings.fixed | {"passes": 1})


def field_error(scene, camera, hologram, settings, field):
    """Relative error that the radiance's noise makes in a field: against one of sixteen times its paths.

    The same phases and rays of the wave. Lamps in view count as little as in the plan. Paths alone, NaN where light is
    baked (sixteen times as many leave far more noise than the texels have), and where it would take hours.
    """
    passes = max(256, 16 * field.report["radiance_passes"])
    if field.plan["cached"] or passes > MOST_PASSES:
        return math.nan
    exact = replace(settings, method="full", fixed=settings.fixed | {"passes": passes})
    other = engine.render(scene, camera, hologram, exact)
    picture = engine.reconstruct(other, [1.0])[0].mean(-1)
    lit = picture[picture > 0.01 * picture.mean()]
    share = np.minimum(picture, np.percentile(lit, 95)).sum() / picture.sum()
    difference = np.linalg.norm(field.data - other.data) / np.linalg.norm(other.data)
    return float(difference / math.sqrt(share))


def measure(name, pixels=SIDE):
    """Figures of one scene, a dict."""
    make, fov = SCENES[name]
    scene, camera = make(Scenes()), engine.Camera(np.eye(4), fov)
    nearer = min(1.0, pixels / 256)
    hologram = engine.Hologram(pixels, pixels, 8e-6, RGB, 1e-3 * nearer, 6e-3 * nearer)
    balanced = engine.Settings(frames=FRAMES)
    whole = everything(balanced, hologram)
    for settings in (warmed(balanced), warmed(whole)):
        timed(scene, camera, hologram, settings)
    seconds, field, plan = timed(scene, camera, hologram, balanced)
    all_seconds, all_field, _ = timed(scene, camera, hologram, whole)
    again, field, plan = timed(scene, camera, hologram, balanced)
    focus = FOCUS[name]
    truth = engine.reference(scene, camera, hologram, focus, spp=PATHS, near=field.near, halves=True)

    def psnr(of):
        pictures = engine.reconstruct(of, focus)
        return [
            engine.psnr(p, t, round(BORDER * pixels / SIDE)) for p, t in zip(pictures, truth, strict=True)
        ]

    estimated = field.report["estimated"]
    return {
        "seconds": 0.5 * (seconds + again),
        "first_seconds": seconds,
        "everything_seconds": all_seconds,
        "psnr": psnr(field),
        "everything_psnr": psnr(all_field),
        "seconds_foretold": estimated["seconds"]["plan"],
        "seconds_measured": estimated["seconds"]["measured"],
        "error_foretold": estimated["field_error"]["plan"],
        "error_by_halves": estimated["field_error"]["measured"],
        "error_measured": field_error(scene, camera, hologram, balanced, field),
        "stages": field.report["seconds"],
        "everything_stages": all_field.report["seconds"],
        "plan": str(plan),
    }


def run(*names, pixels=SIDE):
    """The table as text, for all scenes or those named."""
    lines = [
        f"planning: {pixels} x {pixels}, 8 µm, three wavelengths, M = {FRAMES}, balanced; seconds with the plan, "
        "kernels compiled; PSNR over the foci against the thin lens",
        f"  {'scene':20s} {'planned':>8s} {'all on':>8s} {'ratio':>6s}   {'PSNR':>20s} {'all on':>20s}   "
        f"{'estimated s':>10s} {'came':>6s}   {'estimated error':>14s} {'halves':>7s} {'came':>7s}",
    ]

    def line(name):
        row = measure(name, pixels)
        planned, whole = (" ".join(f"{v:5.2f}" for v in row[key]) for key in ("psnr", "everything_psnr"))
        text = (
            f"  {name:20s} {row['seconds']:8.2f} {row['everything_seconds']:8.2f} "
            f"{row['seconds'] / row['everything_seconds']:6.3f}   {planned:>20s} {whole:>20s}   "
            f"{row['seconds_foretold']:10.2f} {row['seconds_measured']:6.2f}   "
            f"{row['error_foretold']:14.2%} {row['error_by_halves']:7.2%} {row['error_measured']:7.2%}"
        )
        print(
            text,
            row["stages"],
            row["everything_stages"],
            row["plan"],
            f"first {row['first_seconds']:.2f} s",
            sep="\n",
            file=sys.stderr,
            flush=True,
        )
        return text

    head = {"head": lambda: "\n".join(lines)}
    return joined(head | {name: lambda name=name: line(name) for name in names or SCENES})
