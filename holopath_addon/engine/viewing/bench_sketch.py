"""A sketch of a hologram's bench, beam, SLM, volume, stop and eye, as lines and labels to draw in any way.

The bench is to scale along the axis, and across it by another scale, which the sketch says. Behind a break stand what
a hologram knows no distance of: the stop, in the Fourier plane of a relay, and the eye. That plane is drawn beside the
bench, in units of the band's edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..hologram import Hologram

# What lines are of: their colors, as red, green and blue, are seen on white and on black. Ink has that of the text.
INK = "ink"
COLORS = {
    "beam": (0.83, 0.48, 0.1),
    "slm": (0.2, 0.5, 0.95),
    "volume": (0.2, 0.65, 0.4),
    "light": (0.7, 0.4, 0.85),
    "stop": (0.9, 0.3, 0.3),
    "lens": (0.1, 0.57, 0.62),
}
# Pixels: of the whole, across the axis at most, behind the break, the Fourier plane, and of letters.
WIDTH, HIGH, BEHIND_BREAK, SIDE, FONT = 720.0, 170.0, 110.0, 130.0, 12.0
BESIDE = 600.0  # a sketch that is less wide has the Fourier plane below
LETTER = 0.58  # of the letters' size is their mean width in fonts without serifs
GAP = 8.0  # pixels between labels
# Of the depth that SLM and volume fill: how much is drawn of the beam and of the light, and how near a point source is
# for it to be drawn.
BEFORE, AFTER, NEAR_POINT = 0.5, 0.5, 2.0
RAYS = (-0.9, -0.45, 0.0, 0.45, 0.9)  # of the beam, in halves of the panel
CELLS = 99  # of the Fourier plane, a side, which are open or closed
CIRCLE = 64  # corners
FAINT = 0.3  # opacity of areas
STRETCHED = (
    0.1  # an end of the volume behind a lens is drawn at most as much as 1 / this farther from the plane
)
NARROW = 8.0  # pixels: behind the break light is drawn as wide or wider


@dataclass(frozen=True)
class Stroke:
    """A line, or the area within it.

    Attributes
    ----------
    points : numpy.ndarray, shape (n, 2)
        Of an `AxialView` millimeters along the axis and across it; of a `Drawing` pixels to the right and down.
    role : str
        What it is of: `INK`, or one of `COLORS`.
    opacity : float
        Of the area; 0: a line alone.
    dashed : bool
    width : float
        Of the line, pixels.
    """

    points: np.ndarray
    role: str
    opacity: float = 0.0
    dashed: bool = False
    width: float = 1.5


@dataclass(frozen=True)
class AxialView:
    """What stands on the axis, in millimeters from the SLM.

    Attributes
    ----------
    lines : list of Stroke
    above, below : list of (float, str)
        Labels, and which place on the axis each belongs to.
    start, end : float
        Between which it is drawn, along the axis.
    high : float
        To each side of the axis.
    edges : tuple of float
        Where the light that passes the stop ends, to each side of the axis, at `end`.
    zero_order : float or None
        Where the light is at `end` that the SLM leaves as it was, if it leaves along another way.
    upright : bool
        Whether the sketch is seen from the side; otherwise it is seen from above.
    """

    lines: list[Stroke]
    above: list[tuple[float, str]]
    below: list[tuple[float, str]]
    start: float
    end: float
    high: float
    edges: tuple[float, float]
    zero_order: float | None
    upright: bool


@dataclass(frozen=True)
class Text:
    """A line of text that begins at x, and whose letters stand on y, in pixels to the right and down."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Drawing:
    """Lines and texts in pixels."""

    width: float
    height: float
    lines: list[Stroke]
    texts: list[Text]


