"""The command line: ``python -m holopath_addon`` and, in Blender, ``blender --command holopath``."""

import argparse
import json
import signal
import sys
import threading
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from .. import engine
from ..engine.progress import stage
from ..engine.viewing.reconstruction import far_from, picture_pitch
from ..farm.processes import INTERRUPTS
from ..workflow import failures, output, pipeline
from . import (
    cluster_command,
    encode_command,
    exchange_command,
    render_command,
    report_command,
    slm_commands,
    sources,
    study_command,
    template_command,
)
from .console import Progress, close_line, heartbeat
from .options import add_optics, argument, numbers, on_bench


def main(argv=None, store=None):
    """Run one command.

    Parameters
    ----------
    argv : list of str, optional
        The words. Default: those of this process, in Blender the ones after ``--``.
    store : engine.BakeStore, optional
        Where baked light is kept if the words do not say. Default: `engine.BakeStore.default`.

    Returns
    -------
    int
        0 done, 1 the work failed, 2 bad input.
    """
    if argv is None:
        argv = sys.argv[1:]
        if "--" in argv:
            argv = argv[argv.index("--") + 1 :]
    args = None
    try:
        args = parse(argv, store)
        with _interruptible(), heartbeat():
            args.run(args)
        return failures.DONE
    except SystemExit as stop:
        return stop.code or failures.DONE
    except (Exception, KeyboardInterrupt) as error:
        if args is not None and args.debug:
            raise
        close_line()
        print(f"holopath: {failures.sentence(error)}", file=sys.stderr)
        return failures.status(error)


def parse(words, store=None):
    """What words mean.

    Parameters
    ----------
    words : list of str
    store : engine.BakeStore, optional
        See `main`.

    Returns
    -------
    argparse.Namespace
        Its `run` is the command's function; `words` are these.

    Raises
    ------
    SystemExit
        When all is said: for words that are wrong, and for ``--help``.
    """
    args = _parser(store or engine.BakeStore.default()).parse_args(_attach_negative(words))
    args.words = list(words)
    return args


