"""`holopath report`: what a viewer gets of a stored hologram, as one page and a table."""

import base64
import csv
import html
import io
import math
from pathlib import Path

import numpy as np

from .. import engine, output
from ..engine.progress import parts
from ..engine.viewing import assessment
from ..engine.viewing.reconstruction import Refocuser
from .console import Progress

FOCI, POSITIONS, SHARE, VIEWS, SLICE = 13, 5, 0.5, 9, 0.25
STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.5rem}figure{margin:1rem 0;overflow-x:auto}
figcaption,small{color:#555}img{image-rendering:pixelated;max-width:100%}
table{border-collapse:collapse}td,th{padding:.3rem .6rem;text-align:right;font-variant-numeric:tabular-nums}
.pictures{display:flex;flex-wrap:wrap;gap:.5rem}.pictures figure{flex:1 1 14rem;margin:0}.pictures img{width:100%}
"""


def add(command):
    """Add the command, see `render_command.add`."""
    report = command(
        "report", _report, "Show what a viewer gets of a stored hologram, as a page for a browser."
    )
    report.add_argument("folder", metavar="DIR", help="output folder of `holopath render` or `import`")
    report.add_argument(
        "--out", metavar="FILE", help="page (default DIR/report.html); its table lies beside it, as .csv"
    )


def _report(args):
    progress, folder = Progress(quiet=args.quiet), Path(args.folder)
    page = Path(args.out) if args.out else folder / "report.html"
    if page.suffix.lower() not in (".html", ".htm"):
        raise engine.InvalidInput(f"{page} is no page: end its name on .html.")
    phase = output.stored_hologram(folder) if (folder / "hologram").is_dir() else None
    lone = phase is not None and not (folder / "wavefield").is_dir()
    field = phase.field() if lone else output.stored_field(folder)
    rows, sections, depths = [], [], _depths(field)
    refocus, middle = Refocuser(field), depths[FOCI // 2]
    focusing, looking, moving, comparing = parts(progress, 4)
    images = refocus(depths, progress=focusing)
    rows += _focus(sections, field, depths, images)
    rows += _eyebox(sections, refocus, middle, images[FOCI // 2], looking)
    _parallax(sections, refocus, middle, moving)
    if phase is not None:
        rows += _phases(sections, phase, None if lone else refocus, middle, comparing)
    _write(page, folder, field, sections, rows)
    progress(1.0, f"Done: {page}")


def _depths(field):
    """Distances evenly spread over the volume, in world meters."""
    hologram = field.hologram
    ends = hologram.depth_far, hologram.depth_near
    low, high = field.plan.get("z_low", ends[0]), field.plan.get("z_high", ends[1])
    return [float(field.mapping.z_to_depth(z)) for z in np.linspace(low, high, FOCI)]


def _focus(sections, field, depths, images):
    rgb = engine.to_rgb(images, field.hologram.wavelengths)
    white = output.exposure(rgb)
    chosen = (0, FOCI // 2, FOCI - 1)
    pictures = "".join(_picture(rgb[n], white, f"Focus at {_named(depths[n])}") for n in chosen)
    curves = assessment.sharpness(images)
    sections.append(("Pictures", f'<div class="pictures">{pictures}</div>'))
    text = (
        "<p>Sharpness of nine parts of the picture over the distance of focus. Each has its peak where its surfaces "
        "lie.</p>"
    )
    sections.append(("Focus", text + _curves(depths, curves.reshape(len(depths), -1))))
    return [
        ("sharpness", f"focus {_named(depth)}, row {row + 1}, column {column + 1}", curves[n, row, column])
        for n, depth in enumerate(depths)
        for row in range(assessment.PATCHES)
        for column in range(assessment.PATCHES)
    ]


def _eyebox(sections, refocus, focus, whole, progress):
    field = refocus.field
    grid = assessment.pupils(field, SHARE, POSITIONS)
    found = np.full((POSITIONS, POSITIONS), math.nan)
    for row, line in enumerate(grid):
        for column, pupil in enumerate(line):
            progress((row * POSITIONS + column) / POSITIONS**2, "Eyebox")
            if pupil is not None:
                picture = refocus([focus], pupil)[0]
                found[row, column] = assessment.brightness(field, picture, whole, pupil)
    radius = assessment.pupil_radius(field)
    text = (
        f"<p>The pupil that all colors fill is {2e3 * radius:.3g} mm wide. How bright is the picture for an eye whose "
        f"pupil has half of that, wherever it is? 1 is an even eyebox.</p>{_map(found, '{:.2f}')}"
    )
    sections.append(("Eyebox", text))
    return _of_map("eyebox brightness", grid, found)


def _parallax(sections, refocus, focus, progress):
    field = refocus.field
    reach = assessment.pupil_radius(field) * (1 - SLICE)
    seen = [
        engine.Pupil(float(x), 0.0, 2 * SLICE * assessment.pupil_radius(field))
        for x in np.linspace(-reach, reach, VIEWS)
    ]
    progress(0.0, "Parallax")
    lines = assessment.slices(refocus, focus, seen, field.hologram.height // 2)
    picture = np.repeat(lines, 12, axis=0)
    text = (
        f"The middle row of the picture, through a quarter of the pupil that goes from left to right, over "
        f"{2e3 * reach:.3g} mm; focus at {_named(focus)}. What stands still lies at the focus; what leans lies before "
        "it or behind it."
    )
    sections.append(("Parallax", _picture(picture, output.exposure(lines), text)))


def _phases(sections, phase, refocus, focus, progress):
    shares = assessment.efficiency(phase)
    names = [f"{w * 1e9:.4g} nm" for w in phase.hologram.wavelengths]
    cells = "".join(
        f"<tr><th>{name}</th><td>{share:.0%}</td></tr>" for name, share in zip(names, shares, strict=True)
    )
    text = (
        "<p>Of the light that the pixels send out, so much stays within the cone that makes the picture.</p>"
        f"<table>{cells}</table>"
    )
    rows = [("efficiency", name, share) for name, share in zip(names, shares, strict=True)]
    if refocus is not None:
        shown = Refocuser(phase.field())
        grid = assessment.pupils(refocus.field, SHARE, POSITIONS)
        found = np.full((POSITIONS, POSITIONS), math.nan)
        for row, line in enumerate(grid):
            for column, pupil in enumerate(line):
                progress((row * POSITIONS + column) / POSITIONS**2, "Phases")
                if pupil is not None:
                    views = shown([focus], pupil), refocus([focus], pupil)
                    (found[row, column],) = assessment.loss(*views)
        (middle,) = assessment.loss(shown([focus]), refocus([focus]))
        text += (
            "<p>How near do pictures of the phases come to those of the complex field? "
            f"{middle:.1f} dB through the whole pupil; through half of it, wherever it is:</p>{_map(found, '{:.1f}')}"
        )
        rows += [("phases, dB", "whole pupil", middle), *_of_map("phases, dB", grid, found)]
    sections.append((f"Phases ({html.escape(phase.method)})", text))
    return rows


def _of_map(what, grid, values):
    return [
        (what, f"pupil at {1e3 * pupil.x:.3g}, {1e3 * pupil.y:.3g} mm", values[row, column])
        for row, line in enumerate(grid)
        for column, pupil in enumerate(line)
        if pupil is not None
    ]


def _named(depth):
    return "infinity" if math.isinf(depth) else f"{depth:.3g} m"


def _picture(rgb, white, text):
    data, text = base64.b64encode(output.encode_png(rgb, white)).decode(), html.escape(text)
    picture = f'<img alt="{text}" src="data:image/png;base64,{data}">'
    return f"<figure>{picture}<figcaption>{text}</figcaption></figure>"


def _map(values, form):
    """A table whose cells are as dark as their values are low."""
    known = values[np.isfinite(values)]
    low, high = (known.min(), known.max()) if known.size else (0.0, 1.0)
    lines = []
    for row in values:
        cells = []
        for value in row:
            if not math.isfinite(value):
                cells.append("<td></td>")
                continue
            light = 55 + 40 * (value - low) / (high - low if high > low else 1)
            cells.append(f'<td style="background:hsl(210 60% {light:.0f}%)">{form.format(value)}</td>')
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return f"<figure><table>{''.join(lines)}</table></figure>"


def _curves(depths, values):
    """Lines over the distance, each of its own height: where its peak is counts."""
    width, height = 720, 200
    tops = np.maximum(values.max(0), 1e-30)
    x = np.linspace(0, width, len(depths))
    lines, key = [], []
    for n, curve in enumerate((values / tops).T):
        points = " ".join(f"{a:.1f},{height * (1 - b):.1f}" for a, b in zip(x, curve, strict=True))
        color = f"hsl({360 * n / values.shape[1]:.0f} 65% 45%)"
        lines.append(f'<polyline fill="none" stroke="{color}" stroke-width="2" points="{points}"/>')
        row, column = divmod(n, assessment.PATCHES)  # the key is a small picture
        where = f'x="{18 * column}" y="{14 * row - 50}" width="16" height="12"'
        key.append(f'<rect {where} fill="{color}"/>')
    words = "".join(
        f'<text x="{a:.0f}" y="{height + 18}" font-size="12" text-anchor="{anchor}">{_named(depths[n])}</text>'
        for n, a, anchor in ((0, 0, "start"), (len(depths) // 2, width / 2, "middle"), (-1, width, "end"))
    )
    box = f'viewBox="-5 -55 {width + 10} {height + 80}"'
    drawn = "".join([*key, *lines])
    return f'<figure><svg role="img" aria-label="Sharpness over focus" {box}>{drawn}{words}</svg></figure>'


def _write(page, folder, field, sections, rows):
    hologram = field.hologram
    facts = (
        f"{hologram.width} × {hologram.height} pixels of {hologram.pitch * 1e6:.4g} µm, "
        f"{', '.join(f'{w * 1e9:.4g}' for w in hologram.wavelengths)} nm, {len(field.data)} frames"
    )
    body = "".join(f"<h2>{title}</h2>{text}" for title, text in sections)
    name = html.escape(folder.resolve().name)
    table = io.StringIO()
    csv.writer(table, lineterminator="\n").writerows([("what", "where", "value"), *rows])
    text = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{name}</title><style>{STYLE}</style></head><body><h1>{name}</h1><p>{facts}</p>{body}"
        f"<p><small>All figures: {html.escape(page.with_suffix('.csv').name)}</small></p></body></html>\n"
    )
    files = {
        page.with_suffix(".csv").name: table.getvalue().encode(),
        page.name: text.encode("ascii", "xmlcharrefreplace"),
    }
    output.write_pictures(page.parent, files)