def axial_view(hologram: Hologram) -> AxialView:
    """What stands on the axis of a hologram's bench, in the plane in which it is less even."""
    optics = hologram.optics
    axis = int(_aside(optics, 1) > _aside(optics, 0))  # 0 to the right, 1 up
    size, wide = (
        1e3 * _sizes(each)[axis] for each in (hologram, hologram.in_air)
    )  # of the panel, of pictures
    far, near = _ends(hologram)
    stands = 1e3 * optics.lens.distance if optics.lens else 0.0
    first, last = min(0.0, far, near), max(stands, far, near)
    depth, half = last - first, size / 2
    rays, told, start = _beam(optics, axis, half, first, depth)
    end, middle = last + AFTER * depth, (far + near) / 2
    x, radius = optics.opening[axis], optics.opening[2]
    slopes = [hologram.widest_slope * part for part in (x - radius, x + radius)]
    cone = [
        _through(optics.lens, np.array([(middle, 0.0), (end, slope * (end - middle))])) for slope in slopes
    ]
    edges = tuple(float(points[-1, 1]) for points in cone)
    zero_order = -hologram.widest_slope * optics.carrier[axis] * end if any(optics.carrier) else None
    high = 1.25 * max(half, wide / 2, *(np.abs(points[:, 1]).max() for points in cone))
    volume = np.array([(far, -1), (near, -1), (near, 1), (far, 1), (far, -1)]) * (1, wide / 2)
    lines = [
        Stroke(volume, "volume", FAINT),
        Stroke(volume, "volume", width=1.0),
        *(_clipped(ray, high) for ray in rays),
        Stroke(np.array([(0.0, -half), (0.0, half)]), "slm", width=4.0),
        *(Stroke(points, "light") for points in cone),
    ]
    above = [(start, f"beam: {told}"), (0.0, f"SLM, {size:.3g} mm {'high' if axis else 'wide'}")]
    if optics.lens:
        focal = 1e3 * optics.lens.focal
        above.append((stands, f"lens, f = {focal:.4g} mm"))
        lines.append(Stroke(np.array([(stands, -1.2 * half), (stands, 1.2 * half)]), "lens", width=3.0))
        for y in (-0.9 * half, 0.9 * half):  # what the SLM leaves as it was, up to its focus
            ray = _through(optics.lens, np.array([(0.0, y), (min(end, stands + focal), y)]))
            lines.append(Stroke(ray, "beam", dashed=True, width=1.0))
    if zero_order is not None:
        lines.append(_clipped(Stroke(np.array([(0.0, 0.0), (end, zero_order)]), "stop", dashed=True), high))
    return AxialView(
        lines,
        above,
        [(middle, f"volume, {_number(far)} (far) to {_number(near)} mm (near)")],
        start,
        end,
        high,
        edges,
        zero_order,
        bool(axis),
    )


def drawing(
    hologram: Hologram,
    measure: Callable[[str], float] | None = None,
    width: float = WIDTH,
    font: float = FONT,
) -> Drawing:
    """The sketch of a hologram's bench.

    Parameters
    ----------
    hologram : Hologram
    measure : callable, optional
        Pixels that a text is wide. Default: by the mean of letters.
    width : float
        Pixels.
    font : float
        Size of letters, pixels.

    Returns
    -------
    Drawing
    """
    measure = measure or (lambda text: LETTER * font * len(text))
    bench, optics, unit = axial_view(hologram), hologram.optics, font / FONT
    side, tail = SIDE * unit, BEHIND_BREAK * unit
    beside = optics.stopped and width >= BESIDE * unit
    wide = width - (side + 4 * GAP * unit if beside else 0.0)  # of the bench
    along = (wide - tail) / (bench.end - bench.start)
    times = _round_number(HIGH * unit / (2 * bench.high * along))
    across, row = along * times, 1.5 * font
    places = wide - 0.88 * tail, wide - 0.55 * tail, wide - 0.25 * tail  # of break, stop and eye
    marks = [((x - bench.start) * along, text) for x, text in bench.above]
    marks += [(places[1], "stop")] if optics.stopped else []
    marks += [(places[2] + 9 * unit, "eye")]
    above, lanes_above = _labels(marks, wide, measure, row)
    below, lanes_below = _labels(
        [((x - bench.start) * along, text) for x, text in bench.below], wide, measure, row
    )
    top, high = lanes_above * row + GAP * unit, bench.high * across
    axis, bottom = top + high, top + 2 * high
    lines = [
        replace(line, points=(line.points - (bench.start, 0)) * (along, -across) + (0, axis))
        for line in bench.lines
    ]
    lines.append(Stroke(np.array([(0.0, axis), (places[2], axis)]), INK, dashed=True, width=0.75))
    lines += _behind_the_break(bench, optics, across, axis, places, unit)
    texts = [Text(x, top - GAP * unit - y, text) for x, y, text in above]
    texts += [Text(x, bottom + row + y, text) for x, y, text in below]
    foot = bottom + lanes_below * row + 1.6 * row
    bars, words = _scales(bench, along, across, times, foot, measure, font, wide)
    lines, texts = lines + bars, texts + words
    height = max(text.y for text in words) + 0.5 * row
    if optics.stopped:
        corner = (width - side, 0.0) if beside else (0.0, height)
        more, words, deep = _fourier_plane(optics, corner, side, font)
        lines, texts, height = lines + more, texts + words, max(height, deep)
    return Drawing(width, height, lines, texts)


