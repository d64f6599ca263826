"""Commands for the SLM: stream, focus, calibrate, tune, devices."""

import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from .. import engine, llvm_package, slm
from ..engine.progress import stage
from ..engine.scene import variants
from ..engine.waves import libraries
from ..slm.drivers.controller import BAUD
from ..slm.drivers.files import KINDS
from ..slm.drivers.slmsuite_device import options_of
from ..workflow import failures, output, pipeline
from .console import Progress
from .options import add_old_name, argument, listed, numbers, pitch

PATIENCE = 30.0  # seconds to wait for a lost device


def add(command):
    """Add the commands; `command(name, run, text)` makes a parser."""
    stream = command("stream", _stream, "Show phase holograms on an SLM.")
    option = stream.add_argument
    option(
        "folder", metavar="DIR", help="output folder of `holopath render` (also of an animation) or `encode`"
    )
    option(
        "--driver",
        choices=tuple(slm.DRIVERS),
        default="display",
        help="default display; see `holopath devices`",
    )
    option("--rate", type=float, metavar="HZ", help="pictures a second (default: as the device does best)")
    option("--loops", type=int, metavar="N", help="rounds; 0: until Ctrl-C (default: 0 on a device, else 1)")
    option(
        "--repeats",
        type=int,
        default=1,
        metavar="N",
        help="times each frame of an animation is shown (default 1)",
    )
    _add_packing(
        option,
        listed(slm.PACKINGS, "{}")
        + "; or which bits of the channels a level is on your panel, from its highest on, such as R7-5,G7-5,B7-4",
    )
    option("--order", default="RGB", metavar="RGB", help="in which packed channels are shown (default RGB)")
    option("--calibration", metavar="FILE", help="of the device: docs/slm.md")
    option(
        "--falling",
        action="store_true",
        help="the phase falls as the level rises (a calibration says it itself)",
    )
    option(
        "--bits",
        type=int,
        metavar="N",
        help="of a level, in place of the calibration's (default: the device's)",
    )
    option(
        "--patience",
        type=float,
        default=PATIENCE,
        metavar="S",
        help="seconds to wait for a lost device (default %(default)g)",
    )
    _add_device(stream)
    group = stream.add_argument_group("driver files").add_argument
    group("--out", metavar="DIR", help="where to write (default DIR/pictures)")
    group(
        "--kind",
        choices=KINDS,
        default=KINDS[0],
        help="a file for each picture (png, default), all in one (raw), in a lossless video (video), or in a video for "
        "each color (video-per-color); videos need --rate and the program ffmpeg",
    )
    group = stream.add_argument_group("pictures by a camera").add_argument
    group(
        "--captures",
        metavar="DIR",
        help="focus at each plane and take a picture there while the hologram is shown",
    )
    group(
        "--focus-planes",
        metavar="FILE",
        help="focus planes (default with the virtual bench: five over the volume)",
    )
    add_old_name(stream, "--planes", "--focus-planes")
    group(
        "--camera",
        metavar="COMMAND",
        help="takes a picture: {file}, {plane} and {mm} stand for where to write, the plane's number and its distance",
    )

    focus = command("focus", _focus, "Move the camera's focus by a controller on a serial port.")
    option = focus.add_argument
    option("--port", metavar="PORT", help="default: the only one there is")
    option("--baud", type=int, default=BAUD, help="default %(default)s")
    option("--focus-planes", metavar="FILE", help="focus planes, for --plane, --distance and --store")
    add_old_name(focus, "--planes", "--focus-planes")
    what = focus.add_mutually_exclusive_group(required=True)
    what.add_argument("--plane", type=int, metavar="N", help="move to this plane, from 0")
    what.add_argument("--distance", type=float, metavar="MM", help="move between calibrated planes")
    what.add_argument("--position", type=int, metavar="STEPS", help="move the motor there")
    what.add_argument(
        "--store",
        type=int,
        metavar="N",
        help="store where the motor is as this plane's; a FILE that is not there is made, of five planes, 80 to 85 mm",
    )

    calibrate = command(
        "calibrate",
        _calibrate,
        "Find what a display and its camera really are, from captures of known patterns.",
    )
    option = calibrate.add_argument
    option(
        "--out", required=True, metavar="FILE", help="calibration (.json) to write, or to add a wavelength to"
    )
    option("--wavelength", required=True, type=float, metavar="NM", help="of the light source, nanometers")
    option(
        "--pitch",
        required=True,
        type=argument(pitch),
        metavar="UM[,UM]",
        help="of the SLM's pixels, micrometers; X,Y where they are not square",
    )
    _add_bench(calibrate)
    option(
        "--window",
        type=int,
        default=64,
        metavar="N",
        help="pixels in the SLM's middle that show patterns (64)",
    )
    option("--bits", type=int, default=8, metavar="N", help="of a level (default 8)")
    option(
        "--distances",
        type=numbers(0, "a list of distances", "millimeters"),
        metavar="MM,MM[,..]",
        help="of the foci from the SLM (default: those of --focus-planes)",
    )
    option("--captures", type=int, default=64, metavar="N", help="how many (default 64)")
    _add_device(calibrate)

    tune = command(
        "tune", _tune, "Make phases better by what a camera sees of them, on a display that was calibrated."
    )
    option = tune.add_argument
    option("folder", metavar="DIR", help="output folder whose field was encoded with this calibration")
    option("--calibration", required=True, metavar="FILE", help="by `holopath calibrate`")
    option(
        "--wavelength",
        type=float,
        metavar="NM",
        help="of the light source, nanometers (default: the hologram's only one)",
    )
    option(
        "--rounds",
        type=int,
        default=12,
        metavar="N",
        help="in each, a picture of each frame at each focus (default 12)",
    )
    _add_bench(tune)
    _add_device(tune)

    devices = command("devices", _devices, "List SLM drivers, monitors, serial ports and Mitsuba backends.")
    devices.add_argument(
        "--identify",
        nargs="?",
        type=float,
        const=5.0,
        metavar="SECONDS",
        help="show on each monitor its number in the list, so long (default 5)",
    )


