"""`holopath export` and `holopath import`: fields and phases in files of other programs."""

import math
from dataclasses import replace
from pathlib import Path

from .. import engine, exchange
from ..engine.pixels import in_words
from ..exchange import prints
from ..exchange.conventions import ROWS, SIGNS
from ..exchange.holograms import PACKINGS, TRANSFERS, check_packing
from ..exchange.optics import parse_carrier
from ..exchange.parts import FIELD, ROLES
from ..exchange.phases import CHOICES
from ..workflow import output
from .console import Progress
from .options import add_optics, argument, numbers, optics_of, pitch, with_colors

_KINDS = ", ".join(exchange.SUFFIXES)
PRINT = ("dpi", "bits", "carrier", "frame", "wavelength")  # options of a print alone
SAME = 0.5  # nanometers: wavelengths that differ by less are one


def add(command):
    """Add the commands, see `render_command.add`."""
    export = command(
        "export", _export, "Write a stored field, or stored phases, as a file for other programs."
    )
    export.add_argument("folder", metavar="DIR", help="output folder of `holopath render`")
    export.add_argument(
        "file", metavar="FILE", help=f"its name ends on {_KINDS}; of a print on {', '.join(prints.SUFFIXES)}"
    )
    export.add_argument("--hologram", action="store_true", help="the stored phases instead of the wave field")
    _add_print(export)
    _add_convention(export, "how the file has it (default: holopath; matlab in a .mat)")

    take = command(
        "import", _import, "Take a field or phases of another program, to refocus, encode and stream."
    )
    take.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        type=argument(_file),
        help=f"{', '.join(exchange.READABLE)}; two files of one field as amplitude=FILE phase=FILE, "
        "intensity=FILE phase=FILE, or real=FILE imaginary=FILE",
    )
    take.add_argument("--out", required=True, metavar="DIR", help="output folder, which is to be new")
    take.add_argument(
        "--array",
        type=argument(_array),
        metavar="NAME|ROLE=NAME,..",
        help="which of the file's arrays, or which for each role, as amplitude=A,phase=P; of a color picture red, "
        "green or blue (default: as their names say, if they say it in one way)",
    )
    _add_convention(take, "how the program has it (default: as the file says, else holopath)")
    add = take.add_argument_group("what the file does not say").add_argument
    add(
        "--pitch",
        type=argument(pitch),
        metavar="UM[,UM]",
        help="pixel pitch, micrometers; X,Y where pixels are not square",
    )
    add(
        "--wavelengths",
        type=numbers(0, "a list of wavelengths", "nanometers"),
        metavar="NM[,NM..]",
        help="in the array's order",
    )
    add(
        "--at",
        type=float,
        metavar="MM",
        help="distance of the field's plane from the SLM, to which it is brought (default 0)",
    )
    add(
        "--units",
        choices=CHOICES,
        help="of phases (default: as the file says, else levels for whole numbers, and radians for others that fill a "
        "turn)",
    )
    add(
        "--bits",
        type=int,
        metavar="N",
        help="2^N levels are a turn (default: as many as the type holds, if they fill it)",
    )
    add(
        "--transfer",
        choices=TRANSFERS,
        help="how whole numbers hold amplitudes or intensities: in proportion, or encoded for screens",
    )
    add(
        "--packing",
        type=argument(check_packing),
        metavar="NAME|BITS",
        help=f"how a color picture holds phases, one of {', '.join(PACKINGS)} as `holopath stream` has them, or which "
        "bits of the channels a level is, from its highest on, such as R7-5,G7-5,B7-4 (default: one hologram of three "
        "wavelengths)",
    )
    add(
        "--depth-range",
        type=numbers(2, "FAR,NEAR", "millimeters"),
        metavar="FAR_MM,NEAR_MM",
        help="infinity's and the near end's distances from the SLM (default: what the display can show)",
    )
    add("--near", type=float, metavar="METERS", help="world depth of the near end (default 1)")
    add(
        "--fov",
        type=float,
        metavar="DEGREES",
        help="horizontal field of view (default: by an eyepiece of 50 mm)",
    )
    add_optics(take, "what the file says")


