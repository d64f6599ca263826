"""Page of `holopath report`: images, maps and curves as self-contained HTML."""

import base64
import csv
import html
import io
import math

import numpy as np

from ..engine.pixels import in_words
from ..engine.viewing import assessment, bench_sketch
from ..workflow import output

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.5rem}figure{margin:1rem 0;overflow-x:auto}
figcaption,small{color:#555}img{image-rendering:pixelated;max-width:100%}
table{border-collapse:collapse}td,th{padding:.3rem .6rem;text-align:right;font-variant-numeric:tabular-nums}
.pictures{display:flex;flex-wrap:wrap;gap:.5rem}.pictures figure{flex:1 1 14rem;margin:0}.pictures img{width:100%}
td[style]{color:#222}
@media(prefers-color-scheme:dark){body{color:#ddd;background:#181818}figcaption,small{color:#aaa}}
"""


def named(depth):
    """Distance in words.

    Parameters
    ----------
    depth : float
        Meters.

    Returns
    -------
    str
    """
    return "infinity" if math.isinf(depth) else f"{depth:.3g} m"


def picture(rgb, white, text):
    """Figure of an image with a caption.

    Parameters
    ----------
    rgb : numpy.ndarray, shape (y, x, 3)
        Linear RGB.
    white : float
        Linear value shown as white.
    text : str
        Caption.

    Returns
    -------
    str
        HTML.
    """
    data, text = base64.b64encode(output.encode_png(rgb, white)).decode(), html.escape(text)
    image = f'<img alt="{text}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{text}</figcaption></figure>"


def value_map(values, form):
    """Table of values whose cells are the darker the lower the value is.

    Parameters
    ----------
    values : numpy.ndarray, shape (row, column)
        NaN for empty cells.
    form : str
        Format of a value.

    Returns
    -------
    str
        HTML.
    """
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
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


def table(head, rows):
    """Table with a head, and a name at the left of each row.

    Parameters
    ----------
    head : sequence of str
    rows : sequence of sequence of str

    Returns
    -------
    str
        HTML.
    """
    lines = ["".join(f"<th>{html.escape(name)}</th>" for name in head)]
    lines += [
        f"<th>{html.escape(name)}</th>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        for name, *cells in rows
    ]
    return f"<figure><table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table></figure>"


def focus_curves(depths, values):
    """Curves of sharpness over the focus distance, each scaled to the same height to compare their peaks.

    Parameters
    ----------
    depths : sequence of float
        Meters.
    values : numpy.ndarray, shape (depth, patch)

    Returns
    -------
    str
        HTML.
    """
    width, height = 720, 200
    tops = np.maximum(values.max(0), 1e-30)
    x = np.linspace(0, width, len(depths))
    lines, key = [], []
    for n, curve in enumerate((values / tops).T):
        points = " ".join(f"{a:.1f},{height * (1 - b):.1f}" for a, b in zip(x, curve, strict=True))
        color = f"hsl({360 * n / values.shape[1]:.0f} 65% 45%)"
        lines.append(f'<polyline fill="none" stroke="{color}" stroke-width="2" points="{points}"/>')
        row, column = divmod(n, assessment.PATCHES)  # the key is a small map of the patches
        where = f'x="{18 * column}" y="{14 * row - 50}" width="16" height="12"'
        key.append(f'<rect {where} fill="{color}"/>')
    words = "".join(
        f'<text x="{a:.0f}" y="{height + 18}" font-size="12" text-anchor="{anchor}">{named(depths[n])}</text>'
        for n, a, anchor in ((0, 0, "start"), (len(depths) // 2, width / 2, "middle"), (-1, width, "end"))
    )
    words += (
        f'<text x="{width}" y="-40" font-size="12" text-anchor="end">sharpness relative to each peak</text>'
    )
    box = f'viewBox="-5 -55 {width + 10} {height + 80}"'
    shapes = "".join([*key, *lines])
    return f'<figure><svg role="img" aria-label="Sharpness over focus" {box}>{shapes}{words}</svg></figure>'


def svg_sketch(hologram):
    """Sketch of a hologram's bench in the color of the surrounding text.

    Parameters
    ----------
    hologram : engine.Hologram

    Returns
    -------
    str
        SVG.
    """
    drawing = bench_sketch.drawing(hologram)
    shapes = [_shape(line) for line in drawing.lines]
    shapes += [
        f'<text x="{text.x:.1f}" y="{text.y:.1f}" font-size="{bench_sketch.FONT:g}" fill="currentColor" '
        f'font-family="system-ui,sans-serif">{html.escape(text.text)}</text>'
        for text in drawing.texts
    ]
    label = html.escape("; ".join(text.text for text in drawing.texts))
    box = f'viewBox="-2 0 {drawing.width + 4:.0f} {drawing.height:.0f}"'
    return f'<svg role="img" aria-label="{label}" {box}>{"".join(shapes)}</svg>'


def _shape(line):
    """SVG of a line of a sketch, or of a transparent area."""
    color = "currentColor"
    if line.role != bench_sketch.INK:
        color = "rgb({})".format(",".join(f"{255 * part:.0f}" for part in bench_sketch.COLORS[line.role]))
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in line.points)
    if line.opacity:
        return f'<polygon points="{points}" fill="{color}" fill-opacity="{line.opacity:g}"/>'
    dashes = ' stroke-dasharray="5 4"' if line.dashed else ""
    return f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="{line.width:g}"{dashes}/>'


def write(page, folder, field, sections, rows):
    """Write the page and its table, either both or none.

    Parameters
    ----------
    page : pathlib.Path
        File of the page; the table is written beside it as .csv.
    folder : pathlib.Path
        Output folder of the hologram.
    field : engine.WaveField
    sections : list of (str, str)
        Title and HTML of each section.
    rows : list of (str, str, float)
        Rows of the table: what, where, value.

    Raises
    ------
    OSError
    """
    hologram = field.hologram
    facts = (
        f"{hologram.width} × {hologram.height} pixels of {in_words(hologram.pitch)}, "
        f"{', '.join(f'{w * 1e9:.4g}' for w in hologram.wavelengths)} nm, {len(field.data)} frames"
    )
    body = "".join(f"<h2>{title}</h2>{text}" for title, text in sections)
    name = html.escape(folder.resolve().name)
    rows_file = io.StringIO()
    csv.writer(rows_file, lineterminator="\n").writerows([("what", "where", "value"), *rows])
    text = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{name}</title><style>{STYLE}</style></head><body><h1>{name}</h1><p>{facts}</p>{body}"
        f"<p><small>All figures: {html.escape(page.with_suffix('.csv').name)}</small></p></body></html>\n"
    )
    files = {
        page.with_suffix(".csv").name: rows_file.getvalue().encode(),
        page.name: text.encode("ascii", "xmlcharrefreplace"),
    }
    output.write_pictures(page.parent, files)
