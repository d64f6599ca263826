"""The chart as JSON, CSV, pictures and a page."""

import csv
import json
import os
import re
import shutil
import subprocess
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path

import numpy as np

from holopath_addon import engine
from holopath_addon.workflow import output

from ..parts import attempt
from . import analysis, archive, looks, measure, pictures
from .looks import HEADLINE, LOOKS, PUPILS
from .methods import ENCODED, SHOWN_BUDGETS, TUNED, M, methods
from .scenes import SCENES

PAGE, IMAGES = Path("docs/chart.md"), Path("docs/images")
NOTES = Path(__file__).parent / "notes"  # sentences on `auto` where it is not ahead, and on what fell
FALL = 0.2  # dB from which on what is lower than before is told
PLAIN = (
    "seconds",
    "peak_bytes",
    "psnr",
    "psnr_worst",
    "ssim",
    "ssim_worst",
    "psnr_foci",
    "psnr_halfway",
    "psnr_center",
    "psnr_focus",
    "psnr_defocus",
    "ssim_focus",
    "ssim_defocus",
    "flip",
    "speckle",
    *measure.EIGHT_BITS,
)

INTRODUCTION = (
    """# Speed against accuracy

What each method gives for how many seconds: HoloPath's own, and those that it is measured against, each from the same
scene to a field or phases for the same display. `make chart` measures all of it, which takes three to five hours on
two cores, `make chart-quick` a part in about ten minutes; `python -m benchmarks chart [quick] [SCENE ...] [--methods
NAME ...] [--frames M ... [--efforts NAME ...]] [--pixels N] [--anew] [--docs] [--since FILE] [--out FOLDER]` what is
named. Records are kept in build/chart as long as the code that they depend on stays as it is, so that a chart that
was stopped goes on where it was. With `--docs` each scene that is whole is published in docs/chart as JSON, with the
machine, day and commit of its records, and this page is written from all that is published; `python -m benchmarks
chart --page [--since FILE]` writes it and measures nothing. So scenes may come from several machines, but what is
compared at equal seconds does not, unless the table below says so. `--docs --frames M ...` renews records of so many
frames on any machine. That machine times some of the scene's other records as well: seconds are divided by how much
slower it is, and limits of seconds multiplied by it. A part that fails is named at the end of the page, with its
reason, and measured again the next time. With `--since` the page lists what is lower than on an earlier page, or in
its chart.json.

**PSNR** is the mean over eleven pictures against Mitsuba's thin-lens camera: focus in front, in the middle, at the
back and half-way between, four halves of the pupil and two views at 0.5 degrees to the side; **worst** is the lowest
of these. M = 8 frames unless said. A picture is scaled to be as bright as the reference, and through parts of the
pupil wavelengths count as bright as their openings are, for red fills a wider cone than blue; borders that lose light
to the SLM's aperture do not count. Mitsuba's rays do not diffract: through a part of the pupil the reference is
sharper than light can be, which caps what any method has there. **Seconds** are those of the whole pipeline:
planning, pictures of the scene, bakes and descents, all but the scene itself; of the plan baselines take no more than
the range of depths in view, which is given to them and not counted. Kernels are compiled beforehand by a run with
hardly any work, and what takes under {short:g} s runs twice, the shorter time counts. **Memory** is the most of a
process that has the scene, Python and its libraries included. **Speckle** is deviation over mean of picture /
reference in 16 x 16 patches, lit pixels only, the median. *Out of focus* are the pixels whose blur is over two pixels
in radius. Methods that find phases are compared by the light of these; those that find a complex field by that field.
Efforts of ours that are *encoded* are phases, too, of the default encoding, in the seconds that it was given or in its
own time. The effort *phases* of other methods is their usual one's field as phases, by `sgd`. *8 bits* are phases as a
display shows them, each the nearest of 256 levels. **Foci** is the mean of the five through the whole pupil,
**halfway** that of three foci halfway between the planes at which `focal-stack` is supervised. **Center** is what a
person sees first: the middle half of the picture, through the whole pupil, focused on what is there. **FLIP** is a
measure of what a person sees change between picture and reference (Andersson et al., 2020), 0 to 1, less is better:
mean of the foci in front, in the middle and at the back, at 67 pixels a degree; empty where its package was not there.

**Methods**: `auto` is HoloPath at its defaults. `full` follows paths from each view's surfaces, `fast` bakes diffuse
light first, and `auto-opl` puts images in mirrors at the optical path length, as published. `paper` is the published
estimator, and `direct` the same without a recording plane. [The others](how-to/compare.md) are other people's.
**Efforts**: *draft* to *high* are `--quality`, *512 rays* are rays a pixel, *despeckled* is `--despeckle`, and *encoded
5 s* is `--encode-seconds 5`.

All methods have diffuse light as Mitsuba's path tracer finds it: those that start from pictures take them with mirrors,
glass and gloss in them. A learned network is not in the chart: the method `network` takes a user's own.

How are the others tuned? """
    + TUNED
)


