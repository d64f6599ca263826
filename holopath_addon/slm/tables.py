"""Responses of devices from files of text: a list of phases, or a table of level and phase."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..engine.errors import InvalidInput

MAX_TURNS = 20  # of a response
MAX_LEVELS = 1 << 16
# Radians in the units that a header may name, in brackets, behind "in" or behind "unit"
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
# Radians. A response of less may as well be one of about a turn that is written in turns or in units of pi
MIN_CLEAR_SPAN = 4.0


def read_response(path: Path | str) -> np.ndarray:
    """Phases in radians of a device's levels, of a text file.

    One phase for each level, in any layout; or lines of level and phase, with all levels or some from 0 to 2^N - 1,
    between which lines are drawn. Numbers are apart by spaces, tabs, commas or semicolons; beside semicolons and tabs a
    comma is a decimal point. Lines of words, and what follows a #, are a header, which may name the unit in brackets:
    rad, mrad, deg, turns (waves, 2 pi), or pi.

    Parameters
    ----------
    path : path

    Returns
    -------
    numpy.ndarray, float64, shape (level,)

    Raises
    ------
    InvalidInput
        If it cannot be read, or can be read in two ways.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InvalidInput(f"The response {path} cannot be read ({reason}): give a text file.") from error
    rows, header = _rows(path, text)
    numbers = _phases_of(path, rows)
    if len(numbers) < 2 or not np.isfinite(numbers).all():
        _refuse(path, "holds no phases of levels: write two or more, one a line")
    unit = _unit(path, header)
    drive = unit is None and _whole(numbers) and np.abs(numbers).max() > 2 * math.pi * MAX_TURNS
    if path.suffix.lower() == ".lut" or drive:
        _refuse(
            path,
            "says which voltage each level has, and not which phase: load it into the device by its maker's program, "
            "and leave out the response, as its levels then are even steps of a turn",
        )
    if unit is None:
        span = float(np.ptp(numbers))
        binary = len(numbers) == 2 and abs(span - math.pi) < 0.01
        if span < MIN_CLEAR_SPAN and not binary:
            _refuse(
                path,
                f"spans {span:.3g}, which may be radians, turns, or units of pi: name the unit in a first line, as "
                "'phase (rad)', 'phase (turns)' or 'phase (pi)'",
            )
    phases = numbers * (unit or 1.0)
    if np.abs(phases).max() > 2 * math.pi * MAX_TURNS:
        _refuse(
            path, f"goes beyond {MAX_TURNS} turns: name its unit in a first line, as 'level, phase (deg)'"
        )
    return phases


def _rows(path, text):
    """Numbers of each line, and the words of the others."""
    rows, header = [], []
    for line in text.splitlines():
        said, _, comment = line.partition("#")
        header.append(comment)
        decimal = ";" in said or "\t" in said
        words = re.split(r"[;\s]+" if decimal else r"[,;\s]+", said.strip(" ,;\t\r"))
        if words == [""]:
            continue
        try:
            rows.append([float(word.replace(",", ".") if decimal else word) for word in words])
        except ValueError:
            if rows:
                _refuse(
                    path,
                    f"holds {said.strip()[:40]!r} among its numbers: write numbers, and words above them",
                )
            header.append(said)
        if sum(map(len, rows)) > 2 * MAX_LEVELS:
            _refuse(path, f"holds more than {MAX_LEVELS} levels: give one of an SLM")
    return rows, " ".join(header).lower()


def _phases_of(path, rows):
    """One number for each level."""
    widths = {len(row) for row in rows}
    if widths == {2} and len(rows) > 1:
        return _table(path, np.array(rows))
    if len(rows) > 1 and len(widths) == 1 and max(widths) > 2:
        first = [row[0] for row in rows]
        if first == list(range(len(rows))):
            _refuse(path, f"has {max(widths)} columns: leave two, level and phase")
    return np.array([number for row in rows for number in row])


def _table(path, rows):
    levels, values = rows.T
    count = int(levels[-1]) + 1
    if not _whole(levels) or levels[0] != 0 or (np.diff(levels) <= 0).any():
        _refuse(
            path,
            "has two columns, of which the first does not count levels from 0: write level and phase in each line, or "
            "phases alone, one a line",
        )
    if count > MAX_LEVELS or (len(rows) != count and count & (count - 1)):
        _refuse(
            path,
            f"has levels up to {count - 1:g}: give all of them, or some from 0 to the last one, 2^N - 1 of N bits",
        )
    return np.interp(np.arange(count), levels, values)


def _whole(numbers):
    return bool((numbers == np.round(numbers)).all())


def _unit(path, header):
    """Radians in the unit that the header names; None where it names none."""
    said = {" ".join("".join(groups).split()) for groups in UNIT.findall(header)}
    named = {UNITS[word] for word in said if word in UNITS}
    if len(named) > 1:
        _refuse(path, "names several units: leave one of rad, deg, turns, pi")
    return named.pop() if named else None


def _refuse(path, why) -> NoReturn:
    raise InvalidInput(f"The response {path} {why}.")
