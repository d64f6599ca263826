"""Commands `holopath export` and `holopath import`: fields and phases in files of other programs."""

import math
from dataclasses import replace
from pathlib import Path

from .. import engine, exchange
from ..engine.pixels import in_words
from ..engine.settings.former_names import current_name
from ..exchange import prints
from ..exchange.conventions import ROWS, SIGNS
from ..exchange.holograms import PACKINGS, TRANSFERS, check_packing
from ..exchange.optics import parse_carrier
from ..exchange.parts import FIELD, ROLES
from ..exchange.phases import CHOICES
from ..workflow import output
from .console import Progress
from .options import add_optics, argument, numbers, optics_changes, pitch, say, with_colors

_KINDS = ", ".join(exchange.SUFFIXES)
PRINT_OPTIONS = ("dpi", "bits", "carrier", "frame", "wavelength")  # of prints only
MAX_WAVELENGTH_ERROR = 0.5  # nanometers between --wavelength and the hologram's


def add(command):
    """Add the commands.

    Parameters
    ----------
    command : callable
        See `render_command.add`.
    """
    export = command("export", _export, "Write a stored field or stored phases to a file for other programs.")
    export.add_argument("folder", metavar="DIR", help="output folder of `holopath render`")
    export.add_argument(
        "file",
        metavar="FILE",
        help=f"file to write, with the suffix {_KINDS}; for a print {', '.join(prints.SUFFIXES)}",
    )
    export.add_argument(
        "--hologram", action="store_true", help="export the stored phases instead of the wave field"
    )
    _add_print(export)
    _add_convention(export, "convention of the file (default: holopath; matlab for .mat)")

    take = command(
        "import", _import, "Import a field or phases of another program, to refocus, encode and stream."
    )
    take.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        type=argument(_file),
        help=f"file to read ({', '.join(exchange.READABLE)}); two files of one field as amplitude=FILE phase=FILE, "
        "intensity=FILE phase=FILE, or real=FILE imaginary=FILE",
    )
    take.add_argument("--out", required=True, metavar="DIR", help="output folder, new or empty")
    take.add_argument(
        "--array",
        type=argument(_array),
        metavar="NAME|ROLE=NAME,..",
        help="name of the array, or one for each role, as amplitude=A,phase=P; red, green or blue of a color image "
        "(default: by the arrays' names, if they are unambiguous)",
    )
    _add_convention(take, "convention of the program (default: that in the file, else holopath)")
    add = take.add_argument_group("missing in the file").add_argument
    add(
        "--pitch",
        type=argument(pitch),
        metavar="UM[,UM]",
        help="pixel pitch, micrometers; X,Y if pixels are not square",
    )
    add(
        "--wavelengths",
        type=numbers(0, "a list of wavelengths", "nanometers"),
        metavar="NM[,NM..]",
        help="wavelengths in the array's order",
    )
    add(
        "--at",
        type=float,
        metavar="MM",
        help="distance of the field's plane from the SLM, to which the field is propagated (default 0)",
    )
    add(
        "--units",
        choices=CHOICES,
        help="units of phases (default: those in the file, else levels for integers, and radians for other numbers "
        "that fill a turn)",
    )
    add(
        "--bits",
        type=int,
        metavar="N",
        help="bits of levels, of which 2^N are a turn (default: those of the type, if the levels fill it)",
    )
    add(
        "--transfer",
        choices=TRANSFERS,
        help="transfer function of amplitudes or intensities in integers",
    )
    add(
        "--packing",
        type=argument(_packing),
        metavar="NAME|BITS",
        help=f"packing of phases in a color image: {', '.join(PACKINGS)} as in `holopath stream`, or the bits of the "
        "channels that make a level, from its highest on, such as R7-5,G7-5,B7-4 (default: one hologram of three "
        "wavelengths)",
    )
    add(
        "--depth-range",
        type=numbers(2, "FAR,NEAR", "millimeters"),
        metavar="FAR_MM,NEAR_MM",
        help="distances of infinity and of the near end from the SLM (default: the range of the display)",
    )
    add("--near", type=float, metavar="METERS", help="world depth of the near end (default 1)")
    add(
        "--fov",
        type=float,
        metavar="DEGREES",
        help="horizontal field of view (default: that of an eyepiece of 50 mm)",
    )
    add_optics(take, "the file's")


