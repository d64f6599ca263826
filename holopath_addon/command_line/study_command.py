"""`holopath study`: every run that a TOML file asks for, and the table of what came of them."""

import argparse
import time
from pathlib import Path

from .. import engine, failures, stills
from ..engine.progress import stage
from ..farm import study as studies
from ..farm.units import Unit
from ..farm.work import work_off
from . import options, render_command, sources
from .console import Progress

TAG = "study"  # runs are told apart by what they are asked: studies may share a folder


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
    render_command.add_cache(study, store)


class _Words(argparse.ArgumentParser):
    """The words of a run; what is wrong with them is bad input."""

    def error(self, message):
        raise engine.InvalidInput(message)


class _Scenes:
    """The scene that is open, for runs of one scene follow one another."""

    def __init__(self):
        self._opened: tuple = None, None

    def open(self, args):
        """The source of a run's scene, in the frame that the file has, where none is asked for."""
        asked = args.scene, args.at_frame
        if self._opened[0] != asked:
            self._opened = None, None  # before another takes its memory
            self._opened = asked, sources.open_source(args.scene)
        return self._opened[1]


def units_of(args, say):
    """The work that words ask for.

    Parameters
    ----------
    args : argparse.Namespace
        The words of `holopath study`.
    say : callable
        ``say(text)`` of what was there, and what failed.

    Returns
    -------
    Path
        Folder that the units' results are in.
    str
        What they are claimed for.
    dict of str to Unit
        By name: a failure is noted beside the runs, and ends the unit, too.

    Raises
    ------
    engine.InvalidInput
        Before anything is rendered, if a run is asked for what there is not.
    """
    _, out, runs = _asked(args)
    return out / "runs", TAG, _units(out, runs, say)


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
            sources.check(study.scene(run))
            asked = words.parse_args([*words_of(study, run), f"--out={folder}"])
            options.asked(asked, engine.Settings())
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
    for name, value in run.asked.items():
        flag = options.flag(name)
        words += ([flag] if value else []) if name in studies.FLAGS else [f"{flag}={value}"]
    return words


def _units(out, runs, say):
    scenes, units = _Scenes(), {}
    for number, (folder, asked) in enumerate(runs.items(), 1):
        units[folder.name] = _unit(out, folder, asked, scenes, f"Run {number} of {len(runs)}", say)
    return units


def _unit(out, folder, args, scenes, called, say):
    made = False

    def make(told):
        def progress(done, message):
            told(min(done, 0.999), f"{called}: {message}")

        nonlocal made
        try:
            start = time.perf_counter()
            progress(0.0, "Opening the scene")
            source = scenes.open(args)
            progress(0.03, "Exporting the scene")
            still = render_command.still_of(args, source, render_command.pupil_of(args))
            spent = time.perf_counter() - start
            stills.update(
                folder, still, stage(progress, 0.05, 1.0), spent, lambda text: say(f"{folder.name}: {text}")
            )
        except Exception as error:
            if failures.cancelled(error) or isinstance(error, OSError):
                raise
            sentence = failures.sentence(error)
            studies.note_failure(out, folder.name, sentence)
            say(f"{folder.name}: failed: {sentence}")
        made = True

    # that a result is there is not enough: the scene may be another one since
    return Unit(folder.name, make, lambda: made or studies.failure(out, folder.name) is not None)


def _study(args):
    progress = Progress(quiet=args.quiet)
    study, out, runs = _asked(args)
    if args.list:
        for run in study.runs:
            folder = run.folder(out)
            there = " (there)" if folder.is_dir() else ""
            print(f"{folder.name}{there}: holopath render {' '.join(words_of(study, run))}")
        return
    units, folder = _units(out, runs, progress.say), out / "runs"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise engine.InvalidInput(
            f"The output folder {out} cannot be made ({error.strerror}): choose another one."
        ) from error
    for name in units:
        studies.forget_failure(out, name)
    try:
        work_off(folder, units.values(), TAG, progress, progress.say)
    except (Exception, KeyboardInterrupt) as error:
        if not failures.cancelled(error):
            raise
        studies.write_table(study, out)
        raise engine.Cancelled(
            f"Cancelled: the runs that are done are in {out}, and the same command goes on after them."
        ) from error
    progress(0.999, "Writing the table")
    if not studies.write_table(study, out):
        progress.say("note: table.h5 is left out, as it needs h5py: pip install 'holopath[study]'.")
    failed = sum(studies.failure(out, name) is not None for name in units)
    if failed:
        raise failures.Incomplete(
            f"{failed} of {len(units)} runs failed: the column error of {out / 'table.csv'} says why."
        )
    progress(1.0, f"Done: {len(units)} run{'' if len(units) == 1 else 's'}: {out / 'table.csv'}")
