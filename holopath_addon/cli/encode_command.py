"""Command `holopath encode`: phases for an SLM from stored wave fields of a still or an animation."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import engine
from ..engine import encoding, files
from ..engine.progress import Stages
from ..engine.settings.choices import BASELINES, ENCODINGS
from ..farm.job import EncodingJob, digests
from ..farm.units import Unit
from ..farm.work import Work
from ..workflow import output, pipeline
from ..workflow.request import Encoding
from . import options, render_command, sources
from .cluster_command import add_option, animating, work_by
from .console import Progress
from .options import add_old_name

# Options that do not affect phases.
_APART = {
    "run",
    "folder",
    "out",
    "scene",
    "at_frame",
    "run_scripts",
    "define",
    "store",
    "quiet",
    "debug",
    "cluster",
    "words",
    "work",
}
BEFORE = "before"  # --start with the phases of the previous frame


def add(command, store):
    """Add the command.

    Parameters
    ----------
    command, store
        See `render_command.add`.
    """
    encode = command("encode", _encode, "Turn stored wave fields into phases for an SLM.")
    encode.set_defaults(work=work_of)
    encode.add_argument(
        "folder",
        metavar="DIR",
        help="output folder of `holopath render`; frames of an animation that have such phases are skipped",
    )
    add_option(encode, "phases of an animation's frames")
    add = encode.add_argument
    add(
        "--method",
        choices=tuple(ENCODINGS),
        default="auto",
        help="dpac: double phase; sgd: gradient descent of each frame; joint: of all frames together; refine: of all "
        "frames, towards many extra frames of the same light, which need the scene. auto (default) is refine if the "
        "scene is there, else joint, or sgd for one frame of random phases",
    )
    add(
        "--scene",
        metavar="SCENE|none",
        help="scene of the field (default: that in DIR/report.json, if it exists and is unchanged); none: do not open "
        "a scene",
    )
    render_command.add_at_frame(encode, "the field's")
    render_command.add_run_scripts(encode)
    render_command.add_define(encode, "the field's")
    render_command.add_cache(encode, store)
    render_command.add_encode_seconds(encode)
    render_command.add_eyebox(encode)
    render_command.add_levels(encode)
    options.add_optics(encode, "the field's")
    add(
        "--supervision",
        choices=encoding.SUPERVISIONS,
        default="complex",
        help="target of sgd: the complex field (default), or only its amplitude",
    )
    add(
        "--compared-planes",
        type=int,
        default=1,
        metavar="N",
        help="number of planes on which amplitudes are compared (default 1)",
    )
    add_old_name(encode, "--planes", "--compared-planes", type=int)
    add("--no-stop", dest="has_stop", action="store_false", help="no stop in the Fourier plane")
    add_old_name(encode, "--no-aperture", "--no-stop", dest="has_stop", nargs=0, const=False)
    add(
        "--start",
        default="arg",
        metavar="arg|dpac|before|DIR",
        help="initial phases: the field's (arg, default), double phase (dpac), in an animation those of the previous "
        "frame, which is then made first (before), or those of an earlier hologram in DIR",
    )
    add(
        "--tolerance",
        type=float,
        default=1e-3,
        metavar="FRACTION",
        help="minimum relative gain of a step; iteration ends below it (default %(default)s)",
    )
    add(
        "--max-steps",
        type=int,
        metavar="N",
        help="maximum number of steps of each stage (default: as many as pay off)",
    )
    add_old_name(encode, "--steps", "--max-steps", type=int)
    add("--out", metavar="DIR", help="output folder (default DIR/hologram)")


def _encode(args):
    progress = Progress(quiet=args.quiet)
    if output.frame_folders(args.folder):
        _animate(args, progress)
        return
    if args.cluster is not None:
        raise engine.InvalidInput(
            f"Expected an animation in {args.folder} for --cluster, found none. Omit --cluster."
        )
    folder = Path(args.folder)
    target = Path(args.out) if args.out else folder / "hologram"
    start = args.start
    if start == BEFORE:
        raise engine.InvalidInput(
            f"Expected an animation in {args.folder} for --start before, found none. Omit it, or give ./before for a "
            "folder of this name."
        )
    if start not in encoding.STARTS:
        start = output.stored_hologram(Path(start))
        start = replace(start, data=np.array(start.data))  # Windows does not replace mapped files
    if args.encode_seconds is not None and args.method == "dpac":
        raise engine.InvalidInput(
            "Expected a method with gradient descent for --encode-seconds, got dpac. Omit it."
        )
    stopped, stages = None, Stages(progress, "encode")
    try:
        scene, settings = _scene(args, folder, stages["scene"], progress.say)
        phase = _phases(args, folder, start, stages["phases"], scene, settings)
    except engine.Cancelled as error:
        if error.kept is None:
            raise
        phase, stopped = error.kept, error
    phase.save(target, stages["files"])
    if stopped is not None:
        raise engine.Cancelled(f"Canceled: the phases of the last step are in {target}.") from stopped
    for note in pipeline.encoding_notes(phase):
        progress.say(f"note: {note}")
    progress(1.0, f"Done: {target}")


def _scene(args, folder, progress, say):
    """The scene of a stored field and its settings, if the method may need them; otherwise None for both."""
    field, no_scene = output.stored_field(folder), (None, None)
    is_requested = (
        args.scene is not None or args.at_frame is not None or args.run_scripts or bool(args.define)
    )
    if args.method not in ("auto", "refine"):
        if is_requested and args.scene != "none":
            raise engine.InvalidInput(
                f"The encoding {args.method} does not use a scene. Omit --scene, --at-frame, --run-scripts and "
                "--define, or choose refine."
            )
        return no_scene
    if args.scene == "none":
        return no_scene
    is_requested = is_requested or args.method == "refine"
    if not is_requested and sources.scene_name(output.read_report(folder)) is None:
        return no_scene  # such as a field of another program
    progress(0.0, "Opening the scene")
    try:
        reopened = sources.reopen(
            folder, field, args.scene, args.at_frame, args.run_scripts, dict(args.define or ())
        )
        if reopened.settings is not None and reopened.settings.method in BASELINES and args.method == "auto":
            return no_scene
        if reopened.settings is None:
            raise engine.InvalidInput(
                f"The report in {folder} lacks the settings of the render. Render it again, or give --scene none."
            )
        if not reopened.same:
            raise engine.InvalidInput(
                f"{reopened.name} has changed since the render, or is at another frame. Render it again, or give "
                "--at-frame N."
            )
    except (engine.InvalidInput, engine.BackendUnavailable) as error:
        if is_requested:
            raise
        say(
            f"note: {error} The phases approximate only the stored field; with its scene they would be better."
        )
        return no_scene
    return reopened.scene, reopened.settings


def _phases(args, folder, start, progress, scene=None, settings=None):
    field = output.stored_field(folder)
    optics = replace(options.with_colors(field.hologram, args).optics, **options.optics_changes(args))
    if optics.lens != field.hologram.optics.lens:
        raise engine.InvalidInput(
            f"The field in {folder} was rendered for another lens. Omit --lens, or render it with this one."
        )
    field = engine.at_panel(field, optics)
    steps = {} if args.max_steps is None else {"max_steps": args.max_steps}
    encoding = Encoding(
        args.method,
        args.encode_seconds,
        render_command.eyebox_of(args, args.method),
        args.bits,
        render_command.levels_of(args, field.hologram),
        render_command.display_of(args, field.hologram.wavelengths),
    )
    return pipeline.encode(
        field,
        encoding,
        progress,
        scene,
        settings,
        args.store,
        supervision=args.supervision,
        compared_planes=args.compared_planes,
        has_stop=args.has_stop,
        start=start,
        tolerance=args.tolerance,
        **steps,
    )


def _animate(args, progress):
    start = time.perf_counter()
    with animating(args.folder):
        work = work_of(args, progress.say)
        with work.job.join(work.folder):
            work_by(args, work, progress)
    seconds, count = time.perf_counter() - start, len(work.made)
    others = len(work.units) - count
    rest = f", {others} done before or by others" if others else ""
    progress(1.0, f"Done: {count} frame{'' if count == 1 else 's'} in {seconds:.1f} s{rest}: {args.folder}")


def work_of(args, say) -> Work:
    """Work on the phases of an animation, one unit per frame.

    The phases are in the frames' folders, and are deleted when a frame is rendered again.

    Parameters
    ----------
    args : argparse.Namespace
        See `cli.parse`.
    say : callable
        ``say(text)`` receives remarks.

    Returns
    -------
    farm.work.Work

    Raises
    ------
    engine.InvalidInput
        If options do not fit an animation.
    """
    if args.scene not in (None, "none") or args.at_frame is not None or args.run_scripts or args.define:
        raise engine.InvalidInput(
            "Fields of an animation are encoded without their scene. Omit the scene's options, or render with "
            "--encode auto."
        )
    if args.out is not None:
        raise engine.InvalidInput("Phases of an animation are written into its frames' folders. Omit --out.")
    if args.start not in (*encoding.STARTS, BEFORE):
        raise engine.InvalidInput(
            f"Expected arg, dpac or before for --start of an animation, got the hologram {args.start}."
        )
    if args.start == BEFORE and args.method == "dpac":
        raise engine.InvalidInput(
            "Expected a method with gradient descent for --start before, got dpac. Omit it."
        )
    inputs = {name: value for name, value in vars(args).items() if name not in _APART}
    apart = ("blender", "python")
    versions = {name: text or "none" for name, text in output.versions().items() if name not in apart}
    job = EncodingJob("", inputs, digests(render_command.files_of(args)), versions)
    work = Work(Path(args.folder), job, {}, [])
    previous = None
    for folder in output.frame_folders(args.folder):
        work.units[folder.name] = _unit(args, work, folder, previous)
        previous = folder if args.start == BEFORE else None
    return work


def _unit(args, work, folder, previous):
    """Unit of a frame's phases. With `previous` they are made again if that frame's phases have changed."""
    target, digest = folder / "hologram", work.job.digest

    def make(progress):
        files.sweep(target)
        start, entries = args.start, {"job": digest}
        if start == BEFORE:
            initial = None if previous is None else engine.PhaseHologram.load(previous / "hologram")
            fits = initial is not None and initial.data.shape == output.stored_field(folder).data.shape
            start = initial if fits else encoding.STARTS[0]
            entries["begun_with"] = None if initial is None else initial.report["sha256"]
        stages = Stages(progress, "encode")
        phase = _phases(args, folder, start, stages["phases"])
        if args.start == BEFORE:
            entries["sha256"] = phase.digest
        replace(phase, report={**phase.report, **entries}).save(target, stages["files"])
        work.made.append(folder.name)

    def is_done():
        report, initial = _phase_report(folder), {} if previous is None else _phase_report(previous)
        return report.get("job") == digest and report.get("begun_with") == initial.get("sha256")

    return Unit(folder.name, make, is_done, () if previous is None else (previous.name,))


def _phase_report(folder):
    """Report of a frame's phases; empty if it has none."""
    try:
        return engine.PhaseHologram.load(folder / "hologram").report
    except engine.InvalidInput:
        return {}
