"""`holopath encode`: from stored wave fields to phases for an SLM, of a still or of all frames of an animation."""

import hashlib
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import engine
from ..engine import encoding, files
from ..engine.progress import Stages
from ..engine.settings import BASELINES, ENCODINGS
from ..farm.job import EncodingJob, digests
from ..farm.units import Unit
from ..farm.work import Work
from ..workflow import output, pipeline
from ..workflow.request import Encoding
from . import options, render_command, sources
from .cluster_command import add_option, animating, work_by
from .console import Progress
from .options import renamed

# Words that leave phases as they are.
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
BEFORE = "before"  # start of a frame's phases: those of the frame before


def add(command, store):
    """Add the command, see `render_command.add`."""
    encode = command("encode", _encode, "Turn stored wave fields into phases for an SLM.")
    encode.set_defaults(work=work_of)
    encode.add_argument(
        "folder",
        metavar="DIR",
        help="output folder of `holopath render`; of an animation's, frames that have such phases are skipped",
    )
    add_option(encode, "an animation's frames")
    add = encode.add_argument
    add(
        "--method",
        choices=tuple(ENCODINGS),
        default="auto",
        help="double phase (dpac); each frame for itself by gradient descent (sgd); then all frames together (joint); "
        "or towards many more frames of the same light (refine), which needs the scene. auto (default) is refine where "
        "the scene is there, else joint, and sgd with one frame",
    )
    add(
        "--scene",
        metavar="SCENE|none",
        help="that the field was rendered of (default: the one that DIR/report.json names, where it is there and "
        "unchanged); none: leave it alone",
    )
    render_command.add_at_frame(encode, "the one of the field")
    render_command.add_run_scripts(encode)
    render_command.add_define(encode, "those of the field")
    render_command.add_cache(encode, store)
    render_command.add_encode_seconds(encode)
    render_command.add_eyebox(encode)
    render_command.add_levels(encode)
    options.add_optics(encode, "the field's")
    add(
        "--supervision",
        choices=encoding.SUPERVISIONS,
        default="complex",
        help="what sgd compares: the complex field (default), or amplitudes alone",
    )
    add(
        "--compared-planes",
        type=int,
        default=1,
        metavar="N",
        help="on which amplitudes are compared (default 1)",
    )
    renamed(encode, "--planes", "--compared-planes", type=int)
    add("--no-aperture", dest="aperture", action="store_false", help="without a stop in the Fourier plane")
    add(
        "--start",
        default="arg",
        metavar="arg|dpac|before|DIR",
        help="begin with the field's phases (default), double phase, of an animation with the phases of the frame "
        "before, which is then made first, or with an earlier hologram in DIR",
    )
    add(
        "--tolerance",
        type=float,
        default=1e-3,
        metavar="SHARE",
        help="least relative gain of a step that is worth it (default %(default)s)",
    )
    add(
        "--max-steps",
        type=int,
        metavar="N",
        help="steps of each stage at most (default: as many as are worth it)",
    )
    renamed(encode, "--steps", "--max-steps", type=int)
    add("--out", metavar="DIR", help="where to write (default DIR/hologram)")


def _encode(args):
    progress = Progress(quiet=args.quiet)
    if output.frame_folders(args.folder):
        _animate(args, progress)
        return
    if args.cluster is not None:
        raise engine.InvalidInput(f"{args.folder} holds no animation: leave out --cluster.")
    folder = Path(args.folder)
    target = Path(args.out) if args.out else folder / "hologram"
    start = args.start
    if start == BEFORE:
        raise engine.InvalidInput(
            f"{args.folder} holds no animation, whose frames begin with the one before: leave out --start before, or "
            "give ./before for a folder of this name."
        )
    if start not in encoding.STARTS:
        start = output.stored_hologram(Path(start))
        start = replace(start, data=np.array(start.data))  # Windows replaces no file that is mapped
    if args.encode_seconds is not None and args.method == "dpac":
        raise engine.InvalidInput("--encode-seconds is for phases by descent, not for dpac: leave them out.")
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
        raise engine.Cancelled(f"Cancelled: the phases as they were then are in {target}.") from stopped
    if phase.report.get("advice"):
        progress.say(f"note: {phase.report['advice']}")
    progress(1.0, f"Done: {target}")


