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

from . import measure, peers, report
from .methods import FRAMES, M, methods
from .scenes import SCENES, TRIANGLES

FOLDER = Path("build/chart")
RGB = (640e-9, 516.5e-9, 455.4e-9)
TIMED = ("point", "polygon", "gaussian", "auto")  # over triangles
OVER_FRAMES = ("planes", "mirror")  # scenes in which seconds over frames are found


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
        Numbers of frames, other than `M`, of each scene.
    triangles : tuple of int
        Of the hills.
    loss : bool
        Whether the loss of phase-only encoding is found.
    apart : bool
        Whether each scene and method has a process of its own; without, peak memory is not each one's own.
    folder, kept : Path
        What is written, and where records and references are kept, by default there, too.
    """

    name: str
    hologram: engine.Hologram
    spp: int
    limit: float
    scenes: tuple
    methods: tuple
    efforts: dict
    frames: dict
    triangles: tuple = ()
    loss: bool = False
    apart: bool = True
    folder: Path = FOLDER
    kept: Path | None = None

    def usual(self, method):
        """The effort of figures that have one only."""
        efforts = self.efforts_of(method)
        return method.usual if method.usual in efforts else efforts[-1]

    def efforts_of(self, method):
        """Names of a method's efforts in this chart, from the least."""
        return [e for e in method.efforts if e in self.efforts.get(method.name, method.efforts)]

    def records(self, scene, method):
        """Effort and frames of each record of a scene and method, in order of work."""
        several = {M, *self.frames.get(scene, ())}
        usual = self.usual(method)
        return [(e, m) for e in self.efforts_of(method) for m in sorted(several if e == usual else {M})]

    def task(self, scene, method, records):
        """The `measure.Task` of a scene and the name of a method."""
        hologram = self.hologram.to_dict()
        return measure.Task(
            scene, method, hologram, self.spp, self.limit, records, self.loss, str(self.kept or self.folder)
        )


def full(pixels=256):
    """The chart of ``make chart``, of holograms so many pixels wide and high."""
    hologram = engine.Hologram(pixels, pixels, 8e-6, RGB, 1e-3, 6e-3)
    others = tuple(m for m in FRAMES if m != M)
    return Chart(
        "full", hologram, 256, 300.0, tuple(SCENES), tuple(methods(hologram)), {},
        dict.fromkeys(OVER_FRAMES, others), TRIANGLES, loss=True,
    )  # fmt: skip


def quick():
    """The chart of ``make chart-quick``: under ten minutes on two cores."""
    hologram = engine.Hologram(256, 256, 8e-6, RGB, 1e-3, 6e-3)
    known = methods(hologram)
    efforts = {
        name: ("draft",) if method.phases else ("preview",)
        for name, method in known.items()
        if method.kind in ("baseline", "peer")
    }
    efforts |= {
        "direct": ("512 rays",),
        "full": ("balanced",),
        "auto": ("draft", "preview", "balanced"),
    }
    left_out = ("paper", "fast", "auto-opl", *peers.PEERS)
    return Chart(
        "quick", hologram, 32, 60.0, ("planes", "mirror", "tea"),
        tuple(name for name in known if name not in left_out), efforts, {"planes": (1, 24)}, (2_000, 200_000),
        kept=FOLDER / "quick",  # a chart in little must not put out hours of work
    )  # fmt: skip


def run(*arguments):
    """Measure what is missing of a chart, and write it.

    Parameters
    ----------
    *arguments : str
        ``[quick] [SCENE ...] [--methods NAME ...] [--pixels N] [--anew] [--docs]``; see `parser`.

    Returns
    -------
    str
        The tables.
    """
    options = parser().parse_args(arguments)
    names = list(options.names)
    chart = quick() if names[:1] == ["quick"] else full(options.pixels)
    scenes = names[names[:1] == ["quick"] :]
    if scenes:
        chart = replace(chart, triangles=())  # only what is named
    scenes = scenes or chart.scenes
    known = methods(chart.hologram)
    for given, choices, what in ((scenes, SCENES, "scene"), (options.methods or (), known, "method")):
        unknown = sorted(set(given) - set(choices))
        if unknown:
            return f"There is no {what} {', '.join(unknown)}: choose of {', '.join(choices)}."
    records, seconds = measured(chart, scenes, options.methods or chart.methods, options.anew)
    command = " ".join(("python -m benchmarks chart", *arguments))
    made = report.Made.now(command, seconds, measure.ROOT)
    return report.write(chart, records, made, docs=options.docs)


def parser():
    """Of the command's arguments."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks chart", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="[quick] SCENE", help=f"of {', '.join(SCENES)}; default: all"
    )
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="default: all")
    parser.add_argument(
        "--pixels",
        type=int,
        default=256,
        choices=(256, 512, 1024),
        help="of the full chart's holograms, a side",
    )
    parser.add_argument("--anew", action="store_true", help="measure what is there already, too")
    parser.add_argument("--docs", action="store_true", help="write docs/chart.md and its pictures, too")
    return parser


def measured(chart, scenes, names, anew=False, tell=None):
    """All records of scenes and methods, from disk where they are still true; and the seconds it took.

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
    tell = tell or (lambda line: print(line, file=sys.stderr, flush=True))
    start, known, tasks = time.perf_counter(), methods(chart.hologram), []
    for name in list(names):
        reason = known[name].missing()
        if reason:
            tell(reason)
    names = [name for name in names if not known[name].missing()]
    for scene in scenes:
        tasks.append(chart.task(scene, "reference", []))
        tasks += [chart.task(scene, name, chart.records(scene, known[name])) for name in names]
    for triangles in chart.triangles:
        for name in TIMED:
            if name in names:
                tasks.append(chart.task(f"hills {triangles}", name, [(chart.usual(known[name]), M)]))
    if anew:
        for task in tasks:
            for record in task.records:
                measure.record_path(task, *record).unlink(missing_ok=True)
    for task in tasks:
        if task.method == "reference":
            done = measure.truth_path(task).exists()
        else:
            done = all(measure.kept(task, *record) for record in task.records)
        if not done:
            tell(f"{task.scene}: {task.method} ({time.perf_counter() - start:.0f} s so far)")
            _do(task, chart.apart, tell)
    records = [measure.kept(task, *record) for task in tasks for record in task.records]
    return [record for record in records if record], time.perf_counter() - start


def _do(task, apart, tell):
    """Measure a task here, or in a process that may fail on its own."""
    if not apart:
        measure.run(task, tell)
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "task.json"
        file.write_text(json.dumps(asdict(task)))
        command = [sys.executable, "-m", "benchmarks.chart.measure", str(file)]
        patience = 3600 + 4 * task.limit * max(1, len(task.records))
        try:
            done = subprocess.run(command, cwd=measure.ROOT, timeout=patience)
        except subprocess.TimeoutExpired:
            tell(f"{task.scene}: {task.method} does not answer and was stopped")
            return
    if done.returncode:
        tell(f"{task.scene}: {task.method} ended with {done.returncode}")
