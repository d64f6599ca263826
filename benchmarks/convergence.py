"""Rays against PSNR, as the paper's convergence figure: straight from the SLM, its 5 mm plane, and the default.

PSNR is the mean over three focus depths, border pixels left out; a ratio is to the converged PSNR of the same number
of frames. All methods also take the same radiance paths a pixel, which the rays do not count.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from holopath_addon import engine

from .parts import drawn
from .scenes import FOV, GREEN, Scenes

PITCH, PIXELS = 8e-6, 256
THICKNESS = 5e-3  # of the volume
NEAR = 0.5  # world depth of its near end, meters
FRAMES = (1, 3, 8, 24)
LINE, PAPER_LINE = 0.95, 0.8
COUNTS = tuple(1 << k for k in range(6, 15))
THOROUGH = 1 << 16
LATTICE = (5, 9, 21, 37, 69, 109, 149, 197, None)
FAR, FAR_WIDTH = 20e-3, 384  # a volume far from the SLM, and a display whose aperture passes its middle
NEARER = (1e-3, 5e-3, 8e-3)  # where the direct method gets to the line in a minute
PLANES = (0.5, 1.0, 2.0)
METHODS = ("direct", "two-stage, 5 mm plane", "two-stage, chosen plane")


@dataclass(frozen=True)
class JudgedScene:
    """A scene on a display, and the truth of its inner part."""

    scene: object
    hologram: engine.Hologram
    camera: engine.Camera
    focus: tuple
    truth: np.ndarray

    def psnr(self, spp, **settings):
        """Rays a pixel, and PSNR in dB for each of FRAMES."""
        settings = engine.Settings(frames=max(FRAMES), phase_field="random", max_depth=1, spp=spp, **settings)
        field = engine.render(self.scene, self.camera, self.hologram, settings)
        border = (self.hologram.width - self.truth.shape[2]) // 2
        inner = slice(border, -border)
        values = []
        for frames in FRAMES:
            pictures = engine.reconstruct(replace(field, data=field.data[:frames]), self.focus)
            pairs = zip(pictures[:, inner, inner], self.truth, strict=True)
            values.append(np.mean([engine.psnr(p, t) for p, t in pairs]))
        return field.plan["rays_per_pixel"], values

    def ladder(self, counts, **settings):
        """`psnr` over ray counts: arrays (counts,) and (counts, FRAMES)."""
        rungs = [self.psnr(spp, **settings) for spp in counts]
        return np.array([rays for rays, _ in rungs]), np.array([values for _, values in rungs])

    def paper(self, counts):
        """`ladder` of the paper's setting: its estimator, on a plane at the volume's far end."""
        return self.ladder(counts, estimator="paper", wrp=self.hologram.depth_far)

    def direct_rays(self, line, first):
        """Rays with which the direct method reaches `line` at M = 24; `first`, too few, is doubled until it does."""
        rays, values = [], []
        while not values or values[-1] < line:
            count, row = self.psnr(first << len(rays), method="direct")
            rays.append(count)
            values.append(row[-1])
        return crossing(rays, values, line)


def border(hologram):
    """Pixels at each edge that lose light of the near end to the SLM's aperture."""
    return math.ceil(hologram.max_slope(GREEN) * hologram.depth_near / PITCH) + 1


def view_of(scene, focus, width=PIXELS, depth_far=1e-3, thickness=THICKNESS, spp=256):
    """A scene on a square display, its volume from `depth_far` on."""
    hologram = engine.Hologram(width, width, PITCH, (GREEN,), depth_far, depth_far + thickness, near=NEAR)
    camera = engine.Camera(np.eye(4), FOV)
    truth = engine.reference(scene, camera, hologram, focus, spp=spp, near=NEAR, max_depth=1)
    inner = slice(border(hologram), -border(hologram))
    return JudgedScene(scene, hologram, camera, focus, truth[:, inner, inner])


def nearer(view, depth_far):
    """The same inner picture from a volume nearer to the SLM, on a display just large enough."""
    thickness = view.hologram.depth_near - view.hologram.depth_far
    hologram = replace(view.hologram, depth_far=depth_far, depth_near=depth_far + thickness)
    width = view.truth.shape[2] + 2 * border(hologram)
    hologram = replace(hologram, width=width, height=width)
    fov = 2 * math.atan(width / view.hologram.width * math.tan(view.camera.fov_x / 2))
    return replace(view, hologram=hologram, camera=replace(view.camera, fov_x=fov))