@dataclass(frozen=True)
class Made:
    """How a chart came about.

    Attributes
    ----------
    machine, date, commit, command : str
    seconds : float
        That it took this time; what was there already took none.
    """

    machine: str
    date: str
    commit: str
    command: str
    seconds: float

    @classmethod
    def now(cls, command, seconds, root):
        """Here and now, of the checkout at `root`."""
        return cls(_machine(), date.today().isoformat(), _commit(root), command, seconds)


def _machine():
    machine = output.machine()
    return f"{machine['processor']}, {os.cpu_count()} cores, {machine['system']}"


def _commit(root):
    def git(*words):
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True)
        return done.stdout.strip() if done.returncode == 0 else ""

    try:
        commit = git("rev-parse", "--short", "HEAD") or "unknown"
        return commit + (" with changes" if git("status", "--porcelain", "--untracked-files=no") else "")
    except OSError:
        return "unknown"


def write(chart, records, made, docs=False, since=None):
    """The chart's files: JSON, CSV, pictures and the page; with `docs` page and pictures in docs, too.

    Parameters
    ----------
    chart : Chart
    records : list of dict
        Of `run.measured`.
    made : Made
    docs : bool
    since : path, optional
        An earlier page or ``chart.json``: what is lower now than there is listed.

    Returns
    -------
    (str, list of str)
        The tables; and what failed and why, a sentence each, which the page names as well.
    """
    folder = Path(chart.folder)
    folder.mkdir(parents=True, exist_ok=True)
    faults, known = [], methods(chart.hologram)
    before = [] if since is None else earlier(since)
    measured = [record for record in records if record["scene"] in SCENES and "failed" not in record]
    ceilings = attempt(faults, "references", lambda: _ceilings(chart, measured), instead={})
    parts = archive.parts_of(records, made, ceilings)
    if docs:
        whole_parts = {name: part for name, part in parts.items() if _is_whole(chart, name, part)}
        archive.save(whole_parts, archive.FOLDER)
        parts = archive.load((*SCENES, archive.TRIANGLES), archive.FOLDER)
    records = [record for part in parts.values() for record in part["records"]]
    failed = [record for record in records if "failed" in record]
    timed = [record for record in records if record["scene"] not in SCENES and "failed" not in record]
    figures = [record for record in records if record["scene"] in SCENES and "failed" not in record]
    ceilings = {name: part["reference"] for name, part in parts.items() if part["reference"]}
    usual = {name: chart.usual(method) for name, method in known.items()}
    triangles = [
        {"method": r["method"], "triangles": int(r["scene"].split()[1]), "seconds": r["seconds"]}
        for r in timed
    ]
    whole = {
        **asdict(made),
        "chart": chart.name,
        "hologram": chart.hologram.to_dict(),
        "made": {name: part["made"] for name, part in parts.items()},
        "reference": ceilings,
        "records": figures,
        "triangles": triangles,
        "failed": failed,
    }

    def save():
        (folder / "chart.json").write_text(json.dumps(whole, indent=1))

    save()  # what was measured is there, whatever the rest does
    scenes = _scenes(figures)
    budgets = attempt(
        faults, "budgets", lambda: {s: analysis.compare(_of(figures, s)) for s in scenes}, instead={}
    )
    whole |= {"budgets": budgets}
    save()
    attempt(faults, "chart.csv", lambda: _write_csv(folder / "chart.csv", figures))
    ratios = attempt(faults, "ratios", lambda: analysis.ratios(figures, usual), instead={})
    table = attempt(faults, "Table 1", lambda: analysis.table_1(figures, usual), instead=([], {}))
    shown = attempt(faults, "frames", lambda: _shown(figures, known), instead={})
    names = pictures.draw(chart, figures, triangles, table, shown, _scenes(measured), folder, faults)
    published = _published_close_ups(figures, names) if docs else []
    page = _page(
        chart,
        figures,
        triangles,
        budgets,
        failed,
        {name: part["made"] for name, part in parts.items()},
        {name: part.get("renewals", ()) for name, part in parts.items()},
        ratios,
        table,
        ceilings,
        shown,
        [*names, *published],
        faults,
        before,
    )
    (folder / "chart.md").write_text(page.replace("](IMAGES/", "]("))
    if docs:
        IMAGES.mkdir(parents=True, exist_ok=True)
        for name in names:
            shutil.copy(folder / name, IMAGES / name)
        PAGE.write_text(page.replace("](IMAGES/", "](images/"))
    faults += [
        measure.line_of(record)
        for record in failed
        if measure.is_fault(record) and not known[record["method"]].missing()
    ]
    tables = attempt(
        faults,
        "tables",
        lambda: _told(chart, figures, triangles, budgets, failed, made, ratios, shown),
        instead=[],
    )
    return "\n".join(tables), faults