def _scene(args, folder, progress, say):
    """The scene of a stored field and its settings, where `refine` may want them; both None where there is none."""
    field, alone = output.stored_field(folder), (None, None)
    asked = args.scene is not None or args.at_frame is not None or args.run_scripts or bool(args.define)
    if args.method not in ("auto", "refine"):
        if asked and args.scene != "none":
            raise engine.InvalidInput(
                f"The encoding {args.method} takes no scene: leave it out, or choose refine."
            )
        return alone
    if args.scene == "none":
        return alone
    asked = asked or args.method == "refine"
    if not asked and sources.named(output.read_report(folder)) is None:
        return alone  # as of other programs' fields
    progress(0.0, "Opening the scene")
    try:
        found = sources.reopen(
            folder, field, args.scene, args.at_frame, args.run_scripts, dict(args.define or ())
        )
        if found.settings is not None and found.settings.method in BASELINES and args.method == "auto":
            return alone
        if found.settings is None:
            raise engine.InvalidInput(f"{folder} does not say with which settings it was rendered.")
        if not found.same:
            raise engine.InvalidInput(
                f"{found.name} has changed since the field was rendered, or is at another frame: render it again, or "
                "give --at-frame N."
            )
    except (engine.InvalidInput, engine.BackendUnavailable) as error:
        if asked:
            raise
        say(f"note: {error} So phases go towards the field alone; with its scene they would be better.")
        return alone
    return found.scene, found.settings


def _phases(args, folder, start, progress, scene=None, settings=None):
    field = output.stored_field(folder)
    optics = replace(options.with_colors(field.hologram, args).optics, **options.optics_of(args))
    if optics.lens != field.hologram.optics.lens:
        raise engine.InvalidInput(
            f"The field in {folder} was rendered for another lens: leave out --lens, or render it with this one."
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
        aperture=args.aperture,
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
    seconds, made = time.perf_counter() - start, len(work.made)
    others = len(work.units) - made
    before = f", {others} done before or by others" if others else ""
    progress(1.0, f"Done: {made} frame{'' if made == 1 else 's'} in {seconds:.1f} s{before}: {args.folder}")


def work_of(args, say) -> Work:
    """The phases of an animation's frames, a unit a frame; see `render_command.units_of`.

    They lie in the frames' folders, and go with them when a frame is rendered anew.
    """
    if args.scene not in (None, "none") or args.at_frame is not None or args.run_scripts or args.define:
        raise engine.InvalidInput(
            "An animation's fields are encoded without their scene: leave it out, or render with --encode auto."
        )
    if args.out is not None:
        raise engine.InvalidInput("Phases of an animation go into its frames' folders: leave out --out.")
    if args.start not in (*encoding.STARTS, BEFORE):
        raise engine.InvalidInput(
            f"{args.start} is one hologram: an animation's frames begin with arg, dpac or before."
        )
    if args.start == BEFORE and args.method == "dpac":
        raise engine.InvalidInput("--start before is for phases by descent, not for dpac: leave it out.")
    words = {name: value for name, value in vars(args).items() if name not in _APART}
    apart = ("blender", "python")
    versions = {name: text or "none" for name, text in output.versions().items() if name not in apart}
    work = Work(
        Path(args.folder), EncodingJob("", words, digests(render_command.files_of(args)), versions), {}, []
    )
    before = None
    for folder in output.frame_folders(args.folder):
        work.units[folder.name] = _frame(args, work, folder, before)
        before = folder if args.start == BEFORE else None
    return work


def _frame(args, work, folder, before):
    """The phases of a frame. Those that begin with the frame before are made anew where its have changed."""
    target, digest = folder / "hologram", work.job.digest

    def make(progress):
        files.sweep(target)
        start, told = args.start, {"job": digest}
        if start == BEFORE:
            first = None if before is None else engine.PhaseHologram.load(before / "hologram")
            alike = first is not None and first.data.shape == output.stored_field(folder).data.shape
            start = first if alike else encoding.STARTS[0]
            told["begun_with"] = None if first is None else first.report["sha256"]
        stages = Stages(progress, "encode")
        phase = _phases(args, folder, start, stages["phases"])
        if args.start == BEFORE:
            told["sha256"] = hashlib.sha256(np.ascontiguousarray(phase.data).data).hexdigest()
        replace(phase, report={**phase.report, **told}).save(target, stages["files"])
        work.made.append(folder.name)

    def done():
        told, first = _told(folder), {} if before is None else _told(before)
        return told.get("job") == digest and told.get("begun_with") == first.get("sha256")

    return Unit(folder.name, make, done, () if before is None else (before.name,))


def _told(folder):
    """What the report on a frame's phases says; nothing where there are none."""
    try:
        return engine.PhaseHologram.load(folder / "hologram").report
    except engine.InvalidInput:
        return {}
