"""The chart's pictures."""

import math

import numpy as np

from ..parts import attempt
from . import looks, measure
from .analysis import is_phases, pareto
from .methods import FRAMES, SHOWN, M
from .scenes import SCENES

OURS = {
    "auto": "black",
    "full": "magenta",
    "fast": "gold",
    "auto-opl": "dimgrey",
    "paper": "saddlebrown",
    "direct": "teal",
}
CLOSE = 120  # pixels along the side of a close-up
COLUMNS = 4


def draw(chart, records, triangles, table, shown, measured, folder, faults):
    """Write all pictures that there is something for; one that fails is left out.

    Parameters
    ----------
    chart : Chart
    records : list of dict
    triangles : list of dict
        Seconds by method and triangles.
    table : (list of str, dict)
        Of `analysis.table_1`.
    shown : dict of int to dict
        By seconds and scene, of `analysis.over_frames`.
    measured : sequence of str
        Scenes whose pictures are kept beside their records, for close-ups.
    folder : path
    faults : list of str
        Takes what failed and why.

    Returns
    -------
    list of str
        File names of those that are there.
    """
    import matplotlib

    matplotlib.use("Agg")
    names = list(dict.fromkeys(record["method"] for record in records))
    others = [name for name in names if name not in OURS]
    palette = matplotlib.colormaps["tab20"]
    colors = {name: palette(k % 20) for k, name in enumerate(others)} | OURS
    scenes = [name for name in SCENES if _own(records, name)]
    files = {}
    if scenes:
        files["chart-seconds.png"] = lambda path: _seconds(records, scenes, colors, path)
        files["chart-convergence.png"] = lambda path: _convergence(records, scenes, colors, path)
    if table[1]:
        files["chart-table-1.png"] = lambda path: _table(table[0], table[1], path)
    if any(any(own.values()) for own in shown.get(max(shown, default=0), {}).values()):
        files["chart-frames.png"] = lambda path: _frames(shown, scenes, colors, path)
    if triangles:
        files["chart-triangles.png"] = lambda path: _triangles(triangles, colors, path)
    for scene in measured:
        files[f"chart-closeups-{scene}.jpg"] = lambda path, scene=scene: _close_ups(
            chart, records, scene, path
        )
    for name, write in files.items():
        (folder / name).unlink(missing_ok=True)  # of an earlier chart
        attempt(faults, name, lambda write=write, name=name: write(folder / name))
    return [name for name in files if (folder / name).exists()]


def _panels(count, rows=1, width=4.0, height=3.4):
    import matplotlib.pyplot as plt

    columns = min(COLUMNS, count)
    lines = math.ceil(count / columns)
    figure, axes = plt.subplots(
        lines * rows,
        columns,
        figsize=(width * columns, height * lines * rows),
        layout="constrained",
        squeeze=False,
    )
    return figure, axes


def _save(figure, path, dpi=80):
    import matplotlib.pyplot as plt

    figure.savefig(path, dpi=dpi)
    plt.close(figure)


def _own(records, scene):
    """Records of M frames of a scene by method, in order of their efforts, but for fields' phases."""
    by_method = {}
    for record in records:
        if record["scene"] == scene and record["frames"] == M and record["effort"] != SHOWN:
            by_method.setdefault(record["method"], []).append(record)
    return by_method