def crossing(rays, values, line):
    """Rays at which `values` first reach `line`, interpolated in log rays; infinite if they do not."""
    reached = np.flatnonzero(np.asarray(values) >= line)
    if not len(reached):
        return math.inf
    at = reached[0]
    if at == 0:
        return float(rays[0])
    share = (line - values[at - 1]) / (values[at] - values[at - 1])
    return float(rays[at - 1] * (rays[at] / rays[at - 1]) ** share)


def display(pixels):
    """Width, far end and thickness of a volume: on a smaller display all are as much smaller."""
    return pixels, 1e-3 * pixels / PIXELS, THICKNESS * pixels / PIXELS


def views(pixels=PIXELS):
    """Name and view of both scenes."""
    s = Scenes()
    return {
        "three_planes": view_of(s.three_planes(), PLANES, *display(pixels)),
        "floor": view_of(s.floor(), (0.6, 1.0, 3.0), *display(pixels)),
    }


def run(folder, thorough=False, pixels=PIXELS):
    """Tables as text; the chart goes to ``folder/convergence.png``.

    `thorough` adds the longest rungs: four times the rays at the paper's plane, and the direct method 25 mm from
    the SLM, which is otherwise extrapolated.
    """
    counts = (*COUNTS, THOROUGH) if thorough else COUNTS
    lines = [
        f"convergence: {pixels} x {pixels}, 8 µm, random fields; PSNR in dB, mean of three focus depths, and "
        "its ratio to the converged PSNR",
        "  converged is the last row of each method; direct's is that of the 5 mm plane, to whose field it converges",
    ]
    curves, marks = {}, {}
    for name, view in views(pixels).items():
        gray = np.mean([engine.psnr(np.ones_like(picture), picture) for picture in view.truth])
        lines.append(f"  {name}: an even gray picture has {gray:.2f} dB")
        paper, default = view.paper(counts), view.ladder(LATTICE)
        direct = view.ladder(counts, method="direct")
        line = LINE * paper[1][-1, -1]
        for method, ladder, converged in (
            (METHODS[0], direct, paper[1][-1]),
            (METHODS[1], paper, paper[1][-1]),
            (METHODS[2], default, default[1][-1]),
        ):
            curves[name, method] = ladder[0], ladder[1] / converged
            marks[name, method] = crossing(ladder[0], ladder[1][:, -1], line)
            lines += _table(f"{name}, {method}", *ladder, converged)
        asked, ours = marks[name, METHODS[1]], marks[name, METHODS[2]]
        lines.append(
            f"  {name}: the 5 mm plane reaches {LINE:.0%} of converged ({line:.2f} dB, M = 24) with {asked:.0f} rays, "
            f"the default reaches that PSNR with {ours:.0f}: {ours / asked:.4f}, 1/{asked / ours:.1f}"
        )
        own, same = (
            crossing(default[0], default[1][:, -1], v) for v in (LINE * default[1][-1, -1], line / LINE)
        )
        lines.append(
            f"  the default reaches {LINE:.0%} of its own converged PSNR with {own:.0f} rays, the 5 mm plane's "
            f"converged PSNR with {same:.0f}"
        )
    distances, rays, fit, text = _distance(counts, thorough, pixels / PIXELS)
    lines += text
    return drawn(
        "\n".join(lines),
        lambda: _chart(curves, marks, distances, rays, fit, Path(folder) / "convergence.png"),
    )


def _distance(counts, thorough, size):
    """Direct's rays for the line against the distance of the volume's near end, and the 5 mm plane's.

    All lengths are `size` times what they usually are.
    """
    width = round(FAR_WIDTH * size)
    view = view_of(Scenes().three_planes(), PLANES, width, FAR * size, THICKNESS * size)
    paper = view.paper(counts)
    line = LINE * paper[1][-1, -1]
    asked = crossing(paper[0], paper[1][:, -1], line)
    lines = _table(f"three_planes 20 to 25 mm from the SLM, {width}², {METHODS[1]}", *paper, paper[1][-1])
    lines.append(
        f"  {LINE:.0%} of converged ({line:.2f} dB, M = 24) with {asked:.0f} rays at the 5 mm plane; the direct "
        "method, the same inner picture on displays just large enough:"
    )
    distances, rays = [], []

    def measure(depth_far, first):
        own = nearer(view, depth_far)
        distances.append(own.hologram.depth_near)
        rays.append(own.direct_rays(line, first))
        lines.append(
            f"    volume {depth_far * 1e3:2.0f} to {distances[-1] * 1e3:2.0f} mm: {rays[-1]:8.0f} rays"
        )

    for depth_far in NEARER:
        measure(depth_far * size, round(rays[-1]) if rays else 1024)
    power, factor = np.polyfit(np.log(distances), np.log(rays), 1)
    most = view.hologram.depth_near
    guess = math.exp(factor) * most**power
    lines.append(
        f"  fit: rays grow as distance^{power:.2f}; extrapolated to {most * 1e3:.0f} mm {guess:.0f} rays, of which the "
        f"5 mm plane needs {asked / guess:.4f}, 1/{guess / asked:.1f}"
    )
    if thorough:
        measure(FAR * size, round(guess / 1.5))
        lines.append(f"  of those measured {asked / rays[-1]:.4f}, 1/{rays[-1] / asked:.1f}")
    return distances, rays, (power, factor, most, asked), lines


