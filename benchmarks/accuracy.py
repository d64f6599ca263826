"""Seconds against PSNR: the lattice and the paper's estimator, at several ray counts, in one run."""

import time
from pathlib import Path

import numpy as np

from holopath_addon import engine

from .parts import drawn
from .scenes import FOV, GREEN, Scenes

FOCUS = (0.5, 1.0, 2.0)
PIXELS, FRAMES = 256, 24
BORDER = 25  # pixels of those


def run(folder, pixels=PIXELS, frames=FRAMES):
    """Table as text; the chart goes to ``folder/accuracy.png``."""
    size = pixels / PIXELS
    scene = Scenes().two_planes(Scenes().emissive)
    camera = engine.Camera(np.eye(4), FOV)
    hologram = engine.Hologram(pixels, pixels, 8e-6, (GREEN,), 1e-3 * size, 6e-3 * size)
    truth = engine.reference(scene, camera, hologram, FOCUS, spp=256, near=0.5)
    rows = []
    for name, kind, estimator, wrp, counts in (
        ("lattice, designed phases", "designed", "lattice", "auto", (37, 81, 149, None)),
        ("lattice, random phases", "random", "lattice", "auto", (37, 81, 149, None)),
        ("paper, plane in the scene", "random", "paper", "auto", (64, 256, 1024, 4096)),
        ("paper, 5 mm plane", "random", "paper", hologram.depth_far, (256, 1024, 4096, 16384)),
    ):
        for count in counts:
            settings = engine.Settings(
                frames=frames, phase_field=kind, estimator=estimator, wrp=wrp, spp=count
            )
            plan = engine.plan(scene, camera, hologram, settings)
            engine.render(scene, camera, hologram, settings, plan)  # compiles
            start = time.perf_counter()
            field = engine.render(scene, camera, hologram, settings, plan)
            seconds = time.perf_counter() - start
            pictures = engine.reconstruct(field, FOCUS)
            values = [engine.psnr(p, t, round(BORDER * size)) for p, t in zip(pictures, truth, strict=True)]
            rows.append((name, plan.rays_per_pixel, seconds, *values))
    lines = [
        f"accuracy: two emissive planes, {pixels} x {pixels}, 8 µm, M = {frames}; PSNR in dB at 0.5, 1, 2 m"
    ]
    lines += [f"  {n:28s} {r:6d} rays {s:7.2f} s   {a:5.1f} {b:5.1f} {c:5.1f}" for n, r, s, a, b, c in rows]
    return drawn("\n".join(lines), lambda: _chart(rows, Path(folder) / "accuracy.png"))


def _chart(rows, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for name in dict.fromkeys(row[0] for row in rows):
        own = [row for row in rows if row[0] == name]
        axes.plot([r[2] for r in own], [np.mean(r[3:]) for r in own], "o-", label=name)
        for r in own:
            axes.annotate(
                f"{r[1]}", (r[2], np.mean(r[3:])), textcoords="offset points", xytext=(5, -10), fontsize=8
            )
    axes.set(
        xscale="log",
        xlabel="seconds (rays a pixel at the points)",
        ylabel="PSNR, mean of three focus depths, dB",
    )
    axes.grid(alpha=0.3)
    axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)
