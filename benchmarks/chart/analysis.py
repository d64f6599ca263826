"""What follows from a chart's records: who is ahead within a budget, what frames cost, and the paper's Table 1."""

import math

import numpy as np

from .methods import M
from .scenes import SCENES

BUDGETS = (1, 3, 10, 30, 100)  # seconds; no method is given more
RIVALS = ("baseline", "peer")
SIDES = ("left", "right", "up", "down", "view-left", "view-right")
BETWEEN = ("front-middle", "middle-back")


def pareto(points):
    """Numbers of the points that none beats: as soon or sooner and as good or better, and not the same.

    Parameters
    ----------
    points : sequence of (float, float)
        Seconds, and a figure that should be large.

    Returns
    -------
    list of int
        In order of seconds.
    """
    order = sorted(range(len(points)), key=lambda k: (points[k][0], -points[k][1]))
    front, best = [], -math.inf
    for number in order:
        if points[number][1] > best:
            front.append(number)
            best = points[number][1]
    return front


def best_within(records, budget, figure):
    """Largest figure of the records that took no longer than a budget; None where there is none."""
    record = _leader(records, budget, figure)
    return None if record is None else record[figure]


def _leader(records, budget, figure):
    within = [record for record in records if record["seconds"] <= budget]
    return max(within, key=lambda record: record[figure], default=None)


def is_phases(record):
    """Whether what was compared is the light of phases, as an SLM shows it, rather than a complex field."""
    return record.get("psnr_8_bits") is not None


def is_flat(record):
    """Whether a draft shows mirrors and glass as pictures on their own surfaces, for it follows none of them."""
    draft = record["kind"] == "ours" and record["effort"] == "draft"
    return draft and bool(SCENES[record["scene"]].asks & {"mirrors", "glass"})


def compare(records, budgets=BUDGETS):
    """What each method reaches within each budget, and whether `auto` is ahead of the baselines.

    Parameters
    ----------
    records : list of dict
        Of one scene.
    budgets : sequence of float
        Seconds.

    Returns
    -------
    list of dict
        A row for each budget and figure (``psnr``, ``psnr_worst``): `best` by method, `auto`, the best `rival` with
        its name `by`, whether `auto` is `ahead`, None where neither has anything yet, and of which methods the best
        `is_flat`.
    """
    records = [record for record in records if record["frames"] == M]
    names = list(dict.fromkeys(record["method"] for record in records))
    rivals = {record["method"] for record in records if record["kind"] in RIVALS}
    rows = []
    for budget in budgets:
        for figure in ("psnr", "psnr_worst"):
            best = {
                name: best_within([r for r in records if r["method"] == name], budget, figure)
                for name in names
            }
            theirs = {name: value for name, value in best.items() if name in rivals and value is not None}
            by = max(theirs, key=theirs.get, default=None)
            ours, rival = best.get("auto"), theirs.get(by)
            ahead = None
            if ours is not None or rival is not None:
                ahead = ours is not None and (rival is None or ours > rival)
            rows.append(
                {"budget": budget, "figure": figure, "best": best, "auto": ours, "rival": rival, "by": by}
                | {"ahead": ahead, "flat": _flat_of(records, budget, figure)}
            )
    return rows


def _flat_of(records, budget, figure):
    """Methods whose best within a budget is a draft that follows no mirrors."""
    names = dict.fromkeys(record["method"] for record in records)
    leaders = (_leader([r for r in records if r["method"] == name], budget, figure) for name in names)
    return [record["method"] for record in leaders if record is not None and is_flat(record)]


def fallen(before, now, by=0.2):
    """Figures that are lower than they were.

    Parameters
    ----------
    before, now : list of dict
        Records; of the first ``scene``, ``method``, ``effort``, ``frames``, ``seconds``, ``psnr`` and ``psnr_worst``
        count.
    by : float
        dB from which on a fall is told.

    Returns
    -------
    list of (dict, dict, str)
        Records before and now, and the figure, ``psnr`` or ``psnr_worst``, the largest fall first.
    """
    known = {_key(record): record for record in before}
    pairs = [(known[_key(record)], record) for record in now if _key(record) in known]
    falls = [
        (old, new, figure)
        for old, new in pairs
        for figure in ("psnr", "psnr_worst")
        if old[figure] - new[figure] > by
    ]
    return sorted(falls, key=lambda fall: fall[1][fall[2]] - fall[0][fall[2]])


