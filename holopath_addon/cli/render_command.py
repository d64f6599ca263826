"""`holopath render`: a still, or every frame of an animation. What its words mean, and the work that they ask for."""

import argparse
import math
import re
import time
from dataclasses import replace
from pathlib import Path

from .. import engine
from ..blender.demo import DEMOS
from ..engine import displays
from ..engine.progress import Stages
from ..engine.settings import BASELINES, DEPTH_MAPPINGS, ENCODE_SECONDS, ENCODINGS, EYEBOX
from ..exchange import captures
from ..exchange.optics import beam_files, stop_files
from ..farm import ranges
from ..farm.job import SharedJob, digests
from ..farm.work import Work
from ..slm.calibration import fitted_display, measured_levels, response_files
from ..workflow import lengths, output, stills
from ..workflow.request import Encoding, Origin, Outputs, Request
from . import options, sources
from .cluster_command import add_option, animating, work_by
from .console import Progress
from .frames import AnimationFrames
from .options import argument
from .supervised import WindowProgress, supervised

DEMO_SCENES = ", ".join(f"demo:{name}" for name in DEMOS)
MOST_VIEWS = 256  # of a quilt
ENDS = ("depth_far", "depth_near")  # of the volume
# Words that leave results as they are; all others decide them.
_APART = {
    "run",
    "attended",
    "scene",
    "out",
    "animation",
    "frame_range",
    "store",
    "quiet",
    "debug",
    "cluster",
    "words",
    "work",
    "depth",  # whose contents decide
}


def add(command, store):
    """Add the command.

    Parameters
    ----------
    command : callable
        ``command(name, run, text)`` gives its parser.
    store : engine.BakeStore
        Where baked light is kept if the words do not say.
    """
    render = command("render", _render, "Render a scene's wave field and refocused pictures of it.")
    add_scene(render, store)
    render.add_argument(
        "--out", required=True, metavar="DIR", help="results: a new or empty folder, or HoloPath's own"
    )
    render.add_argument(
        "--animation",
        action="store_true",
        help="every frame of the scene's frame range, into DIR/frame_0001 and so on; frames that are there, made of "
        "the same scene with the same settings, are skipped, and processes with the same words share the others",
    )
    render.add_argument(
        "--frame-range",
        type=argument(ranges.frames),
        metavar="1-5,9,20-40:2",
        help="these frames, as with --animation; also beyond the .blend's frame range, and of demo:NAME",
    )
    add_option(render, "frames")
    render.set_defaults(work=_joined)
    options.add_removed(
        render,
        "--divide",
        "One process makes a still: leave out --divide. Several share the frames of --animation and the runs of "
        "`holopath study`.",
    )
    add_focus(render, "three depths spread over the visible range")
    add_encoding(render)
    render.add_argument(
        "--compare-reference",
        action="store_true",
        help="also render every picture with a thin-lens camera, and report PSNR and SSIM",
    )
    render.add_argument(
        "--rgbd",
        action="store_true",
        help="also write a picture in which everything is sharp, and the depths of surfaces and of what mirrors and "
        "glass show, into DIR/rgbd",
    )
    render.add_argument(
        "--light-field",
        type=argument(_views),
        metavar="N",
        help="also write such pictures through N x N points of the pupil into DIR/light_field",
    )
    render.add_argument(
        "--quilt",
        type=argument(_quilt),
        metavar="CxR",
        help="also write such pictures from the left of the pupil to its right, C x R in one as Looking Glass displays "
        "read it, into DIR/quilt",
    )
    render.add_argument(
        "--contact-sheet",
        type=argument(_sheet),
        metavar="NAME.png",
        help="also write one picture of all into DIR: phases of a frame, what is seen at each focus, and a thin lens's "
        "picture of the middle one beside it",
    )
    render.add_argument("--attended", action="store_true", help=argparse.SUPPRESS)  # by a window