def _packing(text):
    """A packing's name, or the bits of channels."""
    slm.packing_of(text)
    return text


def _add_packing(option, meaning):
    option(
        "--packing",
        type=argument(_packing),
        default="time",
        metavar="NAME|BITS",
        help=f"{meaning} (default time)",
    )


def _add_bench(parser):
    """Which driver, and the camera that looks at it."""
    option = parser.add_argument
    _add_packing(option, "how the device takes levels, as of `holopath stream`")
    option(
        "--driver",
        choices=tuple(name for name in slm.DRIVERS if name != "files"),
        default="display",
        help="default display; virtual is a simulated bench that is off in everything",
    )
    option("--focus-planes", metavar="FILE", help="focus planes, which say where the camera's motor goes")
    option(
        "--view",
        type=numbers(2, "two shares", "half sides of the window"),
        default=[0.95, 0.95],
        metavar="X,Y",
        help="half sides of the window that half the camera's shorter side sees; negative: mirrored (0.95,0.95)",
    )
    option("--camera", metavar="COMMAND", help="takes a picture, as for `holopath stream`")
    option(
        "--settle",
        type=float,
        default=0.5,
        metavar="S",
        help="seconds between a picture that is shown and the camera (default 0.5)",
    )
    option(
        "--seed", type=int, default=0, metavar="N", help="of the patterns, and of what the virtual bench is"
    )


def _add_device(parser):
    """Which monitor, port or SLM of slmsuite."""
    group = parser.add_argument_group("driver display").add_argument
    group("--monitor", metavar="NAME", help="name or geometry (1920x1080+1920+0) of the SLM's monitor")
    group("--primary", action="store_true", help="allow the monitor where you work")
    group = parser.add_argument_group("driver serial, trigger and focus").add_argument
    group("--port", metavar="PORT", help="serial port of the controller")
    group("--baud", type=int, default=BAUD, help="default %(default)s")
    group("--trigger", action="store_true", help="have the controller give a pulse for each picture")
    group(
        "--pulse",
        type=int,
        default=100,
        metavar="US",
        help="its length in microseconds (default %(default)s)",
    )
    group = parser.add_argument_group("driver slmsuite").add_argument
    group("--device", default="simulated", metavar="NAME", help="of slmsuite (default simulated)")
    group(
        "--options",
        default="{}",
        metavar="JSON",
        help="of its class, for example '{\"resolution\": [512, 512]}'",
    )