def _add_print(parser):
    parser.add_argument(
        "--interference",
        action="store_true",
        help="write a gray image of the light's interference with an off-axis reference wave, to print on film as an "
        "amplitude hologram; with --hologram, of the light that the phases show",
    )
    add = parser.add_argument_group("print, with --interference").add_argument
    add(
        "--dpi",
        type=float,
        metavar="N",
        help="dots per inch of the printer, one per pixel of the hologram (default: by its pitch)",
    )
    add(
        "--bits",
        type=int,
        choices=prints.BITS,
        help="bits of the image's gray levels (default 8); 1: black and white",
    )
    add(
        "--carrier",
        type=argument(parse_carrier),
        metavar="X,Y|auto",
        help="center of the image's light in units of the band's edge (default: the field's, or auto if that is on "
        "axis)",
    )
    add("--frame", type=int, metavar="N", help="number of the frame, from 0, if there are several")
    add("--wavelength", type=float, metavar="NM", help="wavelength, if there are several")


def _add_convention(parser, what):
    add = parser.add_argument_group("convention, see docs/files.md").add_argument
    add("--convention", choices=tuple(exchange.CONVENTIONS), help=what)
    add("--axes", type=argument(_axes), metavar="A,B,..", help="order of the axes frame, wavelength, y, x")
    add("--time", choices=tuple(SIGNS), help="sign of i omega t: - (default) or +")
    add("--row-0", choices=ROWS, help="position of row 0 (default top)")


def _packing(text):
    """Check a packing's name, or bits of channels; return the current name."""
    return check_packing(current_name("packing", text, say))


def _axes(text):
    axes = tuple(text.replace(" ", "").split(","))
    exchange.Convention(axes)
    return axes


def _file(text):
    """Role, or None, and file of a word."""
    role, equals, path = text.partition("=")
    return (role, path) if equals and role in (FIELD, *ROLES) else (None, text)


def _array(text):
    """Name of an array, or names by role."""
    pairs = [_file(part) for part in text.split(",")]
    if not all(role for role, _ in pairs):
        return text
    if len({role for role, _ in pairs}) < len(pairs):
        raise engine.InvalidInput(f"Expected each role once, got '{text}'")
    return dict(pairs)


def _container(files, array):
    """Contents of one file, or of a file for each role, and the names of their arrays."""
    roles = [role for role, _ in files]
    if len(files) == 1 and roles[0] is None:
        return exchange.read(files[0][1]), array
    if None in roles or len(set(roles)) < len(roles):
        raise engine.InvalidInput(
            "Expected a role for each file of a field. Write amplitude=FILE phase=FILE, intensity=FILE phase=FILE, or "
            "real=FILE imaginary=FILE."
        )
    if isinstance(array, str):
        if len(files) > 1:
            raise engine.InvalidInput(
                f"Expected an array for each role, got {array}. Write for example --array {roles[0]}={array}."
            )
        array = {roles[0]: array}
    return exchange.read_parts(dict(files), array), None


def _convention(args, name):
    """Convention of a name, with the options' changes."""
    return replace(exchange.CONVENTIONS[name], **_changes(args))


def _changes(args):
    """Fields of a convention that the options set."""
    changes = {"axes": args.axes, "time": args.time, "rows": args.row_0}
    return {name: value for name, value in changes.items() if value is not None}


def _export(args):
    progress = Progress(quiet=args.quiet)
    folder, file = Path(args.folder), Path(args.file)
    thing = output.stored_hologram(folder) if args.hologram else output.stored_field(folder)
    if args.interference:
        _print(args, thing, file, progress)
        return
    given = [name for name in PRINT_OPTIONS if getattr(args, name) is not None]
    if given:
        raise engine.InvalidInput(f"Expected --interference with --{given[0]}. Add it, or omit --{given[0]}.")
    usual = "matlab" if file.suffix.lower() == ".mat" else "holopath"
    container = exchange.container_of(thing, _convention(args, args.convention or usual))
    progress(0.1, "Writing")
    exchange.write(file, container)
    progress(1.0, f"Done: {file}")