def add_scene(parser, store):
    add = parser.add_argument
    add(
        "scene",
        metavar="SCENE",
        help=f"a .blend, a Mitsuba .xml, a picture with --depth, a .ply of points, or {DEMO_SCENES}",
    )
    add(
        "--display",
        type=argument(displays.display),
        metavar="PRESET",
        help=f"resolution and pitch of a device: {', '.join(engine.DISPLAYS)}",
    )
    add(
        "--resolution",
        type=argument(_resolution),
        metavar="WxH",
        help="default: the file's (of an .xml: its film's, or its crop window's; the picture's), else 512x512",
    )
    add(
        "--pitch",
        type=argument(options.pitch),
        metavar="UM[,UM]",
        help="pixel pitch, micrometers; X,Y where pixels are not square (default: the file's, 8)",
    )
    add(
        "--wavelengths",
        type=options.numbers(0, "a list of wavelengths", "nanometers"),
        metavar="NM[,NM..]",
        help="default: the file's, 640,516.5,455.4",
    )
    baked = parser.add_mutually_exclusive_group()
    add_cache(baked, store)
    baked.add_argument(
        "--no-cache", dest="store", action="store_const", const=None, help="bake for this run only"
    )
    add(
        "--depth-range",
        type=options.numbers(2, "FAR,NEAR", "millimeters"),
        metavar="FAR_MM,NEAR_MM",
        help="infinity's and the near end's distances from the SLM (default: so near that no border darkens; 80,85 "
        "with --display)",
    )
    add(
        "--depth-mapping",
        choices=tuple(DEPTH_MAPPINGS),
        help="fit the scene into the depth range, or map it as an eyepiece does",
    )
    add("--near", type=float, metavar="METERS", help="world depth of the near end (default: nearest surface)")
    options.add_optics(parser)
    options.add(parser)
    add(
        "--camera",
        metavar="NAME",
        help="camera object, an .xml's sensor id, or of a .ply front or origin (default: active, first, front)",
    )
    add(
        "--move",
        type=options.numbers(3, "RIGHT,UP,FORWARD", "meters"),
        metavar="RIGHT,UP,FORWARD",
        help="put the camera elsewhere, meters along its own axes",
    )
    add(
        "--turn",
        type=options.numbers(2, "LEFT,UP", "degrees"),
        metavar="LEFT,UP",
        help="then turn it, degrees",
    )
    add_at_frame(parser)
    add("--scene-name", metavar="NAME", help="scene of a .blend (default: the one in which it was saved)")
    add("--view-layer", metavar="NAME", help="its view layer (default: the first that renders use)")
    add_run_scripts(parser)
    add_define(parser)
    _add_capture(parser)


def _add_capture(parser):
    add = parser.add_argument_group(
        "of a picture with depth, a .ply of points, or a quilt or another array of views"
    ).add_argument
    add("--depth", metavar="FILE", help="depth of each pixel: an .exr, a .png of 8 or 16 bits, or an .npy")
    add("--depth-unit", choices=captures.UNITS, help=f"what its numbers are: {captures.UNIT_WORDS}")
    add(
        "--depth-ends",
        type=options.numbers(2, "FAR,NEAR", "meters"),
        metavar="FAR,NEAR",
        help="depths of 0 and 1 of --depth-unit inverse, meters",
    )
    add(
        "--depth-along",
        choices=captures.ALONG,
        help="whether depths are distances along the camera's axis, as cameras and Blender give them, or along each "
        "pixel's own ray, as Mitsuba does (default: axis)",
    )
    add(
        "--fov",
        type=float,
        metavar="DEGREES",
        help="horizontal field of view (default: 39.6, that of a 50 mm lens on 36 mm of film)",
    )
    add("--axes", choices=tuple(captures.AXES), help=f"how those of a .ply lie: {captures.AXES_WORDS}")
    add(
        "--point-radius",
        type=float,
        metavar="METERS",
        help="of the disks that points of a .ply become (default: so that those of a surface leave no gaps)",
    )
    add(
        "--view-span",
        type=options.numbers(0, "RIGHT or RIGHT,DOWN", "meters"),
        metavar="RIGHT[,DOWN]",
        help="meters from the first view to the last: of one row, or to the right and down",
    )
    add(
        "--view-focus",
        type=argument(lengths.parse_distance),
        metavar="DISTANCE",
        help="distance at which all views agree, such as 1m, or inf of parallel cameras; a quilt's display lies there",
    )
    add(
        "--view-panel",
        type=argument(lengths.parse_distance),
        metavar="DISTANCE",
        help="distance at which views are put together, and all is sharpest (default: that of --view-focus)",
    )


