"""Random against designed phase fields, same paths, same time: speckle, pictures, pupils, noise, bits, despeckling."""

import math
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import scipy.fft

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.rendering import render_context
from holopath_addon.engine.waves.phase_fields import SETS, designed_phasors, phasors_of
from holopath_addon.engine.waves.propagation import transfer_function

from .convergence import border, display, view_of
from .optics import scenes as optics_scenes
from .parts import drawn, joined
from .scenes import FOV, GREEN, Scenes

KINDS = "random", "designed"
PITCH, SIZE = 8e-6, 256
WAVELENGTHS = (640e-9, 516.5e-9, 455.4e-9)
DEFOCUS = np.arange(-60, 61) * 1e-4  # meters
FRAMES = (1, 3, 8, 24)
THREE = (0.5, 1.0, 2.0)


def contrast(phasors, wavelength, distance):
    """Standard deviation over mean of the frame mean of an even plane's intensity, periodic, at a defocus."""
    transfer = transfer_function((SIZE, SIZE), PITCH, wavelength, distance)
    # the band limit of the sampled transfer function is for padded fields
    assert (transfer != 0).mean() > 0.78
    total: Any = 0
    for phasor in phasors:
        wave = scipy.fft.ifft2(scipy.fft.fft2(phasor) * transfer)
        total = total + wave.real**2 + wave.imag**2
    return float(total.std() / total.mean())