def _stream(args):
    progress = Progress(quiet=args.quiet)
    if args.rate is not None and not 0 < args.rate < 1e5:
        raise engine.InvalidInput(
            f"A rate of {args.rate:g} pictures a second cannot be shown: give a positive one."
        )
    if args.loops is not None and args.loops < 0:
        raise engine.InvalidInput(f"A number of {args.loops} rounds cannot be shown: give 0 for no end.")
    if not 0 < args.pulse < 2**32:
        raise engine.InvalidInput(
            f"A pulse of {args.pulse} microseconds cannot be given: 1 to {2**32 - 1} can."
        )
    holograms = output.stored_holograms(args.folder)
    calibration = slm.Calibration.load(args.calibration) if args.calibration else None
    falling = args.falling
    if args.bits is not None:
        if calibration is None:
            calibration, falling = slm.Calibration(falling=falling), False
        calibration = replace(calibration, bits=args.bits)
    sequence = slm.Sequence(holograms, calibration, args.packing, args.order, args.repeats, falling)
    driver = _driver(args, sequence)
    controller = _controller(args, driver)
    ends = args.driver in ("files", "virtual") or args.captures
    if args.loops == 0 and ends:
        raise engine.InvalidInput(
            f"The driver {args.driver} must come to an end: give a number of --loops, or none."
        )
    if args.captures and args.driver == "files":
        raise engine.InvalidInput(
            "Files cannot be looked at by a camera: leave out --captures, or choose another driver."
        )
    if not args.patience >= 0:
        raise engine.InvalidInput(f"A patience of {args.patience:g} s is none: give 0 or more.")
    loops = args.loops if args.loops is not None else 1 if ends else 0
    trigger = None
    if args.trigger and controller is not None:
        trigger = partial(controller.trigger, microseconds=args.pulse)
    told = _Told(progress)
    try:
        if controller is not None and controller is not getattr(driver, "controller", None):
            controller.open()
        if args.captures:
            counts = _captured(args, sequence, driver, controller, trigger, progress, told)
        else:
            counts = slm.stream(sequence, driver, args.rate, loops or None, told, trigger, args.patience)
    except (KeyboardInterrupt, engine.Cancelled):
        if loops or args.captures:
            raise engine.Cancelled(f"Cancelled: {told.counts}.") from None
        counts = told.counts
    finally:
        if controller is not None:
            controller.close()
    progress(1.0, f"Done: {counts}; {driver.info.name}{', ' * bool(driver.info.note)}{driver.info.note}")


class _Told:
    """Counts to progress; what happens to the device in lines of its own."""

    def __init__(self, progress):
        self.counts, self._progress, self._lost = slm.Counts(), progress, ""

    def __call__(self, counts):
        self.heed(counts)
        done = (counts.shown + counts.dropped) / counts.total if counts.total else 0.0
        self._progress(min(done, 0.999), str(counts))

    def heed(self, counts):
        """Tell what happens to the device alone."""
        self.counts = counts
        if counts.lost and counts.lost != self._lost:
            self._progress.say(f"{counts.lost} Waiting for it.")
        if self._lost and not counts.lost:
            self._progress.say("The device is there again: going on.")
        self._lost = counts.lost


def _driver(args, sequence):
    if args.driver == "files":
        return slm.FilesDriver(args.out or Path(args.folder) / "pictures", args.kind, sequence)
    if args.driver == "virtual":
        # an SLM that is what the calibration says it is
        return slm.VirtualDriver(
            sequence.holograms[0], sequence.calibration, packing=args.packing, order=args.order
        )
    return _device(args, sequence.size)


