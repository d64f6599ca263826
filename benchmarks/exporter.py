"""What the exporter carries over: every feature rendered by Mitsuba and by Cycles, and how far they are apart.

    python -m benchmarks exporter [NAME ...] [--pictures DIR] [--markdown FILE]

Both render the scenes of `features` from the same camera with as many samples, linear and without
denoising. Each picture is the mean of two of half the samples and another seed; half their difference tells
its noise.
"""

import argparse
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("BLENDER_USER_RESOURCES", tempfile.mkdtemp(prefix="holopath-bench-"))

import bpy
import numpy as np

from .features import BOUND, FEATURES, Feature
from .parts import Incomplete, attempt
from .stage import Stage

SPP = 512
BLOCK = 6
# Blocks darker than this share of their region's mean are compared with that share instead.
DARK = 0.05


@dataclass
class Comparison:
    """What one feature's two pictures differ by.

    Attributes
    ----------
    feature : Feature
    spp : int
        Samples a pixel of each picture.
    differences : dict of str to float
        Mean absolute relative difference by region.
    noise : float
        The largest such difference that the two pictures' noise alone makes in a region.
    brightness : float
        Ours over theirs, in the regions together.
    notes : list of Note
    seconds : float
    ours, theirs : array [y, x, 3]
    """

    feature: Feature
    spp: int
    differences: dict
    noise: float
    brightness: float
    notes: list
    seconds: float
    ours: np.ndarray
    theirs: np.ndarray

    @property
    def over(self):
        """Regions beyond the bound."""
        return [name for name, value in self.differences.items() if not value <= self.feature.bound]

    @property
    def unexpected(self):
        """Features of notes that were not expected, or expected and not made."""
        return {n.feature for n in self.notes if not n.effect.startswith("baked")} ^ self.feature.notes


