"""The settings that `engine.settings` declares, as options of a command and as the documentation's table."""

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from .. import engine
from ..engine.optics import COLORS
from ..engine.pixels import Pitch
from ..engine.settings import BASELINES, DECLARED, Choice, Settings, current, default_of
from ..exchange.optics import (
    BEAM_WORDS,
    LENS_WORDS,
    STOP_WORDS,
    parse_beam,
    parse_carrier,
    parse_colors,
    parse_lens,
    parse_stop,
)
from ..slm.calibration import colors_of


def argument(parse: Callable) -> Callable:
    """Argument type from a function that raises `InvalidInput` or `ValueError`."""

    def convert(text):
        try:
            return parse(text)
        except engine.InvalidInput as error:
            raise argparse.ArgumentTypeError(str(error).rstrip(".")) from None

    convert.__name__ = parse.__name__.replace("_", " ").strip()
    return convert


def pitch(text: str) -> Pitch:
    """A pixel pitch, or one in x and one in y, in micrometers; gives meters."""
    try:
        found = [float(part) * 1e-6 for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) not in (1, 2):
        raise engine.InvalidInput(
            f"'{text}' is no pixel pitch: give it in micrometers, or X,Y where pixels are not square."
        )
    return found[0] if len(found) == 1 else (found[0], found[1])


def numbers(count: int, shape: str, unit: str) -> Callable:
    """Argument type of so many numbers with commas between them; 0 for one or more."""

    def parse(text):
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if not values or (count and len(values) != count):
            raise engine.InvalidInput(f"'{text}' is not {shape} in {unit}")
        return values

    return argument(parse)


def renamed(parser: argparse.ArgumentParser, old: str, new: str, **told) -> None:
    """Take an option's old name for a version more, with a word."""

    class Renamed(argparse.Action):
        def __call__(self, parser, args, value, option=None):
            print(
                f"holopath: {old} is called {new} now; the old name goes with the next version.",
                file=sys.stderr,
            )
            setattr(args, self.dest, value)

    dest = new.removeprefix("--").replace("-", "_")
    parser.add_argument(
        old, dest=dest, action=Renamed, default=argparse.SUPPRESS, help=argparse.SUPPRESS, **told
    )


def removed(parser: argparse.ArgumentParser, option: str, instead: str) -> None:
    """Refuse an option that there was, with what is to be done instead of it."""

    class Removed(argparse.Action):
        def __call__(self, parser, args, value, option=None):
            raise engine.InvalidInput(instead)

    parser.add_argument(option, nargs="?", action=Removed, default=argparse.SUPPRESS, help=argparse.SUPPRESS)


def flag(name: str) -> str:
    """A setting's word on the command line."""
    return "--fix" if name == "fixed" else f"--{name.replace('_', '-')}"


def add(parser: argparse.ArgumentParser) -> None:
    """Add an option for each setting; those that take each other's place exclude each other."""
    instead = {declared.instead_of: name for name, declared in DECLARED.items() if declared.instead_of}
    groups = {}
    for name, other in instead.items():
        groups[name] = groups[other] = parser.add_mutually_exclusive_group()
    for name, declared in DECLARED.items():
        told: dict[str, Any] = {"metavar": _value(name, declared), "type": _type(name, declared)}
        if declared.chosen:
            told = {"choices": tuple(declared.chosen), "type": partial(current, name, tell=_say)}
        text = _meaning(declared, "{}")
        text += f". There are {', '.join(engine.FIXABLE)}" if name == "fixed" else ""
        groups.get(name, parser).add_argument(
            flag(name), dest=name, help=f"{text} (default: the file's, {_default(name)})", **told
        )


def asked(args: argparse.Namespace, base: Settings) -> Settings:
    """The settings that words ask for, over a scene's own; a display brings the frames that it shows."""
    given = {name: getattr(args, name) for name in DECLARED if getattr(args, name) is not None}
    if args.display is not None and not {"frames", "speckle"} & set(given):
        given["frames"] = args.display.frames
    others = {name: default_of(name) for name, each in DECLARED.items() if each.instead_of in given}
    return replace(base, **others | given)


def guide_table() -> str:
    """The documentation's table of settings, Markdown."""
    rows = ["| setting | on the command line | meaning | start with |", "|---|---|---|---|"]
    for name, declared in DECLARED.items():
        value = "" if declared.chosen else f" {_value(name, declared)}".replace("|", "\\|")
        meaning = "<br>".join([declared.help, *_choices(declared.chosen, "`{}`")])
        advice = declared.advice or _default(name)
        rows.append(f"| {declared.label} | `{flag(name)}{value}` | {meaning} | {advice} |")
    return "\n".join(rows)


