"""Commands for the SLM: stream, focus, calibrate, tune, devices."""

import math
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
from ..engine.settings.former_names import current_name
from ..engine.waves import libraries
from ..slm.drivers.controller import BAUD
from ..slm.drivers.files import KINDS
from ..slm.drivers.slmsuite_device import options_of
from ..slm.sequence import check_responses
from ..workflow import failures, output, pipeline
from .console import Progress
from .options import add_old_name, argument, listed, numbers, pitch, say

MAX_WAIT = 30.0  # seconds for a lost device
PULSE = 100  # microseconds
MAX_LIGHT = 255  # index of a light source in the serial protocol


def add(command):
    """Add the commands.

    Parameters
    ----------
    command : callable
        See `render_command.add`.
    """
    stream = command("stream", _stream, "Show phase holograms on an SLM.")
    option = stream.add_argument
    option(
        "folder",
        metavar="DIR",
        help="output folder of `holopath render`, also of an animation, or of `encode`",
    )
    option(
        "--driver",
        choices=tuple(slm.DRIVERS),
        default="display",
        help="driver of the device, see `holopath devices` (default display)",
    )
    option(
        "--rate", type=float, metavar="HZ", help="pictures per second (default: the best rate of the device)"
    )
    option(
        "--loops",
        type=int,
        metavar="N",
        help="number of rounds; 0: until Ctrl-C (default: 0 on a device, else 1)",
    )
    option(
        "--repeats",
        type=int,
        default=1,
        metavar="N",
        help="number of times that each frame of an animation is shown (default 1)",
    )
    _add_packing(
        option,
        listed(slm.PACKINGS, "{}")
        + "; or the bits of the channels that make a level on your panel, from its highest on, such as R7-5,G7-5,B7-4",
    )
    option(
        "--order", default="RGB", metavar="RGB", help="order in which packed channels are shown (default RGB)"
    )
    option("--calibration", metavar="FILE", help="calibration of the device, see docs/slm.md")
    option(
        "--falling",
        action="store_true",
        help="the phase falls as the level rises (part of a calibration)",
    )
    option(
        "--bits",
        type=int,
        metavar="N",
        help="bits of a level, instead of the calibration's (default: the device's)",
    )
    option(
        "--patience",
        type=float,
        default=MAX_WAIT,
        metavar="S",
        help="maximum wait for a lost device, seconds (default %(default)g)",
    )
    _add_device(stream)
    group = stream.add_argument_group("pulses").add_argument
    group("--trigger", action="store_true", help="send a pulse by the controller for each picture")
    group("--pulse", type=int, metavar="US", help=f"length of the pulse in microseconds (default {PULSE})")
    group = stream.add_argument_group("driver files").add_argument
    group("--out", metavar="DIR", help="output folder (default DIR/pictures)")
    group(
        "--kind",
        choices=KINDS,
        help="one file per picture (png, default), one file of all (raw), a lossless video (video), or one for each "
        "color (video-per-color); videos need --rate and the program ffmpeg",
    )
    group = stream.add_argument_group("captures by a camera").add_argument
    group(
        "--captures",
        metavar="DIR",
        help="output folder of captures at each focus plane while the hologram is shown",
    )
    group(
        "--focus-planes",
        metavar="FILE",
        help="file of focus planes (default with the virtual bench: five over the volume)",
    )
    add_old_name(stream, "--planes", "--focus-planes")
    group(
        "--camera",
        metavar="COMMAND",
        help="command that takes a picture; {file}, {plane} and {mm} are replaced by its file, the plane's number and "
        "its distance",
    )

    focus = command("focus", _focus, "Move the camera's focus by a controller on a serial port.")
    option = focus.add_argument
    option("--port", metavar="PORT", help="serial port of the controller (default: the only one)")
    option("--baud", type=int, default=BAUD, help="baud rate (default %(default)s)")
    option("--focus-planes", metavar="FILE", help="file of focus planes, for --plane, --distance and --store")
    add_old_name(focus, "--planes", "--focus-planes")
    what = focus.add_mutually_exclusive_group(required=True)
    what.add_argument("--plane", type=int, metavar="N", help="move to this plane, from 0")
    what.add_argument("--distance", type=float, metavar="MM", help="move between calibrated planes")
    what.add_argument("--position", type=int, metavar="STEPS", help="move the motor there")
    what.add_argument(
        "--store",
        type=int,
        metavar="N",
        help="store the motor's position as that of this plane; creates a missing FILE of five planes from 80 to 85 mm",
    )

    calibrate = command(
        "calibrate",
        _calibrate,
        "Calibrate a display and its camera by captures of known patterns.",
    )
    option = calibrate.add_argument
    option(
        "--out", required=True, metavar="FILE", help="calibration to write (.json), or to add a wavelength to"
    )
    option(
        "--wavelength",
        required=True,
        type=float,
        metavar="NM",
        help="wavelength of the light source, nanometers",
    )
    option(
        "--pitch",
        required=True,
        type=argument(pitch),
        metavar="UM[,UM]",
        help="pixel pitch of the SLM, micrometers; X,Y if pixels are not square",
    )
    _add_bench(calibrate)
    option(
        "--window",
        type=int,
        default=64,
        metavar="N",
        help="side of the patterns' window in the SLM's middle, pixels (default 64)",
    )
    option("--bits", type=int, default=8, metavar="N", help="bits of a level (default 8)")
    option(
        "--distances",
        type=numbers(0, "a list of distances", "millimeters"),
        metavar="MM,MM[,..]",
        help="focus distances from the SLM (default: those of --focus-planes)",
    )
    option("--captures", type=int, default=64, metavar="N", help="number of captures (default 64)")
    _add_light(calibrate, "0")
    _add_device(calibrate)

    tune = command("tune", _tune, "Improve phases by captures of them on a calibrated display.")
    option = tune.add_argument
    option("folder", metavar="DIR", help="output folder whose field was encoded with this calibration")
    option("--calibration", required=True, metavar="FILE", help="calibration by `holopath calibrate`")
    option(
        "--wavelength",
        type=float,
        metavar="NM",
        help="wavelength of the light source, nanometers (default: the hologram's only one)",
    )
    option(
        "--rounds",
        type=int,
        default=12,
        metavar="N",
        help="number of rounds, each with a capture of each frame at each focus (default 12)",
    )
    _add_bench(tune)
    _add_light(tune, "that of the wavelength within the hologram")
    _add_device(tune)

    devices = command("devices", _devices, "List SLM drivers, monitors, serial ports and Mitsuba backends.")
    devices.add_argument(
        "--identify",
        nargs="?",
        type=float,
        const=5.0,
        metavar="SECONDS",
        help="show on each monitor its number in the list for that time (default 5)",
    )


