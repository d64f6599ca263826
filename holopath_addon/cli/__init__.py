"""Command line: ``python -m holopath_addon`` and, in Blender, ``blender --command holopath``."""

import argparse
import difflib
import io
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
from ..workflow.signals import ignore_signals_of_writes
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

MIN_LIKENESS = 0.75  # of an unknown option and the one that is meant, difflib's ratio


def main(argv=None, store=None):
    """Run one command.

    Parameters
    ----------
    argv : list of str, optional
        Command and options. Default: those of this process, in Blender those after ``--``.
    store : engine.BakeStore, optional
        Default store of baked light. Default: `engine.BakeStore.default`.

    Returns
    -------
    int
        Exit status: 0 done, 1 the work failed, 2 bad input.
    """
    if argv is None:
        if isinstance(sys.stdout, io.TextIOWrapper):  # names may have letters that its encoding lacks
            sys.stdout.reconfigure(errors="backslashreplace")
        argv = sys.argv[1:]
        if "--" in argv:
            argv = argv[argv.index("--") + 1 :]
    ignore_signals_of_writes()
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
    """Parse a command and its options.

    Parameters
    ----------
    words : list of str
    store : engine.BakeStore, optional
        See `main`.

    Returns
    -------
    argparse.Namespace
        Its `run` is the command's function, its `words` those given.

    Raises
    ------
    SystemExit
        For wrong words, after a message, and for ``--help``.
    """
    args = _parser(store or engine.BakeStore.default()).parse_args(_attach_negative(words))
    args.words = list(words)
    return args


@contextmanager
def _interruptible():
    """Raise KeyboardInterrupt on Ctrl-C in the block, also in `blender --background`, whose handler only sets a flag.

    SIGTERM, by which batch systems end a job, raises it, too: unfinished files are deleted.
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
    """Join ``--pupil -1,0,2`` to ``--pupil=-1,0,2``, because argparse would parse the value as an option."""
    joined = []
    for word in argv:
        is_option = bool(joined) and joined[-1].startswith("--") and "=" not in joined[-1]
        if is_option and word[:1] == "-" and word[1:2].isdigit():
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line, and name the help of their own command."""

    def error(self, message):
        end = "" if message.endswith("?") else "."
        print(f"holopath: {message}{end} See `{self.prog} --help`.", file=sys.stderr)
        raise SystemExit(failures.BAD_INPUT)

    def parse_known_args(self, args=None, namespace=None):
        """Refuse unknown words here, as the parser of all commands does not know the options of each."""
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            near = self._nearest_option(unknown)
            advice = f". Did you mean {near}?" if near else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{advice}")
        return known, unknown

    def _nearest_option(self, words):
        """Option that is spelled nearly as the first unknown one; None if there is none."""
        shown = [action for action in self._actions if action.help != argparse.SUPPRESS]
        options = [option for action in shown for option in action.option_strings]
        unknown = next((word.partition("=")[0] for word in words if word.startswith("-")), "")
        return next(iter(difflib.get_close_matches(unknown, options, 1, MIN_LIKENESS)), None)


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
        sub.add_argument("--quiet", action="store_true", help="print neither progress nor saved files")
        sub.add_argument("--debug", action="store_true", help="print the traceback of an error")
        return sub

    render_command.add(command, store)
    study_command.add(command, store)

    plan = command(
        "plan", _plan, "Print what would be computed, why, and for how long, without computing it."
    )
    render_command.add_scene(plan, store)
    render_command.add_encoding(plan)
    plan.add_argument("--json", action="store_true", help="print JSON")

    reconstruct = command(
        "reconstruct", _reconstruct, "Refocus a stored wave field, or stored phases, without rendering again."
    )
    reconstruct.add_argument("folder", metavar="DIR", help="output folder of `holopath render`")
    render_command.add_focus(reconstruct, "those of the stored images")
    reconstruct.add_argument(
        "--distances",
        type=numbers(0, "a list of distances", "millimeters"),
        metavar="MM[,MM..]",
        help="focus at distances from the SLM instead, or from the plane of the image behind its lens; those far "
        "beyond the depth volume are in the far field",
    )
    reconstruct.add_argument("--out", metavar="DIR", help="output folder (default DIR/reconstruction)")
    add_optics(reconstruct, "that of the stored field or phases")
    _add_modulator(reconstruct)

    encode_command.add(command, store)
    exchange_command.add(command)
    report_command.add(command)

    cache = command("cache", _cache, "Print the size and folder of stored baked light.")
    render_command.add_cache(cache, store)
    cache.add_argument("--clear", action="store_true", help="delete the baked light")

    template_command.add(command)
    slm_commands.add(command)
    cluster_command.add(commands, parse)
    return parser


def _add_modulator(parser):
    add = parser.add_argument_group("stored phases on a display").add_argument
    add("--hologram", action="store_true", help="refocus the stored phases instead of the wave field")
    add(
        "--bits",
        type=argument(render_command.bits),
        metavar="N",
        help="bits of a pixel's phase levels (default: continuous phases)",
    )
    add(
        "--response",
        metavar="FILE",
        help="measured levels instead, as in `holopath encode`, with the fitted model of the display if there is one",
    )
    add(
        "--fill-factor",
        type=float,
        metavar="FRACTION",
        help="fraction of a pixel's area that modulates light, which dims light at large angles; 1 is the whole square "
        "(default: a point)",
    )
    add(
        "--unmodulated",
        type=float,
        default=0.0,
        metavar="FRACTION",
        help="fraction of unmodulated light (default 0)",
    )
    add(
        "--crosstalk",
        type=float,
        default=0.0,
        metavar="PIXELS",
        help="blur of the phases, pixels (default 0)",
    )