def add_run_scripts(parser):
    parser.add_argument(
        "--run-scripts",
        action="store_true",
        help="let a .blend run its Python, such as drivers; only for files that you trust",
    )


def add_define(parser, default="the file's own"):
    parser.add_argument(
        "-D",
        "--define",
        action="append",
        type=argument(_definition),
        metavar="NAME=VALUE",
        help=f"value of a $parameter of a Mitsuba .xml; may be repeated (default: {default})",
    )


def _definition(text):
    name, equals, value = text.partition("=")
    if not (equals and re.fullmatch(r"\w+", name)):
        raise engine.InvalidInput(f"'{text}' is not NAME=VALUE, for example width=640")
    return name, value


def add_at_frame(parser, default="the file's current one"):
    parser.add_argument(
        "--at-frame",
        type=argument(_one_frame),
        metavar="N",
        help=f"frame of a Blender scene (default: {default})",
    )


def add_encoding(parser):
    add = parser.add_argument
    add(
        "--encode",
        choices=("none", *ENCODINGS),
        default="none",
        help="also write phases for an SLM into DIR/hologram (default none); auto is the best that --encode-seconds "
        "allow: refine, joint where they are too few, sgd with one frame",
    )
    add_levels(parser)
    add_encode_seconds(parser)
    add_eyebox(parser)
    parser.add_argument(
        "--encode-start",
        choices=("own", "before"),
        default="own",
        help="what phases of an animation's frames begin with: each for itself (default), or with those of the frame "
        "before, which flickers less; frames are then made in turn",
    )


def add_encode_seconds(parser):
    parser.add_argument(
        "--encode-seconds",
        type=argument(_encode_seconds),
        metavar=ENCODE_SECONDS.metavar,
        help="that encoding may take after the field: more seconds, better phases; what there is by then is kept "
        "(default: no limit)",
    )


def add_eyebox(parser):
    parser.add_argument(
        "--eyebox",
        type=argument(_eyebox),
        metavar=EYEBOX.metavar,
        help="how much parts of the pupil count besides the whole, from 0 to 1, in joint and refine (default: 0 with "
        "up to six frames, 1 from eight on)",
    )


def eyebox_of(args, method):
    """Weight of parts of the pupil; None for the plan's."""
    if args.eyebox is not None and method not in ("auto", "joint", "refine"):
        raise engine.InvalidInput(
            f"--eyebox is for phases of all frames together, not for {method}: choose joint or refine, or leave it out."
        )
    return args.eyebox


def encode_seconds_of(args):
    """Seconds that encoding may take; None for no limit."""
    if args.encode_seconds is not None and args.encode in ("none", "dpac"):
        raise engine.InvalidInput(
            f"--encode-seconds is for phases by descent, not for {args.encode}: add --encode auto, or leave them out."
        )
    return args.encode_seconds


def add_cache(parser, store):
    parser.add_argument(
        "--cache",
        dest="store",
        type=engine.BakeStore,
        default=store,
        metavar="DIR",
        help=f"folder of baked light (default: {store.folder})".replace("%", "%%"),
    )


def _views(text):
    if not text.isdigit() or not 2 <= int(text) <= 32:
        raise engine.InvalidInput(f"A light field has 2 to 32 views in a row, not {text}")
    return int(text)


def _quilt(text):
    columns, _, rows = text.partition("x")
    if not (columns.isdigit() and rows.isdigit() and 2 <= int(columns) * int(rows) <= MOST_VIEWS):
        raise engine.InvalidInput(
            f"A quilt has columns and rows as 8x6, of 2 to {MOST_VIEWS} views, not {text}"
        )
    return int(columns), int(rows)


def _sheet(text):
    if Path(text).name != text or Path(text).suffix != ".png":
        raise engine.InvalidInput(f"'{text}' is not the name of a picture in DIR, such as demo.png")
    return text


def _one_frame(text):
    frames = ranges.frames(text)
    if len(frames) != 1:
        raise engine.InvalidInput(f"'{text}' is not one frame, but several")
    return frames[0]