def _device(args, size):
    """A real one, for pictures of a width and height."""
    if args.driver == "display":
        return slm.DisplayDriver(args.monitor, args.primary, size)
    if args.driver == "serial":
        return slm.SerialDriver(args.port, args.baud)
    return slm.SlmsuiteDriver(args.device, options_of(args.options, args.device, size))


def _controller(args, driver):
    """Of triggers and focus, where they are wanted: the SLM's own, or on another port."""
    if not (args.trigger or (args.captures and args.driver != "virtual")):
        return None
    return getattr(driver, "controller", None) or slm.Controller(args.port, args.baud)


def _planes(args, hologram):
    if args.focus_planes:
        return slm.FocusPlanes.load(args.focus_planes)
    if args.driver != "virtual":
        raise engine.InvalidInput(
            "The focus planes are missing: give them with --focus-planes, see `holopath focus --help`."
        )
    return slm.FocusPlanes.spread(hologram.depth_far, hologram.depth_near)


def _captured(args, sequence, driver, controller, trigger, progress, tell):
    """Show the holograms, and meanwhile take a picture at each focus plane."""
    hologram = sequence.holograms[0].hologram
    planes, folder = _planes(args, hologram), Path(args.captures)
    names = [f"plane_{n}_{p.distance * 1e3:.4g}mm" for n, p in enumerate(planes.planes)]
    told = stage(progress, 0.1, 0.99)
    if args.driver == "virtual":
        counts = slm.stream(sequence, driver, args.rate, args.loops or 1, None, trigger)
        pictures = {}

        def take(number):
            pictures[names[number]] = engine.to_rgb(driver.capture(), hologram.wavelengths)

        slm.sweep(planes, lambda number: driver.focus_at(planes.planes[number].distance), take, told)
        white = output.exposure(list(pictures.values()))
        files = {}
        for name, rgb in pictures.items():
            files |= {f"{name}.exr": output.encode_exr(rgb), f"{name}.png": output.encode_png(rgb, white)}
        output.write_pictures(folder, files)
        return counts
    if not args.camera:
        raise engine.InvalidInput(
            "The camera is missing: give the command that takes a picture with --camera."
        )
    for number in range(len(planes.planes)):
        planes.position(number)
    stop, shown = threading.Event(), threading.Event()

    def watch(counts):
        tell.heed(counts)
        if counts.shown >= len(sequence):
            shown.set()
        if stop.is_set():
            raise engine.Cancelled

    def look(number):
        """A picture of what is shown; another one if the device was lost meanwhile."""
        file, found = part / f"{names[number]}.png", None
        while found is None:
            while tell.counts.lost and not streaming.done():
                time.sleep(0.1)
            if streaming.done():
                streaming.result()
            before = tell.counts.reconnected
            slm.run_camera(args.camera, file, number, planes.planes[number].distance)
            if not tell.counts.lost and tell.counts.reconnected == before:
                found = file.read_bytes()
        pictures[file.name] = found

    pictures = {}
    with ThreadPoolExecutor(1) as workers, tempfile.TemporaryDirectory() as temporary:
        part = Path(temporary)
        streaming = workers.submit(
            slm.stream, sequence, driver, args.rate, None, watch, trigger, args.patience
        )
        try:
            while not shown.wait(0.1) and not streaming.done():
                progress(0.05, "Showing the hologram")
            if streaming.done():
                streaming.result()
            slm.sweep(planes, lambda number: controller.focus(planes.position(number)), look, told)
        finally:
            stop.set()
    with suppress(engine.Cancelled):
        streaming.result()
    output.write_pictures(folder, pictures)
    return tell.counts


