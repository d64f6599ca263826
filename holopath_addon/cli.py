"""The command line: ``python -m holopath_addon`` and, in Blender, ``blender --command holopath``."""

import argparse
import json
import math
import signal
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from . import engine, failures, lengths, output, stills
from .command_line import options, slm_commands, sources
from .command_line.console import Progress, close_line
from .command_line.options import argument, renamed
from .engine import displays, encoding
from .engine.progress import stage
from .engine.settings import DEPTH_MAPPINGS, ENCODINGS


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
        args = _parser(store or engine.BakeStore.default()).parse_args(_attach_negative(argv))
        with _interruptible():
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


@contextmanager
def _interruptible():
    """Ctrl-C raises KeyboardInterrupt, in `blender --background` too, whose own handler only sets a flag.

    So does SIGTERM, by which batch systems end a job: what was half written is cleared away.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.default_int_handler) for number in sources.INTERRUPTS}
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


def _numbers(count, shape, unit):
    def parse(text):
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if not values or (count and len(values) != count):
            raise engine.InvalidInput(f"'{text}' is not {shape} in {unit}")
        return values

    return argument(parse)


def _resolution(text):
    width, x, height = text.lower().partition("x")
    if not (x and width.isdigit() and height.isdigit()):
        raise engine.InvalidInput(f"'{text}' is not WIDTHxHEIGHT in pixels, for example 512x512")
    return int(width), int(height)


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
        sub.add_argument("--quiet", action="store_true", help="no progress on standard error")
        sub.add_argument("--debug", action="store_true", help="show a traceback where an error occurs")
        return sub

    render = command("render", _render, "Render a scene's wave field and refocused pictures of it.")
    _add_scene(render, store)
    render.add_argument(
        "--out", required=True, metavar="DIR", help="results: a new or empty folder, or HoloPath's own"
    )
    render.add_argument(
        "--animation",
        action="store_true",
        help="every frame of the .blend's frame range, into DIR/frame_0001 and so on; frames that are there, made of "
        "the same scene with the same settings, are skipped",
    )
    _add_focus(render, "three depths spread over the visible range")
    render.add_argument(
        "--encode",
        choices=("none", *ENCODINGS),
        default="none",
        help="also write phases for an SLM into DIR/hologram (default none); auto is refine with --method full, joint "
        "with several frames, sgd with one",
    )
    _add_bits(render)
    render.add_argument(
        "--compare-reference",
        action="store_true",
        help="also render every picture with a thin-lens camera, and report PSNR and SSIM",
    )

    plan = command("plan", _plan, "Say what would be computed, why and how long it takes; compute nothing.")
    _add_scene(plan, store)
    plan.add_argument("--json", action="store_true", help="machine-readable")

    reconstruct = command("reconstruct", _reconstruct, "Refocus a stored wave field without rendering again.")
    reconstruct.add_argument("folder", metavar="DIR", help="output folder of `holopath render`")
    _add_focus(reconstruct, "the depths of the stored pictures")
    reconstruct.add_argument("--out", metavar="DIR", help="where to write (default DIR/reconstruction)")
    _add_modulator(reconstruct)

    encode = command("encode", _encode, "Turn a stored wave field into phases for an SLM.")
    encode.add_argument("folder", metavar="DIR", help="output folder of `holopath render`")
    add = encode.add_argument
    add(
        "--method",
        choices=tuple(ENCODINGS),
        default="auto",
        help="double phase (dpac); each frame for itself by gradient descent (sgd); then all frames together (joint); "
        "auto (default) is joint, or sgd with one frame. refine needs the scene: `holopath render --encode refine`",
    )
    _add_bits(encode)
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
        metavar="arg|dpac|DIR",
        help="begin with the field's phases (default), double phase, or an earlier hologram in DIR",
    )
    add(
        "--tolerance",
        type=float,
        default=1e-3,
        metavar="SHARE",
        help="least relative gain of a step that is worth it (default %(default)s)",
    )
    add("--steps", type=int, default=1000, metavar="N", help="most steps of each stage (default %(default)s)")
    encode.add_argument("--out", metavar="DIR", help="where to write (default DIR/hologram)")

    cache = command("cache", _cache, "Say how much baked light is kept, and where.")
    _add_cache(cache, store)
    cache.add_argument("--clear", action="store_true", help="delete it")

    slm_commands.add(command)
    return parser


def _add_scene(parser, store):
    add = parser.add_argument
    add("scene", metavar="SCENE", help="a .blend, a Mitsuba .xml, or demo:NAME")
    add(
        "--display",
        type=argument(displays.display),
        metavar="PRESET",
        help=f"resolution and pitch of a device: {', '.join(engine.DISPLAYS)}",
    )
    add("--resolution", type=argument(_resolution), metavar="WxH", help="default: the file's, 512x512")
    add("--pitch", type=float, metavar="UM", help="pixel pitch, micrometres (default: the file's, 8)")
    add(
        "--wavelengths",
        type=_numbers(0, "a list of wavelengths", "nanometres"),
        metavar="NM[,NM..]",
        help="default: the file's, 640,516.5,455.4",
    )
    baked = parser.add_mutually_exclusive_group()
    _add_cache(baked, store)
    baked.add_argument(
        "--no-cache", dest="store", action="store_const", const=None, help="bake for this run only"
    )
    add(
        "--depth-range",
        type=_numbers(2, "FAR,NEAR", "millimetres"),
        metavar="FAR_MM,NEAR_MM",
        help="infinity's and the near end's distances from the SLM (default: what the display can show)",
    )
    add(
        "--depth-mapping",
        choices=tuple(DEPTH_MAPPINGS),
        help="fit the scene into the depth range, or map it as an eyepiece does",
    )
    add("--near", type=float, metavar="METRES", help="world depth of the near end (default: nearest surface)")
    options.add(parser)
    add("--camera", metavar="NAME", help="camera object, or an .xml's sensor id (default: active or first)")


def _add_cache(parser, store):
    parser.add_argument(
        "--cache",
        dest="store",
        type=engine.BakeStore,
        default=store,
        metavar="DIR",
        help=f"folder of baked light (default: {store.folder})".replace("%", "%%"),
    )


def _bits(text):
    if not text.isdigit() or not 1 <= int(text) <= 16:
        raise engine.InvalidInput(f"An SLM has 1 to 16 bits, not {text}")
    return int(text)


def _add_bits(parser):
    parser.add_argument(
        "--bits",
        type=argument(_bits),
        metavar="N",
        help="of phase that a pixel of the SLM takes, where they are few: the phases are the best of its levels",
    )


def _add_modulator(parser):
    add = parser.add_argument_group("from the stored phases, as a display shows them").add_argument
    add("--hologram", action="store_true", help="refocus the stored phases instead of the wave field")
    add("--bits", type=argument(_bits), metavar="N", help="of phase that a pixel takes (default: any phase)")
    add("--response", metavar="FILE", help="text file of the phase in radians that each grey level shows")
    add("--fill-factor", type=float, default=1.0, metavar="SHARE", help="of a pixel's area (default 1)")
    add("--unmodulated", type=float, default=0.0, metavar="SHARE", help="of the light (default 0)")
    add("--crosstalk", type=float, default=0.0, metavar="PIXELS", help="blur of the phases (default 0)")


def _add_focus(parser, default):
    parser.add_argument(
        "--focus",
        type=argument(lengths.parse_focus),
        metavar="0.5m,1m,inf",
        help=f"focus distances in m, cm, mm, D (dioptres) or inf (default: {default})",
    )
    parser.add_argument(
        "--pupil",
        type=_numbers(3, "X,Y,DIAMETER", "millimetres"),
        metavar="X,Y,DIAMETER",
        help="part of the viewer's pupil, mm right and up of the axis (default: all of it)",
    )


def _hologram_of(args, base):
    """Hologram from the flags over the scene's own."""
    changes = {}
    if args.display is not None:
        if args.resolution or args.pitch:
            raise engine.InvalidInput(
                "--display sets resolution and pitch: leave out --resolution and --pitch."
            )
        changes.update(width=args.display.width, height=args.display.height, pitch=args.display.pitch)
    if args.resolution is not None:
        changes.update(width=args.resolution[0], height=args.resolution[1])
    if args.pitch is not None:
        changes["pitch"] = args.pitch * 1e-6
    if args.depth_range is not None:
        changes.update(depth_far=args.depth_range[0] * 1e-3, depth_near=args.depth_range[1] * 1e-3)
    elif changes:
        changes.update(depth_far=None, depth_near=None)
    if args.wavelengths is not None:
        changes["wavelengths"] = tuple(w * 1e-9 for w in args.wavelengths)
    if args.depth_mapping is not None:
        changes["depth_mapping"] = args.depth_mapping
    if args.near is not None:
        changes["near"] = args.near
    return replace(base, **changes)


