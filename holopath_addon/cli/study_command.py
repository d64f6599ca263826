"""`holopath study`: every run that a TOML file asks for, and the table of what came of them."""

import argparse
import hashlib
import json
import time
from pathlib import Path
from typing import Any

from .. import engine
from ..engine.progress import Stages
from ..exchange.captures import SUFFIXES
from ..farm import study as studies
from ..farm.errors import FarmFailed
from ..farm.job import SharedJob, digests
from ..farm.units import Unit
from ..farm.work import Work
from ..workflow import failures, stills
from . import options, render_command, sources
from .cluster_command import add_option, work_by
from .console import Progress


def add(command, store):
    """Add the command; parameters as of `render_command.add`."""
    study = command("study", _study, "Render all that a TOML file asks for, and write a table of figures.")
    study.add_argument("study", metavar="STUDY.toml", help="scenes, seeds, views and settings: docs/study.md")
    study.add_argument(
        "--out",
        metavar="DIR",
        help="runs and table.csv; runs that are there, made of the same scene, are skipped (default: a folder beside "
        "STUDY.toml, of its name)",
    )
    study.add_argument("--list", action="store_true", help="say which runs are asked for; make nothing")
    add_option(study, "runs")
    study.set_defaults(work=_joined)
    render_command.add_cache(study, store)


class _Words(argparse.ArgumentParser):
    """The words of a run; what is wrong with them is bad input."""

    def error(self, message):
        raise engine.InvalidInput(message)


class _Scenes:
    """The scene that is open, for runs of one scene follow one another."""

    def __init__(self):
        self._source: Any = None
        self._name: tuple = ()
        self._moved = False

    def open(self, args):
        """The source of a run: of Blender's in the frame that the file has, where none is to be gone to."""
        name = args.scene, args.scene_name, args.view_layer, args.run_scripts, args.define
        if name != self._name or (self._moved and args.at_frame is None):
            self._name, self._source = (), None  # before another takes its memory
            self._source, self._name, self._moved = sources.open_requested(args), name, False
        self._moved |= args.at_frame is not None
        return self._source


def units_of(args, say) -> Work:
    """The work that words ask for, a unit a run.

    Parameters
    ----------
    args : argparse.Namespace
        See `cli.parse`.
    say : callable
        ``say(text)`` of what was there, and of what failed: that is noted, and ends the unit, too.

    Returns
    -------
    Work

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
        Before anything is rendered, if a run is asked for what there is not.
    """
    return _work(*_asked(args), say)


def _joined(args, say):
    """The work of one who joins in: `units_of`, of the job that the others work on."""
    work = units_of(args, say)
    with work.job.join(work.folder):
        return work


def _asked(args):
    """The `Study`, its output folder, and the words of each run by its folder: all may be rendered."""
    study = studies.read(args.study)
    out = Path(args.out) if args.out else study.path.with_suffix("")
    studies.check_free(out)
    words = _Words(prog="holopath render", add_help=False, allow_abbrev=False)
    render_command.add(lambda name, run, text: words, args.store)
    runs = {}
    for run in study.runs:
        folder = run.folder(out)
        try:
            if Path(run.scene).suffix.lower() in SUFFIXES:
                raise engine.InvalidInput(
                    f"{run.scene} is a picture, a point cloud or views, which studies do not take: render it by itself."
                )
            sources.check(study.scene(run))
            asked = words.parse_args([*words_of(study, run), f"--out={folder}"])
            options.settings_of(asked, engine.Settings())
            render_command.hologram_of(asked, engine.Hologram(512, 512, 8e-6))
            render_command.pupil_of(asked)
        except engine.InvalidInput as error:
            raise engine.InvalidInput(f"{study.path}: {error}") from None
        asked.store = args.store
        runs[folder] = asked
    return study, out, runs


def words_of(study, run):
    """The words of `holopath render` that a run stands for, but for ``--out``."""
    words = [study.scene(run)]
    for name, value in run.options.items():
        flag = options.flag(name)
        if name in studies.FLAGS:
            words += [flag] if value else []
        else:
            words += [f"{flag}={each}" for each in (value if isinstance(value, tuple) else (value,))]
    return words


def _work(study, out, runs, say):
    scenes = _Scenes()
    work = Work(out / "runs", _job(study, list(runs.values()), scenes), {}, [])
    for number, (folder, asked) in enumerate(runs.items(), 1):
        work.units[folder.name] = _unit(out, folder, asked, scenes, work, f"Run {number} of {len(runs)}", say)
    return work


def _job(study, asked, scenes):
    """What decides the results: with other runs, or a scene saved anew, it is another study."""
    files: dict = {}
    decides: dict = {"runs": sorted(run.digest for run in study.runs)}
    for run, args in zip(study.runs, asked, strict=True):
        if run.scene in decides:
            continue
        found = scenes.open(argparse.Namespace(**{**vars(args), "at_frame": None})).files
        told = {f"{run.scene}: {name}": digest for name, digest in digests(found).items()}
        decides[run.scene] = told.pop(f"{run.scene}: {Path(run.scene).name}", "")
        files |= told
    whole = hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()
    name = study.path.name
    return SharedJob(name, {}, {name: whole, **files}, render_command.versions())


def _unit(out, folder, args, scenes, work, called, say):
    job = work.job.digest

    def make(told):
        def progress(done, message):
            told(min(done, 0.999), f"{called}: {message}")

        try:
            start = time.perf_counter()
            progress(0.0, "Opening the scene")
            source = scenes.open(args)
            progress(0.03, "Exporting the scene")
            request = render_command.request_of(args, source, job)
            spent = time.perf_counter() - start
            result, _ = stills.update(
                folder,
                request,
                Stages(progress, "still")["still"],
                spent,
                lambda text: say(f"{folder.name}: {text}"),
            )
        except Exception as error:
            if failures.cancelled(error) or isinstance(error, OSError):
                raise
            sentence = failures.sentence(error)
            studies.note_failure(out, folder.name, sentence)
            say(f"{folder.name}: failed: {sentence}")
        else:
            if result is not None:
                work.made.append(folder.name)

    def done():
        return studies.failure(out, folder.name) is not None or stills.is_complete(folder, job, args.encode)

    return Unit(folder.name, make, done)


def _study(args):
    progress = Progress(quiet=args.quiet)
    study, out, runs = _asked(args)
    if args.list:
        for run in study.runs:
            folder = run.folder(out)
            there = " (there)" if folder.is_dir() else ""
            print(f"{folder.name}{there}: holopath render {' '.join(words_of(study, run))}")
        return
    progress(0.0, "Opening the scenes")
    work = _work(study, out, runs, progress.say)
    for name in work.units:
        studies.forget_failure(out, name)
    try:
        with work.job.join(work.folder, work.units):
            work_by(args, work, progress)
    except (Exception, KeyboardInterrupt) as error:
        if not failures.cancelled(error):
            raise
        studies.write_table(study, out)
        raise engine.Cancelled(
            f"Cancelled: the runs that are done are in {out}, and the same command goes on after them."
        ) from error
    progress(0.999, "Writing the table")
    if not studies.write_table(study, out):
        progress.say("note: table.h5 is left out, as it needs h5py: `pip install h5py`.")
    count, failed = len(work.units), sum(studies.failure(out, name) is not None for name in work.units)
    if failed:
        raise FarmFailed(
            f"{failed} of {count} runs failed: the column error of {out / 'table.csv'} says why."
        )
    progress(1.0, f"Done: {count} run{'' if count == 1 else 's'}: {out / 'table.csv'}")