def _is_whole(chart, name, part):
    """Whether all records of a scene were measured, given up for their seconds, or are of methods that are missing."""
    known = methods(chart.hologram)
    there = {
        (r["scene"], r["method"], r["effort"], r["frames"])
        for r in part["records"]
        if not measure.is_fault(r) or known[r["method"]].missing()
    }
    due = {
        (t.scene, t.method, *record)
        for t in chart.tasks(chart.scenes, chart.methods)
        if archive.part_of(t.scene) == name
        for record in t.records
    }
    return due <= there


def _published_close_ups(figures, names):
    """Names of close-ups in docs of scenes that were measured before."""
    files = [f"chart-closeups-{scene}.jpg" for scene in _scenes(figures)]
    return [name for name in files if name not in names and (IMAGES / name).exists()]


def _shown(records, known):
    """By seconds and scene, what phases of each method show by frames."""
    efforts = {name: method.shown for name, method in known.items()}
    return {
        budget: {s: analysis.over_frames(_of(records, s), efforts, budget) for s in _scenes(records)}
        for budget in SHOWN_BUDGETS
    }


def _scenes(records):
    return [name for name in SCENES if any(record["scene"] == name for record in records)]


def _of(records, scene):
    return [record for record in records if record["scene"] == scene]


def _ceilings(chart, records):
    """PSNR in dB that the reference's own noise and the pupil's diffraction allow, by scene: mean and worst."""
    out = {}
    for scene in _scenes(records):
        path = measure.truth_path(chart.task(scene, "reference", []))
        if path.exists():
            with np.load(path) as truth:
                noise, wanted = truth["ceiling"][: len(HEADLINE)], truth["pictures"]
                others = truth["others"]
            blurred = looks.diffracted(wanted, SCENES[scene].foci, others, chart.hologram)
            border = looks.border_of(chart.hologram)
            waves = np.array(
                [engine.psnr_of_halves(*pair, border) for pair in zip(blurred, wanted, strict=True)][
                    : len(HEADLINE)
                ]
            )
            out[scene] = {
                "spp": chart.spp,
                "noise": {"psnr": float(noise.mean()), "psnr_worst": float(noise.min())},
                "diffraction": {"psnr": float(waves.mean()), "psnr_worst": float(waves.min())},
            }
    return out