def _pupil_of(args):
    if args.pupil is None:
        return None
    return engine.Pupil(*(v * 1e-3 for v in args.pupil))


def _load(args, source):
    """Scene in its current frame, hologram and settings that the words ask for."""
    hologram, settings = (
        _hologram_of(args, source.hologram),
        options.asked(args, source.settings),
    )
    with sources.native_output_to_stderr():
        loaded = source.load(hologram.width, hologram.height, args.camera)
    return loaded, hologram, settings


def _still(args, source, pupil):
    """The `Still` that the words ask for, of the scene in its current frame."""
    loaded, hologram, settings = _load(args, source)
    return stills.Still(
        args.scene,
        loaded.scene,
        loaded.camera,
        hologram,
        settings,
        args.focus,
        pupil,
        args.store,
        loaded.notes,
        args.compare_reference,
        args.encode,
        args.bits,
    )


def _render(args):
    progress = Progress(quiet=args.quiet)
    pupil = _pupil_of(args)
    if args.animation:
        _animate(args, pupil, progress)
        return
    start = time.perf_counter()
    with output.output_folder(args.out) as folder:
        progress(0.0, "Opening the scene")
        source = sources.open_source(args.scene)
        progress(0.03, "Exporting the scene")
        still = _still(args, source, pupil)
        spent = time.perf_counter() - start
        _, report = stills.write(folder, still, stage(progress, 0.05, 1.0), spent)
    if report.get("encoding", {}).get("stopped"):
        raise engine.Cancelled(
            f"Cancelled while encoding: {args.out} holds the render, and the phases as they were then."
        )
    progress(1.0, f"Done in {report['seconds']['total']:.1f} s: {args.out}")
    for line in _remarks(report):
        progress.say(line)


