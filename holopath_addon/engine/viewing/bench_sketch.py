"""Sketch of a hologram's bench (beam, SLM, volume, stop, eye) as lines and labels, independent of what draws it.

The bench is to scale along the axis; across it has another scale, which the sketch states. The stop, in the Fourier
plane of a relay, and the eye stand behind a break, because a hologram has no distances for them. The Fourier plane is
drawn beside the bench, in units of the band's edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..hologram import Hologram

# Roles of lines, and their colors as red, green and blue, which are visible on white and on black. Ink has the text's.
INK = "ink"
COLORS = {
    "beam": (0.83, 0.48, 0.1),
    "slm": (0.2, 0.5, 0.95),
    "volume": (0.2, 0.65, 0.4),
    "light": (0.7, 0.4, 0.85),
    "stop": (0.9, 0.3, 0.3),
    "lens": (0.1, 0.57, 0.62),
}
# Pixels: width of the sketch, maximum height across the axis, width behind the break, side of the Fourier plane, font.
WIDTH, MAX_HEIGHT, BREAK_WIDTH, FOURIER_SIDE, FONT = 720.0, 170.0, 110.0, 130.0, 12.0
MIN_WIDTH_BESIDE = 600.0  # pixels: a narrower sketch has the Fourier plane below the bench
LETTER_WIDTH = 0.58  # mean width of letters of sans-serif fonts, fraction of their size
GAP = 8.0  # pixels between labels
# Fractions of the depth that SLM and volume fill: length of the beam, length of the light, and maximum distance of a
# point source that is drawn.
BEFORE, AFTER, NEAR_POINT = 0.5, 0.5, 2.0
RAYS = (-0.9, -0.45, 0.0, 0.45, 0.9)  # heights of the beam's rays, in half-widths of the panel
CELLS = 99  # cells along a side of the Fourier plane, each open or closed
CIRCLE_CORNERS = 64
AREA_OPACITY = 0.3
MIN_LENS_DENOMINATOR = (
    0.1  # an end of the volume behind a lens is drawn at most 1 / this times as far from the plane
)
MIN_LIGHT_WIDTH = 8.0  # pixels, of the light behind the break


@dataclass(frozen=True)
class Stroke:
    """A line, or the area within it.

    Attributes
    ----------
    points : numpy.ndarray, shape (n, 2)
        In an `AxialView`: millimeters along the axis and across it. In a `Drawing`: pixels to the right and down.
    role : str
        `INK`, or a key of `COLORS`.
    opacity : float
        Opacity of the area; 0 for a line alone.
    dashed : bool
        Whether the line is dashed.
    width : float
        Width of the line, pixels.
    """

    points: np.ndarray
    role: str
    opacity: float = 0.0
    dashed: bool = False
    width: float = 1.5


@dataclass(frozen=True)
class AxialView:
    """Elements on the axis of a bench, in millimeters from the SLM.

    Attributes
    ----------
    lines : list of Stroke
    above, below : list of (float, str)
        Labels above and below the bench: position on the axis, and text.
    start, end : float
        Range along the axis that is drawn.
    high : float
        Half the height across the axis.
    edges : (float, float)
        Heights at `end` of the edges of the light that passes the stop.
    zero_order : float or None
        Height at `end` of the unmodulated light, if it leaves in another direction than the picture.
    upright : bool
        Whether this is the view from the side; otherwise it is from above.
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
    """A line of text: left end of its baseline in pixels to the right and down, and its letters."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Drawing:
    """Lines and texts of a sketch, and its size, in pixels."""

    width: float
    height: float
    lines: list[Stroke]
    texts: list[Text]


def axial_view(hologram: Hologram) -> AxialView:
    """Elements on the axis of a hologram's bench, in the plane with the larger carrier or tilt."""
    optics = hologram.optics
    axis = int(_asymmetry(optics, 1) > _asymmetry(optics, 0))  # 0 to the right, 1 up
    size, wide = (
        1e3 * _sizes(each)[axis] for each in (hologram, hologram.in_air)
    )  # of the panel, of pictures
    far, near = _ends(hologram)
    lens_at = 1e3 * optics.lens.distance if optics.lens else 0.0
    first, last = min(0.0, far, near), max(lens_at, far, near)
    depth, half = last - first, size / 2
    rays, beam, start = _beam(optics, axis, half, first, depth)
    end, middle = last + AFTER * depth, (far + near) / 2
    x, radius = optics.stop_circle[axis], optics.stop_circle[2]
    slopes = [hologram.widest_slope * part for part in (x - radius, x + radius)]
    cone = [
        _refract(optics.lens, np.array([(middle, 0.0), (end, slope * (end - middle))])) for slope in slopes
    ]
    edges = tuple(float(points[-1, 1]) for points in cone)
    zero_order = -hologram.widest_slope * optics.carrier[axis] * end if any(optics.carrier) else None
    high = 1.25 * max(half, wide / 2, *(np.abs(points[:, 1]).max() for points in cone))
    volume = np.array([(far, -1), (near, -1), (near, 1), (far, 1), (far, -1)]) * (1, wide / 2)
    lines = [
        Stroke(volume, "volume", AREA_OPACITY),
        Stroke(volume, "volume", width=1.0),
        *(_clip(ray, high) for ray in rays),
        Stroke(np.array([(0.0, -half), (0.0, half)]), "slm", width=4.0),
        *(Stroke(points, "light") for points in cone),
    ]
    above = [(start, f"beam: {beam}"), (0.0, f"SLM, {size:.3g} mm {'high' if axis else 'wide'}")]
    if optics.lens:
        focal = 1e3 * optics.lens.focal
        above.append((lens_at, f"lens, f = {focal:.4g} mm"))
        lines.append(Stroke(np.array([(lens_at, -1.2 * half), (lens_at, 1.2 * half)]), "lens", width=3.0))
        for y in (-0.9 * half, 0.9 * half):  # unmodulated light, up to its focus
            ray = _refract(optics.lens, np.array([(0.0, y), (min(end, lens_at + focal), y)]))
            lines.append(Stroke(ray, "beam", dashed=True, width=1.0))
    if zero_order is not None:
        lines.append(_clip(Stroke(np.array([(0.0, 0.0), (end, zero_order)]), "stop", dashed=True), high))
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
    """Sketch of a hologram's bench.

    Parameters
    ----------
    hologram : Hologram
    measure : callable, optional
        ``measure(text)`` gives the width of a text in pixels. Default: from the mean width of letters.
    width : float
        Width of the sketch, pixels.
    font : float
        Size of letters, pixels.

    Returns
    -------
    Drawing
    """
    measure = measure or (lambda text: LETTER_WIDTH * font * len(text))
    bench, optics, unit = axial_view(hologram), hologram.optics, font / FONT
    side, tail = FOURIER_SIDE * unit, BREAK_WIDTH * unit
    beside = optics.stopped and width >= MIN_WIDTH_BESIDE * unit
    wide = width - (side + 4 * GAP * unit if beside else 0.0)  # of the bench
    along = (wide - tail) / (bench.end - bench.start)
    times = _round_number(MAX_HEIGHT * unit / (2 * bench.high * along))
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
    bars, words = _scales(bench, along, times, foot, measure, font, wide)
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

    Behind a lens a point z behind the picture's plane stands at z / (1 - z D / B), with B and D of the ray matrix.
    """
    ends, lens = (hologram.depth_far, hologram.depth_near), hologram.optics.lens
    if hologram.in_air is hologram:
        return tuple(1e3 * z for z in ends)
    plane = lens.distance + (lens.focal if lens.picture is None else lens.picture)
    bend = (1 - lens.distance / lens.focal) / lens.reach
    return tuple(1e3 * (plane + z / max(1 - z * bend, MIN_LENS_DENOMINATOR)) for z in ends)


def _refract(lens, points):
    """A ray between two points, with a corner at the lens if one stands between them."""
    (x, y), (u, v) = points
    if lens is None or not x < 1e3 * lens.distance < u:
        return points
    lens_at, slope = 1e3 * lens.distance, (v - y) / (u - x)
    height = y + slope * (lens_at - x)
    bent = slope - height / (1e3 * lens.focal)
    return np.array([(x, y), (lens_at, height), (u, height + bent * (u - lens_at))])


def _asymmetry(optics, axis):
    """Deviation of the bench from symmetry along an axis, by its carrier first and its beam second; any unit."""
    numbers = {"tilt": optics.beam.numbers, "gaussian": optics.beam.numbers[1:]}.get(optics.beam.kind, ())
    return 10 * abs(optics.carrier[axis]) + (abs(numbers[axis]) if numbers else 0.0)


def _beam(optics, axis, half, first, depth):
    """The beam's rays up to the SLM, its description, and the start of the sketch on the axis."""
    kind, numbers = optics.beam.kind, optics.beam.numbers
    start, heights = first - BEFORE * depth, half * np.array(RAYS)
    slopes = np.zeros(len(heights))
    text = {"flat": "flat", "measured": "as measured"}.get(kind, "")
    if kind == "tilt":
        slopes += math.tan(numbers[axis])
        right, up = (_number(math.degrees(angle)) for angle in numbers)
        text = f"tilted, {right}° right, {up}° up"
    elif kind == "point":
        distance = 1e3 * numbers[0]
        words = ("from", "before") if distance > 0 else ("towards", "behind")
        text = f"{words[0]} a point {abs(distance):.4g} mm {words[1]}"
        slopes = heights / distance
        if 0 < distance < NEAR_POINT * depth:
            start = -distance
    elif kind == "gaussian":
        waist, *middle = (1e3 * number for number in numbers)
        text, center = f"Gaussian, waist {waist:.3g} mm", middle[axis] if middle else 0.0
        heights = center + waist * np.array([-1.0, 0.0, 1.0])
        slopes = np.zeros(3)
    rays = [
        Stroke(np.array([(start, y + slope * start), (0.0, y)]), "beam", width=1.0)
        for y, slope in zip(heights, slopes, strict=True)
    ]
    return rays, text, start