def _write_csv(path, records):
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ["method", "scene", "frames", "effort", "pixels", *PLAIN, *(f"psnr {n}" for n in LOOKS)]
        )
        for r in records:
            own = [r["method"], r["scene"], r["frames"], r["effort"], r["pixels"]]
            table.writerow([*own, *(r[n] for n in PLAIN), *(r["pictures"][n]["psnr"] for n in LOOKS)])


def _number(value, digits=1):
    return "" if value is None else f"{value:.{digits}f}"


def _seconds(value):
    return "" if value is None else f"{value:.3g}"


def _rows(header, rows):
    lines = [f"| {' | '.join(header)} |", f"|{' --- |' * len(header)}"]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows)]


def _page(
    chart,
    records,
    triangles,
    budgets,
    failed,
    made,
    renewals,
    ratios,
    table,
    ceilings,
    shown,
    names,
    faults,
    before,
):
    """The page, its pictures in IMAGES; of pictures those `names` that were drawn."""

    def picture(name, what):
        return f"![{what}](IMAGES/{name})\n" if name in names else ""

    size = f"{chart.hologram.width} x {chart.hologram.height}"
    text = [INTRODUCTION.format(short=measure.SHORT)]
    text.append(
        f"Holograms of {size}, 8 µm, 640, 516.5 and 455.4 nm, 1 to 6 mm from the SLM; references of {chart.spp} paths "
        "a pixel and wavelength.\n"
    )
    text += [*_made_table(made, renewals), ""]
    lacking = [scene for scene in chart.scenes if scene not in made]
    if lacking and made:
        text.append(f"Not measured of this code: {', '.join(lacking)}.\n")
    if not records and not failed:
        text.append("Nothing has been measured yet: `make chart` writes the tables and pictures here.\n")
        return "\n".join(text)
    text.append("## What a 60 Hz SLM shows\n")
    text.append(
        f"One frame, phases: best PSNR in dB within {max(SHOWN_BUDGETS)} s, mean / worst. Most SLMs show 60 to 180 "
        "pictures a second: one to three frames in one color, one frame in three. Methods that find a complex field "
        "are compared by the phases that `sgd` or `joint` finds for it, in the seconds of both. With fewer than six "
        "frames other people's methods begin with phases that are nearly constant, for random ones show more speckle "
        "than picture; stereogram, light-field and the paper's estimator stay random.\n"
    )
    text += [*attempt(faults, "one frame", lambda: _one_frame_table(shown), instead=[]), ""]
    text += ["## Frames\n", picture("chart-frames.png", "PSNR of phases over frames")]
    text.append(
        f"The best phases within {max(SHOWN_BUDGETS)} s, and dashed within {min(SHOWN_BUDGETS)} s. In the tables, "
        "means over all scenes, empty where one of them takes longer; *in focus* and *out of focus* are "
        "pixels in front, middle and back.\n"
    )
    measured = {
        m for best in shown.get(max(SHOWN_BUDGETS), {}).values() for own in best.values() for m in own
    }
    for frames in sorted(measured):
        text += [f"**M = {frames}**, dB\n"]
        text += attempt(
            faults, f"M = {frames}", lambda frames=frames: _frame_table(shown, frames), instead=[]
        )
        text.append("")
    text += ["## What a person sees first\n"]
    text.append(
        f"Phases within {max(SHOWN_BUDGETS)} s, means over scenes, M = {M}; in brackets within {min(SHOWN_BUDGETS)} s. "
        "The middle of the picture in focus, what a person sees change, the five foci, foci at which nothing was "
        "supervised, and structure in focus and out of it.\n"
    )
    text += [*attempt(faults, "what a person sees", lambda: _seen_table(shown), instead=[]), ""]
    text += ["## Fields, phases, and phases of 8 bits\n"]
    text.append(
        f"PSNR in dB of `auto` at its defaults, M = {M}, mean / worst: its complex field, phases by the default "
        "encoding, and these as a display shows them.\n"
    )
    text += [*attempt(faults, "8 bits", lambda: _levels_table(records), instead=[]), ""]
    text += ["## Seconds and PSNR\n", picture("chart-seconds.png", "PSNR over seconds")]
    text.append(
        "Each line is a method at its efforts, M = 8: solid for complex fields, dashed for the light of phases. Rings "
        "mark what no other beats in both.\n"
    )
    text.append("## Within a budget\n")
    text.append(
        "dB by which auto leads the best that starts from pictures or surfaces alone, mean / worst; none: it has "
        "nothing yet. With a star it is a draft, which shows mirrors and glass as pictures on their surfaces.\n"
    )
    text += [*attempt(faults, "leads", lambda: _leads_table(budgets), instead=[]), ""]
    text.append(
        "In that table a method that finds a complex field is compared by it. The same of phases alone, which is what "
        "most SLMs show; empty where nobody has any yet:\n"
    )
    phases = [record for record in records if analysis.is_phases(record)]
    text += attempt(
        faults,
        "leads of phases",
        lambda: _leads_table({scene: analysis.compare(_of(phases, scene)) for scene in budgets}),
        instead=[],
    )
    text += ["", *_notes("exceptions")]
    for scene, rows in budgets.items():
        text += attempt(
            faults,
            f"budgets of {scene}",
            lambda scene=scene, rows=rows: _budget_lines(scene, rows, ceilings.get(scene)),
            instead=[],
        )
    if ratios:
        text.append("## Seconds over frames\n")
        text += attempt(faults, "seconds over frames", lambda: _frames_table(ratios), instead=[])
    text += ["\n## The paper's Table 1, measured\n", picture("chart-table-1.png", "Table 1")]
    text.append(
        "Medians of seconds and means of PSNR over the scenes at each method's usual effort; reflection and refraction "
        "on scenes with mirrors or glass, material and GI on those with gloss or indirect light; *view* of the four "
        "half pupils and both views, *depth between* of the two foci where nothing need be. Nothing here is trained.\n"
    )
    criteria, cells = table
    rows = [[name, *(_seconds(v) if "dB" not in c else _number(v) for c, v in zip(criteria, row, strict=True))]
            for name, row in cells.items()]  # fmt: skip
    text += _rows(["method", *criteria], rows)
    text += ["\n## Convergence\n", picture("chart-convergence.png", "PSNR over effort")]
    if triangles:
        text += ["## Triangles\n", picture("chart-triangles.png", "Seconds over triangles")]
        text += [*attempt(faults, "triangles", lambda: _triangles_table(triangles), instead=[]), ""]
    text.append(
        "## Close-ups\n\nThe reference first, then each method at its effort of highest PSNR: in focus in front, at "
        "the back, and the view to the right.\n"
    )
    text += [picture(f"chart-closeups-{scene}.jpg", scene) for scene in _scenes(records)]
    text.append("## All figures\n")
    text += attempt(faults, "all figures", lambda: _all_figures(records), instead=[])
    if before:
        text.append(
            f"\n## What is lower than before\n\nBy more than {FALL} dB, in {len(before)} records of before.\n"
        )
        text += _notes("falls")
        text += attempt(faults, "falls", lambda: _falls_table(before, records), instead=[])
    gaps = [(r, r["failed"]) for r in failed]
    text.append("\n## What gave no figures\n")
    text.append(f"{_count(records, triangles, failed)}\n")
    if gaps or faults:
        text += _rows(
            ["scene", "method", "effort", "frames", "why"],
            [[r["scene"], r["method"], r["effort"], str(r["frames"]), _cell(why)] for r, why in gaps]
            + [["", "", "", "", _cell(fault)] for fault in faults],
        )
    return "\n".join(text) + "\n"