def _animate(args, pupil, progress):
    """Every frame of a .blend's frame range, but those that are done."""
    if Path(args.scene).suffix.lower() != ".blend":
        raise engine.InvalidInput(f"{args.scene} has no animation: give a .blend, or leave out --animation.")
    if Path(args.out).exists() and not Path(args.out).is_dir():
        raise engine.InvalidInput(f"The output {args.out} is a file: choose a folder.")
    progress(0.0, "Opening the scene")
    source = sources.open_source(args.scene)
    assert isinstance(source, sources.BlenderSource)  # of a .blend
    numbers, start, made, told = source.frames, time.perf_counter(), 0, set()
    try:
        for index, number in enumerate(numbers):
            folder = output.frame_folder(args.out, number)
            at = _frame_progress(progress, index, number, numbers)
            with _naming(number):
                began = time.perf_counter()
                at(0.0, "Exporting the scene")
                source.go_to(number)
                still = _still(args, source, pupil)
                spent = time.perf_counter() - began
                result, report = stills.update(
                    folder,
                    still,
                    stage(at, 0.05, 1.0),
                    spent,
                    lambda text, name=folder.name: progress.say(f"{name}: {text}"),
                )
            if result is not None:
                made += 1
                for line in [line for line in _remarks(report) if line not in told]:
                    progress.say(f"{folder.name}: {line}")
                    told.add(line)
    except (Exception, KeyboardInterrupt) as error:
        if not failures.cancelled(error):
            raise
        raise engine.Cancelled(
            f"Cancelled: the frames that are done are in {args.out}, and the same command goes on after them."
        ) from error
    seconds = time.perf_counter() - start
    before = f", {len(numbers) - made} done before" if made < len(numbers) else ""
    progress(1.0, f"Done: {made} frame{'' if made == 1 else 's'} in {seconds:.1f} s{before}: {args.out}")


def _frame_progress(progress, index, number, numbers):
    """Progress of one of the frames."""
    part = stage(progress, index / len(numbers), (index + 1) / len(numbers))
    return lambda done, message: part(min(done, 0.999), f"Frame {number}: {message}")


@contextmanager
def _naming(number):
    """Errors of bad input name the frame."""
    try:
        yield
    except engine.InvalidInput as error:
        raise engine.InvalidInput(f"Frame {number}: {error}") from error