def _clip(line, high):
    """The part of a line of two ends that lies within the sketch, which may be empty."""
    (x, y), (u, v) = line.points
    if v == y:
        first, last = (0.0, 1.0) if abs(y) <= high else (0.0, 0.0)
    else:
        crossings = sorted((edge - y) / (v - y) for edge in (-high, high))
        first, last = (min(max(t, 0.0), 1.0) for t in crossings)
    return replace(line, points=np.array([(x + t * (u - x), y + t * (v - y)) for t in (first, last)]))


def _behind_the_break(bench, optics, across, axis, places, unit):
    """The break, the stop with the light that it passes and blocks, and the eye; in pixels."""
    high, (break_at, stop_at, eye_at) = bench.high * across, places
    lines, wave = [], np.linspace(-1, 1, 17)
    for offset in (-3 * unit, 3 * unit):
        points = np.stack([break_at + offset + 2 * unit * np.sin(3 * wave), axis + high * wave], 1)
        lines.append(Stroke(points, INK, width=1.0))
    scale = max(across, MIN_LIGHT_WIDTH * unit / (bench.edges[1] - bench.edges[0]))
    first, last = (axis - min(max(edge * scale, -0.9 * high), 0.9 * high) for edge in bench.edges)
    begin, radius = break_at + 8 * unit, 9 * unit
    lines += [Stroke(np.array([(begin, edge), (eye_at, edge)]), "light") for edge in (first, last)]
    if optics.stopped:
        for edge, end in ((first, axis + high), (last, axis - high)):
            lines.append(Stroke(np.array([(stop_at, edge), (stop_at, end)]), "stop", width=3.0))
    if bench.zero_order is not None:
        height = axis - min(max(bench.zero_order * scale, -0.9 * high), 0.9 * high)
        lines.append(Stroke(np.array([(begin, height), (stop_at, height)]), "stop", dashed=True))
    turns = np.linspace(0, 2 * math.pi, CIRCLE_CORNERS + 1)
    ball = np.stack([np.cos(turns), np.sin(turns)], 1)
    middle = np.array([eye_at + radius, (first + last) / 2])
    lines.append(Stroke(middle + radius * ball, INK))
    lines.append(Stroke(middle + (-0.6 * radius, 0) + 0.4 * radius * ball * (0.5, 1.0), INK, 1.0))
    return lines