def _focus(args):
    progress = Progress(quiet=args.quiet)
    file = Path(args.focus_planes) if args.focus_planes else None
    planes, target = None, args.position
    if target is None:
        if file is None:
            raise engine.InvalidInput("The focus planes are missing: give their file with --focus-planes.")
        new = args.store is not None and not file.exists()
        planes = slm.FocusPlanes.spread() if new else slm.FocusPlanes.load(file)
    controller = slm.Controller(args.port, args.baud)
    if planes is not None:
        if args.plane is not None:
            target = planes.position(args.plane)
        elif args.distance is not None:
            target = planes.position_at(args.distance * 1e-3)
        else:
            planes.with_position(args.store, 0)  # there is such a plane
    controller.open()
    try:
        if planes is not None and target is None:
            position = controller.position()
            planes.with_position(args.store, position).save(args.focus_planes)
            distance = planes.planes[args.store].distance * 1e3
            progress(1.0, f"Done: plane {args.store} ({distance:g} mm) is position {position}, in {file}")
            return
        controller.focus(target, lambda position: progress(0.5, f"Moving to {target}: {position}"))
        progress(1.0, f"Done: position {target}")
    finally:
        controller.close()


def _check_writable(path):
    """Refuse a file that cannot be made, before there is something to lose."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise engine.InvalidInput(
            f"{path} cannot be made ({error.strerror}): choose another place."
        ) from error


def _calibrate(args):
    progress, path = Progress(quiet=args.quiet), Path(args.out)
    if path.suffix.lower() != ".json":
        raise engine.InvalidInput(f"A calibration is a .json file: {path} is none.")
    before = slm.Calibration.load(path) if path.exists() else None
    if before is not None and not before.plain:
        raise engine.InvalidInput(
            f"{path} turns, moves, corrects or varies what the device shows, which a fit would not know: name another "
            "file."
        )
    if before is not None and before.responses and before.bits != args.bits:
        raise engine.InvalidInput(
            f"{path} is of {before.bits} bits, not of {args.bits}: give --bits {before.bits}, or name another file."
        )
    if not 16 <= args.window <= 512:
        raise engine.InvalidInput(f"A window of {args.window} pixels cannot be fitted: choose 16 to 512.")
    if not 1 <= args.bits <= 16:
        raise engine.InvalidInput(f"An SLM has 1 to 16 bits, not {args.bits}.")
    window = slm.PatternWindow(args.window, args.pitch, args.wavelength * 1e-9, args.bits)
    planes = slm.FocusPlanes.load(args.focus_planes) if args.focus_planes else None
    distances = [mm * 1e-3 for mm in args.distances or ()]
    if planes is not None and not distances:
        distances = [plane.distance for plane in planes.planes]
    if not distances:
        raise engine.InvalidInput("The foci are missing: give them with --distances or --focus-planes.")
    _check_writable(path)
    told = partial(slm.calibrate, window=window, distances=distances, view=args.view, count=args.captures,
                   seed=args.seed, progress=progress)  # fmt: skip
    with _looking(args, window, planes, distances) as look:
        found = told(look)
    slm.calibration_of(found, window, earlier=before).save(path)
    if not args.quiet:
        for row, value, deviation in zip(found.parameters, found.values, found.deviations, strict=True):
            print(f"{row.name:<28} {value:12.5g} +- {deviation:<10.2g} {row.unit}")
    progress(1.0, f"Done: {found.explained:.1%} of what the camera saw is explained: {path}")


def _tune(args):
    progress, folder = Progress(quiet=args.quiet), Path(args.folder)
    calibration = slm.Calibration.load(args.calibration)
    field, phase = output.stored_field(folder), output.stored_hologram(folder)
    hologram = phase.hologram
    wavelengths = hologram.wavelengths
    if args.wavelength is None and len(wavelengths) > 1:
        raise engine.InvalidInput(
            "The hologram has several wavelengths: name that of the light with --wavelength."
        )
    wavelength = wavelengths[0] if args.wavelength is None else args.wavelength * 1e-9
    planes = slm.FocusPlanes.load(args.focus_planes) if args.focus_planes else None
    distances = list(calibration.sensor(wavelength).homographies)
    width, height = calibration.size or (hologram.width, hologram.height)
    if args.driver == "virtual" and width != height:
        raise engine.InvalidInput(f"The virtual bench is as high as wide, the hologram {width} x {height}.")
    window = slm.PatternWindow(min(width, height), hologram.pitch, wavelength, calibration.bits)
    phase = replace(phase, data=np.array(phase.data))  # Windows replaces no file that is mapped
    try:
        with _looking(args, window, planes, distances, size=(width, height)) as look:
            what = field, look, calibration, wavelength, args.rounds, stage(progress, 0.0, 0.98)
            tuned = pipeline.phases_by_card(
                lambda data: slm.tune(replace(phase, data=data), *what), phase.data
            )
    except Exception as error:
        kept = getattr(error, "kept", None)
        if kept is None:
            raise
        kept.save(folder / "hologram")
        told = f"the best phases until then are in {folder / 'hologram'}."
        if failures.cancelled(error):
            raise engine.Cancelled(f"Cancelled: {told}") from error
        progress.say(f"It ended early: {told}")
        raise
    tuned.save(folder / "hologram")
    if libraries.RAN_OUT in tuned.report.get("advice", ""):
        progress.say(f"note: {libraries.RAN_OUT}")
    decibels = tuned.report["tuned"][-1]["psnr_db"]
    progress(
        1.0, f"Done: the camera saw {decibels[0]:.1f} dB, now {max(decibels):.1f}: {folder / 'hologram'}"
    )


@contextmanager
def _looking(args, window, planes, distances, size=None):
    """``look(levels, distance)`` of `slm.calibrate`, of a window's levels or of so many, width and height."""
    slm.packing_of(args.packing).require(window.bits)
    if args.driver == "virtual":
        camera = round(1.4 * window.side)
        start = slm.nominal_setup(window, distances, (camera, camera), args.view)
        yield slm.perturbed_bench(start, window, args.seed)[0].capture_values
        return
    if not args.camera:
        raise engine.InvalidInput(
            "The camera is missing: give the command that takes a picture with --camera."
        )
    if len(distances) > 1 and planes is None:
        raise engine.InvalidInput(
            "The focus planes are missing: give them with --focus-planes, see `holopath focus --help`."
        )
    size = size or (window.side, window.side)
    driver = _device(args, size)
    own = getattr(driver, "controller", None)
    mover = None if planes is None else own or slm.Controller(args.port, args.baud)
    with ExitStack() as opened:
        file = Path(opened.enter_context(tempfile.TemporaryDirectory())) / "capture.png"
        stills = opened.enter_context(slm.Stills(driver, args.packing))
        if mover is not None and mover is not own:
            opened.callback(mover.close)
            mover.open()

        def look(levels, distance):
            stills.show(levels, window.bits)
            if planes is not None and mover is not None:
                mover.focus(planes.position_at(distance))
            time.sleep(args.settle)
            slm.run_camera(args.camera, file, distances.index(distance), distance)
            return slm.read_capture(file)

        yield look