def _packing(text):
    """Check a packing's name, or bits of channels; return the current name."""
    name = current_name("packing", text, say)
    slm.packing_of(name)
    return name


def _add_packing(option, meaning):
    option(
        "--packing",
        type=argument(_packing),
        default="time",
        metavar="NAME|BITS",
        help=f"{meaning} (default time)",
    )


def _add_bench(parser):
    """Add the options of a driver and its camera."""
    option = parser.add_argument
    _add_packing(option, "packing of the device, see `holopath stream`")
    option(
        "--driver",
        choices=tuple(name for name in slm.DRIVERS if name != "files"),
        default="display",
        help="driver of the device (default display); virtual is a simulated bench with errors in everything",
    )
    option("--focus-planes", metavar="FILE", help="file of focus planes with positions of the camera's motor")
    option(
        "--view",
        type=numbers(2, "two numbers", "half sides of the window"),
        default=[0.95, 0.95],
        metavar="X,Y",
        help="half of the camera's shorter side, in half sides of the window; negative: mirrored (default 0.95,0.95)",
    )
    option("--camera", metavar="COMMAND", help="command that takes a picture, see `holopath stream`")
    option(
        "--settle",
        type=float,
        default=0.5,
        metavar="S",
        help="delay of the camera after a picture is shown, seconds (default 0.5)",
    )
    option(
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="seed of the patterns, and of the virtual bench (default 0)",
    )


def _add_light(parser, default):
    """Add the option of the light source."""
    parser.add_argument(
        "--light",
        type=int,
        metavar="N",
        help=f"index of the light source that the driver serial switches on, from 0 (default {default})",
    )