def _labels(marks, wide, measure, row):
    """Labels as (x, distance from the bench, text), each in the first row with room for it, and the number of rows."""
    ends, labels = [], []
    for place, text in sorted(marks):
        size = measure(text)
        x = min(max(place - size / 2, 0.0), max(wide - size, 0.0))
        lane = next((n for n, end in enumerate(ends) if x >= end + GAP), len(ends))
        ends[lane:] = [x + size, *ends[lane + 1 :]]
        labels.append((x, lane * row, text))
    return labels, len(ends)


def _scales(bench, along, times, foot, measure, font, wide):
    """A scale bar along the axis, one across it, and a text that compares them."""
    lines, texts, x = [], [], 1.0
    bars = [
        (along, 0.15 * (bench.end - bench.start), "along", (1, 0)),
        (along * times, 0.35 * bench.high, "across", (0, -1)),
    ]
    for scale, limit, word, direction in bars:
        length = _round_number(limit)
        start = np.array([x, foot])
        lines.append(Stroke(np.stack([start, start + scale * length * np.array(direction)]), INK, width=2.0))
        x += (scale * length if direction[0] else 0.0) + font / 2
        texts.append(Text(x, foot, f"{length:g} mm {word}"))
        x += measure(texts[-1].text) + 2 * font
    ratio = f"{times:g} times" if times >= 1 else f"1/{1 / times:g} of"
    text = f"across at {ratio} the scale along, seen from {'the side' if bench.upright else 'above'}"
    next_row = x + measure(text) > wide
    texts.append(Text(0.0 if next_row else x, foot + 1.5 * font * next_row, text))
    return lines, texts


def _fourier_plane(optics, corner, side, font):
    """Open cells, the zero order, and the middle rays of picture and twin, as lines and texts; and the lowest pixel."""
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
            lines.append(Stroke(place(corners), "light", AREA_OPACITY))
    turns = np.linspace(0, 2 * math.pi, CIRCLE_CORNERS + 1)
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
    """Largest number of the form 1, 2 or 5 times a power of ten that is not above a limit."""
    power = 10.0 ** math.floor(math.log10(limit))
    return float(f"{next(step for step in (5, 2, 1) if step * power <= limit * (1 + 1e-9)) * power:.1g}")


def _number(value):
    return f"{value:.4g}".replace("-", "\u2212")