def _add_print(parser):
    parser.add_argument(
        "--interference",
        action="store_true",
        help="a gray picture of the light's interference with an off-axis reference wave, to be printed on film as an "
        "amplitude hologram; of phases, of what the SLM lets through",
    )
    add = parser.add_argument_group("print, with --interference").add_argument
    add(
        "--dpi",
        type=float,
        metavar="N",
        help="dots per inch of the printer, one for each pixel of the hologram (default: as its pitch has them)",
    )
    add("--bits", type=int, choices=prints.BITS, help="of the picture's gray (default 8); 1: black and white")
    add(
        "--carrier",
        type=argument(parse_carrier),
        metavar="X,Y|auto",
        help="where the middle of the picture's light is to lie, in units of the band's edge (default: the field's; "
        "auto if that lies on axis)",
    )
    add("--frame", type=int, metavar="N", help="which one, from 0, where there are several")
    add("--wavelength", type=float, metavar="NM", help="which one, where there are several")


def _add_convention(parser, what):
    add = parser.add_argument_group("convention, see docs/files.md").add_argument
    add("--convention", choices=tuple(exchange.CONVENTIONS), help=what)
    add("--axes", type=argument(_axes), metavar="A,B,..", help="of frame, wavelength, y, x, in any order")
    add("--time", choices=tuple(SIGNS), help="sign of i omega t: - (default) or +")
    add("--row-0", choices=ROWS, help="where row 0 is (default top)")


def _axes(text):
    axes = tuple(text.replace(" ", "").split(","))
    exchange.Convention(axes)
    return axes


def _file(text):
    """A role, or None, and a file."""
    role, equals, path = text.partition("=")
    return (role, path) if equals and role in (FIELD, *ROLES) else (None, text)


def _array(text):
    """A name, or a name for each role."""
    pairs = [_file(part) for part in text.split(",")]
    if not all(role for role, _ in pairs):
        return text
    if len({role for role, _ in pairs}) < len(pairs):
        raise engine.InvalidInput(f"'{text}' names a role twice")
    return dict(pairs)


def _container(files, array):
    """What is in one file, or in a file for each role, and which of its arrays are named."""
    roles = [role for role, _ in files]
    if len(files) == 1 and roles[0] is None:
        return exchange.read(files[0][1]), array
    if None in roles or len(set(roles)) < len(roles):
        raise engine.InvalidInput(
            "Two files are one field: say what each is, as amplitude=FILE phase=FILE, intensity=FILE phase=FILE, or "
            "real=FILE imaginary=FILE."
        )
    if isinstance(array, str):
        if len(files) > 1:
            raise engine.InvalidInput(
                f"Each file has a role: say --array {roles[0]}={array}, as in amplitude=A,phase=P."
            )
        array = {roles[0]: array}
    return exchange.read_parts(dict(files), array), None


def _convention(args, default=None):
    """What the words say; None if they say nothing."""
    said = {"axes": args.axes, "time": args.time, "rows": args.row_0}
    said = {name: value for name, value in said.items() if value is not None}
    named = exchange.CONVENTIONS[args.convention] if args.convention else default
    return replace(named or exchange.Convention(), **said) if named or said else None


def _export(args):
    progress = Progress(quiet=args.quiet)
    folder, file = Path(args.folder), Path(args.file)
    thing = output.stored_hologram(folder) if args.hologram else output.stored_field(folder)
    if args.interference:
        _print(args, thing, file, progress)
        return
    asked = [name for name in PRINT if getattr(args, name) is not None]
    if asked:
        raise engine.InvalidInput(f"--{asked[0]} is of a print: add --interference, or leave it out.")
    matlab = exchange.CONVENTIONS["matlab"] if file.suffix.lower() == ".mat" else None
    container = exchange.container_of(thing, _convention(args, matlab))
    progress(0.1, "Writing")
    exchange.write(file, container)
    progress(1.0, f"Done: {file}")