def _light(args, default):
    """Index of the light source to switch on."""
    if args.light is None:
        return default
    if not 0 <= args.light <= MAX_LIGHT:
        raise engine.InvalidInput(
            f"Expected a light source from 0 to {MAX_LIGHT}, got {args.light}. Choose another --light."
        )
    if args.driver != "serial":
        raise engine.InvalidInput("--light would have no effect here. Add --driver serial, or omit it.")
    return args.light


def _add_device(parser):
    """Add the options of a monitor, a serial port or an SLM of slmsuite."""
    group = parser.add_argument_group("driver display").add_argument
    group("--monitor", metavar="NAME", help="name or geometry (1920x1080+1920+0) of the SLM's monitor")
    group("--primary", action="store_true", help="allow the monitor where you work")
    group = parser.add_argument_group("driver serial, pulses and focus").add_argument
    group("--port", metavar="PORT", help="serial port of the controller")
    group("--baud", type=int, default=BAUD, help="baud rate (default %(default)s)")
    group = parser.add_argument_group("driver slmsuite").add_argument
    group("--device", default="simulated", metavar="NAME", help="SLM of slmsuite (default simulated)")
    group(
        "--options",
        default="{}",
        metavar="JSON",
        help="options of its class, for example '{\"resolution\": [512, 512]}'",
    )


def _stream(args):
    progress = Progress(quiet=args.quiet)
    if args.rate is not None and not 0 < args.rate < 1e5:
        raise engine.InvalidInput(
            f"Expected a positive rate below 100000 pictures per second, got {args.rate:g}. Give another --rate."
        )
    if args.loops is not None and args.loops < 0:
        raise engine.InvalidInput(f"Expected 0 or more rounds, got {args.loops}. Give --loops 0 for no end.")
    pulse = PULSE if args.pulse is None else args.pulse
    if not 0 < pulse < 2**32:
        raise engine.InvalidInput(
            f"Expected a pulse of 1 to {2**32 - 1} microseconds, got {pulse}. Give another --pulse."
        )
    _refuse_unused(args)
    holograms = output.stored_holograms(args.folder)
    calibration = slm.Calibration.load(args.calibration) if args.calibration else None
    falling = args.falling
    if args.bits is not None:
        if calibration is None:
            calibration, falling = slm.Calibration(falling=falling), False
        calibration = replace(calibration, bits=args.bits)
    check_responses(args.packing, calibration)
    sequence = slm.Sequence(holograms, calibration, args.packing, args.order, args.repeats, falling)
    for note in sequence.notes:
        progress.say(f"note: {note}")
    driver = _driver(args, sequence)
    controller = _controller(args, driver)
    must_end = args.driver in ("files", "virtual") or args.captures
    if args.loops == 0 and must_end:
        raise engine.InvalidInput(
            f"Expected a number of rounds for the driver {args.driver}, got 0 for no end. Give another --loops, or "
            "omit it."
        )
    if args.captures and args.driver == "files":
        raise engine.InvalidInput("A camera cannot see files. Omit --captures, or choose another driver.")
    if not args.patience >= 0:
        raise engine.InvalidInput(f"Expected a --patience of 0 s or more, got {args.patience:g} s.")
    loops = args.loops if args.loops is not None else 1 if must_end else 0
    trigger = None
    if args.trigger and controller is not None:
        trigger = partial(controller.trigger, microseconds=pulse)
    watch = _Watch(progress)
    try:
        if controller is not None and controller is not getattr(driver, "controller", None):
            controller.open()
        if args.captures:
            counts = _capture(args, sequence, driver, controller, trigger, progress, watch)
        else:
            counts = slm.stream(sequence, driver, args.rate, loops or None, watch, trigger, args.patience)
    except (KeyboardInterrupt, engine.Cancelled):
        if loops or args.captures:
            raise engine.Cancelled(f"Canceled: {watch.counts}.") from None
        counts = watch.counts
    finally:
        if controller is not None:
            controller.close()
    progress(1.0, f"Done: {counts}; {driver.info.name}{', ' * bool(driver.info.note)}{driver.info.note}")