def _notes(name):
    """Remarks of whoever measured, which the page has as they are."""
    file = NOTES / f"{name}.md"
    return [file.read_text("utf-8")] if file.exists() else []


def _made_table(made, renewals):
    """Where and when each scene was measured, and what was renewed of it: scenes of one run share a row."""
    runs = {}
    for scene, run_of in made.items():
        key = tuple(run_of[name] for name in ("machine", "date", "commit"))
        runs.setdefault(key, []).append(scene)
    for scene, later in renewals.items():
        for run_of in later:
            key = tuple(run_of[name] for name in ("machine", "date", "commit"))
            frames = ", ".join(map(str, sorted({m for *_, m in run_of["records"]})))
            names = ", ".join(dict.fromkeys(name for name, *_ in run_of["records"]))
            runs.setdefault(key, []).append(
                f"{scene} ({names}: {len(run_of['records'])} records of {frames} frames, "
                f"seconds divided by {run_of['slower']:.2f})"
            )
    return _rows(
        ["measured on", "date", "commit", "scenes"], [[*key, ", ".join(names)] for key, names in runs.items()]
    )


def _one_frame_table(shown):
    """What phases of one frame show of each scene within the most seconds, and where `auto` is ahead."""
    best = shown.get(max(shown, default=0), {})
    names = list(dict.fromkeys(name for own in best.values() for name in own))

    def pair(own, name):
        record = own.get(name, {}).get(1)
        return "" if record is None else f"{record['psnr']:.1f} / {record['psnr_worst']:.1f}"

    def ahead(own, figure):
        values = {name: records[1][figure] for name, records in own.items() if 1 in records}
        return "" if "auto" not in values else "yes" if values["auto"] == max(values.values()) else "no"

    body = [[name, *(pair(own, name) for own in best.values())] for name in names]
    figures = ("psnr", "psnr_worst")
    body.append(["*auto ahead*", *(" / ".join(ahead(own, f) for f in figures) for own in best.values())])
    return _rows(["method", *best], body)