def _sizes(hologram):
    """Width and height of a grid, meters."""
    return hologram.width * hologram.pitch_x, hologram.height * hologram.pitch_y


def _ends(hologram):
    """Far and near end of the volume, millimeters from the SLM.

    Behind a lens what is z behind the plane of the picture stands at z / (1 - z D / B), with B and D of the ray matrix.
    """
    ends, lens = (hologram.depth_far, hologram.depth_near), hologram.optics.lens
    if hologram.in_air is hologram:
        return tuple(1e3 * z for z in ends)
    plane = lens.distance + (lens.focal if lens.picture is None else lens.picture)
    bend = (1 - lens.distance / lens.focal) / lens.reach
    return tuple(1e3 * (plane + z / max(1 - z * bend, STRETCHED)) for z in ends)


def _through(lens, points):
    """A ray between two points as a lens bends it, if one stands between them."""
    (x, y), (u, v) = points
    if lens is None or not x < 1e3 * lens.distance < u:
        return points
    stands, slope = 1e3 * lens.distance, (v - y) / (u - x)
    there = y + slope * (stands - x)
    bent = slope - there / (1e3 * lens.focal)
    return np.array([(x, y), (stands, there), (u, there + bent * (u - stands))])


def _aside(optics, axis):
    """How far the bench is from even to the right, or up: by its carrier, or else its beam."""
    numbers = {"tilt": optics.beam.numbers, "gaussian": optics.beam.numbers[1:]}.get(optics.beam.kind, ())
    return 10 * abs(optics.carrier[axis]) + (abs(numbers[axis]) if numbers else 0.0)


def _beam(optics, axis, half, first, depth):
    """Its rays up to the SLM, in words, and where the sketch begins."""
    kind, numbers = optics.beam.kind, optics.beam.numbers
    start, places = first - BEFORE * depth, half * np.array(RAYS)
    slopes = np.zeros(len(places))
    told = {"flat": "flat", "measured": "as measured"}.get(kind, "")
    if kind == "tilt":
        slopes += math.tan(numbers[axis])
        right, up = (_number(math.degrees(angle)) for angle in numbers)
        told = f"tilted, {right}° right, {up}° up"
    elif kind == "point":
        distance = 1e3 * numbers[0]
        way = ("from", "before") if distance > 0 else ("towards", "behind")
        told = f"{way[0]} a point {abs(distance):.4g} mm {way[1]}"
        slopes = places / distance
        if 0 < distance < NEAR_POINT * depth:
            start = -distance
    elif kind == "gaussian":
        waist, *middle = (1e3 * number for number in numbers)
        told, at = f"Gaussian, waist {waist:.3g} mm", middle[axis] if middle else 0.0
        places = at + waist * np.array([-1.0, 0.0, 1.0])
        slopes = np.zeros(3)
    rays = [
        Stroke(np.array([(start, y + slope * start), (0.0, y)]), "beam", width=1.0)
        for y, slope in zip(places, slopes, strict=True)
    ]
    return rays, told, start


def _clipped(line, high):
    """A line of two ends as far as it lies within the sketch, which may be none of it."""
    (x, y), (u, v) = line.points
    if v == y:
        first, last = (0.0, 1.0) if abs(y) <= high else (0.0, 0.0)
    else:
        crossed = sorted((edge - y) / (v - y) for edge in (-high, high))
        first, last = (min(max(share, 0.0), 1.0) for share in crossed)
    return replace(
        line, points=np.array([(x + share * (u - x), y + share * (v - y)) for share in (first, last)])
    )


def _behind_the_break(bench, optics, across, axis, places, unit):
    """The break, the stop with what it lets through and keeps, and the eye; in pixels."""
    high, (broken, stop_at, eye_at) = bench.high * across, places
    lines, wave = [], np.linspace(-1, 1, 17)
    for aside in (-3 * unit, 3 * unit):
        points = np.stack([broken + aside + 2 * unit * np.sin(3 * wave), axis + high * wave], 1)
        lines.append(Stroke(points, INK, width=1.0))
    wider = max(across, NARROW * unit / (bench.edges[1] - bench.edges[0]))
    first, last = (axis - min(max(edge * wider, -0.9 * high), 0.9 * high) for edge in bench.edges)
    begin, radius = broken + 8 * unit, 9 * unit
    lines += [Stroke(np.array([(begin, edge), (eye_at, edge)]), "light") for edge in (first, last)]
    if optics.stopped:
        for edge, end in ((first, axis + high), (last, axis - high)):
            lines.append(Stroke(np.array([(stop_at, edge), (stop_at, end)]), "stop", width=3.0))
    if bench.zero_order is not None:
        aside = axis - min(max(bench.zero_order * wider, -0.9 * high), 0.9 * high)
        lines.append(Stroke(np.array([(begin, aside), (stop_at, aside)]), "stop", dashed=True))
    turns = np.linspace(0, 2 * math.pi, CIRCLE + 1)
    ball = np.stack([np.cos(turns), np.sin(turns)], 1)
    middle = np.array([eye_at + radius, (first + last) / 2])
    lines.append(Stroke(middle + radius * ball, INK))
    lines.append(Stroke(middle + (-0.6 * radius, 0) + 0.4 * radius * ball * (0.5, 1.0), INK, 1.0))
    return lines