def _refuse_unused(args):
    """Refuse options that would have no effect."""
    on_device = args.driver not in ("files", "virtual")
    for flag, is_given, has_effect, remedy in (
        ("--out", args.out is not None, args.driver == "files", "Add --driver files"),
        ("--kind", args.kind is not None, args.driver == "files", "Add --driver files"),
        ("--trigger", args.trigger, args.driver != "files", "Choose another driver"),
        ("--pulse", args.pulse is not None, args.trigger, "Add --trigger"),
        ("--camera", args.camera is not None, args.captures and on_device, "Add --captures DIR on a device"),
        ("--focus-planes", args.focus_planes is not None, args.captures, "Add --captures DIR"),
        ("--order", args.order != "RGB", args.packing != "time", "Add --packing color"),
        ("--loops", args.loops is not None, not (args.captures and on_device), "Omit --captures"),
    ):
        if is_given and not has_effect:
            raise engine.InvalidInput(f"{flag} would have no effect here. {remedy}, or omit it.")


class _Watch:
    """Reports counts as progress, and the loss of the device in remarks."""

    def __init__(self, progress):
        self.counts, self._progress, self._lost = slm.Counts(), progress, ""

    def __call__(self, counts):
        self.update(counts)
        done = (counts.shown + counts.dropped) / counts.total if counts.total else 0.0
        self._progress(min(done, 0.999), str(counts))

    def update(self, counts):
        """Keep the counts, and report only the loss of the device."""
        self.counts = counts
        if counts.lost and counts.lost != self._lost:
            self._progress.say(f"{counts.lost} Waiting for it.")
        if self._lost and not counts.lost:
            self._progress.say("The device is connected again. Streaming continues.")
        self._lost = counts.lost


def _driver(args, sequence):
    if args.driver == "files":
        return slm.FilesDriver(args.out or Path(args.folder) / "pictures", args.kind or KINDS[0], sequence)
    if args.driver == "virtual":
        # An SLM without errors relative to its calibration.
        return slm.VirtualDriver(
            sequence.holograms[0], sequence.calibration, packing=args.packing, order=args.order
        )
    return _device(args, sequence.size)


def _device(args, size):
    """Driver of a real device, for pictures of that width and height."""
    if args.driver == "display":
        return slm.DisplayDriver(args.monitor, args.primary, size)
    if args.driver == "serial":
        return slm.SerialDriver(args.port, args.baud)
    return slm.SlmsuiteDriver(args.device, options_of(args.options, args.device, size))


def _controller(args, driver):
    """Controller of triggers and focus, the SLM's own or on another port; None if it is not needed."""
    if not (args.trigger or (args.captures and args.driver != "virtual")):
        return None
    return getattr(driver, "controller", None) or slm.Controller(args.port, args.baud)


def _planes(args, hologram):
    if args.focus_planes:
        return slm.FocusPlanes.load(args.focus_planes)
    if args.driver != "virtual":
        raise engine.InvalidInput(
            "The focus planes are missing. Give them with --focus-planes, see `holopath focus --help`."
        )
    return slm.FocusPlanes.spread(hologram.depth_far, hologram.depth_near)


def _capture(args, sequence, driver, controller, trigger, progress, watch):
    """Show the holograms, and capture them at each focus plane; the counts."""
    hologram = sequence.holograms[0].hologram
    planes, sweep_progress = _planes(args, hologram), stage(progress, 0.1, 0.99)
    if args.driver == "virtual":
        if len(sequence.holograms) > 1:
            raise engine.InvalidInput(
                f"Expected one hologram for captures of the virtual bench, got {len(sequence.holograms)}. Give the "
                "folder of one frame."
            )
        counts = slm.stream(sequence, driver, args.rate, args.loops or 1, None, trigger)
        files = _virtual_captures(driver, planes, hologram.wavelengths, sweep_progress)
        output.write_pictures(Path(args.captures), files)
        return counts
    if not args.camera:
        raise engine.InvalidInput(
            "The camera is missing. Give the command that takes a picture with --camera."
        )
    positions = [planes.position(number) for number in range(len(planes.planes))]
    camera = _Camera(args.camera, planes, watch, len(sequence))
    files = camera.captures(
        lambda on_counts: slm.stream(sequence, driver, args.rate, None, on_counts, trigger, args.patience),
        lambda number: controller.focus(positions[number]),
        lambda: progress(0.05, "Showing the hologram"),
        sweep_progress,
    )
    output.write_pictures(Path(args.captures), files)
    return watch.counts