SEEN_COLUMNS = {
    "center": ("psnr_center", 1),
    "FLIP": ("flip", 3),
    "foci": ("psnr_foci", 1),
    "halfway": ("psnr_halfway", 1),
    "SSIM in focus": ("ssim_focus", 3),
    "SSIM out of focus": ("ssim_defocus", 3),
}


def _seen_table(shown):
    """What a person sees first, in means over the scenes, of phases of `M` frames; the fewest seconds in brackets."""
    best, soon = (shown.get(pick(shown, default=0), {}) for pick in (max, min))
    body = []
    for name in dict.fromkeys(name for own in best.values() for name in own):
        row = []
        for figure, digits in SEEN_COLUMNS.values():
            value, early = (
                _number(analysis.mean_over_scenes(b, figure, name, M), digits) for b in (best, soon)
            )
            row.append(f"{value} ({early})" if early else value)
        body.append([name, *row])
    return _rows(["method", *SEEN_COLUMNS], body)


def _levels_table(records):
    """`auto` at its defaults by scene: the complex field, phases, and phases of 8 bits."""
    own = {(r["scene"], r["effort"]): r for r in records if (r["method"], r["frames"]) == ("auto", M)}
    body = []
    for scene in _scenes(records):
        field, phases = own.get((scene, "balanced")), own.get((scene, ENCODED))
        pairs = [(field, ""), (phases, ""), (phases, "_8_bits")]
        body.append([scene, *("" if r is None else f"{r['psnr' + kind]:.2f} / {r['psnr_worst' + kind]:.2f}"
                              for r, kind in pairs)])  # fmt: skip
    return _rows(["scene", "complex field", "phases", "phases of 8 bits"], body)


def _count(records, triangles, failed):
    """How many records there are, and how many are missing."""
    there, late = len(records) + len(triangles), sum(not measure.is_fault(r) for r in failed)
    sentence = f"{there} of {there + len(failed)} records are there"
    if not failed:
        return f"{sentence}."
    return f"{sentence}. {late} were given up for their seconds, and {len(failed) - late} failed or were left out."