def _plan(args):
    seconds = render_command.encode_seconds_of(args)
    source = sources.open_requested(args)
    loaded, hologram, settings = render_command.load(args, source)
    render_command.check_phases(args)
    render_command.check_encoding(args, settings, hologram)
    plan = engine.plan(loaded.scene, loaded.camera, hologram, settings, args.store)
    encoding = axis = None
    if args.encode != "none":
        eyebox = render_command.eyebox_of(args, args.encode)
        extra_frames = engine.extra_frame_count(plan, hologram, args.encode, seconds, eyebox)
        encoding = engine.plan_encoding(plan, args.encode, seconds, extra_frames, eyebox)
        axis = engine.axis_decision(encoding.method, render_command.bits_of(args), hologram)
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
    size = render_command.size_origin(args, source)
    if size is not None:
        print(f"resolution: {size[0]} (of {size[1]})")
    print(plan)
    if encoding is not None:
        print(encoding.decision)
        if axis is not None:
            print(axis)
        if encoding.advice:
            print(f"note: {encoding.advice} See --encode-seconds.")
        for warning in encoding.memory_warnings():
            print(f"warning: {warning}")
    for note in loaded.notes:
        print(f"note: {render_command.note_text(note)}")


def _light_of_phases(args, folder):
    """Field of the stored phases on the requested display."""
    phase = on_bench(output.stored_hologram(folder), args)
    display = render_command.display_of(args, phase.hologram.wavelengths)
    modulator = _modulator_of(args)
    if display is not None and modulator != engine.Modulator():
        raise engine.InvalidInput(
            "A fitted display has its own limits. Omit the other options of the display."
        )
    if args.response is not None and args.bits is not None:
        raise engine.InvalidInput("Measured levels have their own number. Omit --bits.")
    levels = None if display is not None else render_command.levels_of(args, phase.hologram)
    return phase.field(modulator, display, levels)


def _modulator_of(args):
    return engine.Modulator(args.bits, args.fill_factor, args.unmodulated, args.crosstalk)


def _reconstruct(args):
    progress = Progress(quiet=args.quiet)
    folder = Path(args.folder)
    has_display = (
        args.response is not None or args.beam is not None or _modulator_of(args) != engine.Modulator()
    )
    if has_display and not args.hologram:
        raise engine.InvalidInput(
            "Options of a display, and its beam, are for stored phases. Add --hologram."
        )
    if args.focus and args.distances:
        raise engine.InvalidInput("Expected either --focus or --distances, got both. Omit one of them.")
    field = _light_of_phases(args, folder) if args.hologram else on_bench(output.stored_field(folder), args)
    report = output.read_report(folder)
    focus = args.focus or _depths(args.distances, field) or [float(f) for f in report.get("focus_m", [])]
    if not focus:
        raise engine.InvalidInput(
            f"The report in {folder} has no focus distances. Give them with --focus, for example 0.5m,1m,inf."
        )
    pupil = render_command.pupil_of(args)
    for z in map(float, field.mapping.depth_to_z(focus)):
        if abs(z) >= far_from(field.hologram):
            pixel = picture_pitch(field.hologram, z)
            progress.say(
                f"{z * 1e3:g} mm from the SLM is in its far field: one Fresnel transform, with pixels of the image "
                f"{pixel * 1e3:.4g} mm wide."
            )
    images, notes = pipeline.reconstruct(field, focus, pupil, stage(progress, 0.0, 0.97))
    for note in notes:
        progress.say(f"note: {note}")
    rgb = engine.to_rgb(images, field.hologram.wavelengths)
    same_pupil = output.pupil_of(report) == pupil  # a smaller part passes less light
    white = (same_pupil and report.get("exposure_white")) or output.exposure(rgb)
    target = Path(args.out) if args.out else folder / "reconstruction"
    distances = None if args.focus else args.distances
    files = output.picture_files(rgb, focus, white, pupil, distances)
    output.write_pictures(target, output.hologram_files(files) if args.hologram else files)
    progress(1.0, f"Done: {target}")


def _depths(millimeters, field):
    """World depths of distances from the SLM, or from the image behind its lens."""
    ends = 1e3 * field.hologram.depth_far, 1e3 * field.hologram.depth_near
    for distance in millimeters or ():
        if not distance >= ends[0]:
            raise engine.InvalidInput(
                f"{distance:g} mm from {field.hologram.origin} is beyond infinity, which is at {ends[0]:g} mm in this "
                f"field. Give larger distances; the near end is at {ends[1]:g} mm."
            )
    return [float(field.mapping.z_to_depth(mm * 1e-3)) for mm in millimeters or ()]


def _cache(args):
    store = args.store
    count = len(store.files())
    size = store.clear() if args.clear else store.size()
    print(f"{store.folder}: {count} file{'' if count == 1 else 's'}, {size / 1e6:.1f} MB", end="")
    print(" freed" if args.clear else "")