def _remarks(report):
    """Lines on what is to be known of a result."""
    lines = [f"note: {text}" for text in [*report["warnings"], *map(note_text, report["export_notes"])]]
    for row in report.get("comparison", []):
        depth = row["focus_m"]
        where = "infinity" if math.isinf(depth) else f"{lengths.format_distance(depth)} m"
        lines.append(
            f"focus {where}: PSNR {row['psnr_db']:.2f} dB, SSIM {row['ssim']:.3f}; "
            f"a perfect hologram of this pitch: {row['psnr_ceiling_db']:.1f} dB"
        )
    return lines


def note_text(note):
    """One line about what the exporter changed or left out."""
    from .export.notes import Note

    return str(Note(**note))


def _plan(args):
    loaded, hologram, settings = _load(args, sources.open_source(args.scene))
    plan = engine.plan(loaded.scene, loaded.camera, hologram, settings, args.store)
    if args.json:
        print(
            json.dumps(
                {
                    **plan.to_dict(),
                    "hologram": hologram.to_dict(),
                    "settings": asdict(settings),
                    "export_notes": loaded.notes,
                },
                indent=1,
            )
        )
        return
    print(plan)
    for note in loaded.notes:
        print(f"note: {note_text(note)}")


def _stored_field(folder):
    """The wave field of an output folder, or of one that holds nothing else."""
    if not folder.is_dir():
        raise engine.InvalidInput(
            f"The folder {folder} does not exist: give `holopath render`'s output folder."
        )
    inner = folder / "wavefield"
    return engine.WaveField.load(inner if inner.is_dir() else folder)


def _modulator_of(args):
    response = None
    if args.response is not None:
        try:
            response = tuple(float(word) for word in Path(args.response).read_text().split())
        except (OSError, ValueError) as error:
            raise engine.InvalidInput(
                f"The response {args.response} cannot be read ({error}): give a text file of numbers."
            ) from error
    return engine.Modulator(args.bits, response, args.fill_factor, args.unmodulated, args.crosstalk)


def _reconstruct(args):
    progress = Progress(quiet=args.quiet)
    folder, modulator = Path(args.folder), _modulator_of(args)
    if modulator != engine.Modulator() and not args.hologram:
        raise engine.InvalidInput("The limits of a display are for stored phases: add --hologram.")
    field = output.stored_hologram(folder).field(modulator) if args.hologram else _stored_field(folder)
    report = output.read_report(folder)
    focus = args.focus or [float(f) for f in report.get("focus_m", [])]
    if not focus:
        raise engine.InvalidInput(f"{folder} stores no focus distances: give some with --focus 0.5m,1m,inf.")
    images = engine.reconstruct(field, focus, _pupil_of(args), progress=stage(progress, 0.0, 0.97))
    rgb = engine.to_rgb(images, field.hologram.wavelengths)
    white = report.get("exposure_white") or output.exposure(rgb)
    target = Path(args.out) if args.out else folder / "reconstruction"
    files = output.picture_files(rgb, focus, white)
    prefix = "hologram_" if args.hologram else ""
    output.write_pictures(target, {prefix + name: data for name, data in files.items()})
    progress(1.0, f"Done: {target}")


def _encode(args):
    progress = Progress(quiet=args.quiet)
    folder = Path(args.folder)
    target = Path(args.out) if args.out else folder / "hologram"
    start = args.start
    if start not in encoding.STARTS:
        start = output.stored_hologram(Path(start))
        start = replace(start, data=np.array(start.data))  # Windows replaces no file that is mapped
    stopped = None
    try:
        phase = engine.encode(
            _stored_field(folder),
            args.method,
            stage(progress, 0.0, 0.9),
            bits=args.bits,
            supervision=args.supervision,
            planes=args.compared_planes,
            aperture=args.aperture,
            start=start,
            tolerance=args.tolerance,
            most_steps=args.steps,
        )
    except engine.Cancelled as error:
        if error.kept is None:
            raise
        phase, stopped = error.kept, error
    phase.save(target, stage(progress, 0.9, 0.99))
    if stopped is not None:
        raise engine.Cancelled(f"Cancelled: the phases as they were then are in {target}.") from stopped
    progress(1.0, f"Done: {target}")


def _cache(args):
    store = args.store
    count = len(store.files())
    size = store.clear() if args.clear else store.size()
    print(f"{store.folder}: {count} file{'' if count == 1 else 's'}, {size / 1e6:.1f} MB", end="")
    print(" freed" if args.clear else "")


if __name__ == "__main__":
    sys.exit(main())