def earlier(path):
    """Records of an earlier chart: its ``chart.json``, or the table of all figures of its page.

    Raises
    ------
    engine.InvalidInput
        If there is neither.
    """
    try:
        text = Path(path).read_text("utf-8")
        if Path(path).suffix == ".json":
            return json.loads(text)["records"]
    except (OSError, ValueError, KeyError) as error:
        raise engine.InvalidInput(
            f"{path} is no earlier chart ({error}): name its chart.json or its page."
        ) from None
    tables = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    rows = [
        row
        for table in tables
        if table.startswith("| scene | method | effort | M | s |")  # not that of what is lower
        for row in table.splitlines()
    ]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    if not cells:
        raise engine.InvalidInput(
            f"{path} has no table of all figures: name a chart's chart.json or its page."
        )
    names = dict(zip(cells[0], range(len(cells[0])), strict=True))
    return [
        {"scene": row[0], "method": row[1], "effort": row[2], "frames": int(row[3])}
        | {"seconds": float(row[names["s"]]), "psnr": float(row[names["PSNR"]])}
        | {"psnr_worst": float(row[names["worst"]])}
        for row in cells[2:]
        if row[4]
    ]


def _falls_table(before, records):
    body = [
        [
            new["scene"],
            new["method"],
            new["effort"],
            str(new["frames"]),
            "mean" if figure == "psnr" else "worst",
        ]
        + [f"{old[figure]:.2f}", f"{new[figure]:.2f}", _seconds(old["seconds"]), _seconds(new["seconds"])]
        for old, new, figure in analysis.fallen(before, records, FALL)
    ]
    header = ["scene", "method", "effort", "M", "PSNR", "before", "now", "s before", "s now"]
    return _rows(header, body)


FRAME_COLUMNS = {
    "mean": "psnr",
    "worst": "psnr_worst",
    "in focus": "psnr_focus",
    "out of focus": "psnr_defocus",
}


def _frame_table(shown, frames):
    """Means over the scenes of which so many frames were measured, within each budget."""
    most = shown.get(max(shown, default=0), {})
    scenes = [scene for scene, best in most.items() if any(frames in own for own in best.values())]
    shown = {budget: {scene: best[scene] for scene in scenes} for budget, best in shown.items()}
    names = dict.fromkeys(name for best in shown.values() for own in best.values() for name in own)
    header = [f"{what}, {budget} s" for budget in shown for what in FRAME_COLUMNS]
    body = [
        [name, *(_number(analysis.mean_over_scenes(best, figure, name, frames))
                 for best in shown.values() for figure in FRAME_COLUMNS.values())]
        for name in names
    ]  # fmt: skip
    return _rows(["method", *header], body)


def _cell(text):
    return text.replace("|", "/")


def _budget_lines(scene, rows, note):
    """A scene's table of budgets, and what its reference allows."""
    allowed = "".join(
        f"; {what} allows {note[name]['psnr']:.1f} / {note[name]['psnr_worst']:.1f} dB"
        for name, what in (
            ("noise", "the reference's own noise"),
            ("diffraction", "the pupil's diffraction"),
        )
        if note
    )
    title = f"**{scene}**, {SCENES[scene].what}: best PSNR in dB, mean / worst{allowed}\n"
    return [title, *_budget_table(rows), "", *_why(scene, rows), ""]


def _budget_table(rows):
    names = list(rows[0]["best"])
    pairs = list(zip(rows[::2], rows[1::2], strict=True))
    body = [
        [name, *("" if mean["best"][name] is None else f"{_best(mean, name)} / {_best(worst, name)}"
                 for mean, worst in pairs)]
        for name in names
    ]  # fmt: skip
    said = {True: "yes", False: "no"}
    ahead = ((mean["ahead"], worst["ahead"]) for mean, worst in pairs)
    body.append(["*auto ahead*", *("" if a is None else f"{said[a]} / {said[b]}" for a, b in ahead)])
    return _rows(["method", *(f"{mean['budget']} s" for mean, _ in pairs)], body)


def _best(row, name):
    return f"{row['best'][name]:.1f}" + ("*" if name in row["flat"] else "")


def _leads_table(budgets):
    """By how much `auto` is ahead on each scene within each budget."""

    def lead(row):
        if row["auto"] is None:
            return "none" if row["rival"] is not None else ""
        lead = "alone" if row["rival"] is None else f"{row['auto'] - row['rival']:+.1f}"
        return lead + ("*" if "auto" in row["flat"] else "")

    rows = list(budgets.values())
    header = ["scene", *(f"{row['budget']} s" for row in rows[0][::2])] if rows else ["scene"]
    body = [
        [
            scene,
            *(
                f"{lead(mean)} / {lead(worst)}".strip(" /")
                for mean, worst in zip(own[::2], own[1::2], strict=True)
            ),
        ]
        for scene, own in budgets.items()
    ]
    return _rows(header, body)