def planes_table(pixels=PIXELS, max_planes=8):
    """Rays in all, and PSNR at each focus depth, with 1 to 8 recording planes."""
    lines = [
        f"planes: {pixels} x {pixels}, 8 µm, M = 24; rays a pixel on all planes, PSNR in dB at each focus depth"
    ]
    for name, view in views(pixels).items():
        for j in range(1, max_planes + 1):
            settings = engine.Settings(frames=24, phase_field="random", max_depth=1, planes=j)
            field = engine.render(view.scene, view.camera, view.hologram, settings)
            inner = slice(border(view.hologram), -border(view.hologram))
            pictures = engine.reconstruct(field, view.focus)[:, inner, inner]
            values = [engine.psnr(p, t) for p, t in zip(pictures, view.truth, strict=True)]
            bright = pictures.mean() / view.truth.mean()
            lines.append(
                f"  {name:14s} J = {j}, {len(field.plan['planes'])} used  {field.plan['rays_per_pixel']:4d} rays  "
                + "".join(f"{v:6.1f}" for v in values)
                + f"   brightness {bright:.3f}"
            )
    return "\n".join(lines)


def _table(title, rays, values, converged):
    lines = [f"  {title}: M = " + ", ".join(map(str, FRAMES))]
    for count, row in zip(rays, values, strict=True):
        ratios = "".join(f"{r:6.3f}" for r in row / converged)
        lines.append(f"    {count:7d} rays " + "".join(f"{v:7.2f}" for v in row) + "   " + ratios)
    return lines


def _chart(curves, marks, distances, rays, fit, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(name for name, _ in curves))
    panels = [[*(f"{name}\n{method}" for method in METHODS), "distance"] for name in names]
    figure, axes = plt.subplot_mosaic(panels, figsize=(15, 7), layout="constrained")
    colors = plt.get_cmap("viridis")(np.linspace(0, 0.85, len(FRAMES)))
    for key, (counts, ratios) in curves.items():
        panel = axes["\n".join(key)]
        for column, frames in enumerate(FRAMES):
            panel.plot(counts, ratios[:, column], "o-", ms=3.5, color=colors[column], label=f"M = {frames}")
        for level in (PAPER_LINE, LINE):
            panel.axhline(level, color="0.4", ls="--", lw=0.9)
            panel.text(8e4, level - 0.005, f"{level:.0%}", va="top", ha="right", fontsize=8, color="0.3")
        panel.axvline(marks[key], color="tab:red", lw=1)
        panel.text(
            marks[key] * 0.93,
            0.37,
            f"{marks[key]:.0f} rays",
            rotation=90,
            color="tab:red",
            ha="right",
            fontsize=9,
        )
        panel.set(title="\n".join(key), xscale="log", xlim=(3, 1e5), ylim=(0.35, 1.05))
        panel.grid(alpha=0.25)
    for name in names:
        axes[f"{name}\n{METHODS[0]}"].set_ylabel("PSNR / converged PSNR")
    for method in METHODS:
        axes[f"{names[-1]}\n{method}"].set_xlabel("rays a pixel")
    axes[panels[0][2]].legend(fontsize=9, loc="lower right")
    power, factor, most, asked = fit
    panel = axes["distance"]
    span = np.array([distances[0], most])
    panel.plot(1e3 * span, np.exp(factor) * span**power, ":", color="0.4", label=f"fit, distance^{power:.2f}")
    panel.plot(1e3 * np.array(distances), rays, "o", color="tab:red", label="direct, measured")
    panel.axhline(asked, color="tab:blue", label=f"5 mm plane, {asked:.0f} rays")
    panel.set(
        xscale="log",
        yscale="log",
        xlabel="near end of the volume, mm from the SLM",
        title=f"three_planes: rays a pixel\nfor {LINE:.0%} of converged, M = 24",
    )
    ticks = [1e3 * distance for distance in (*distances, most)]
    panel.set_xticks(ticks, [f"{tick:.2g}" for tick in ticks])
    panel.minorticks_off()
    panel.grid(alpha=0.25)
    panel.legend(fontsize=9)
    figure.suptitle(f"Red: the PSNR of the 5 mm plane at {LINE:.0%} of converged is reached, M = 24")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
