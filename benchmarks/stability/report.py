"""Walk the sweeps; a table in docs/stability.md, a plot for each group, and the rows as JSON."""

import json
import math
import sys
from pathlib import Path

from holopath_addon.engine import InvalidInput

from ..parts import Incomplete, attempt
from .sweep import LIMITS, faults, steps, walk

GROUPS = ("scenes", "roughness", "displays")
DOCS, ROWS = Path("docs"), "stability.json"
NOT_FIGURES = ("refused", "warned")
COLUMNS = 4  # of small multiples

INTRODUCTION = """# Where models break

At which edges could HoloPath's models fail, and do they? Each sweep below walks one parameter across such an edge in
small steps. It measures a figure that physics keeps flat, or divides it by the law that it follows.

- **PSNR** is against a truth of its own for each value: Mitsuba's thin-lens camera, torchoptics' angular spectrum
  method, or an analytic answer.
- **Brightness** is over that of the truth.
- **Largest step** is between neighbors. PSNR may step by {psnr:g} dB and brightness by {brightness:.0%}. Nothing may be
  no number, or end in an exception. Where pictures must get worse or better by physics, the largest step is left out or
  counts only falls, and the last column says so.

`python -m benchmarks stability` walks all sweeps and writes this page. `python -m benchmarks stability pitch rays`
walks those that are named, and takes the others' rows from out/bench/stability.json. Where some have no rows yet, the
page goes to out/bench. Tests in tests/stability walk a few values of each, and `python -m benchmarks stability quick`
walks those, for a page in out/bench, too. The command ends with the steps that are larger than they may be.

Kernels are cut to whole pixels of a lattice. Where the lattice gains or loses a ring, PSNR changes by up to 0.7 dB.
Values lie densely where several rings follow each other. There a rough mirror's surface loses 1.5 dB between alpha
0.006 and 0.007, in three steps.

In the plots blue is PSNR in dB, or gigabytes. Orange is brightness and other ratios. Red dots mark what is refused.
"""


def groups():
    """Sweeps by the module that has them."""
    from . import displays, roughness, scenes

    return {module.__name__.rpartition(".")[2]: module.SWEEPS for module in (scenes, roughness, displays)}


def run(folder, *names):
    """Walk sweeps, and write the page, the plots and the rows.

    Parameters
    ----------
    folder : path
        Of the rows, which are kept for sweeps that are not walked.
    *names : str
        Of sweeps. Default: all. First may be ``quick``: only the values of the tests, and the page goes to the folder.

    Returns
    -------
    str
        What is at fault, a line each; or that nothing is.

    Raises
    ------
    Incomplete
        Where a sweep could not be walked: the page has the others.
    """
    known = groups()
    every = [sweep for sweeps in known.values() for sweep in sweeps]
    quick = names[:1] == ("quick",)
    names = names[quick:]
    unknown = set(names) - {sweep.name for sweep in every}
    if unknown:
        raise InvalidInput(
            f"There is no sweep {', '.join(sorted(unknown))}: choose of {', '.join(s.name for s in every)}."
        )
    file = Path(folder) / (f"quick-{ROWS}" if quick else ROWS)
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = json.loads(file.read_text()) if file.exists() else {}
    found, broken = [], []
    for sweep in every:
        if names and sweep.name not in names:
            continue
        if quick and not sweep.quick:
            continue

        def walked(sweep=sweep):
            values = sweep.quick if quick else None
            return walk(sweep, values, progress=lambda value, figures: _tell(sweep, value, figures))

        own = attempt(broken, sweep.name, walked)
        if own:
            rows[sweep.name] = own
            file.write_text(json.dumps(rows, indent=1, default=float))
            found += faults(sweep, own)
    is_whole = not quick and all(sweep.name in rows for sweep in every)
    attempt(broken, "page", lambda: write(known, rows, DOCS if is_whole else Path(folder)))
    text = "\n".join(found or ["stability: no faults"])
    if broken:
        raise Incomplete(text, broken)
    return text


