"""Command `holopath render`: its options, and its work on a still or on every frame of an animation."""

import argparse
import math
import re
import time
from dataclasses import replace
from pathlib import Path

from .. import engine
from ..blender.demo import DEMOS
from ..engine import displays
from ..engine.baselines import network
from ..engine.progress import Stages
from ..engine.settings import ENCODE_SECONDS, EYEBOX
from ..engine.settings.choices import BASELINES, DEPTH_MAPPINGS, ENCODINGS
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
MAX_VIEWS = 256  # in a quilt
ENDS = ("depth_far", "depth_near")  # of the volume
# Options that do not affect results; all others do.
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
    "depth",  # its contents are among the files
}


def add(command, store):
    """Add the command.

    Parameters
    ----------
    command : callable
        ``command(name, run, text)`` gives the parser of a command, with its function and help text.
    store : engine.BakeStore
        Default store of baked light.
    """
    render = command("render", _render, "Render the wave field of a scene, and refocused images.")
    add_scene(render, store)
    render.add_argument(
        "--out",
        required=True,
        metavar="DIR",
        help="output folder: new, empty, or an earlier output of HoloPath",
    )
    render.add_argument(
        "--animation",
        action="store_true",
        help="render every frame of the scene's frame range into DIR/frame_0001 and so on; existing frames of the same "
        "scene with the same settings are skipped, and processes with the same options share the others",
    )
    render.add_argument(
        "--frame-range",
        type=argument(ranges.frames),
        metavar="1-5,9,20-40:2",
        help="render these frames, as with --animation; also beyond the .blend's frame range, and of demo:NAME",
    )
    add_option(render, "frames")
    render.set_defaults(work=_join)
    add_focus(render, "three depths spread over the visible range")
    add_encoding(render)
    render.add_argument(
        "--compare-reference",
        action="store_true",
        help="also render every image with a thin-lens camera, and report PSNR and SSIM",
    )
    render.add_argument(
        "--rgbd",
        action="store_true",
        help="also write a pinhole image, its surface depths, and the depths of what mirrors and glass show, into "
        "DIR/rgbd",
    )
    render.add_argument(
        "--light-field",
        type=argument(_views),
        metavar="N",
        help="also write pinhole images through N x N points of the pupil into DIR/light_field",
    )
    render.add_argument(
        "--quilt",
        type=argument(_quilt),
        metavar="CxR",
        help="also write pinhole images from the left of the pupil to its right, C x R in one image for Looking Glass "
        "displays, into DIR/quilt",
    )
    render.add_argument(
        "--contact-sheet",
        type=argument(_sheet),
        metavar="NAME.png",
        help="also write an overview image into DIR: phases of a frame, the image at each focus, and beside the middle "
        "one the image through a thin lens",
    )
    render.add_argument("--attended", action="store_true", help=argparse.SUPPRESS)  # for Blender's window


def add_scene(parser, store):
    """Add the options of a scene, its hologram and its settings.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    store : engine.BakeStore
        See `add`.
    """
    add = parser.add_argument
    add(
        "scene",
        metavar="SCENE",
        help=f"a .blend, a Mitsuba .xml, an image with --depth, a .ply of points, an array of views, or {DEMO_SCENES}",
    )
    add(
        "--display",
        type=argument(displays.display),
        metavar="PRESET",
        help="resolution, pitch, bits, frames and depth range of a device, see docs/slm.md: "
        + ", ".join(engine.DISPLAYS),
    )
    add(
        "--resolution",
        type=argument(_resolution),
        metavar="WxH",
        help="pixels of the SLM (default: the file's, of an .xml its film's or crop window's, else 512x512)",
    )
    add(
        "--pitch",
        type=argument(options.pitch),
        metavar="UM[,UM]",
        help="pixel pitch, micrometers; X,Y if pixels are not square (default: the file's, 8)",
    )
    add(
        "--wavelengths",
        type=options.numbers(0, "a list of wavelengths", "nanometers"),
        metavar="NM[,NM..]",
        help="wavelengths, nanometers (default: the file's, 640,516.5,455.4)",
    )
    baked = parser.add_mutually_exclusive_group()
    add_cache(baked, store)
    baked.add_argument(
        "--no-cache", dest="store", action="store_const", const=None, help="bake light for this run only"
    )
    add(
        "--depth-range",
        type=options.numbers(2, "FAR,NEAR", "millimeters"),
        metavar="FAR_MM,NEAR_MM",
        help="distances of infinity and of the near end from the SLM (default: those without dark borders; 80,85 with "
        "--display)",
    )
    add(
        "--depth-mapping",
        choices=tuple(DEPTH_MAPPINGS),
        help="mapping of the scene into the depth range",
    )
    add("--near", type=float, metavar="METERS", help="world depth of the near end (default: nearest surface)")
    options.add_optics(parser)
    options.add(parser)
    add(
        "--camera",
        metavar="NAME",
        help="camera object, sensor id of an .xml, or front or origin for a .ply (default: active, first, front)",
    )
    add(
        "--move",
        type=options.numbers(3, "RIGHT,UP,FORWARD", "meters"),
        metavar="RIGHT,UP,FORWARD",
        help="move the camera, meters along its own axes",
    )
    add(
        "--turn",
        type=options.numbers(2, "LEFT,UP", "degrees"),
        metavar="LEFT,UP",
        help="then turn the camera, degrees",
    )
    add_at_frame(parser)
    add(
        "--scene-name",
        metavar="NAME",
        help="scene of a .blend (default: the one that was active when it was saved)",
    )
    add(
        "--view-layer",
        metavar="NAME",
        help="view layer of the scene (default: the first that is used for rendering)",
    )
    add_run_scripts(parser)
    add_define(parser)
    _add_capture(parser)