def _why(scene, rows):
    """Where `auto` is not ahead: of whom, and by how much."""
    lines = []
    for row in rows:
        if row["ahead"] is False:
            kind = "mean" if row["figure"] == "psnr" else "worst"
            own = "nothing yet" if row["auto"] is None else f"{row['auto']:.2f} dB"
            lines.append(f"- {row['budget']} s, {kind}: {row['by']} {row['rival']:.2f} dB, auto {own}")
    return lines


def _frames_table(several):
    frames = sorted({m for own, _ in several.values() for m in own})
    body = [
        [scene, method, *(_seconds(own.get(m)) for m in frames), _number(ratio, 2)]
        for (scene, method), (own, ratio) in several.items()
    ]
    return _rows(["scene", "method", *(f"s at M = {m}" for m in frames), "M = 24 / M = 1"], body)


def _triangles_table(triangles):
    counts = sorted({row["triangles"] for row in triangles})
    body = []
    for name in dict.fromkeys(row["method"] for row in triangles):
        own = {row["triangles"]: row["seconds"] for row in triangles if row["method"] == name}
        ratio = own[max(own)] / own[min(own)]
        body.append([name, *(_seconds(own.get(n)) for n in counts), f"{ratio:.2f}"])
    return _rows(["method", *(f"{n:,}, s" for n in counts), "most / fewest"], body)


def _all_figures(records):
    header = ["scene", "method", "effort", "M", "s", "GB", "PSNR", "worst", "SSIM"]
    header += ["front, middle, back", "views", "pupil 1/2, 1/4"]
    header += ["in focus", "out of focus", "foci", "halfway", "center", "FLIP", "speckle"]
    header += ["8 bits, mean", "8 bits, worst"]
    body = []
    for r in records:
        shown = (("front", "middle", "back"), ("view-left", "view-right"), PUPILS)
        foci, views, pupils = (
            ", ".join(_number(r["pictures"][name]["psnr"]) for name in names) for names in shown
        )
        body.append(
            [r["scene"], r["method"], r["effort"], str(r["frames"]), _seconds(r["seconds"])]
            + [_number(r["peak_bytes"] / 1e9, 2), _number(r["psnr"], 2), _number(r["psnr_worst"], 2)]
            + [_number(r["ssim"], 3), foci, views, pupils]
            + [
                _number(r[name])
                for name in ("psnr_focus", "psnr_defocus", "psnr_foci", "psnr_halfway", "psnr_center")
            ]
            + [
                _number(r["flip"], 3),
                _number(r["speckle"], 3),
                *(_number(r[name], 2) for name in measure.EIGHT_BITS),
            ]
        )
    return _rows(header, body)


def _told(chart, records, triangles, budgets, failed, made, ratios, shown):
    """The tables for the terminal."""
    lines = [
        f"chart: {chart.name}, {chart.hologram.width} x {chart.hologram.height}, {len(records)} records, "
        f"{made.seconds:.0f} s; {made.machine}, {made.date}, commit {made.commit}"
    ]
    lines += [
        "",
        f"One frame, phases, within {max(SHOWN_BUDGETS)} s, dB, mean / worst",
        *_one_frame_table(shown),
    ]
    for scene, rows in budgets.items():
        lines += ["", f"{scene}: best PSNR within a budget, dB, mean / worst", *_budget_table(rows)]
    if ratios:
        lines += ["", *_frames_table(ratios)]
    if triangles:
        lines += ["", *_triangles_table(triangles)]
    lines += [measure.line_of(record) for record in failed]
    lines.append(_count(records, triangles, failed))
    lines.append(f"\n{chart.folder}: chart.json, chart.csv, chart.md and pictures")
    return lines
