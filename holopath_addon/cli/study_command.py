"""Command `holopath study`: all runs of a TOML file, and their table."""

import argparse
import hashlib
import json
import time
from pathlib import Path
from typing import Any

from .. import engine
from ..engine.baselines import network
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
    """Add the command.

    Parameters
    ----------
    command, store
        See `render_command.add`.
    """
    study = command("study", _study, "Render all runs of a TOML file, and write a table of figures.")
    study.add_argument("study", metavar="STUDY.toml", help="scenes, seeds, views and settings: docs/study.md")
    study.add_argument(
        "--out",
        metavar="DIR",
        help="output folder of runs and table.csv; existing runs of the same scene are skipped (default: a folder "
        "beside STUDY.toml, with its name)",
    )
    study.add_argument("--list", action="store_true", help="list the runs without rendering them")
    add_option(study, "runs")
    study.set_defaults(work=_join)
    render_command.add_cache(study, store)


class _RunParser(argparse.ArgumentParser):
    """Parser of a run's options, whose errors are `engine.InvalidInput`."""

    def error(self, message):
        raise engine.InvalidInput(message)


class _Scenes:
    """The open scene, which consecutive runs share."""

    def __init__(self):
        self._source: Any = None
        self._name: tuple = ()
        self._is_moved = False

    def open(self, args):
        """Open the source of a run; without `at_frame` a Blender scene is in its file's frame."""
        name = args.scene, args.scene_name, args.view_layer, args.run_scripts, args.define
        if name != self._name or (self._is_moved and args.at_frame is None):
            self._name, self._source = (), None  # frees its memory before another scene is opened
            self._source, self._name, self._is_moved = sources.open_requested(args), name, False
        self._is_moved |= args.at_frame is not None
        return self._source


def units_of(args, say) -> Work:
    """Work on a study, one unit per run.

    Parameters
    ----------
    args : argparse.Namespace
        See `cli.parse`.
    say : callable
        ``say(text)`` receives remarks on runs that were there, and on failed ones, which are noted and count as done.

    Returns
    -------
    Work

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
        Before the first render, if a run is not possible.
    """
    study, out, runs = _read(args)
    return _work(study, out, runs, say)


def _join(args, say):
    """Work of a process that joins the others' job, see `units_of`."""
    work = units_of(args, say)
    with work.job.join(work.folder):
        return work


def _read(args):
    """Read the `Study`, its output folder, and the checked options of each run by its folder."""
    study = studies.read(args.study)
    out = Path(args.out) if args.out else study.path.with_suffix("")
    studies.check_free(out)
    parser = _RunParser(prog="holopath render", add_help=False, allow_abbrev=False)
    render_command.add(lambda name, run, text: parser, args.store)
    runs = {}
    for run in study.runs:
        folder = run.folder(out)
        try:
            if Path(run.scene).suffix.lower() in SUFFIXES:
                raise engine.InvalidInput(
                    f"Expected a .blend, an .xml or a demo, got {run.scene}. Render it by `holopath render`."
                )
            sources.check(study.scene(run))
            run_args = parser.parse_args([*words_of(study, run), f"--out={folder}"])
            options.settings_of(run_args, engine.Settings())
            render_command.hologram_of(run_args, engine.Hologram(512, 512, 8e-6))
            render_command.pupil_of(run_args)
        except engine.InvalidInput as error:
            raise engine.InvalidInput(f"{study.path}: {error}") from None
        run_args.store = args.store
        runs[folder] = run_args
    return study, out, runs


def words_of(study, run):
    """Arguments of `holopath render` for a run, without ``--out``.

    Parameters
    ----------
    study : farm.study.Study
    run : farm.study.Run

    Returns
    -------
    list of str
    """
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
    for number, (folder, args) in enumerate(runs.items(), 1):
        work.units[folder.name] = _unit(out, folder, args, scenes, work, f"Run {number} of {len(runs)}", say)
    return work


def _job(study, run_args, scenes):
    """The job: every input that affects the results, such as the runs and the scenes' files."""
    files: dict = {}
    inputs: dict = {"runs": sorted(run.digest for run in study.runs)}
    if any(args.method == "network" for args in run_args):
        inputs["network of a run"] = network.digests()
    known = set()
    for run, args in zip(study.runs, run_args, strict=True):
        opened = run.scene, str(args.define), args.scene_name  # which may have other files each
        if opened in known:
            continue
        known.add(opened)
        source = scenes.open(argparse.Namespace(**{**vars(args), "at_frame": None}))
        entries = {f"{run.scene}: {name}": digest for name, digest in digests(source.files).items()}
        inputs[run.scene] = entries.pop(f"{run.scene}: {Path(run.scene).name}", "")
        files |= entries
    digest = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
    name = study.path.name
    return SharedJob(name, {}, {name: digest, **files}, render_command.versions())


def _unit(out, folder, args, scenes, work, title, say):
    """Unit of a run, with a title for its progress."""
    job = work.job.digest

    def make(unit_progress):
        def progress(done, message):
            unit_progress(min(done, 0.999), f"{title}: {message}")

        try:
            start = time.perf_counter()
            progress(0.0, "Opening the scene")
            source = scenes.open(args)
            progress(0.03, "Exporting the scene")
            request = render_command.request_of(args, source, job)
            seconds = time.perf_counter() - start
            result, _ = stills.update(
                folder,
                request,
                Stages(progress, "still")["still"],
                seconds,
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

    def is_done():
        return studies.failure(out, folder.name) is not None or stills.is_complete(folder, job, args.encode)

    return Unit(folder.name, make, is_done)


def _study(args):
    progress = Progress(quiet=args.quiet)
    study, out, runs = _read(args)
    if args.list:
        for run in study.runs:
            folder = run.folder(out)
            exists = " (there)" if folder.is_dir() else ""
            print(f"{folder.name}{exists}: holopath render {' '.join(words_of(study, run))}")
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
        studies.write_table(study, out, work.job.digest)
        raise engine.Cancelled(
            f"Canceled: finished runs are in {out}. The same command continues after them."
        ) from error
    progress(0.999, "Writing the table")
    if not studies.write_table(study, out, work.job.digest):
        progress.say("note: table.h5 is not written, because it needs h5py: `pip install h5py`.")
    count, failed = len(work.units), sum(studies.failure(out, name) is not None for name in work.units)
    if failed:
        raise FarmFailed(f"{failed} of {count} runs failed. See the column error in {out / 'table.csv'}.")
    progress(1.0, f"Done: {count} run{'' if count == 1 else 's'}: {out / 'table.csv'}")