def _labels(marks, wide, measure, row):
    """Where labels begin, and how high above or below the bench, each in the first row with room for it; rows."""
    ends, found = [], []
    for place, text in sorted(marks):
        size = measure(text)
        x = min(max(place - size / 2, 0.0), max(wide - size, 0.0))
        lane = next((n for n, end in enumerate(ends) if x >= end + GAP), len(ends))
        ends[lane:] = [*([x + size] if lane == len(ends) else [x + size, *ends[lane + 1 :]])]
        found.append((x, lane * row, text))
    return found, len(ends)


def _scales(bench, along, across, times, foot, measure, font, wide):
    """A bar along the axis and one across it, and how they compare."""
    lines, texts, x = [], [], 1.0
    bars = [
        (along, 0.15 * (bench.end - bench.start), "along", (1, 0)),
        (across, 0.35 * bench.high, "across", (0, -1)),
    ]
    for scale, most, word, direction in bars:
        length = _round_number(most)
        start = np.array([x, foot])
        lines.append(Stroke(np.stack([start, start + scale * length * np.array(direction)]), INK, width=2.0))
        x += (scale * length if direction[0] else 0.0) + font / 2
        texts.append(Text(x, foot, f"{length:g} mm {word}"))
        x += measure(texts[-1].text) + 2 * font
    ratio = f"{times:g} times" if times >= 1 else f"1/{1 / times:g} of"
    told = f"across at {ratio} the scale along, seen from {'the side' if bench.upright else 'above'}"
    apart = x + measure(told) > wide
    texts.append(Text(0.0 if apart else x, foot + 1.5 * font * apart, told))
    return lines, texts


def _fourier_plane(optics, corner, side, font):
    """What is open of it, the zero order, and the middle rays of picture and twin; and its lowest pixel."""
    left, top, half = corner[0], corner[1] + 1.6 * font, side / 2

    def place(points):
        return (np.asarray(points) * (1, -1) + 1) * half + (left, top)

    edges = np.linspace(-1, 1, CELLS + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    x, y = optics.carrier
    lines = []
    for below, above, g_y in zip(edges[:-1], edges[1:], middles, strict=True):
        is_open = np.pad(optics.open_at(middles - x, np.full(CELLS, g_y - y)), 1).astype(int)
        for first, last in zip(*(np.flatnonzero(np.diff(is_open) == step) for step in (1, -1)), strict=True):
            corners = [
                (edges[first], below),
                (edges[last], below),
                (edges[last], above),
                (edges[first], above),
            ]
            lines.append(Stroke(place(corners), "light", FAINT))
    turns = np.linspace(0, 2 * math.pi, CIRCLE + 1)
    circle = np.stack([np.cos(turns), np.sin(turns)], 1)
    lines.append(Stroke(place(circle), INK, width=1.0))
    lines.append(Stroke(place([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]), INK, width=0.75))
    texts, row = [Text(left, corner[1] + font, "Fourier plane")], 1.4 * font
    small, y_text = 3.5 * font / FONT, top + side + row
    marks = [((0.0, 0.0), "zero order", "stop", True), ((x, y), "picture", "light", False)]
    marks += [((-x, -y), "twin", "stop", False)] if any(optics.carrier) else []
    for at, text, role, filled in marks:
        for middle in (place([at])[0], np.array([left + small, y_text - 0.35 * font])):
            lines.append(Stroke(middle + small * circle, role, float(filled)))
        texts.append(Text(left + 4 * small, y_text, text))
        y_text += row
    return lines, texts, y_text


def _round_number(limit):
    """Largest of 1, 2 and 5 times a power of ten, or of these parts of one, up to a limit."""
    power = 10.0 ** math.floor(math.log10(limit))
    return float(f"{next(step for step in (5, 2, 1) if step * power <= limit * (1 + 1e-9)) * power:.1g}")


def _number(value):
    return f"{value:.4g}".replace("-", "\u2212")