def _key(record):
    return record["scene"], record["method"], record["effort"], record["frames"]


def over_frames(records, shown, budget):
    """What phases of each method show within a budget, by frames.

    Parameters
    ----------
    records : list of dict
        Of one scene.
    shown : dict of str to sequence of str
        Efforts of each method that are phases.
    budget : float
        Seconds.

    Returns
    -------
    dict of str to (dict of int to dict)
        By method and frames, the record with the largest mean PSNR of those that took no longer.
    """
    best = {}
    for record in records:
        if record["effort"] in shown[record["method"]]:
            own = best.setdefault(record["method"], {})
            other = own.get(record["frames"])
            if record["seconds"] <= budget and (other is None or record["psnr"] > other["psnr"]):
                own[record["frames"]] = record
    return best


def mean_over_scenes(best, figure, method, frames):
    """Mean of a figure over scenes; None where one of them has none within the budget.

    Parameters
    ----------
    best : dict of str to dict
        By scene, of `over_frames`.
    figure, method : str
    frames : int
    """
    records = [own.get(method, {}).get(frames) for own in best.values()]
    values = [record and record[figure] for record in records]
    return None if not values or None in values else float(np.mean(values))


def ratios(records, usual):
    """Seconds by frames, and those of the most over those of one frame.

    Parameters
    ----------
    records : list of dict
    usual : dict of str to str
        The effort of each method.

    Returns
    -------
    dict of (str, str) to (dict of int to float, float or None)
        By scene and method.
    """
    seconds = {}
    for record in records:
        if record["effort"] == usual[record["method"]]:
            own = seconds.setdefault((record["scene"], record["method"]), {})
            own[record["frames"]] = record["seconds"]
    several = {key: own for key, own in seconds.items() if len(own) > 1}
    return {key: (own, own[24] / own[1] if {1, 24} <= own.keys() else None) for key, own in several.items()}


def table_1(records, usual):
    """The paper's Table 1, with what was measured for each of its criteria.

    Returns
    -------
    (list of str, dict of str to list)
        The criteria, and by method a figure for each, None where nothing was measured.
    """
    criteria = (
        ("fast: s at M = 8", lambda r: r["seconds"], None, np.median),
        ("multi-frame: M = 24 / M = 1", None, None, np.median),
        ("data: s of pictures first", lambda r: _pictures_first(r), None, np.median),
        ("pretraining: s", lambda r: 0.0, None, max),
        ("reflection, refraction: dB", lambda r: r["psnr"], {"mirrors", "glass"}, np.mean),
        ("material, GI: dB", lambda r: r["psnr"], {"gloss", "indirect"}, np.mean),
        ("view: dB", lambda r: _mean_of(r, SIDES), None, np.mean),
        ("depth between: dB", lambda r: _mean_of(r, BETWEEN), None, np.mean),
        ("out of focus: dB", lambda r: r["psnr_defocus"], None, np.mean),
    )
    several = ratios(records, usual)
    rows = {}
    for name in dict.fromkeys(record["method"] for record in records):
        own = [r for r in records if (r["method"], r["frames"], r["effort"]) == (name, M, usual[name])]
        row = []
        for _, figure, asks, mean in criteria:
            if figure is None:
                values = [ratio for (_, method), (_, ratio) in several.items() if method == name and ratio]
            else:
                asked = [r for r in own if not asks or asks & SCENES[r["scene"]].asks]
                values = list(map(figure, asked))
            values = [value for value in values if value is not None]
            row.append(float(mean(values)) if values else None)
        if own:
            rows[name] = row
    return [name for name, *_ in criteria], rows


def _mean_of(record, names):
    return float(np.mean([record["pictures"][name]["psnr"] for name in names]))


def _pictures_first(record):
    """Seconds; None of a method that takes its pictures bit by bit, between other work."""
    if record["method"] == "stereogram":
        return None
    return sum(
        seconds for stage, seconds in record["stages"].items() if stage in ("Picture", "Pictures", "Preview")
    )