def _print(args, thing, file, progress):
    """Write the amplitude hologram of a frame at one wavelength."""
    if args.convention or _changes(args):
        raise engine.InvalidInput("A print has no convention. Omit --convention, --axes, --time and --row-0.")
    hologram = thing.hologram
    frame, color = _frame(args.frame, len(thing.data)), _color(args.wavelength, hologram.wavelengths)
    if isinstance(hologram.pitch, tuple):
        raise engine.InvalidInput(
            f"Expected square pixels for a print, got {in_words(hologram.pitch)}. Render with one number for --pitch."
        )
    if args.dpi is not None:
        prints.check_dots(args.dpi, hologram.pitch)
    thing = replace(thing, hologram=replace(hologram, optics=_off_axis(args, hologram.optics)))
    progress(0.1, "Computing the interference")
    bits, dot = args.bits or 8, prints.INCH / args.dpi if args.dpi else hologram.pitch
    picture = engine.interference(thing, frame, color, binary=bits == 1)
    progress(0.5, "Writing")
    prints.write_print(file, picture, bits, dot)
    sines = (c * hologram.wavelengths[color] / (2 * hologram.pitch) for c in thing.hologram.optics.carrier)
    angles = " and ".join(f"{math.degrees(math.asin(sine)):.3g}" for sine in sines)
    width, height = (n * dot * 1e3 for n in (hologram.width, hologram.height))
    progress.say(
        f"The print is {width:.3g} x {height:.3g} mm at {prints.dots_per_inch(dot):.5g} dots per inch. Lit "
        f"from straight behind, it shows the picture {angles} degrees to the right and up."
    )
    progress(1.0, f"Done: {file}")


def _frame(frame, count):
    if frame is None and count > 1:
        raise engine.InvalidInput(
            f"Expected one frame for a print, got {count}. Choose one with --frame N, from 0."
        )
    if frame is not None and not 0 <= frame < count:
        raise engine.InvalidInput(
            f"Expected a frame from 0 to {count - 1}, got {frame}. Choose another --frame."
        )
    return frame or 0


def _color(wavelength, wavelengths):
    """Index of a wavelength in nanometers among wavelengths in meters."""
    names = ", ".join(f"{w * 1e9:.4g}" for w in wavelengths)
    if wavelength is None:
        if len(wavelengths) > 1:
            raise engine.InvalidInput(
                f"Expected one wavelength for a print, got {len(wavelengths)}. Choose --wavelength {names}."
            )
        return 0
    nearest = min(range(len(wavelengths)), key=lambda n: abs(wavelengths[n] * 1e9 - wavelength))
    if abs(wavelengths[nearest] * 1e9 - wavelength) > MAX_WAVELENGTH_ERROR:
        raise engine.InvalidInput(
            f"Expected a wavelength of the hologram, got {wavelength:g} nm. Choose --wavelength {names}."
        )
    return nearest


def _off_axis(args, optics):
    """The stored bench with an off-axis carrier."""
    if args.hologram:
        if args.carrier is not None:
            raise engine.InvalidInput(
                "Stored phases have their own carrier. Omit --carrier, or encode with it."
            )
        if not any(optics.carrier):
            raise engine.InvalidInput(
                "Expected off-axis phases: on axis the image and its twin overlap. Encode with --carrier auto."
            )
        return optics
    if args.carrier is None and any(optics.carrier):
        return optics
    return replace(optics, carrier=args.carrier or "auto")


def _import(args):
    progress = Progress(quiet=args.quiet)
    out = Path(args.out)
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise engine.InvalidInput(f"The output {out} exists already. Choose a new folder.")
    progress(0.0, "Reading")
    container, array = _container(args.files, args.array)
    options = exchange.ReadOptions(
        array,
        _convention(args, args.convention) if args.convention else _changes(args),
        args.pitch,
        args.wavelengths and [nm * 1e-9 for nm in args.wavelengths],
        args.depth_range and tuple(mm * 1e-3 for mm in args.depth_range),
        args.near,
        None if args.fov is None else math.radians(args.fov),
        args.at and args.at * 1e-3,
        args.bits,
        args.units,
        args.transfer,
        args.packing,
        optics_changes(args),
    )
    thing = exchange.hologram_of(container, options)
    thing = replace(thing, hologram=with_colors(thing.hologram, args))
    is_field = isinstance(thing, engine.WaveField)
    with output.output_folder(out) as part:
        thing.save(part / ("wavefield" if is_field else "hologram"))
        names = [path if role is None else f"{role}={path}" for role, path in args.files]
        output.write_report(part, {"imported": names[0] if len(names) == 1 else names})
    progress(1.0, f"Done: {out}{'' if is_field else ' (phases: refocus them with --hologram)'}")