def _add_capture(parser):
    add = parser.add_argument_group(
        "images with depth, a .ply of points, and quilts or other arrays of views"
    ).add_argument
    add("--depth", metavar="FILE", help="depth of each pixel: an .exr, a .png of 8 or 16 bits, or an .npy")
    add("--depth-unit", choices=captures.UNITS, help=f"meaning of its numbers: {captures.UNIT_WORDS}")
    add(
        "--depth-ends",
        type=options.numbers(2, "FAR,NEAR", "meters"),
        metavar="FAR,NEAR",
        help="depths of 0 and 1 of --depth-unit inverse, meters",
    )
    add(
        "--depth-along",
        choices=captures.ALONG,
        help="direction of depths: the camera's axis, as of cameras and Blender, or each pixel's own ray, as of "
        "Mitsuba (default: axis)",
    )
    add(
        "--fov",
        type=float,
        metavar="DEGREES",
        help="horizontal field of view (default: 39.6, that of a 50 mm lens on 36 mm of film)",
    )
    add("--axes", choices=tuple(captures.AXES), help=f"axes of a .ply: {captures.AXES_WORDS}")
    add(
        "--point-radius",
        type=float,
        metavar="METERS",
        help="radius of the disks that replace points of a .ply (default: large enough to close surfaces)",
    )
    add(
        "--view-span",
        type=options.numbers(0, "RIGHT or RIGHT,DOWN", "meters"),
        metavar="RIGHT[,DOWN]",
        help="distance from the first view to the last, meters: of one row, or to the right and down",
    )
    add(
        "--view-focus",
        type=argument(lengths.parse_distance),
        metavar="DISTANCE",
        help="distance at which all views coincide, such as 1m, or inf for parallel cameras; that of a quilt's display",
    )
    add(
        "--view-panel",
        type=argument(lengths.parse_distance),
        metavar="DISTANCE",
        help="distance of the plane on which views are combined, and which is sharpest (default: --view-focus)",
    )


def add_run_scripts(parser):
    """Add the option `--run-scripts`.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    """
    parser.add_argument(
        "--run-scripts",
        action="store_true",
        help="let a .blend run its Python, such as drivers; only for files that you trust",
    )


def add_define(parser, default="the file's own"):
    """Add the option `--define`.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    default : str
        Default values, for the help text.
    """
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
        raise engine.InvalidInput(f"Expected NAME=VALUE, for example width=640, got '{text}'")
    return name, value


def add_at_frame(parser, default="the file's current one"):
    """Add the option `--at-frame`.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    default : str
        Default frame, for the help text.
    """
    parser.add_argument(
        "--at-frame",
        type=argument(_one_frame),
        metavar="N",
        help=f"frame of a Blender scene (default: {default})",
    )