def _plane_names(planes):
    """Name of the files of each focus plane, without an ending."""
    return [f"plane_{n}_{plane.distance * 1e3:.4g}mm" for n, plane in enumerate(planes.planes)]


def _virtual_captures(driver, planes, wavelengths, progress):
    """Files of the virtual bench's captures at each focus plane, by name, all at one exposure."""
    pictures = []
    slm.sweep(
        planes,
        lambda number: driver.focus_at(planes.planes[number].distance),
        lambda number: pictures.append(engine.to_rgb(driver.capture(), wavelengths)),
        progress,
    )
    white, files = output.exposure(pictures), {}
    for name, rgb in zip(_plane_names(planes), pictures, strict=True):
        files |= {f"{name}.exr": output.encode_exr(rgb), f"{name}.png": output.encode_png(rgb, white)}
    return files


class _Camera:
    """A camera that captures each focus plane while another thread streams the hologram.

    Parameters
    ----------
    command : str
        Command that takes a picture, see `slm.run_camera`.
    planes : slm.FocusPlanes
    watch : _Watch
        Receives the counts of the stream.
    round_length : int
        Pictures of a round. Captures begin when that many were shown.
    """

    def __init__(self, command, planes, watch, round_length):
        self._command, self._planes, self._watch, self._round_length = command, planes, watch, round_length
        self._first_round, self._stop = threading.Event(), threading.Event()

    def captures(self, stream, move, on_wait, progress):
        """Files of the captures, by name.

        Parameters
        ----------
        stream : callable
            ``stream(on_counts)`` shows the hologram until `on_counts` raises.
        move : callable
            See `slm.sweep`.
        on_wait : callable
            Called several times a second until the first round was shown; may raise.
        progress : callable
            See `slm.sweep`.
        """
        files, names = {}, _plane_names(self._planes)

        def take(number):
            name = f"{names[number]}.png"
            files[name] = self._picture(streaming, Path(folder) / name, number)

        with ThreadPoolExecutor(1) as workers, tempfile.TemporaryDirectory() as folder:
            streaming = workers.submit(stream, self._on_counts)
            try:
                while not self._first_round.wait(0.1) and not streaming.done():
                    on_wait()
                if streaming.done():
                    streaming.result()
                slm.sweep(self._planes, move, take, progress)
            finally:
                self._stop.set()
        with suppress(engine.Cancelled):
            streaming.result()
        return files

    def _on_counts(self, counts):
        self._watch.update(counts)
        if counts.shown >= self._round_length:
            self._first_round.set()
        if self._stop.is_set():
            raise engine.Cancelled

    def _picture(self, streaming, file, number):
        """Content of the file of a capture, which is taken again if the device was lost meanwhile."""
        watch, distance = self._watch, self._planes.planes[number].distance
        while True:
            while watch.counts.lost and not streaming.done():
                time.sleep(0.1)
            if streaming.done():
                streaming.result()
            reconnected = watch.counts.reconnected
            slm.run_camera(self._command, file, number, distance)
            if not watch.counts.lost and watch.counts.reconnected == reconnected:
                return file.read_bytes()


def _focus(args):
    progress = Progress(quiet=args.quiet)
    file = Path(args.focus_planes) if args.focus_planes else None
    planes, target = None, args.position
    if target is None:
        if file is None:
            raise engine.InvalidInput("The focus planes are missing. Give their file with --focus-planes.")
        is_new = args.store is not None and not file.exists()
        planes = slm.FocusPlanes.spread() if is_new else slm.FocusPlanes.load(file)
    controller = slm.Controller(args.port, args.baud)
    if planes is not None:
        if args.plane is not None:
            target = planes.position(args.plane)
        elif args.distance is not None:
            target = planes.position_at(args.distance * 1e-3)
        else:
            planes.with_position(args.store, 0)  # raises if there is no such plane
    controller.open()
    try:
        if planes is not None and target is None:
            position = controller.resting_position()
            planes.with_position(args.store, position).save(args.focus_planes)
            distance = planes.planes[args.store].distance * 1e3
            progress(1.0, f"Done: plane {args.store} ({distance:g} mm) is position {position}, in {file}")
            return
        controller.focus(target, lambda position: progress(0.5, f"Moving to {target}: {position}"))
        progress(1.0, f"Done: position {target}")
    finally:
        controller.close()


