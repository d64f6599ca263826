"""Responses of devices in text files: a list of phases, or a table of level and phase."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..engine.errors import InvalidInput

MAX_TURNS = 20  # of a response
MAX_LEVELS = 1 << 16
# Radians per unit that a header may name, in brackets, after "in" or after "unit"
UNITS = {
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
    **dict.fromkeys(("mrad", "milliradians"), 1e-3),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), math.pi / 180),
    **dict.fromkeys(("pi", "π", "pi rad", "π rad", "units of pi"), math.pi),
    **dict.fromkeys(
        ("turn", "turns", "wave", "waves", "cycles", "lambda", "λ", "2pi", "2 pi", "2π", "2π rad", "2pi rad"),
        2 * math.pi,
    ),
}
UNIT = re.compile(r"[(\[]([^)\]]*)[)\]]|\bin\s+([\wπ°]+)|\bunits?\b\s*[:=]?\s*([\wπ° ]+)")
# Radians. A smaller span is ambiguous: it may be about one turn in units of turns or of pi
MIN_CLEAR_SPAN = 4.0
# A larger number without a unit is ambiguous: radians of many turns, or degrees of a quarter of one and more
MAX_CLEAR = 90.0


def read_response(path: Path | str) -> np.ndarray:
    """Read the phase of each level from a text file.

    The file has one phase per level, in any layout; or lines of level and phase, for all levels or some from 0 to
    2^N - 1, which are interpolated linearly. Spaces, tabs, commas or semicolons separate numbers; with semicolons or
    tabs a comma is a decimal point. Lines of words, and text after #, are a header, which may name the unit in
    brackets: rad, mrad, deg, turns (waves, 2 pi), or pi.

    Parameters
    ----------
    path : path

    Returns
    -------
    numpy.ndarray, float64, shape (level,)
        Radians.

    Raises
    ------
    InvalidInput
        If the file cannot be read, or can be read in two ways.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InvalidInput(f"The response {path} cannot be read ({reason}). Give a text file.") from error
    rows, header = _rows(path, text)
    numbers = _phases_of(path, rows)
    if len(numbers) < 2 or not np.isfinite(numbers).all():
        _refuse(path, "has no phases of levels. Write two or more, one per line")
    unit = _unit(path, header)
    voltages = unit is None and _whole(numbers) and np.abs(numbers).max() > 2 * math.pi * MAX_TURNS
    if path.suffix.lower() == ".lut" or voltages:
        _refuse(
            path,
            "gives the voltage of each level, not its phase. Load it into the device by its maker's program, and omit "
            "the response, as its levels then are even steps of a turn",
        )
    if unit is None:
        span = float(np.ptp(numbers))
        largest = float(np.abs(numbers).max())
        if MAX_CLEAR <= largest <= 2 * math.pi * MAX_TURNS:
            _refuse(
                path,
                f"reaches {largest:.4g}, which may be radians or degrees. Name the unit in a first line: 'phase (rad)' "
                "or 'phase (deg)'",
            )
        binary = len(numbers) == 2 and abs(span - math.pi) < 0.01
        if span < MIN_CLEAR_SPAN and not binary:
            _refuse(
                path,
                f"spans {span:.3g}, which may be radians, turns, or units of pi. Name the unit in a first line: "
                "'phase (rad)', 'phase (turns)' or 'phase (pi)'",
            )
    phases = numbers * (unit or 1.0)
    if np.abs(phases).max() > 2 * math.pi * MAX_TURNS:
        _refuse(
            path, f"exceeds {MAX_TURNS} turns. Name its unit in a first line, such as 'level, phase (deg)'"
        )
    return phases


def _rows(path, text):
    """Numbers of each line, and the text of the header."""
    rows, header = [], []
    for line in text.splitlines():
        text_part, _, comment = line.partition("#")
        header.append(comment)
        decimal = ";" in text_part or "\t" in text_part
        words = re.split(r"[;\s]+" if decimal else r"[,;\s]+", text_part.strip(" ,;\t\r"))
        if words == [""]:
            continue
        try:
            rows.append([float(word.replace(",", ".") if decimal else word) for word in words])
        except ValueError:
            if rows:
                _refuse(
                    path,
                    f"has {text_part.strip()[:40]!r} among its numbers. Write words above all numbers",
                )
            header.append(text_part)
        if sum(map(len, rows)) > 2 * MAX_LEVELS:
            _refuse(path, f"has more than {MAX_LEVELS} levels. Give that of an SLM")
    return rows, " ".join(header).lower()


def _phases_of(path, rows):
    """One number per level."""
    widths = {len(row) for row in rows}
    if widths == {2} and len(rows) > 1:
        return _table(path, np.array(rows))
    if len(rows) > 1 and len(widths) == 1 and max(widths) > 2:
        first = [row[0] for row in rows]
        if first == list(range(len(rows))):
            _refuse(path, f"has {max(widths)} columns. Keep two, level and phase")
    return np.array([number for row in rows for number in row])


def _table(path, rows):
    levels, values = rows.T
    count = int(levels[-1]) + 1
    if not _whole(levels) or levels[0] != 0 or (np.diff(levels) <= 0).any():
        _refuse(
            path,
            "has two columns, and the first does not count levels from 0. Write level and phase in each line, or only "
            "phases, one per line",
        )
    if count > MAX_LEVELS or (len(rows) != count and count & (count - 1)):
        _refuse(
            path,
            f"has levels up to {count - 1:g}. Give all of them, or some from 0 to the last one, 2^N - 1 of N bits",
        )
    return np.interp(np.arange(count), levels, values)


def _whole(numbers):
    return bool((numbers == np.round(numbers)).all())


def _unit(path, header):
    """Radians per unit that the header names; None without one."""
    words = {" ".join("".join(groups).split()) for groups in UNIT.findall(header)}
    units = {UNITS[word] for word in words if word in UNITS}
    if len(units) > 1:
        _refuse(path, "names several units. Keep one of rad, deg, turns, pi")
    return units.pop() if units else None


def _refuse(path, why) -> NoReturn:
    raise InvalidInput(f"The response {path} {why}.")