def add_encoding(parser):
    """Add the options of the encoding.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    """
    add = parser.add_argument
    add(
        "--encode",
        choices=("none", *ENCODINGS),
        default="none",
        help="also write phases for an SLM into DIR/hologram (default none); auto: the best method that "
        "--encode-seconds allow, which is refine, or if they are too few joint or sgd",
    )
    add_levels(parser, " (default: those of --display, if they are fewer than 8)")
    add_encode_seconds(parser)
    add_eyebox(parser)
    parser.add_argument(
        "--encode-start",
        choices=("own", "before"),
        default="own",
        help="initial phases of an animation's frames: own (default), or those of the previous frame, which reduces "
        "flicker, but renders one frame after another",
    )


def add_encode_seconds(parser):
    """Add the option `--encode-seconds`.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    """
    parser.add_argument(
        "--encode-seconds",
        type=argument(_encode_seconds),
        metavar=ENCODE_SECONDS.metavar,
        help="time limit of the encoding after the field: more time gives better phases; at the limit the best ones "
        "are kept; it ends earlier where more steps would show less (default: no limit)",
    )


def add_eyebox(parser):
    """Add the option `--eyebox`.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    """
    parser.add_argument(
        "--eyebox",
        type=argument(_eyebox),
        metavar=EYEBOX.metavar,
        help="weight of parts of the pupil relative to the whole, from 0 to 1, in joint and refine (default: 0 for up "
        "to six frames, 1 from eight on; in less time than the default takes 0 for up to 15)",
    )


def eyebox_of(args, method):
    """Weight of parts of the pupil in the encoding.

    Parameters
    ----------
    args : argparse.Namespace
    method : str
        Method of encoding.

    Returns
    -------
    float or None
        None for the plan's choice.

    Raises
    ------
    engine.InvalidInput
        If the method has no such weight.
    """
    if args.eyebox is not None and method not in ("auto", "joint", "refine"):
        raise engine.InvalidInput(
            f"Expected joint or refine for --eyebox, got {method}. Choose one of them, or omit it."
        )
    return args.eyebox


def encode_seconds_of(args):
    """Time limit of the encoding.

    Parameters
    ----------
    args : argparse.Namespace

    Returns
    -------
    float or None
        Seconds; None for no limit.

    Raises
    ------
    engine.InvalidInput
        If the method has no time limit.
    """
    if args.encode_seconds is not None and args.encode in ("none", "dpac"):
        raise engine.InvalidInput(
            f"Expected a method with gradient descent for --encode-seconds, got {args.encode}. Add --encode auto, or "
            "omit it."
        )
    return args.encode_seconds


def add_cache(parser, store):
    """Add the option `--cache`.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    store : engine.BakeStore
        See `add`.
    """
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
        raise engine.InvalidInput(f"Expected 2 to 32 views in a row, got {text}")
    return int(text)


def _quilt(text):
    columns, _, rows = text.partition("x")
    if not (columns.isdigit() and rows.isdigit() and 2 <= int(columns) * int(rows) <= MAX_VIEWS):
        raise engine.InvalidInput(f"Expected columns and rows as 8x6, of 2 to {MAX_VIEWS} views, got {text}")
    return int(columns), int(rows)


def _sheet(text):
    if Path(text).name != text or Path(text).suffix != ".png":
        raise engine.InvalidInput(f"Expected the name of an image in DIR, such as demo.png, got '{text}'")
    return text


def _one_frame(text):
    frames = ranges.frames(text)
    if len(frames) != 1:
        raise engine.InvalidInput(f"Expected one frame, got '{text}'")
    return frames[0]


def bits(text):
    """Parse the bits of an SLM's levels.

    Parameters
    ----------
    text : str

    Returns
    -------
    int

    Raises
    ------
    engine.InvalidInput
        If the text is not an integer from 1 to 16.
    """
    if not text.isdigit() or not 1 <= int(text) <= 16:
        raise engine.InvalidInput(f"Expected 1 to 16 bits, got {text}")
    return int(text)


def _eyebox(text):
    weight = float(text)
    EYEBOX.check(weight)
    return weight


def _encode_seconds(text):
    seconds = float(text)
    ENCODE_SECONDS.check(seconds)
    return seconds