def _check_writable(path):
    """Check that a file can be created, before the long work."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise engine.InvalidInput(
            f"{path} cannot be created ({error.strerror}). Choose another folder."
        ) from error


def _calibrate(args):
    progress, path = Progress(quiet=args.quiet), Path(args.out)
    if path.suffix.lower() != ".json":
        raise engine.InvalidInput(
            f"Expected a .json file for the calibration, got {path}. Give another name."
        )
    earlier = slm.Calibration.load(path) if path.exists() else None
    if earlier is not None and not earlier.plain:
        raise engine.InvalidInput(
            f"{path} rotates, shifts, corrects or varies the device's pictures, which the fit does not model. Name "
            "another file."
        )
    if earlier is not None and earlier.responses and earlier.bits != args.bits:
        raise engine.InvalidInput(
            f"Expected {earlier.bits} bits as in {path}, got {args.bits}. Give --bits {earlier.bits}, or another file."
        )
    if not 16 <= args.window <= 512:
        raise engine.InvalidInput(
            f"Expected a window of 16 to 512 pixels, got {args.window}. Choose another --window."
        )
    if not 1 <= args.bits <= 16:
        raise engine.InvalidInput(f"Expected 1 to 16 bits, got {args.bits}. Choose other --bits.")
    light = _light(args, 0)
    window = slm.PatternWindow(args.window, args.pitch, args.wavelength * 1e-9, args.bits)
    planes = slm.FocusPlanes.load(args.focus_planes) if args.focus_planes else None
    distances = [mm * 1e-3 for mm in args.distances or ()]
    if planes is not None and not distances:
        distances = [plane.distance for plane in planes.planes]
    if not distances:
        raise engine.InvalidInput(
            "The focus distances are missing. Give them with --distances or --focus-planes."
        )
    _check_writable(path)
    with _bench(args, window, planes, distances, light=light) as capture:
        fit = slm.calibrate(
            capture,
            window=window,
            distances=distances,
            view=args.view,
            count=args.captures,
            seed=args.seed,
            progress=progress,
        )
    slm.calibration_of(fit, window, earlier=earlier).save(path)
    if not args.quiet:
        for row, value, deviation in zip(fit.parameters, fit.values, fit.deviations, strict=True):
            print(f"{row.name:<28} {value:12.5g} +- {deviation:<10.2g} {row.unit}")
    progress(1.0, f"Done: the fit explains {fit.explained:.1%} of the captures: {path}")


def _tune(args):
    progress, folder = Progress(quiet=args.quiet), Path(args.folder)
    calibration = slm.Calibration.load(args.calibration)
    field, phase = output.stored_field(folder), output.stored_hologram(folder)
    hologram = phase.hologram
    wavelengths = hologram.wavelengths
    if args.wavelength is None and len(wavelengths) > 1:
        raise engine.InvalidInput(
            "The hologram has several wavelengths. Choose that of the light source with --wavelength."
        )
    wavelength = wavelengths[0] if args.wavelength is None else args.wavelength * 1e-9
    light = _light(args, int(np.argmin(np.abs(np.subtract(wavelengths, wavelength)))))
    planes = slm.FocusPlanes.load(args.focus_planes) if args.focus_planes else None
    distances = list(calibration.sensor(wavelength).homographies)
    width, height = calibration.size or (hologram.width, hologram.height)
    if args.driver == "virtual" and width != height:
        raise engine.InvalidInput(
            f"Expected a square hologram for the virtual bench, got {width} x {height}. Render one."
        )
    window = slm.PatternWindow(min(width, height), hologram.pitch, wavelength, calibration.bits)
    phase = replace(phase, data=np.array(phase.data))  # Windows does not replace mapped files
    try:
        with _bench(args, window, planes, distances, (width, height), light) as capture:
            tuned = pipeline.phases_by_card(
                lambda data: slm.tune(
                    replace(phase, data=data),
                    field,
                    capture,
                    calibration,
                    wavelength,
                    args.rounds,
                    stage(progress, 0.0, 0.98),
                ),
                phase.data,
            )
    except Exception as error:
        kept = getattr(error, "kept", None)
        if kept is None:
            raise
        kept.save(folder / "hologram")
        place = f"the best phases so far are in {folder / 'hologram'}."
        if failures.cancelled(error):
            raise engine.Cancelled(f"Canceled: {place}") from error
        progress.say(f"Tuning ended early: {place}")
        raise
    tuned.save(folder / "hologram")
    if libraries.RAN_OUT in tuned.report.get("advice", ""):
        progress.say(f"note: {libraries.RAN_OUT}")
    decibels = tuned.report["tuned"][-1]["psnr_db"]
    progress(
        1.0,
        f"Done: PSNR of captures {decibels[0]:.1f} dB before, {max(decibels):.1f} dB now: {folder / 'hologram'}",
    )


@contextmanager
def _bench(args, window, planes, distances, size=None, light=0):
    """Function ``capture(levels, distance)`` of `slm.calibrate`, for levels of the window or of that size."""
    if not 0 <= args.settle < math.inf:
        raise engine.InvalidInput(f"Expected a --settle of 0 s or more, got {args.settle:g} s.")
    slm.packing_of(args.packing).require(window.bits)
    if args.driver == "virtual":
        camera = round(1.4 * window.side)
        start = slm.nominal_setup(window, distances, (camera, camera), args.view)
        yield slm.perturbed_bench(start, window, args.seed)[0].capture_values
        return
    if not args.camera:
        raise engine.InvalidInput(
            "The camera is missing. Give the command that takes a picture with --camera."
        )
    if len(distances) > 1 and planes is None:
        raise engine.InvalidInput(
            "The focus planes are missing. Give them with --focus-planes, see `holopath focus --help`."
        )
    size = size or (window.side, window.side)
    driver = _device(args, size)
    own = getattr(driver, "controller", None)
    mover = None if planes is None else own or slm.Controller(args.port, args.baud)
    with ExitStack() as stack:
        file = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "capture.png"
        stills = stack.enter_context(slm.Stills(driver, args.packing, light))
        if mover is not None and mover is not own:
            stack.callback(mover.close)
            mover.open()

        def capture(levels, distance):
            stills.show(levels, window.bits)
            if planes is not None and mover is not None:
                mover.focus(planes.position_at(distance))
            time.sleep(args.settle)
            slm.run_camera(args.camera, file, distances.index(distance), distance)
            return slm.read_capture(file)

        yield capture


def _devices(args):
    from ..engine.light.unwrapping import LACKING

    print("Mitsuba backends")
    backends = variants.describe()
    _print_rows(backends)
    if any(row["available"] for row in backends if row["name"] == variants.CUDA):
        print(f"  {libraries.describe()}")
    if not any(row["available"] for row in backends if row["name"] == variants.LLVM):
        print(f"  pip brings an LLVM:  {llvm_package.command()}")
    print("Baked light")
    detail = LACKING or "unwraps meshes with few seams"
    _print_rows([{"name": "xatlas", "available": not LACKING, "detail": detail}])
    print("SLM drivers")
    _print_rows(slm.describe())
    print("Monitors")
    try:
        monitors = slm.monitors()
    except engine.InvalidInput as error:
        if args.identify is not None:
            raise
        monitors, lines = [], [str(error)]
    else:
        lines = [f"{number}  {monitor}" for number, monitor in enumerate(monitors, 1)]
    print(*(f"  {line}" for line in lines), sep="\n", flush=True)
    if args.identify is not None:
        if not 0 < args.identify <= 3600:
            raise engine.InvalidInput(
                f"Expected a time of up to an hour, got {args.identify:g} s. Give another --identify."
            )
        slm.identify(monitors, args.identify)
    print("Serial ports")
    print(*(f"  {name:<14} {text}" for name, text in slm.serial_ports() or [("none", "")]), sep="\n")


def _print_rows(rows):
    for row in rows:
        print(f"  {row['name']:<14} {'available' if row['available'] else 'missing':<10} {row['detail']}")