def bits(text):
    if not text.isdigit() or not 1 <= int(text) <= 16:
        raise engine.InvalidInput(f"An SLM has 1 to 16 bits, not {text}")
    return int(text)


def _eyebox(text):
    share = float(text)
    EYEBOX.check(share)
    return share


def _encode_seconds(text):
    seconds = float(text)
    ENCODE_SECONDS.check(seconds)
    return seconds


def add_levels(parser):
    parser.add_argument(
        "--bits",
        type=argument(bits),
        metavar="N",
        help="of phase that a pixel of the SLM takes, where they are few: the phases are the best of its levels",
    )
    parser.add_argument(
        "--response",
        metavar="FILE",
        help="levels as measured instead: the SLM's calibration (.json), with the display's model where `holopath "
        "calibrate` fitted one, or a text file of their phases in radians",
    )


def levels_of(args, hologram):
    """`engine.Levels` that the words say the SLM has at each wavelength; None if they say nothing."""
    return None if args.response is None else measured_levels(args.response, hologram)


def files_of(args):
    """Files that say it, or what beam and stop are, by what they are."""
    bench = stop_files(args.stop) | {f"beam {role}": path for role, path in beam_files(args.beam).items()}
    return bench | ({} if args.response is None else response_files(args.response))


def display_of(args, wavelengths):
    """What the display does to light at each wavelength, where the words name a calibration that knows; else None."""
    return None if args.response is None else fitted_display(args.response, wavelengths)


def add_focus(parser, default):
    parser.add_argument(
        "--focus",
        type=argument(lengths.parse_focus),
        metavar="0.5m,1m,inf",
        help=f"focus distances in m (or without a unit), cm, mm, D (diopters), or inf (default: {default})",
    )
    parser.add_argument(
        "--pupil",
        type=options.numbers(3, "X,Y,DIAMETER", "millimeters"),
        metavar="X,Y,DIAMETER",
        help="part of the viewer's pupil, mm right and up of the axis (default: all of it)",
    )


def _resolution(text):
    width, x, height = text.lower().partition("x")
    if not (x and width.isdigit() and height.isdigit()):
        raise engine.InvalidInput(f"'{text}' is not WIDTHxHEIGHT in pixels, for example 512x512")
    return int(width), int(height)


def hologram_of(args, base):
    """Hologram from the flags over the scene's own."""
    changes, optics = {}, options.optics_of(args)
    lens = optics.get("lens", base.optics.lens)
    if args.display is not None:
        if args.resolution or args.pitch:
            raise engine.InvalidInput(
                "--display sets resolution and pitch: leave out --resolution and --pitch."
            )
        changes.update(width=args.display.width, height=args.display.height, pitch=args.display.pitch)
    if args.resolution is not None:
        changes.update(width=args.resolution[0], height=args.resolution[1])
    if args.pitch is not None:
        changes["pitch"] = args.pitch
    if args.depth_range is not None:
        changes.update(zip(ENDS, (mm * 1e-3 for mm in args.depth_range), strict=True))
    elif args.display is not None and lens is None:
        changes.update(zip(ENDS, args.display.depth_range, strict=True))
    elif changes or lens != base.optics.lens:
        changes.update(dict.fromkeys(ENDS))
    if args.wavelengths is not None:
        changes["wavelengths"] = tuple(w * 1e-9 for w in args.wavelengths)
    if args.depth_mapping is not None:
        changes["depth_mapping"] = args.depth_mapping
    if args.near is not None:
        changes["near"] = args.near
    if optics:
        changes["optics"] = replace(base.optics, **optics)
    return options.with_colors(replace(base, **changes), args)


def pupil_of(args):
    if args.pupil is None:
        return None
    return engine.Pupil(*(v * 1e-3 for v in args.pupil))


def size_from(args, source):
    """Resolution and where it is from, as words; None where words or a .blend give it."""
    if args.resolution is not None or args.display is not None or source.frame is not None:
        return None
    hologram = source.hologram_from(args.camera)
    return f"{hologram.width} x {hologram.height}", source.size_from(args.camera)


