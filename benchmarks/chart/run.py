"""Which records a chart has, who measures them, and in which order."""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from holopath_addon import engine

from ..parts import Incomplete, sentence_of
from . import archive, measure, renewal, report
from .methods import ENCODED, OTHERS, SHOWN, M, methods
from .scenes import SCENES, TRIANGLES

FOLDER = Path("build/chart")
PIXELS = 256  # of the holograms, a side
RGB = (640e-9, 516.5e-9, 455.4e-9)
TIMED = ("point", "polygon", "gaussian", "auto")  # over triangles
OVER_FRAMES = ("planes",)  # scenes in which seconds of the usual efforts over frames are found
MANY_FRAMES = ("planes", "portrait")  # in which phases of 24 frames are measured
# Efforts of the whole chart, of methods that gain too little by the others: it is to take three hours at most.
FULL_EFFORTS = {
    **dict.fromkeys(("point", "gaussian"), ("draft", "balanced")),
    "polygon": ("draft", "balanced", SHOWN),
    "rgbd": ("draft", "balanced", SHOWN, "joint phases", "dpac"),
    "rgbd-sgd": ("preview", "balanced"),
    "focal-stack": ("draft", "preview", "balanced", "balanced, 128 paths"),
    "light-field": ("preview", "balanced"),
    **dict.fromkeys(("stereogram", "rgbd-torchoptics", "rgbd-odak", "fast", "auto-opl"), ("balanced",)),
    "direct": ("512 rays",),
    "paper": ("256 rays", "1024 rays"),
    "full": ("draft", "balanced"),
    "auto": (
        "draft", "preview", "balanced", "high", "preview, encoded 1 s", "preview, encoded 5 s",
        "balanced, encoded 7 s", "balanced, encoded 20 s", ENCODED, "high, encoded 45 s",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Chart:
    """What is measured.

    Attributes
    ----------
    name : str
    hologram : engine.Hologram
    spp : int
        Paths a pixel of the reference.
    limit : float
        Seconds after which a record is given up.
    scenes, methods : tuple of str
    efforts : dict of str to tuple
        Of methods that are not given all of theirs.
    frames : dict of str to tuple
        Numbers of frames, other than `M`, of each scene, for the usual efforts.
    shown : dict of str to tuple
        The same of efforts that are phases, of those that the method has, see `Method.shown`.
    triangles : tuple of int
        Of the hills.
    apart : bool
        Whether each scene and method has a process of its own; without, peak memory is not each one's own.
    folder : Path
        Of what is written, and of records and references that are kept.
    """

    name: str
    hologram: engine.Hologram
    spp: int
    limit: float
    scenes: tuple
    methods: tuple
    efforts: dict
    frames: dict
    shown: dict
    triangles: tuple = ()
    apart: bool = True
    folder: Path = FOLDER

    def __post_init__(self):
        """Refuse what could only fail after hours: names that there are not, and methods without an effort."""
        known = methods(self.hologram)
        for names, choices, what in (
            (self.scenes, SCENES, "scene"),
            (self.methods, known, "method"),
            (self.frames, self.scenes, "scene of this chart"),
            (self.shown, self.scenes, "scene of this chart"),
            (self.efforts, self.methods, "method of this chart"),
        ):
            for name in names:
                _check(name, choices, what)
        for name, efforts in self.efforts.items():
            for effort in efforts:
                _check(effort, known[name].efforts, f"effort of {name}")
            if not efforts:
                raise engine.InvalidInput(f"The chart {self.name} gives {name} no effort.")

    def usual(self, method):
        """The effort of figures that have one only."""
        efforts = self.efforts_of(method)
        if method.usual in efforts:
            return method.usual
        return ([effort for effort in efforts if not method.encoding(effort)] or efforts)[-1]

    def efforts_of(self, method):
        """Names of a method's efforts in this chart, from the least."""
        return [e for e in method.efforts if e in self.efforts.get(method.name, method.efforts)]

    def records(self, scene, method):
        """Effort and frames of each record of a scene and method, in order of work."""
        usual, records = self.usual(method), []
        for effort in self.efforts_of(method):
            several = {M}
            if effort == usual:
                several.update(self.frames.get(scene, ()))
            if effort in method.shown:
                several.update(m for m in method.shown[effort] if m in self.shown.get(scene, ()))
            records += [(effort, frames) for frames in sorted(several)]
        return records

    def tasks(self, scenes, names):
        """Every `measure.Task` of scenes and methods: each scene's reference before its methods."""
        known, tasks = methods(self.hologram), []
        for scene in scenes:
            tasks.append(self.task(scene, "reference", []))
            tasks += [self.task(scene, name, self.records(scene, known[name])) for name in names]
        for triangles in self.triangles:
            for name in TIMED:
                if name in names:
                    record = (self.usual(known[name]), M)
                    tasks.append(self.task(f"hills {triangles}", name, [record]))
        return tasks

    def task(self, scene, method, records):
        """The `measure.Task` of a scene and the name of a method."""
        hologram = self.hologram.to_dict()
        return measure.Task(scene, method, hologram, self.spp, self.limit, records, str(self.folder))


def _check(name, choices, what):
    if name not in choices:
        raise engine.InvalidInput(f"There is no {what} {name}: choose of {', '.join(choices)}.")


def _hologram(pixels):
    """From 256 pixels a side on the same volume; below, one as much nearer, whose light still passes the aperture."""
    nearer = min(1.0, pixels / 256)
    return engine.Hologram(pixels, pixels, 8e-6, RGB, 1e-3 * nearer, 6e-3 * nearer)


def full(pixels=PIXELS):
    """The chart of ``make chart``, of holograms so many pixels wide and high."""
    hologram = _hologram(pixels)
    shown = {scene: OTHERS if scene in MANY_FRAMES else (1, 3) for scene in SCENES}
    return Chart(
        "full", hologram, 128, 100.0, tuple(SCENES), tuple(methods(hologram)), FULL_EFFORTS,
        dict.fromkeys(OVER_FRAMES, OTHERS), shown, TRIANGLES,
    )  # fmt: skip


def quick(pixels=PIXELS):
    """The chart of ``make chart-quick``: `auto` at its efforts and its rivals, under ten minutes on two cores."""
    hologram = _hologram(pixels)
    efforts = {
        "polygon": ("preview",),
        "rgbd": ("preview", SHOWN),
        "gaussian": ("preview",),
        "focal-stack": ("preview",),
        "direct": ("512 rays",),
        "auto": ("draft", "preview", "balanced", "preview, encoded 5 s", "balanced, encoded"),
    }
    return Chart(
        "quick", hologram, 16, 60.0, ("planes", "mirror"), tuple(efforts), efforts, {"planes": (1, 24)},
        {"planes": (1, 3)}, (2_000, 200_000),
        folder=FOLDER / "quick",  # a chart in little must not put out hours of work
    )  # fmt: skip


def run(*arguments):
    """Measure what is missing of a chart, and write it.

    Parameters
    ----------
    *arguments : str
        ``[quick] [SCENE ...] [--methods NAME ...] [--frames M ... [--efforts NAME ...]] [--pixels N] [--anew] [--docs]
        [--page] [--since FILE] [--out FOLDER]``; see `parser`.

    Returns
    -------
    str
        The tables.

    Raises
    ------
    Incomplete
        With the tables, where a part of the chart failed: the others are written all the same.
    """
    options = parser().parse_args(arguments)
    short = options.names[:1] == ["quick"]
    if short and options.docs:
        raise engine.InvalidInput("The quick chart is not published: leave out --docs, or quick.")
    if options.page:
        return _write_page(options)
    chart = (quick if short else full)(options.pixels)
    parts = options.names[short:] or (*chart.scenes, archive.TRIANGLES)
    scenes = [name for name in parts if name != archive.TRIANGLES]
    if len(scenes) == len(parts):
        chart = replace(chart, triangles=())  # only what is named
    if options.out:
        chart = replace(chart, folder=Path(options.out).absolute())
    names = options.methods or chart.methods
    for name in scenes:
        _check(name, SCENES, "scene")
    for name in names:
        _check(name, methods(chart.hologram), "method")
    if options.since:
        report.earlier(options.since)  # it is told before hours of work that there is none
    command, start = " ".join(("python -m benchmarks chart", *arguments)), time.perf_counter()

    def made_now():
        return report.Made.now(command, time.perf_counter() - start, measure.ROOT)

    if options.efforts and not options.frames:
        raise engine.InvalidInput("--efforts chooses of what --frames renews: give it with --frames.")
    if options.frames:
        if not options.docs:
            raise engine.InvalidInput("--frames renews what is published: give it with --docs.")
        if options.pixels != PIXELS:
            raise engine.InvalidInput("--frames renews holograms of the published size: leave out --pixels.")

        def do(chart, tasks):
            return measured_tasks(chart, tasks)[0]

        faults = renewal.renew(chart, scenes, names, options.frames, options.efforts, do, made_now)
        tables, others = report.write(chart, [], made_now(), True, options.since)
        if faults or others:
            raise Incomplete(tables, [*faults, *others])
        return tables
    records, seconds = measured(chart, scenes, names, options.anew)
    made = made_now()
    tables, faults = report.write(chart, records, made, options.docs, options.since)
    if faults:
        raise Incomplete(tables, faults)
    return tables


def _write_page(options):
    """Write the page of what is published; return its tables."""
    chart = full()
    others = options.names, options.methods, options.anew, options.docs, options.out, options.pixels != PIXELS
    if any(others):
        raise engine.InvalidInput(
            "The page is of all that is published: leave out all but --page and --since."
        )
    if not archive.load((*chart.scenes, archive.TRIANGLES), archive.FOLDER):
        raise engine.InvalidInput(
            f"Nothing is published in {archive.FOLDER} yet: measure a scene with --docs."
        )
    made = report.Made.now("python -m benchmarks chart --page", 0.0, measure.ROOT)
    tables, faults = report.write(chart, [], made, True, options.since)
    if faults:
        raise Incomplete(tables, faults)
    return tables


def parser():
    """Of the command's arguments."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks chart", description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="[quick] SCENE",
        help=f"of {', '.join(SCENES)}, {archive.TRIANGLES}; default: all",
    )
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="default: all")
    parser.add_argument(
        "--frames",
        nargs="+",
        type=int,
        metavar="M",
        help="with --docs: measure only records of so many frames anew, of scenes that are published, in the seconds "
        "of their machine",
    )
    parser.add_argument(
        "--efforts", nargs="+", default=(), metavar="NAME", help="with --frames: only these; default: all"
    )
    parser.add_argument("--pixels", type=int, default=PIXELS, help="of the holograms, a side; default: 256")
    parser.add_argument("--anew", action="store_true", help="measure what is there already, too")
    parser.add_argument(
        "--docs",
        action="store_true",
        help="publish scenes that are whole in docs/chart, and write docs/chart.md of all that are there",
    )
    parser.add_argument(
        "--page", action="store_true", help="write docs/chart.md of what is published, and measure nothing"
    )
    parser.add_argument(
        "--since", metavar="FILE", help="an earlier page or chart.json: list what is lower now than there"
    )
    parser.add_argument(
        "--out", metavar="FOLDER", help=f"of records and page; default: {FOLDER}, of quick {FOLDER}/quick"
    )
    return parser


def measured(chart, scenes, names, anew=False, tell=None):
    """All records of scenes and methods, from disk where they are still true; and the seconds it took.

    A task that fails or is interrupted leaves the others: its records are there, ``failed`` with the reason.

    Parameters
    ----------
    chart : Chart
    scenes, names : sequence of str
        Of scenes and methods.
    anew : bool
        Measure what is there already, too.
    tell : callable, optional
        ``tell(line)``; default: to the error output.
    """
    tasks = chart.tasks(scenes, names)
    if anew:
        for task in tasks:
            for record in task.records:
                measure.record_path(task, *record).unlink(missing_ok=True)
    return measured_tasks(chart, tasks, tell)


def measured_tasks(chart, tasks, tell=None):
    """Records of tasks, and the seconds that it took; see `measured`."""
    tell = tell or (lambda line: print(line, file=sys.stderr, flush=True))
    start, known = time.perf_counter(), methods(chart.hologram)
    reasons = {}  # why records are missing, by scene and method
    for task in tasks:
        key, reference = (task.scene, task.method), reasons.get((task.scene, "reference"))
        reason = known[task.method].missing() if task.method in known else None
        if reason:
            tell(reason)
        elif reference:
            reason = f"no reference: {reference}"
        elif renewal.INTERRUPTED in reasons.values():
            reason = renewal.INTERRUPTED
        elif not measure.is_done(task):
            tell(f"{task.scene}: {task.method} ({time.perf_counter() - start:.0f} s so far)")
            try:
                reason = _do(task, chart.apart)
            except KeyboardInterrupt:
                reason = renewal.INTERRUPTED
        if reason:
            reasons[key] = reason
            tell(f"{task.scene}: {task.method}: {reason}")
    records = []
    for task in tasks:
        why = reasons.get((task.scene, task.method), "not measured")
        for effort, frames in task.records:
            gap = {"scene": task.scene, "method": task.method, "effort": effort, "frames": frames}
            records.append(measure.kept(task, effort, frames) or gap | {"failed": why})
    return records, time.perf_counter() - start


def _do(task, apart):
    """Measure a task here, or in a process that may fail on its own; why it failed, None where it did not."""
    if not apart:
        try:
            measure.run(task)
        except Exception as error:
            return sentence_of(error)
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "task.json"
        file.write_text(json.dumps(asdict(task)))
        command = [sys.executable, "-m", "benchmarks.chart.measure", str(file)]
        patience = 3600 + 4 * task.limit * max(1, len(task.records))
        try:
            status = subprocess.run(command, cwd=measure.ROOT, timeout=patience).returncode
        except subprocess.TimeoutExpired:
            return f"no answer within {patience:g} s"
        why = file.with_suffix(".why")
        return (
            why.read_text() if why.exists() else f"its process ended with status {status}" if status else None
        )