@contextmanager
def _interruptible():
    """Ctrl-C raises KeyboardInterrupt, in `blender --background` too, whose own handler only sets a flag.

    So does SIGTERM, by which batch systems end a job: what was half written is cleared away.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.default_int_handler) for number in INTERRUPTS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


def _attach_negative(argv):
    """Join ``--pupil -1,0,2`` to ``--pupil=-1,0,2``: argparse would take the value for an option."""
    joined = []
    for word in argv:
        option = bool(joined) and joined[-1].startswith("--") and "=" not in joined[-1]
        if option and word[:1] == "-" and word[1:2].isdigit():
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message):
        print(f"holopath: {message}; see `{self.prog} --help`.", file=sys.stderr)
        raise SystemExit(failures.BAD_INPUT)


def _parser(store):
    parser = _Parser(
        prog="holopath",
        description="Phase holograms of Blender and Mitsuba scenes by wave path tracing.",
        epilog="Exit status: 0 done, 1 the work failed, 2 bad input.",
        allow_abbrev=False,
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=_Parser)

    def command(name, run, text):
        sub = commands.add_parser(name, help=text, description=text, allow_abbrev=False)
        sub.set_defaults(run=run)
        sub.add_argument("--quiet", action="store_true", help="no progress, and no lines on what is saved")
        sub.add_argument("--debug", action="store_true", help="show a traceback where an error occurs")
        return sub

    render_command.add(command, store)
    study_command.add(command, store)

    plan = command("plan", _plan, "Say what would be computed, why and how long it takes; compute nothing.")
    render_command.add_scene(plan, store)
    render_command.add_encoding(plan)
    plan.add_argument("--json", action="store_true", help="machine-readable")

    reconstruct = command("reconstruct", _reconstruct, "Refocus a stored wave field without rendering again.")
    reconstruct.add_argument("folder", metavar="DIR", help="output folder of `holopath render`")
    render_command.add_focus(reconstruct, "the depths of the stored pictures")
    reconstruct.add_argument(
        "--distances",
        type=numbers(0, "a list of distances", "millimeters"),
        metavar="MM[,MM..]",
        help="focus at distances from the SLM instead, or from the plane of the picture behind its lens; those far "
        "beyond the depth volume are of the far field",
    )
    reconstruct.add_argument("--out", metavar="DIR", help="where to write (default DIR/reconstruction)")
    add_optics(reconstruct, "that of the stored field or phases")
    _add_modulator(reconstruct)

    encode_command.add(command, store)
    exchange_command.add(command)
    report_command.add(command)

    cache = command("cache", _cache, "Say how much baked light is kept, and where.")
    render_command.add_cache(cache, store)
    cache.add_argument("--clear", action="store_true", help="delete it")

    template_command.add(command)
    slm_commands.add(command)
    cluster_command.add(commands, parse)
    return parser


def _add_modulator(parser):
    add = parser.add_argument_group("from the stored phases, as a display shows them").add_argument
    add("--hologram", action="store_true", help="refocus the stored phases instead of the wave field")
    add(
        "--bits",
        type=argument(render_command.bits),
        metavar="N",
        help="of phase that a pixel takes (default: any phase)",
    )
    add(
        "--response",
        metavar="FILE",
        help="levels as measured instead, as in `holopath encode`; with the display as it was fitted, if it was",
    )
    add(
        "--fill-factor",
        type=float,
        metavar="FRACTION",
        help="of a pixel's area, whose shape dims steep light; 1 is a whole square pixel (default: no shape, a point)",
    )
    add("--unmodulated", type=float, default=0.0, metavar="SHARE", help="of the light (default 0)")
    add("--crosstalk", type=float, default=0.0, metavar="PIXELS", help="blur of the phases (default 0)")


def _plan(args):
    seconds = render_command.encode_seconds_of(args)
    source = sources.open_requested(args)
    loaded, hologram, settings = render_command.load(args, source)
    render_command.check_encoding(args, settings, hologram)
    plan = engine.plan(loaded.scene, loaded.camera, hologram, settings, args.store)
    encoding = axis = None
    if args.encode != "none":
        along = engine.frames_along(plan, hologram, args.encode, seconds)
        eyebox = render_command.eyebox_of(args, args.encode)
        encoding = engine.plan_encoding(plan, args.encode, seconds, along, eyebox)
        axis = engine.axis_decision(encoding.method, args.bits, hologram)
    if args.json:
        print(
            json.dumps(
                {
                    **plan.to_dict(),
                    "encoding": encoding and encoding.to_dict(),
                    "axis": axis and axis.reason,
                    "hologram": hologram.to_dict(),
                    "settings": asdict(settings),
                    "export_notes": loaded.notes,
                },
                indent=1,
            )
        )
        return
    size = render_command.size_from(args, source)
    if size is not None:
        print(f"resolution: {size[0]} (of {size[1]})")
    print(plan)
    if encoding is not None:
        print(encoding.decision)
        if axis is not None:
            print(axis)
        if encoding.advice:
            print(f"note: {encoding.advice} See --encode-seconds.")
        for warning in encoding.warnings:
            print(f"warning: {warning}")
    for note in loaded.notes:
        print(f"note: {render_command.note_text(note)}")


def _shown(args, folder):
    """Light of the stored phases."""
    phase = on_bench(output.stored_hologram(folder), args)
    display = render_command.display_of(args, phase.hologram.wavelengths)
    modulator = _modulator_of(args)
    if display is not None and modulator != engine.Modulator():
        raise engine.InvalidInput("A display that was fitted has limits of its own: leave out the others.")
    if args.response is not None and args.bits is not None:
        raise engine.InvalidInput("Levels that were measured have a number of their own: leave out --bits.")
    levels = None if display is not None else render_command.levels_of(args, phase.hologram)
    return phase.field(modulator, display, levels)


def _modulator_of(args):
    return engine.Modulator(args.bits, args.fill_factor, args.unmodulated, args.crosstalk)


def _reconstruct(args):
    progress = Progress(quiet=args.quiet)
    folder, limited = (
        Path(args.folder),
        args.response is not None or args.beam is not None or _modulator_of(args) != engine.Modulator(),
    )
    if limited and not args.hologram:
        raise engine.InvalidInput(
            "The limits of a display, and its beam, are for stored phases: add --hologram."
        )
    field = _shown(args, folder) if args.hologram else on_bench(output.stored_field(folder), args)
    report = output.read_report(folder)
    focus = args.focus or _at(args.distances, field) or [float(f) for f in report.get("focus_m", [])]
    if not focus:
        raise engine.InvalidInput(f"{folder} stores no focus distances: give some with --focus 0.5m,1m,inf.")
    pupil = render_command.pupil_of(args)
    for place in (float(z) for z in field.mapping.depth_to_z(focus)):
        if abs(place) >= far_from(field.hologram):
            pixel = picture_pitch(field.hologram, place)
            progress.say(
                f"{place * 1e3:g} mm from the SLM is in its far field: one Fresnel transform, each of the picture's "
                f"pixels {pixel * 1e3:.4g} mm wide."
            )
    images, notes = pipeline.reconstruct(field, focus, pupil, stage(progress, 0.0, 0.97))
    for note in notes:
        progress.say(f"note: {note}")
    rgb = engine.to_rgb(images, field.hologram.wavelengths)
    alike = output.pupil_of(report) == pupil  # through a smaller part there is less light
    white = (alike and report.get("exposure_white")) or output.exposure(rgb)
    target = Path(args.out) if args.out else folder / "reconstruction"
    distances = None if args.focus else args.distances
    files = output.picture_files(rgb, focus, white, pupil, distances)
    output.write_pictures(target, output.hologram_files(files) if args.hologram else files)
    progress(1.0, f"Done: {target}")


def _at(millimeters, field):
    """World depths of distances from the SLM or the picture behind its lens."""
    ends = 1e3 * field.hologram.depth_far, 1e3 * field.hologram.depth_near
    for distance in millimeters or ():
        if not distance >= ends[0]:
            raise engine.InvalidInput(
                f"{distance:g} mm from {field.hologram.origin} lies beyond infinity, which this field has at "
                f"{ends[0]:g} mm: give distances from there on; the near end lies at {ends[1]:g} mm."
            )
    return [float(field.mapping.z_to_depth(mm * 1e-3)) for mm in millimeters or ()]


def _cache(args):
    store = args.store
    count = len(store.files())
    size = store.clear() if args.clear else store.size()
    print(f"{store.folder}: {count} file{'' if count == 1 else 's'}, {size / 1e6:.1f} MB", end="")
    print(" freed" if args.clear else "")