def _say_size(args, source, say):
    found = size_from(args, source)
    if found is not None:
        say(f"{found[0]} pixels, the size of {found[1]}; --resolution WxH for another one.")


def load(args, source):
    """Scene in its current frame, hologram and settings that the words ask for."""
    sources.to_frame(args.at_frame, args.scene, source)
    hologram, settings = (
        hologram_of(args, source.hologram_from(args.camera)),
        options.settings_of(args, source.settings),
    )
    with sources.native_output_to_stderr():
        loaded = source.load(hologram.picture.width, hologram.picture.height, args.camera)
    yaw, pitch = map(math.radians, args.turn or (0.0, 0.0))
    camera = loaded.camera.moved(args.move or (0.0, 0.0, 0.0), yaw, pitch)
    return replace(loaded, camera=camera), hologram, settings


def check_encoding(args, settings, hologram):
    """Levels and display model by which phases are to be found; what cannot be encoded is refused before a render."""
    method, levels, display = args.encode, levels_of(args, hologram), display_of(args, hologram.wavelengths)
    if args.encode_start == "before" and (
        method in ("none", "dpac") or not (args.animation or args.frame_range)
    ):
        raise engine.InvalidInput(
            "--encode-start before is for phases of an animation by descent: add --animation and --encode auto, or "
            "leave it out."
        )
    if levels is not None and args.bits is not None:
        raise engine.InvalidInput("Levels that were measured have a number of their own: leave out --bits.")
    for name in ("correction", "variation") if display is not None else ():
        if any(getattr(each, name, None) is not None for each in levels or ()):
            raise engine.InvalidInput(
                f"A display model knows no {name}: leave out either in {args.response}."
            )
    if method == "dpac" and display is not None:
        raise engine.InvalidInput(
            "Double phase knows no display model: choose --encode sgd or joint, or leave out --response."
        )
    if display is not None and not hologram.flat_bench:
        raise engine.InvalidInput(
            "A display that was fitted has a beam and a stop of its own, and no lens behind it: leave out "
            "--response, or the optics."
        )
    if method == "refine" and settings.method in BASELINES:
        raise engine.InvalidInput(
            f"The encoding refine needs many frames, which the method {settings.method} has not: choose --encode joint."
        )
    return levels, display


def request_of(args, source, job=None):
    """The `Request` that the words stand for, of the scene in its current frame."""
    seconds = encode_seconds_of(args)
    loaded, hologram, settings = load(args, source)
    levels, display = check_encoding(args, settings, hologram)
    opened = {
        "frame": source.frame,
        "camera": args.camera,
        "scene": args.scene_name,
        "view_layer": args.view_layer,
        **({"define": dict(args.define)} if args.define else {}),
        **({"capture": given} if (given := sources.capture_options(args).to_dict()) else {}),
    }
    request = Request(
        hologram,
        settings,
        args.focus,
        pupil_of(args),
        args.store,
        Encoding(args.encode, seconds, eyebox_of(args, args.encode), args.bits, levels, display),
        Outputs(args.compare_reference, args.rgbd, args.light_field, args.quilt, args.contact_sheet),
        Origin(args.scene, opened=opened, job=job),
    )
    return request.with_scene(loaded.scene, loaded.camera, loaded.notes)


def _render(args):
    if args.attended:
        with supervised(args.scene):
            _work(args, WindowProgress())
    else:
        _work(args, Progress(quiet=args.quiet))


def _work(args, progress):
    if args.animation or args.frame_range:
        _share(args, progress)
        return
    if args.cluster is not None:
        raise engine.InvalidInput("One process makes a still: add --animation, or leave out --cluster.")
    start = time.perf_counter()
    with output.output_folder(args.out) as folder:
        progress(0.0, "Opening the scene")
        source = sources.open_requested(args)
        _say_size(args, source, progress.say)
        progress(0.03, "Exporting the scene")
        request = request_of(args, source)
        spent = time.perf_counter() - start
        _, report = stills.write(folder, request, Stages(progress, "still")["still"], spent)
    if report.get("encoding", {}).get("stopped"):
        raise engine.Cancelled(
            f"Cancelled while encoding: {args.out} holds the render, and the phases as they were then."
        )
    progress.saved(output.first_picture(args.out, report), report["seconds"]["total"])
    progress(1.0, f"Done in {report['seconds']['total']:.1f} s: {args.out}")
    for line in _remarks(report):
        progress.say(line)