def _devices(args):
    from ..engine.light.unwrapping import LACKING

    print("Mitsuba backends")
    backends = variants.describe()
    _print_rows(backends)
    if any(row["available"] for row in backends if row["name"] == variants.CUDA):
        print(f"  {libraries.described()}")
    if not any(row["available"] for row in backends if row["name"] == variants.LLVM):
        print(f"  pip brings an LLVM:  {llvm_package.command()}")
    print("Baked light")
    lays_out = "lays meshes out, with few seams"
    _print_rows([{"name": "xatlas", "available": not LACKING, "detail": LACKING or lays_out}])
    print("SLM drivers")
    _print_rows(slm.describe())
    print("Monitors")
    try:
        there = slm.monitors()
    except engine.InvalidInput as error:
        if args.identify is not None:
            raise
        there, lines = [], [str(error)]
    else:
        lines = [f"{number}  {monitor}" for number, monitor in enumerate(there, 1)]
    print(*(f"  {line}" for line in lines), sep="\n", flush=True)
    if args.identify is not None:
        if not 0 < args.identify <= 3600:
            raise engine.InvalidInput(
                f"Numbers are shown for a time of up to an hour, not for {args.identify:g} s."
            )
        slm.identify(there, args.identify)
    print("Serial ports")
    print(*(f"  {name:<14} {text}" for name, text in slm.serial_ports() or [("none", "")]), sep="\n")


def _print_rows(rows):
    for row in rows:
        print(f"  {row['name']:<14} {'available' if row['available'] else 'missing':<10} {row['detail']}")