def _print(args, thing, file, progress):
    """Write the amplitude hologram of a frame at one wavelength."""
    if _convention(args) is not None:
        raise engine.InvalidInput(
            "A print has no convention: leave out --convention, --axes, --time and --row-0."
        )
    hologram = thing.hologram
    frame, color = _frame(args.frame, len(thing.data)), _color(args.wavelength, hologram.wavelengths)
    if isinstance(hologram.pitch, tuple):
        raise engine.InvalidInput(
            f"A print has dots as far apart in x as in y, and pixels are {in_words(hologram.pitch)}: render with one "
            "number for --pitch."
        )
    if args.dpi is not None:
        prints.check_dots(args.dpi, hologram.pitch)
    thing = replace(thing, hologram=replace(hologram, optics=_off_axis(args, hologram.optics)))
    progress(0.1, "Interfering")
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
            f"A print is one frame, and there are {count}: choose one with --frame N, from 0."
        )
    if frame is not None and not 0 <= frame < count:
        raise engine.InvalidInput(f"There is no frame {frame}: choose --frame 0 to {count - 1}.")
    return frame or 0


def _color(wavelength, there):
    """Number of a wavelength in nanometers."""
    names = ", ".join(f"{w * 1e9:.4g}" for w in there)
    if wavelength is None:
        if len(there) > 1:
            raise engine.InvalidInput(
                f"A print is of one wavelength, and there are {len(there)}: choose --wavelength {names}."
            )
        return 0
    near = min(range(len(there)), key=lambda n: abs(there[n] * 1e9 - wavelength))
    if abs(there[near] * 1e9 - wavelength) > SAME:
        raise engine.InvalidInput(f"There is no light of {wavelength:g} nm: choose --wavelength {names}.")
    return near


def _off_axis(args, optics):
    """The stored bench with the carrier that the words say."""
    if args.hologram:
        if args.carrier is not None:
            raise engine.InvalidInput(
                "Stored phases have their carrier: leave out --carrier, or encode with it."
            )
        if not any(optics.carrier):
            raise engine.InvalidInput(
                "The stored phases are for light on axis, where the picture and its twin lie on each other: encode "
                "them with --carrier auto."
            )
        return optics
    if args.carrier is None and any(optics.carrier):
        return optics
    return replace(optics, carrier=args.carrier or "auto")


def _import(args):
    progress = Progress(quiet=args.quiet)
    out = Path(args.out)
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise engine.InvalidInput(f"{out} is there already: choose a new folder, for nothing is replaced.")
    progress(0.0, "Reading")
    container, array = _container(args.files, args.array)
    given = exchange.ReadOptions(
        array,
        _convention(args),
        args.pitch,
        args.wavelengths and [nm * 1e-9 for nm in args.wavelengths],
        args.depth_range and tuple(mm * 1e-3 for mm in args.depth_range),
        args.near,
        args.fov and math.radians(args.fov),
        args.at and args.at * 1e-3,
        args.bits,
        args.units,
        args.transfer,
        args.packing,
        engine.Optics(**optics) if (optics := optics_of(args)) else None,
    )
    thing = exchange.hologram_of(container, given)
    thing = replace(thing, hologram=with_colors(thing.hologram, args))
    field = isinstance(thing, engine.WaveField)
    with output.output_folder(out) as part:
        thing.save(part / ("wavefield" if field else "hologram"))
        names = [path if role is None else f"{role}={path}" for role, path in args.files]
        report = {
            "format": output.FORMAT,
            "format_version": output.FORMAT_VERSION,
            "imported": names[0] if len(names) == 1 else names,
        }
        output.write_report(part, report)
    progress(1.0, f"Done: {out}{'' if field else ' (phases: refocus them with --hologram)'}")