def _share(args, progress):
    """All frames that are asked for, but those that are done, or made by other processes."""
    start = time.perf_counter()
    with animating(args.out):
        progress(0.0, "Opening the scene")
        work = units_of(args, progress.say, progress.saved)
        with work.job.join(work.folder, work.units):
            work_by(args, work, progress)
        made = len(work.made)
        others = sum(not unit.prepares for unit in work.units.values()) - made
    seconds = time.perf_counter() - start
    before = f", {others} done before or by others" if others else ""
    progress(1.0, f"Done: {made} frame{'' if made == 1 else 's'} in {seconds:.1f} s{before}: {args.out}")


def units_of(args, say, saved=lambda picture, seconds: None) -> Work:
    """The work that the words of `holopath render` ask for: a unit a frame of an animation, and the light of all.

    Parameters
    ----------
    args : argparse.Namespace
        See `cli.parse`.
    say : callable
        ``say(text)`` of what is made.
    saved : callable
        ``saved(picture, seconds)`` of each frame that is made, see `console.Progress.saved`.

    Returns
    -------
    Work
        Of the scene that is opened, until another one is.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
    """
    out = Path(args.out).absolute()
    if out.exists() and not out.is_dir():
        raise engine.InvalidInput(f"The output {args.out} is a file: choose a folder.")
    if not sources.of_blender(args.scene):
        flag = "--frame-range" if args.frame_range else "--animation"
        raise engine.InvalidInput(f"{args.scene} has no animation: give a .blend, or leave out {flag}.")
    if args.at_frame is not None:
        raise engine.InvalidInput("An animation has frames of its own: leave out --at-frame.")
    source = sources.open_requested(args)
    assert isinstance(source, sources.BlenderSource)
    job, told = _job(args, source), set()

    def finished(folder, report):
        """Remarks that were made of an earlier frame are left out."""
        saved(output.first_picture(folder, report), report["seconds"]["total"])
        for line in [line for line in _remarks(report) if line not in told]:
            say(f"{folder.name}: {line}")
            told.add(line)

    frames = AnimationFrames(
        out,
        args.frame_range or source.frames,
        source,
        job.digest,
        options.settings_of(args, source.settings).method,
        args.encode,
        args.store,
        lambda: request_of(args, source, job.digest),
        finished,
        say,
        args.encode_start == "before",
    )
    return Work(out, job, frames.units, frames.names)


def _joined(args, say):
    """The work of one who joins in: `units_of`, of the job that the others work on."""
    work = units_of(args, say)
    with work.job.join(work.folder):
        return work


def _job(args, source):
    """What decides the results."""
    words = {name: value for name, value in vars(args).items() if name not in _APART}
    scene = args.scene if args.scene.startswith("demo:") else Path(args.scene).name
    files = {**source.files, **files_of(args)}
    return SharedJob(scene, output.plain(words), digests(files), versions())


def versions():
    """Those of the programs on which results depend, as a `SharedJob` takes them."""
    return {name: text or "none" for name, text in output.versions().items() if name != "python"}


def _remarks(report):
    """Lines on what is to be known of a result."""
    lines = [f"note: {text}" for text in [*report["warnings"], *map(note_text, report["export_notes"])]]
    for row in report.get("comparison", []):
        depth = row["focus_m"]
        where = "infinity" if math.isinf(depth) else f"{lengths.format_distance(depth)} m"
        phases = f", of the phases {row['phases_psnr_db']:.2f} dB" if "phases_psnr_db" in row else ""
        lines.append(
            f"focus {where}: PSNR {row['psnr_db']:.2f} dB{phases}, SSIM {row['ssim']:.3f}; "
            f"a perfect hologram of this pitch: {row['psnr_ceiling_db']:.1f} dB"
        )
    return lines


def note_text(note):
    """One line about what the exporter changed or left out."""
    from ..export.notes import Note

    return str(Note(**note))