def compare(feature, counts=(SPP,)):
    """Render a feature both ways.

    Parameters
    ----------
    feature : Feature
    counts : sequence of int
        Samples a pixel of each picture, ascending: the next number is only tried where the one before is not
        within the bound. Noise adds to the mean size of a difference, so what passes with few passes with many.

    Returns
    -------
    Comparison
        With as many samples as were needed, or the most.
    """
    start = time.perf_counter()
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    stage = Stage()
    feature.build(stage)
    stage.scene.view_layers[0].update()
    exported = stage.export(feature.resolution)
    if feature.reference:
        feature.reference(stage)
    for spp in counts:
        # two of half the samples tell their noise; while few are tried, one shows enough
        pictures = 2 if spp == counts[-1] else 1
        options = dict(resolution=feature.resolution, spp=spp // pictures, depth=feature.depth)
        ours = np.stack([stage.mitsuba(**options, exported=exported, seed=seed) for seed in range(pictures)])
        theirs = np.stack([unbiased_cycles(stage, seed, **options) for seed in range(pictures)])
        differences, noise, brightness = _apart(ours, theirs, feature.regions)
        seconds = time.perf_counter() - start
        result = Comparison(
            feature,
            spp,
            differences,
            noise,
            brightness,
            exported.notes,
            seconds,
            ours.mean(0),
            theirs.mean(0),
        )
        if not result.over:
            break
    return result


def unbiased_cycles(stage, seed, **options):
    """Cycles' picture without its biased shortcuts."""
    settings = stage.scene.cycles
    settings.seed = seed
    settings.blur_glossy = settings.light_sampling_threshold = 0
    settings.transparent_max_bounces = options["depth"]
    return stage.cycles(**options)


def _apart(ours, theirs, regions):
    """Differences by region, noise and brightness of two pairs of pictures [2, y, x, 3]; one each tells no noise."""
    ours, theirs = (_blocks(pair) for pair in (ours, theirs))
    rows, columns = ours.shape[1:3]
    x = (np.arange(columns) + 0.5) / columns * 2 - 1
    y = 1 - (np.arange(rows) + 0.5) / rows * 2
    inside = {name: region(x[None, :], y[:, None]) for name, region in regions.items()}
    differences, noise = {}, 0.0
    for name, chosen in inside.items():
        a, b = ours[:, chosen], theirs[:, chosen]
        unit = np.maximum(b.mean(0), DARK * b.mean())
        differences[name] = float(np.mean(np.abs(a.mean(0) - b.mean(0)) / unit))
        # the noise of a - b: both pictures' own, halves of the differences of their halves, in quadrature
        own = np.hypot(a[0] - a[-1], b[0] - b[-1]) / 2
        noise = max(noise, float(np.mean(own / unit)))
    every = np.any(list(inside.values()), axis=0)
    return differences, noise, float(ours[:, every].mean() / theirs[:, every].mean())


def _blocks(pictures):
    count, height, width, channels = pictures.shape
    return pictures.reshape(count, height // BLOCK, BLOCK, width // BLOCK, BLOCK, channels).mean((2, 4))


def chosen(names):
    """Features whose name or group holds one of the words; all without words."""
    picked = [
        feature
        for feature in FEATURES
        if not names or any(n.lower() in feature.name.lower() or n.lower() == feature.group for n in names)
    ]
    if not picked:
        sys.exit(f"No feature is called {' or '.join(names)}.")
    return picked


def run(names=(), pictures=None, markdown=None):
    """Table as text; contact sheets go to the folder `pictures`, the table in Markdown to a file."""
    start = time.perf_counter()
    rows, compared = [], []
    for feature in chosen(names):
        try:
            result = compare(feature)
        except Exception as error:  # a feature that fails is a row of the table, and the others still count
            rows.append((feature, "failed", "", "", f"{type(error).__name__}: {error}"))
        else:
            compared.append(result)
            rows.append((feature, *_cells(result)))
        print(_line(rows[-1]), file=sys.stderr, flush=True)
    faults = [f"{feature.name}: {why}" for feature, verdict, *_, why in rows if verdict == "failed"]
    if pictures:
        attempt(faults, "pictures", lambda: _contact_sheets(compared, Path(pictures)))
    summary = _summary(rows, compared, time.perf_counter() - start)
    if markdown:
        Path(markdown).write_text(_markdown(rows, summary))
    table = "\n".join(["exporter: mean difference from Cycles", *map(_line, rows), "  " + summary])
    if faults:
        raise Incomplete(table, faults)
    return table


def _cells(result):
    differences = ", ".join(f"{name} {100 * value:.1f}" for name, value in result.differences.items())
    verdict = "over" if result.over else "notes" if result.unexpected else "pass"
    notes = "; ".join(dict.fromkeys(note.feature for note in result.notes))
    return verdict, differences, f"{100 * result.noise:.1f} {result.brightness:.3f}", notes


def _line(row):
    feature, verdict, differences, noise, notes = row
    bound = f"{100 * feature.bound:.0f}"
    return f"  {feature.name:58.58s} {differences:30s} {noise:10s} {bound:>3s} {verdict:6s} {notes}"


def _summary(rows, compared, seconds):
    passed = sum(row[1] == "pass" for row in rows)
    noise = np.array([result.noise for result in compared] or [0])
    return (
        f"{passed} of {len(rows)} pass; noise {100 * np.median(noise):.1f} % (median), at most "
        f"{100 * noise.max():.1f} %; {seconds:.0f} s, {SPP} samples a pixel, blocks of {BLOCK} x {BLOCK} pixels"
    )


def _markdown(rows, summary):
    lines = [
        "| feature | difference from Cycles, % | noise, % | brightness | bound, % | | notes |",
        "|---|---|---|---|---|---|---|",
    ]
    for feature, verdict, differences, noise, notes in rows:
        noise, brightness = noise.split() if noise else ("", "")
        bound = f"{100 * feature.bound:.0f}" + (f" ({feature.reason})" if feature.bound != BOUND else "")
        lines.append(
            f"| {feature.name} | {differences} | {noise} | {brightness} | {bound} | {verdict} | {notes} |"
        )
    return "\n".join([*lines, "", summary, ""])


def _contact_sheets(compared, folder, columns=5, scale=2, gap=14):
    """A picture a group, each feature by Cycles, by Mitsuba, and their relative difference.

    Differences run to 20 %: blue where ours is darker, red where it is brighter.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    for group in dict.fromkeys(result.feature.group for result in compared):
        own = [result for result in compared if result.feature.group == group]
        side = gap + scale * max(max(result.feature.resolution) for result in own)
        canvas = np.ones((-(-len(own) // columns) * side, 3 * columns * side, 3))
        figure = plt.figure(figsize=(canvas.shape[1] / 100, canvas.shape[0] / 100), dpi=100)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.axis("off")
        for number, result in enumerate(own):
            top, left = number // columns * side, number % columns * 3 * side
            axes.text(left + 2, top + gap - 3, result.feature.name[:60], fontsize=7)
            for step, image in enumerate(_displayed(result, plt.get_cmap("RdBu_r"))):
                image = image.repeat(scale, axis=0).repeat(scale, axis=1)
                height, width = image.shape[:2]
                start = left + step * side
                canvas[top + gap : top + gap + height, start : start + width] = image
        axes.imshow(canvas, interpolation="nearest")
        figure.savefig(folder / f"{group}.png")
        plt.close(figure)


def _displayed(result, colors):
    """Both pictures as a screen shows them, and the map of their difference."""
    white = max(np.percentile(result.theirs, 98), 1e-6)
    both = [np.clip(image / white, 0, 1) ** (1 / 2.2) for image in (result.theirs, result.ours)]
    ours, theirs = result.ours.mean(2), result.theirs.mean(2)
    relative = (ours - theirs) / np.maximum(theirs, DARK * theirs.mean() + 1e-9)
    return [*both, colors(np.clip(0.5 + relative / 0.4, 0, 1))[..., :3]]


def main(*arguments):
    """The table as text, by the command's own options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks exporter", description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", help="groups, or words in the names of features; default: all")
    parser.add_argument("--pictures", metavar="DIR", help="write contact sheets, a PNG a group")
    parser.add_argument("--markdown", metavar="FILE", help="write the table in Markdown")
    options = parser.parse_args(arguments)
    return run(options.names, options.pictures, options.markdown)