def _seconds(records, scenes, colors, path):
    """PSNR over seconds: mean above, worst below."""
    from matplotlib.ticker import LogLocator, NullFormatter

    figure, axes = _panels(len(scenes), 2)
    for axis in axes.flat:
        axis.set_visible(False)
    columns = axes.shape[1]
    for number, scene in enumerate(scenes):
        for below, figure_name in enumerate(("psnr", "psnr_worst")):
            axis = axes[2 * (number // columns) + below, number % columns]
            axis.set_visible(True)
            points = []
            for name, own in _own(records, scene).items():
                width = 2.2 if name == "auto" else 1
                for phases, style in ((False, "o-"), (True, "o--")):
                    places = sorted((r["seconds"], r[figure_name]) for r in own if is_phases(r) == phases)
                    if places:
                        axis.plot(
                            *zip(*places, strict=True), style, color=colors[name], lw=width, ms=4, label=name
                        )
                    points += places
            front = [points[k] for k in pareto(points)]
            axis.plot(
                *zip(*front, strict=True), "o", mfc="none", mec="k", ms=10, mew=0.8, label="Pareto front"
            )
            axis.step(*zip(*front, strict=True), where="post", color="k", lw=0.6, ls=":")
            axis.set_xscale("log")
            axis.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.set_title(f"{scene}, {'worst' if below else 'mean'}", fontsize=10)
            axis.set_xlabel("seconds", fontsize=8)
            axis.set_ylabel("PSNR, dB", fontsize=8)
            axis.grid(alpha=0.3, which="both")
    _legend(figure, axes)
    _save(figure, path)


def _legend(figure, axes):
    """One legend for all panels, below them."""
    labels = {}
    for axis in axes.flat:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            labels.setdefault(label, handle)
    figure.legend(
        labels.values(),
        labels.keys(),
        loc="outside lower center",
        ncols=min(6, 3 * axes.shape[1]),
        fontsize=8,
    )


def _convergence(records, scenes, colors, path):
    """PSNR, mean, over the number of the effort, from the least."""
    figure, axes = _panels(len(scenes))
    for axis in axes.flat[len(scenes) :]:
        axis.set_visible(False)
    for axis, scene in zip(axes.flat, scenes, strict=False):
        for name, own in _own(records, scene).items():
            values = [record["psnr"] for record in own]
            axis.plot(range(1, len(own) + 1), values, "o-", color=colors[name], label=name, ms=4, lw=1)
        axis.set_title(scene, fontsize=10)
        axis.set_xlabel("effort, from the least", fontsize=8)
        axis.set_ylabel("PSNR, dB", fontsize=8)
        axis.xaxis.get_major_locator().set_params(integer=True)
        axis.grid(alpha=0.3)
    _legend(figure, axes)
    _save(figure, path)


def _frames(shown, scenes, colors, path):
    """PSNR of phases over frames: mean above, worst below; within the most seconds, and dashed the fewest."""
    from matplotlib.ticker import NullLocator

    figure, axes = _panels(len(scenes), 2)
    for axis in axes.flat:
        axis.set_visible(False)
    columns = axes.shape[1]
    for number, scene in enumerate(scenes):
        for below, figure_name in enumerate(("psnr", "psnr_worst")):
            axis = axes[2 * (number // columns) + below, number % columns]
            axis.set_visible(True)
            for budget, style in ((max(shown), "o-"), (min(shown), ".--")):
                for name, own in shown[budget][scene].items():
                    places = [(m, own[m][figure_name]) for m in sorted(own)]
                    if places:
                        width = 2.2 if name == "auto" else 1
                        label = name if budget == max(shown) else None
                        axis.plot(
                            *zip(*places, strict=True),
                            style,
                            color=colors[name],
                            lw=width,
                            ms=4,
                            label=label,
                        )
            axis.set_xscale("log")
            axis.set_xticks(FRAMES, FRAMES)
            axis.xaxis.set_minor_locator(NullLocator())
            axis.set_title(f"{scene}, {'worst' if below else 'mean'}", fontsize=10)
            axis.set_xlabel("frames", fontsize=8)
            axis.set_ylabel("PSNR, dB", fontsize=8)
            axis.grid(alpha=0.3)
    _legend(figure, axes)
    _save(figure, path)


def _triangles(triangles, colors, path):
    figure, axes = _panels(1, width=6, height=4)
    axis = axes.flat[0]
    for name in dict.fromkeys(row["method"] for row in triangles):
        own = sorted((row["triangles"], row["seconds"]) for row in triangles if row["method"] == name)
        axis.plot(*zip(*own, strict=True), "o-", color=colors.get(name), label=name)
    axis.set(xscale="log", yscale="log", xlabel="triangles", ylabel="seconds")
    axis.grid(alpha=0.3, which="both")
    axis.legend(fontsize=8)
    _save(figure, path)


def _table(criteria, rows, path):
    """Table 1: green is good, red poor, by rank in a column."""
    import matplotlib

    cells = np.array([[np.nan if v is None else v for v in row] for row in rows.values()], float)
    shade = np.full(cells.shape, np.nan)
    for column, name in enumerate(criteria):
        known = np.flatnonzero(np.isfinite(cells[:, column]))
        order = cells[known, column] * (1 if "dB" in name else -1)
        rank = np.searchsorted(np.unique(order), order)
        shade[known, column] = rank / max(1, rank.max(initial=0)) if rank.any() else 1
    figure, axes = _panels(1, width=13, height=0.9 + 0.32 * len(rows))
    axis = axes.flat[0]
    colors = matplotlib.colormaps["RdYlGn"].with_extremes(bad="white")
    axis.imshow(np.ma.masked_invalid(shade), cmap=colors, vmin=-0.3, vmax=1.3, aspect="auto", alpha=0.7)
    for (row, column), value in np.ndenumerate(cells):
        if np.isfinite(value):
            text = f"{value:.1f}" if "dB" in criteria[column] else f"{value:.3g}"
            axis.text(column, row, text, ha="center", va="center", fontsize=9)
    axis.set_xticks(range(len(criteria)), [c.replace(": ", "\n") for c in criteria], fontsize=8)
    axis.xaxis.tick_top()
    axis.set_yticks(range(len(rows)), rows, fontsize=9)
    axis.tick_params(length=0)
    _save(figure, path)


def _close_ups(chart, records, scene, path):
    """Rows of looks, columns of methods at their best, the reference first."""
    truth = measure.truth_path(chart.task(scene, "reference", []))
    border = looks.border_of(chart.hologram)
    columns = {}
    if truth.exists():
        with np.load(truth) as file:
            columns["reference"] = measure.displayed(file["pictures"].mean(1), dict(file), border)
    for name, own in _own(records, scene).items():
        best = max(own, key=lambda record: record["psnr"])
        file = measure.record_path(chart.task(scene, name, []), best["effort"], M).with_suffix(".npz")
        if file.exists():
            columns[f"{name}\n{best['seconds']:.3g} s, {best['psnr']:.1f} dB"] = dict(np.load(file))
    if not columns:
        return
    figure, axes = _subplots(len(measure.SHOWN), len(columns))
    for column, (title, shown) in enumerate(columns.items()):
        for row, name in enumerate(measure.SHOWN):
            axis, picture = axes[row, column], shown[name]
            rows, width = picture.shape[:2]
            half = min(CLOSE, rows, width) // 2
            part = picture[rows // 2 - half : rows // 2 + half, width // 2 - half : width // 2 + half]
            axis.imshow(part)
            axis.set_xticks([])
            axis.set_yticks([])
            if column == 0:
                axis.set_ylabel(name, fontsize=8)
        axes[0, column].set_title(title, fontsize=7)
    _save(figure, path, 110)


def _subplots(rows, columns):
    import matplotlib.pyplot as plt

    return plt.subplots(
        rows, columns, figsize=(1.35 * columns, 1.45 * rows + 0.3), layout="constrained", squeeze=False
    )