def add_optics(parser: argparse.ArgumentParser, kept: str | None = None) -> None:
    """Add the options of the bench around the SLM; `kept` says where the default is from, if it is not the flat one."""
    parser.add_argument(
        "--beam",
        metavar=BEAM_WORDS,
        help="light that falls on the SLM, for which phases make up: a tilt in degrees to the right and up; a point so "
        "many millimeters before the SLM, or behind it if negative, from or to which it runs; the waist of a Gaussian "
        "beam and its middle; or a file of complex numbers, amplitude=FILE or intensity=FILE, with ,phase=FILE or "
        f"without (default: {kept or 'flat'})",
    )
    parser.add_argument(
        "--carrier",
        metavar="X,Y|auto",
        help="where the middle of the picture's light lies in the Fourier plane, to the right and up of the zero order "
        f"in units of the band's edge; auto: in the middle of the stop (default: {kept or '0,0'}; with --stop half "
        "auto, with another --stop 0,0)",
    )
    parser.add_argument(
        "--stop",
        metavar=STOP_WORDS,
        help="what the relay lets through in its Fourier plane, for binary and amplitude devices, or to leave out the "
        "zero order: a circle of radius R around the carrier, the half of the band in a direction, a rectangle around "
        f"the carrier, or a picture of the plane (default: {kept or 'a circle, as large as it can be'})",
    )
    parser.add_argument(
        "--lens",
        metavar=LENS_WORDS,
        help="a lens behind the SLM: its focal length, its distance from the SLM (default: the focal length), and the "
        "distance of the picture behind it (default: the focal length), all in millimeters; and the share that the "
        "picture has of the width that light reaches there (default: 1, all of it). With --depth-mapping eyepiece "
        "somebody looks through it, and no picture is behind it "
        f"(default: {kept or 'none'})",
    )
    parser.add_argument(
        "--color-scale",
        metavar="S[,S..]",
        help="magnification of each wavelength's picture over what it should be, which is made up for "
        f"(default: {kept or '1'})",
    )
    parser.add_argument(
        "--color-distance",
        metavar="MM[,MM..]",
        help="how far each wavelength's picture lies too near to the viewer, millimeters, which is made up for "
        f"(default: {kept or '0'})",
    )
    parser.add_argument(
        "--color-shift",
        metavar="X,Y[,X,Y..]",
        help="how far each wavelength's picture lies aside, millimeters to the right and up, which is made up for "
        f"(default: {kept or '0'})",
    )
    parser.add_argument(
        "--colors-from",
        metavar="FILE",
        help="instead of these three, a calibration of each wavelength, by `holopath calibrate`: scale and shift in "
        "terms of the wavelength in the middle, as its camera saw them, and distance as the fitted defocus has it",
    )


def optics_of(args: argparse.Namespace) -> dict[str, Any]:
    """What words say of the bench: changes of an `engine.Optics`.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
    """
    changes: dict[str, Any] = {} if args.beam is None else {"beam": parse_beam(args.beam)}
    if args.stop is not None:
        changes |= {"stop": parse_stop(args.stop), "carrier": None}
    if args.carrier is not None:
        changes["carrier"] = parse_carrier(args.carrier)
    if args.lens is not None:
        changes["lens"] = parse_lens(args.lens)
    for name in COLORS:
        if (text := getattr(args, name)) is not None:
            changes[name] = parse_colors(name, text)
    return changes


def with_colors(hologram: engine.Hologram, args: argparse.Namespace) -> engine.Hologram:
    """A hologram whose colors lie where the calibration of `--colors-from` has them.

    Raises
    ------
    engine.InvalidInput
        If other words say it, too, or the calibration does not.
    """
    if args.colors_from is None:
        return hologram
    if given := [flag(name) for name in COLORS if getattr(args, name) is not None]:
        raise engine.InvalidInput(
            f"--colors-from says where colors lie, and so does {given[0]}: leave out either."
        )
    return replace(hologram, optics=replace(hologram.optics, **colors_of(args.colors_from, hologram)))


def on_bench(thing, args: argparse.Namespace):
    """A `WaveField` or `PhaseHologram` on the bench that words say."""
    changes, hologram = optics_of(args), with_colors(thing.hologram, args)
    thing = thing if hologram is thing.hologram else replace(thing, hologram=hologram)
    if not changes:
        return thing
    optics = replace(hologram.optics, **changes)
    ends: dict[str, Any] = {}
    if optics.lens != hologram.optics.lens:  # which has a volume of its own
        ends = {"depth_far": None, "depth_near": None}
    return replace(thing, hologram=replace(hologram, optics=optics, **ends))


def _say(text):
    print(f"holopath: {text}", file=sys.stderr)


def _value(name, declared):
    auto = default_of(name) == "auto" and not declared.chosen
    return f"auto|{declared.metavar}" if auto else declared.metavar


def _type(name, declared):
    if name == "fixed":
        return argument(engine.parse_fixed)

    def parse(text):
        if text == "auto":
            return text
        try:
            return declared.kind(text) * (1e-3 if declared.unit else 1)
        except ValueError:
            what = "a distance in millimeters" if declared.unit else "a whole number"
            raise engine.InvalidInput(f"'{text}' is neither auto nor {what}") from None

    return argument(parse) if default_of(name) == "auto" else declared.kind


def listed(chosen: Mapping[str, Choice], form: str) -> str:
    """What each choice does, but for other people's methods."""
    return "; ".join(_choices(chosen, form))


def _choices(chosen, form):
    return [
        f"{form.format(name)}: {_small(each.help)}" for name, each in chosen.items() if name not in BASELINES
    ]


def _meaning(declared, form):
    text = f"{declared.help}. {listed(declared.chosen, form)}" if declared.chosen else declared.help
    return _small(text)


def _small(text):
    """A sentence that goes on: its first word small, unless it is a name."""
    return text if text[1:2].isupper() else text[:1].lower() + text[1:]


def _default(name):
    default = default_of(name)
    return "none" if default is None or default == {} else str(default)
