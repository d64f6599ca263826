"""Where diffuse light comes from: paths for each ray (the paper's), paths for each grain, or baked light.

Seconds until a hologram's PSNR reaches 80 % and 95 % of the best that any of them has, one after the other in one run.
Each method climbs its own ladder: rays, paths and qualities; a rung takes what it takes, from the plan to the field.
"""

import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.scene import variants

from .scenes import GREEN, Scenes

SIDE, PITCH, FRAMES = 512, 8e-6, 24
LINES = (0.8, 0.95)
FOCUS = (0.9, 1.3, 2.0)
BORDER = 24  # of 512 pixels: those at the edge that lose light to the aperture
RAY, GRAIN, FAST, REUSED, ALONE = (
    "paths of each ray",
    "paths of each grain",
    "baked, with the bake",
    "baked before",
    "baked before, no grains",
)
LADDERS = {
    RAY: [{"method": "full", "radiance": "ray", **rung} for rung in ({"spp": 37}, {"spp": 97}, {})],
    GRAIN: [{"method": "full", "quality": q} for q in ("preview", "balanced")],
    FAST: [{"method": "fast", "quality": q} for q in ("preview", "balanced")],
    REUSED: [{"method": "fast", "quality": q} for q in ("preview", "balanced")],
    ALONE: [{"method": "fast", "radiance": "ray", "quality": q} for q in ("preview", "balanced")],
}


@dataclass(frozen=True)
class Rung:
    """One hologram: seconds, of which for the bake, mean PSNR in dB, brightness over the reference's."""

    method: str
    settings: dict
    seconds: float
    bake: float
    psnr: float
    brightness: float


def scenes(pixels):
    """Name and scene, hologram and camera."""
    build = Scenes()
    camera = engine.Camera(np.eye(4), math.radians(36))
    far = 10e-3 * pixels / SIDE
    near = far + 5e-3 * min(1, pixels / 256)
    hologram = engine.Hologram(pixels, pixels, PITCH, (GREEN,), far, near)
    return {
        "closed box": (build.closed_box(), hologram, camera),
        "room": (build.room(sharp=False), hologram, camera),
    }


def climb(scene, hologram, camera, ladders=LADDERS, spp=512):
    """All rungs of all methods on a scene, each with a store that lasts as long as its method wants it."""
    near = engine.plan(scene, camera, hologram, engine.Settings(method="full")).near
    truth = engine.reference(scene, camera, hologram, FOCUS, spp=spp, near=near)
    border = round(BORDER * hologram.width / SIDE)
    inner = slice(border, -border)
    rungs = []
    with tempfile.TemporaryDirectory() as folder:
        for method, ladder in ladders.items():
            for changes in ladder:
                settings = engine.Settings(frames=FRAMES, **changes)
                # preview's light is not good enough for balanced: each rung bakes, or finds, its own
                name = changes.get("quality", "balanced")
                store = engine.BakeStore(Path(folder) / f"{method if method == FAST else 'kept'} {name}")
                if method in (REUSED, ALONE) and not store.files():
                    engine.render(scene, camera, hologram, settings, store=store)
                start = time.perf_counter()
                field = engine.render(scene, camera, hologram, settings, store=store)
                seconds = time.perf_counter() - start
                pictures = engine.reconstruct(field, FOCUS)[:, inner, inner]
                pairs = list(zip(pictures, truth[:, inner, inner], strict=True))
                psnr = float(np.mean([engine.psnr(p, t) for p, t in pairs]))
                brightness = float(np.mean([p.mean() / t.mean() for p, t in pairs]))
                bake = field.report["seconds"].get("bake", 0.0)
                rungs.append(Rung(method, changes, seconds, bake, psnr, brightness))
    return rungs


def to_line(rungs, method, line):
    """Fewest seconds of a method's rungs that reach a PSNR; infinite if none does."""
    return min((r.seconds for r in rungs if r.method == method and r.psnr >= line), default=math.inf)


def run(scene=None, pixels=SIDE):
    """Tables as text, of one scene or of all."""
    variants.activate()
    lines = [
        f"where diffuse light comes from: {pixels} x {pixels}, M = {FRAMES}, mean of {len(FOCUS)} focus depths"
    ]
    chosen = {name: parts for name, parts in scenes(pixels).items() if scene in (None, name)}
    for name, parts in chosen.items():
        rungs = climb(*parts)
        best = max(r.psnr for r in rungs)
        lines.append(f"  {name}: best {best:.2f} dB")
        for r in rungs:
            asked = ", ".join(f"{k} {v}" for k, v in r.settings.items() if k not in ("method", "radiance"))
            lines.append(
                f"    {r.method:24} {asked or 'balanced':17} {r.seconds:7.1f} s (bake {r.bake:5.1f})  "
                f"{r.psnr:5.2f} dB  brightness {r.brightness:.3f}"
            )
        for share in LINES:
            reached = {m: to_line(rungs, m, share * best) for m in LADDERS}
            said = ", ".join(f"{m} {s:.1f} s" if s < math.inf else f"{m} never" for m, s in reached.items())
            lines.append(f"    {share:.0%} line: {said}")
            ratios = [f"{reached[RAY] / reached[m]:.1f} x ({m})" for m in (FAST, REUSED)]
            lines.append(f"      paths of each ray over baked: {', '.join(ratios)}")
    return "\n".join(lines)