def _defocus(pixels):
    """Fewer distances in little: fields are as large as the designed maps all the same."""
    return DEFOCUS[:: max(1, SIZE // pixels) ** 2]


def speckle(folder, pixels):
    """Contrast of an even plane over defocus; the chart goes to ``folder/phase_fields.png``."""
    lines = [
        "speckle of an even plane, -6 to 6 mm in 0.1 mm steps, 640, 516.5, 455.4 nm: contrast, mean and worst"
    ]
    curves = {}
    for frames in FRAMES:
        for kind in KINDS:
            phasors = phasors_of(kind, frames, SIZE, SIZE)
            values = [[contrast(phasors, w, z) for z in _defocus(pixels)] for w in WAVELENGTHS]
            curves[frames, kind] = np.array(values)
            means = " ".join(f"{np.mean(v):.3f}" for v in values)
            lines.append(
                f"  M = {frames:2d} {kind:9s} mean {np.mean(values):.3f} ({means})  worst {np.max(values):.3f}"
            )
    lines.append("the first m frames of each set: mean over green")
    for count in SETS:
        phasors = designed_phasors(count)
        cells = [
            f"{m}: {np.mean([contrast(phasors[:m], GREEN, z) for z in _defocus(pixels)[::6]]):.3f}"
            for m in (1, 2, 3, 4, 6, 8, 12, 16, 24)
            if m <= count
        ]
        lines.append(f"  set of {count:2d}  " + "  ".join(cells))
    path = Path(folder) / "phase_fields.png"
    return drawn("\n".join(lines), lambda: _speckle_chart(curves, _defocus(pixels), path))


def _speckle_chart(curves, defocus, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(FRAMES), figsize=(15, 3.8), sharey=True, layout="constrained")
    for axis, frames in zip(axes, FRAMES, strict=True):
        for kind, style in zip(KINDS, (":", "-"), strict=True):
            for values, color, w in zip(
                curves[frames, kind], ("tab:red", "tab:green", "tab:blue"), WAVELENGTHS, strict=True
            ):
                axis.plot(
                    1e3 * defocus, values, style, color=color, lw=1.2, label=f"{kind}, {w * 1e9:.4g} nm"
                )
        axis.set(title=f"M = {frames}", xlabel="defocus, mm", yscale="log", ylim=(0.01, 1.3))
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("speckle contrast of an even plane")
    axes[0].legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def arrangements():
    """Name, scene and focus depths: emissive planes, occlusion, a slanted plane, mirrors and glass."""
    s = Scenes()
    half = 0.5 * math.tan(FOV / 2)
    yield "two planes", s.two_planes(s.emissive), THREE
    yield "three planes", s.three_planes(), THREE
    slanted = s.plane(1.0, s.emissive(s.texture(256, 6, contrast=4)), 0.6, slant=60)
    back = s.plane(2.0, s.emissive(s.texture(256, 1, contrast=4)))
    near = s.plane(0.5, s.emissive(s.texture(128, 2, contrast=4)), 0.4 * half, 0.5 * half, x=-0.6 * half)
    yield "slanted plane", s.scene(slanted=slanted, back=back, near=near), (0.5, 1.0, 1.9)
    for name, scene, focus in optics_scenes():
        if name.startswith(("flat", "convex", "glass ball")):
            yield name, scene, focus


def pupils(hologram, camera, near):
    """The whole pupil, half its diameter, and as much half a degree to either side."""
    mapping = DepthMapping.of(hologram, camera, near)
    radius = mapping.pupil_radius(hologram.max_slope(GREEN))
    aside = math.tan(math.radians(0.5)) * mapping.beta / mapping.focal
    return {
        "whole": None,
        "half": engine.Pupil(0, 0, radius),
        "-0.5°": engine.Pupil(-aside, 0, radius),
        "+0.5°": engine.Pupil(aside, 0, radius),
    }


def _hologram(pixels):
    _, far, thickness = display(pixels)
    return engine.Hologram(pixels, pixels, PITCH, (GREEN,), far, far + thickness)


def pictures(pixels, count, frames=(8, 24)):
    """PSNR and SSIM at three focus depths, random -> designed."""
    lines = [
        f"scenes: {pixels} x {pixels}, 8 µm, 516.5 nm; PSNR in dB (SSIM) at three focus depths, random -> designed"
    ]
    camera, hologram = engine.Camera(np.eye(4), FOV), _hologram(pixels)
    edge = border(hologram)
    for name, scene, focus in islice(arrangements(), count):
        plan = engine.plan(scene, camera, hologram, engine.Settings(frames=24, phase_field="designed"))
        truths = {
            view: engine.reference(scene, camera, hologram, focus, pupil, spp=256, near=plan.near)
            for view, pupil in pupils(hologram, camera, plan.near).items()
        }
        for count in frames:
            fields = {
                kind: engine.render(
                    scene, camera, hologram, engine.Settings(frames=count, phase_field=kind), plan
                )
                for kind in KINDS
            }
            for view, pupil in pupils(hologram, camera, plan.near).items():
                rows = {kind: engine.reconstruct(field, focus, pupil) for kind, field in fields.items()}
                cells = []
                for a, b, truth in zip(*rows.values(), truths[view], strict=True):
                    values = [(engine.psnr(p, truth, edge), engine.ssim(p, truth, edge)) for p in (a, b)]
                    (p0, s0), (p1, s1) = values
                    cells.append(f"{p0:5.1f} ({s0:.2f}) -> {p1:5.1f} ({s1:.2f})")
                lines.append(f"  {name:22s} M = {count:2d} {view:6s} " + "   ".join(cells))
    return "\n".join(lines)


def demo(pixels, frames=8):
    """The demo scene in color, as ``make demo`` renders it."""
    from holopath_addon.cli import sources

    source = sources.open_source("demo:suzanne")
    loaded = source.load(pixels, pixels, None)
    size = pixels / 512
    hologram = engine.Hologram(pixels, pixels, PITCH, depth_far=10e-3 * size, depth_near=15e-3 * size)
    focus = (0.5, 1.0, 4.0)
    plan = engine.plan(loaded.scene, loaded.camera, hologram, engine.Settings(frames=frames))
    truth = engine.reference(loaded.scene, loaded.camera, hologram, focus, spp=256, near=plan.near)
    lines = [
        f"demo scene, {pixels} x {pixels}, RGB, M = {frames}, {plan.passes} radiance paths: PSNR (SSIM) at 0.5, 1, 4 m"
    ]
    edge = math.ceil(hologram.max_slope(GREEN) * hologram.depth_near / PITCH) + 1
    for kind in KINDS:
        settings = engine.Settings(frames=frames, phase_field=kind)
        engine.render(loaded.scene, loaded.camera, hologram, settings, plan)
        start = time.perf_counter()
        field = engine.render(loaded.scene, loaded.camera, hologram, settings, plan)
        seconds = time.perf_counter() - start
        shown = engine.reconstruct(field, focus)
        cells = [
            f"{engine.psnr(p, t, edge):5.1f} ({engine.ssim(p, t, edge):.2f})"
            for p, t in zip(shown, truth, strict=True)
        ]
        lines.append(f"  {kind:9s} {'  '.join(cells)}   {seconds:.1f} s")
    return "\n".join(lines)


def evenness():
    """Light of an even plane through parts of the pupil, over what an even pupil would pass."""
    f = scipy.fft.fftfreq(SIZE)
    fx, fy = f[None, :], f[:, None]
    places = [(0.0, 0.0)] + [(0.25 * math.cos(a), 0.25 * math.sin(a)) for a in np.arange(8) * math.pi / 4]
    lines = ["pupil: light through nine parts of half its diameter, over an even pupil's: least and most"]
    for frames in FRAMES:
        for kind in KINDS:
            power: Any = sum(np.abs(scipy.fft.fft2(p)) ** 2 for p in phasors_of(kind, frames, SIZE, SIZE))
            band = fx**2 + fy**2 <= 0.25
            parts = [(fx - x) ** 2 + (fy - y) ** 2 <= 0.0625 for x, y in places]
            shares = [power[p].mean() / power[band].mean() for p in parts]
            lines.append(f"  M = {frames:2d} {kind:9s} {min(shares):.3f} to {max(shares):.3f}")
    return "\n".join(lines)


def noise(pixels, frames=24):
    """PSNR over radiance paths, for both kinds: two planes under a lamp."""
    s = Scenes()
    scene = s.two_planes(s.diffuse)
    camera, hologram = engine.Camera(np.eye(4), FOV), _hologram(pixels)
    edge = border(hologram)
    plan = engine.plan(scene, camera, hologram, engine.Settings(frames=frames))
    truth = engine.reference(scene, camera, hologram, THREE, spp=1024, near=plan.near)
    lines = [
        f"noise: two diffuse planes under a lamp, M = {frames}; PSNR at 0.5, 1, 2 m over radiance paths a pixel "
        f"(the plan takes {plan.passes})"
    ]
    for passes in (1, 4, 16, 64, 256, 1024):
        cells = []
        for kind in KINDS:
            settings = engine.Settings(frames=frames, phase_field=kind)
            field = engine.render(scene, camera, hologram, settings, replace(plan, passes=passes))
            shown = engine.reconstruct(field, THREE)
            values = [engine.psnr(p, t, edge) for p, t in zip(shown, truth, strict=True)]
            cells.append(f"{kind} " + " ".join(f"{v:5.1f}" for v in values))
        lines.append(f"  {passes:5d} paths   " + "   ".join(cells))
    return "\n".join(lines)


def bits(pixels):
    """Designed maps of fewer levels: contrast of an even plane, and PSNR of the three planes."""
    lines = ["levels of the designed maps: contrast at M = 8 and 24, PSNR on three planes at M = 24"]
    view = view_of(Scenes().three_planes(), THREE, *display(pixels))

    def rounded(phasors, count):
        step = 2 * math.pi / 2**count
        return np.exp(1j * step * np.round(np.angle(phasors) / step)).astype(np.complex64)

    for count in (8, 6, 4, 3, 2):
        cells = [
            np.mean([contrast(rounded(designed_phasors(m), count), GREEN, z) for z in _defocus(pixels)[::6]])
            for m in (8, 24)
        ]
        with mock.patch.object(
            render_context, "phasors_of", lambda *a, count=count: rounded(phasors_of(*a), count)
        ):
            shown = _three_planes(view, engine.Settings(frames=24, max_depth=1))
        lines.append(
            f"  {count} bits   {cells[0]:.3f} {cells[1]:.3f}   " + " ".join(f"{v:5.1f}" for v in shown[0])
        )
    return "\n".join(lines)


def _three_planes(view, settings):
    """PSNR at each focus depth, and seconds."""
    start = time.perf_counter()
    field = engine.render(view.scene, view.camera, view.hologram, settings)
    seconds = time.perf_counter() - start
    inner = slice(border(view.hologram), -border(view.hologram))
    shown = engine.reconstruct(field, view.focus)[:, inner, inner]
    return [engine.psnr(p, t) for p, t in zip(shown, view.truth, strict=True)], seconds


def despeckling(folder, pixels):
    """PSNR and seconds over despeckling steps; the chart goes to ``folder/despeckle.png``."""
    view = view_of(Scenes().three_planes(), THREE, *display(pixels))
    _three_planes(view, engine.Settings(frames=24, max_depth=1, despeckle=1))
    lines = ["despeckling: three planes, PSNR at 0.5, 1, 2 m"]
    curves = {}
    for frames in (3, 8, 24):
        _three_planes(view, engine.Settings(frames=frames, max_depth=1))
        for kind in KINDS:
            for steps in (0, 20, 60, 200):
                settings = engine.Settings(frames=frames, max_depth=1, phase_field=kind, despeckle=steps)
                values, seconds = _three_planes(view, settings)
                curves.setdefault((frames, kind), []).append((steps, seconds, np.mean(values)))
                cells = " ".join(f"{v:5.1f}" for v in values)
                lines.append(f"  M = {frames:2d} {kind:9s} {steps:3d} steps  {cells}   {seconds:5.1f} s")
    return drawn("\n".join(lines), lambda: _despeckling_chart(curves, Path(folder) / "despeckle.png"))


def _despeckling_chart(curves, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
    colors = {3: "tab:orange", 8: "tab:blue", 24: "tab:purple"}
    for (frames, kind), points in curves.items():
        axis.plot(
            [seconds for _, seconds, _ in points],
            [value for _, _, value in points],
            "o:" if kind == "random" else "o-",
            color=colors[frames],
            label=f"M = {frames}, {kind}",
        )
        for steps, seconds, value in points:
            axis.annotate(
                f"{steps}", (seconds, value), textcoords="offset points", xytext=(4, -10), fontsize=7
            )
    axis.set(
        xscale="log",
        xlabel="seconds of the whole render (steps at the points)",
        ylabel="PSNR, mean of three focus depths, dB",
    )
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def textured(seeds):
    """Squared error in textured pictures over that of independent frames: `phase_fields.GAIN`."""
    from holopath_addon.engine.waves.phase_fields.design import Design, Recipe, invent
    from holopath_addon.engine.waves.supervision import FramePool

    lines = ["textured pictures: squared error over that of independent frames"]
    with FramePool() as pool:
        for count in SETS:
            maps = np.angle(designed_phasors(count))
            recipe = Recipe(count, maps.shape[-1])
            design, losses = Design(recipe, maps), []
            for seed in range(seeds):
                rng = np.random.default_rng((1, seed))
                tasks = invent(rng, recipe.size, recipe.reach, 0.0)
                losses.append(design.slopes(*tasks, pool)[0][count] * count / len(tasks[1]))
            lines.append(f"  set of {count:2d}: {np.mean(losses):.3f}")
    return "\n".join(lines)


def run(folder, pixels=SIZE, scenes=None):
    """All tables as text, of pictures those of so many scenes; charts go to the folder."""
    parts = {
        "speckle": lambda: speckle(folder, pixels),
        "textured": lambda: textured(max(1, 40 * pixels // SIZE)),
        "evenness": evenness,
        "pictures": lambda: pictures(pixels, scenes),
        "demo": lambda: demo(2 * pixels),
        "noise": lambda: noise(pixels),
        "bits": lambda: bits(pixels),
        "despeckling": lambda: despeckling(folder, pixels),
    }
    return joined(parts)