def add_levels(parser, default=""):
    """Add the options of the SLM's levels.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    default : str
        Words on what is taken without ``--bits``.
    """
    parser.add_argument(
        "--bits",
        type=argument(bits),
        metavar="N",
        help=f"bits of the SLM's phase levels, if they are few: phases are optimized for these levels{default}",
    )
    parser.add_argument(
        "--response",
        metavar="FILE",
        help="measured levels instead of --bits: the SLM's calibration (.json), with the display's model if `holopath "
        "calibrate` has fitted one, or a text file of phases in radians",
    )


def bits_of(args):
    """Bits of the levels that phases are optimized for: those of ``--bits``, or few ones of ``--display``.

    Parameters
    ----------
    args : argparse.Namespace

    Returns
    -------
    int or None
        None for any phase, and with measured levels.
    """
    if args.bits is not None or args.response is not None or args.display is None:
        return args.bits
    return args.display.few_bits


def levels_of(args, hologram):
    """Measured levels of the SLM.

    Parameters
    ----------
    args : argparse.Namespace
    hologram : engine.Hologram

    Returns
    -------
    list of engine.Levels or None
        Levels at each wavelength; None without measured levels.

    Raises
    ------
    engine.InvalidInput
    """
    return None if args.response is None else measured_levels(args.response, hologram)


def files_of(args):
    """Files of the beam, the stop, the colors and the measured levels.

    Parameters
    ----------
    args : argparse.Namespace

    Returns
    -------
    dict of str to path
        By their role.
    """
    bench = stop_files(args.stop) | {f"beam {role}": path for role, path in beam_files(args.beam).items()}
    if args.colors_from is not None:
        bench |= {f"colors {role}": path for role, path in response_files(args.colors_from).items()}
    return bench | ({} if args.response is None else response_files(args.response))


def display_of(args, wavelengths):
    """Fitted model of the display.

    Parameters
    ----------
    args : argparse.Namespace
    wavelengths : sequence of float
        Meters.

    Returns
    -------
    list of engine.DisplayModel or None
        Model at each wavelength; None without a calibration that has one.

    Raises
    ------
    engine.InvalidInput
    """
    return None if args.response is None else fitted_display(args.response, wavelengths)


def add_focus(parser, default):
    """Add the options of focus and pupil.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    default : str
        Default focus, for the help text.
    """
    parser.add_argument(
        "--focus",
        type=argument(lengths.parse_focus),
        metavar="0.5m,1m,inf",
        help=f"focus distances in m, cm, mm or D (diopters), or inf; meters without a unit (default: {default})",
    )
    parser.add_argument(
        "--pupil",
        type=options.numbers(3, "X,Y,DIAMETER", "millimeters"),
        metavar="X,Y,DIAMETER",
        help="part of the viewer's pupil, millimeters to the right and up of the axis (default: all of it)",
    )


def _resolution(text):
    width, x, height = text.lower().partition("x")
    if not (x and width.isdigit() and height.isdigit()):
        raise engine.InvalidInput(f"Expected WIDTHxHEIGHT in pixels, for example 512x512, got '{text}'")
    return int(width), int(height)