def write(known, rows, docs):
    """The page and the plots of the sweeps that have rows.

    Parameters
    ----------
    known : dict of str to list of Sweep
        By group.
    rows : dict of str to list
        Value and figures, by the sweep's name.
    docs : Path
        Folder of the page.
    """
    text, images = [INTRODUCTION.format(**LIMITS)], docs / "images"
    images.mkdir(parents=True, exist_ok=True)
    for group, sweeps in known.items():
        have = [(sweep, rows[sweep.name]) for sweep in sweeps if sweep.name in rows]
        if not have:
            continue
        text.append(f"\n## {group.capitalize()}\n\n![{group}](images/stability-{group}.png)\n")
        text.append(
            "| sweep | edge | range | PSNR, largest step | brightness, largest step | where it breaks |"
        )
        text.append("| --- | --- | --- | --- | --- | --- |")
        text += [_line(sweep, walked) for sweep, walked in have]
        _chart(have, images / f"stability-{group}.png")
    (docs / "stability.md").write_text("\n".join(text) + "\n")


def _tell(sweep, value, figures):
    said = ", ".join(f"{name} {f if isinstance(f, str) else format(f, '.4g')}" for name, f in figures.items())
    print(f"{sweep.name}: {value:g} {sweep.parameter}: {said}", file=sys.stderr, flush=True)


def _line(sweep, rows):
    values = [value for value, _ in rows]
    ends = f"{min(values):g} to {max(values):g} {sweep.parameter}"
    shown = {name: _steps(sweep, rows, name) for name in LIMITS}
    others = [_steps(sweep, rows, name, True) for name in sweep.limits if name not in LIMITS]
    brightness = "; ".join(part for part in (shown["brightness"], *others) if part)
    cells = (sweep.name, sweep.edge, ends, shown["psnr"], brightness, sweep.then)
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def _steps(sweep, rows, name, named=False):
    """Range and largest step of a figure, in words; nothing where it has no limit."""
    figures = [f[name] for _, f in rows if name in f]
    if name not in sweep.limits or not figures:
        return ""
    largest = max((step for *_, step in steps(sweep, rows, name)), default=0.0)
    if name == "psnr":
        return f"{min(figures):.1f} to {max(figures):.1f} dB, {largest:.2f} dB"
    return f"{f'{name} ' if named else ''}{min(figures):.3f} to {max(figures):.3f}, {largest:.1%}"


def _chart(have, path):
    """Small multiples: PSNR to the left, brightness and others with limits to the right; refusals as crosses."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    lines = math.ceil(len(have) / COLUMNS)
    size = (3.1 * COLUMNS, 2.3 * lines)
    figure, axes = plt.subplots(lines, COLUMNS, figsize=size, layout="constrained", squeeze=False)
    for axis in axes.flat[len(have) :]:
        axis.set_visible(False)
    for axis, (sweep, rows) in zip(axes.flat, have, strict=False):
        ratios = [name for name in sweep.limits if name != "psnr"]
        _draw(axis, rows, [n for n in _names(rows) if n.startswith("psnr")], "tab:blue", "-")
        if not ratios:
            _draw(axis, rows, [n for n in _names(rows) if not n.startswith("psnr")][:1], "tab:blue", "-")
        right = axis.twinx()
        for name, style in zip(ratios, ("-", "--", ":"), strict=False):
            _draw(right, rows, [name], "tab:orange", style)
        if not ratios:
            right.set_yticks([])
        low, high = right.get_ylim()
        if ratios and high - low < 0.2:  # what is flat should look flat
            right.set_ylim((low + high) / 2 - 0.1, (low + high) / 2 + 0.1)
        low, high = axis.get_ylim()
        if high - low < 4 and _names(rows)[:1] == ["psnr"]:
            axis.set_ylim((low + high) / 2 - 2, (low + high) / 2 + 2)
        for value, figures in rows:
            if "refused" in figures:
                axis.axvline(value, color="tab:red", linestyle=":", linewidth=1)
        if sweep.log:
            axis.set_xscale("symlog" if min(v for v, _ in rows) <= 0 else "log")
        axis.set_title(sweep.name, fontsize=9)
        axis.set_xlabel(sweep.parameter, fontsize=8)
        for side, color in ((axis, "tab:blue"), (right, "tab:orange")):
            side.tick_params(labelsize=7, axis="y", colors=color)
            side.tick_params(labelsize=7, axis="x")
    figure.savefig(path, dpi=70)
    plt.close(figure)


def _names(rows):
    return list(dict.fromkeys(name for _, figures in rows for name in figures if name not in NOT_FIGURES))


def _draw(axis, rows, names, color, style):
    for name in names:
        points = [(value, figures[name]) for value, figures in rows if name in figures]
        if points:
            thin = name not in ("psnr", "brightness")
            axis.plot(
                *zip(*points, strict=True), style, color=color, marker=".", lw=0.8 if thin else 1.2, ms=3
            )