def hologram_of(args, base):
    """Hologram by the options, or else the scene's own.

    Parameters
    ----------
    args : argparse.Namespace
    base : engine.Hologram
        Hologram of the scene.

    Returns
    -------
    engine.Hologram

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
    """
    changes, optics = {}, options.optics_changes(args)
    lens = optics.get("lens", base.optics.lens)
    if args.display is not None:
        if args.resolution or args.pitch:
            raise engine.InvalidInput(
                "--display sets resolution and pitch. Omit --resolution and --pitch, or, for a part of the panel, give "
                "them with --bits and --frames in place of --display."
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
    """Part of the viewer's pupil.

    Parameters
    ----------
    args : argparse.Namespace

    Returns
    -------
    engine.Pupil or None
        None for the whole pupil.

    Raises
    ------
    engine.InvalidInput
    """
    if args.pupil is None:
        return None
    return engine.Pupil(*(v * 1e-3 for v in args.pupil))


def size_origin(args, source):
    """Resolution of a scene file and its origin, in words.

    Parameters
    ----------
    args : argparse.Namespace
    source : sources.BlenderSource, sources.MitsubaSource or sources.CaptureSource

    Returns
    -------
    (str, str) or None
        None if options or a .blend set the resolution.
    """
    if args.resolution is not None or args.display is not None or source.frame is not None:
        return None
    hologram = source.hologram_from(args.camera)
    return f"{hologram.width} x {hologram.height}", source.size_origin(args.camera)


def _say_size(args, source, say):
    size = size_origin(args, source)
    if size is not None:
        say(f"{size[0]} pixels, the size of {size[1]}; --resolution WxH for another one.")


def load(args, source):
    """Load the requested scene in its current frame, its hologram and its settings.

    Parameters
    ----------
    args : argparse.Namespace
    source : sources.BlenderSource, sources.MitsubaSource or sources.CaptureSource

    Returns
    -------
    exchange.built_scene.BuiltScene
    engine.Hologram
    engine.Settings

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
    """
    sources.to_frame(args.at_frame, args.scene, source)
    hologram = hologram_of(args, source.hologram_from(args.camera))
    settings = options.settings_of(args, source.settings)
    with sources.native_output_to_stderr():
        loaded = source.load(hologram.picture.width, hologram.picture.height, args.camera)
    yaw, pitch = map(math.radians, args.turn or (0.0, 0.0))
    camera = loaded.camera.moved(args.move or (0.0, 0.0, 0.0), yaw, pitch)
    return replace(loaded, camera=camera), hologram, settings


def check_encoding(args, settings, hologram):
    """Check the options of the encoding before the render.

    Parameters
    ----------
    args : argparse.Namespace
    settings : engine.Settings
    hologram : engine.Hologram

    Returns
    -------
    list of engine.Levels or None
        Measured levels at each wavelength.
    list of engine.DisplayModel or None
        Fitted model of the display at each wavelength.

    Raises
    ------
    engine.InvalidInput
        If the options do not fit each other, or the hologram.
    """
    method, levels, display = args.encode, levels_of(args, hologram), display_of(args, hologram.wavelengths)
    is_animation = getattr(args, "animation", False) or getattr(
        args, "frame_range", None
    )  # of `render` alone
    if args.encode_start == "before" and (method in ("none", "dpac") or not is_animation):
        raise engine.InvalidInput(
            "Expected an animation and a method with gradient descent for --encode-start before. Add --animation and "
            "--encode auto, or omit it."
        )
    if levels is not None and args.bits is not None:
        raise engine.InvalidInput("Measured levels have their own number. Omit --bits.")
    for name in ("correction", "variation") if display is not None else ():
        if any(getattr(each, name, None) is not None for each in levels or ()):
            raise engine.InvalidInput(
                f"Expected either a display model or a {name} in {args.response}, got both. Remove one of them."
            )
    if method == "dpac" and display is not None:
        raise engine.InvalidInput(
            "Double phase does not use a display model. Choose --encode sgd or joint, or omit --response."
        )
    if display is not None and not hologram.flat_bench:
        raise engine.InvalidInput(
            "A fitted display has its own beam and stop, and no lens behind it. Omit --response, or the options of the "
            "optics."
        )
    if method == "refine" and settings.method in BASELINES:
        raise engine.InvalidInput(
            f"The encoding refine needs extra frames, which the method {settings.method} lacks. Choose --encode joint."
        )
    return levels, display


def request_of(args, source, job=None):
    """Request of the scene in its current frame.

    Parameters
    ----------
    args : argparse.Namespace
    source : sources.BlenderSource, sources.MitsubaSource or sources.CaptureSource
    job : str, optional
        See `Origin`.

    Returns
    -------
    Request

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
    """
    seconds = encode_seconds_of(args)
    loaded, hologram, settings = load(args, source)
    levels, display = check_encoding(args, settings, hologram)
    scene_state = {
        "frame": source.frame,
        "camera": args.camera,
        "scene": args.scene_name,
        "view_layer": args.view_layer,
        **({"define": dict(args.define)} if args.define else {}),
        **({"capture": capture} if (capture := sources.capture_options(args).to_dict()) else {}),
    }
    request = Request(
        hologram,
        settings,
        args.focus,
        pupil_of(args),
        args.store,
        Encoding(args.encode, seconds, eyebox_of(args, args.encode), bits_of(args), levels, display),
        Outputs(args.compare_reference, args.rgbd, args.light_field, args.quilt, args.contact_sheet),
        Origin(args.scene, scene_state=scene_state, job=job),
    )
    return request.with_scene(loaded.scene, loaded.camera, loaded.notes)


def check_phases(args):
    """Refuse options of phases where none are requested; a study may have both.

    Raises
    ------
    engine.InvalidInput
    """
    if args.encode == "none" and not (args.bits is None and args.response is None):
        raise engine.InvalidInput(
            "--bits and --response are for phases, and none are requested. Add --encode auto, or omit them."
        )


def _render(args):
    check_phases(args)
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
        raise engine.InvalidInput("One process renders a still. Add --animation, or omit --cluster.")
    start = time.perf_counter()
    with output.output_folder(args.out) as folder:
        progress(0.0, "Opening the scene")
        source = sources.open_requested(args)
        _say_size(args, source, progress.say)
        progress(0.03, "Exporting the scene")
        request = request_of(args, source)
        seconds = time.perf_counter() - start
        _, report = stills.write(folder, request, Stages(progress, "still")["still"], seconds)
    if report.get("encoding", {}).get("stopped"):
        raise engine.Cancelled(
            f"Canceled while encoding: {args.out} has the render, and the phases of the last step."
        )
    progress.saved(output.first_picture(args.out, report), report["seconds"]["total"])
    progress(1.0, f"Done in {report['seconds']['total']:.1f} s: {args.out}")
    for line in _remarks(report):
        progress.say(line)


def _share(args, progress):
    """Make the requested frames that are neither done nor claimed by other processes."""
    start = time.perf_counter()
    with animating(args.out):
        progress(0.0, "Opening the scene")
        work = units_of(args, progress.say, progress.saved)
        with work.job.join(work.folder, work.units):
            work_by(args, work, progress)
        count = len(work.made)
        others = sum(not unit.prepares for unit in work.units.values()) - count
    seconds = time.perf_counter() - start
    rest = f", {others} done before or by others" if others else ""
    progress(1.0, f"Done: {count} frame{'' if count == 1 else 's'} in {seconds:.1f} s{rest}: {args.out}")


def units_of(args, say, saved=lambda picture, seconds: None) -> Work:
    """Work on an animation: one unit per frame, and one for their common light.

    Parameters
    ----------
    args : argparse.Namespace
        See `cli.parse`.
    say : callable
        ``say(text)`` receives remarks.
    saved : callable
        ``saved(picture, seconds)`` is called after each frame, see `console.Progress.saved`.

    Returns
    -------
    Work
        Valid until another scene is opened.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
    """
    out = Path(args.out).absolute()
    if out.exists() and not out.is_dir():
        raise engine.InvalidInput(f"The output {args.out} is a file. Choose a folder.")
    if not sources.is_blender_scene(args.scene):
        flag = "--frame-range" if args.frame_range else "--animation"
        raise engine.InvalidInput(f"{args.scene} has no animation. Give a .blend, or omit {flag}.")
    if args.at_frame is not None:
        raise engine.InvalidInput("An animation has its own frames. Omit --at-frame.")
    source = sources.open_requested(args)
    assert isinstance(source, sources.BlenderSource)
    job, known = _job(args, source), set()

    def on_finish(folder, report):
        """Print the remarks that no earlier frame had."""
        saved(output.first_picture(folder, report), report["seconds"]["total"])
        for line in [line for line in _remarks(report) if line not in known]:
            say(f"{folder.name}: {line}")
            known.add(line)

    frames = AnimationFrames(
        args, out, source, job.digest, lambda: request_of(args, source, job.digest), on_finish, say
    )
    return Work(out, job, frames.units, frames.names)


def _join(args, say):
    """Work of a process that joins the others' job, see `units_of`."""
    work = units_of(args, say)
    with work.job.join(work.folder):
        return work


def _job(args, source):
    """The job: every input that affects the results."""
    words = {name: value for name, value in vars(args).items() if name not in _APART}
    scene = args.scene if args.scene.startswith("demo:") else Path(args.scene).name
    if options.settings_of(args, source.settings).method == "network":
        words["network"] = network.digests()
    return SharedJob(scene, output.plain(words), digests({**source.files, **files_of(args)}), versions())


def versions():
    """Versions of the programs that results depend on, for a `SharedJob`.

    Returns
    -------
    dict of str to str
    """
    return {name: text or "none" for name, text in output.versions().items() if name != "python"}


def _remarks(report):
    """Remarks on a result, a line each."""
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
    """Line on an approximation or omission of the exporter.

    Parameters
    ----------
    note : dict
        See `export.Note`.

    Returns
    -------
    str
    """
    from ..export.notes import Note

    return str(Note(**note))
