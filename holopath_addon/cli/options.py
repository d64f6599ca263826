"""Options of several commands: the settings of `engine.settings`, and the bench around the SLM."""

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from .. import engine
from ..engine.optics import COLORS
from ..engine.pixels import Pitch
from ..engine.settings import DECLARED, Settings, default_of
from ..engine.settings.choices import BASELINES, Choice
from ..engine.settings.former_names import FORMER_NAMES, current_name
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

MIN_PITCH = 1e-9  # meters: a smaller pitch on the command line was given in meters


def argument(parse: Callable) -> Callable:
    """Argument type of a parser from a function.

    Parameters
    ----------
    parse : callable
        ``parse(text)`` gives the value, or raises `engine.InvalidInput` or ValueError. Its name describes the type.

    Returns
    -------
    callable
    """

    def convert(text):
        try:
            return parse(text)
        except engine.InvalidInput as error:
            raise argparse.ArgumentTypeError(str(error).rstrip(".")) from None

    convert.__name__ = parse.__name__.replace("_", " ").strip()
    return convert


def pitch(text: str) -> Pitch:
    """Parse a pixel pitch.

    Parameters
    ----------
    text : str
        One number in micrometers, or two with a comma for x and y.

    Returns
    -------
    float or (float, float)
        Meters.

    Raises
    ------
    engine.InvalidInput
        If the text is not one or two numbers, or a number is far too small for micrometers.
    """
    try:
        values = [float(part) * 1e-6 for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2):
        raise engine.InvalidInput(
            f"Expected a pixel pitch, got '{text}'. Give it in micrometers, or as X,Y if pixels are not square."
        )
    if any(0 < value < MIN_PITCH for value in values):
        raise engine.InvalidInput(f"Expected a pixel pitch in micrometers, got '{text}'. Give 8 for 8 µm.")
    return values[0] if len(values) == 1 else (values[0], values[1])


def numbers(count: int, shape: str, unit: str) -> Callable:
    """Argument type of numbers with commas between them.

    Parameters
    ----------
    count : int
        How many there must be; 0 for one or more.
    shape : str
        The numbers in words, for the message.
    unit : str
        Their unit, for the message.

    Returns
    -------
    callable
        Gives a list of float.
    """

    def parse(text):
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if not values or (count and len(values) != count):
            raise engine.InvalidInput(f"Expected {shape} in {unit}, got '{text}'")
        return values

    return argument(parse)


def add_old_name(parser: argparse.ArgumentParser, old: str, new: str, **words) -> None:
    """Accept an option's old name for one more version, with a note.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    old, new : str
        Names of the option.
    words
        Further arguments of `add_argument`; a flag's are ``nargs=0`` and its value as `const`.
    """

    class OldName(argparse.Action):
        def __call__(self, parser, args, value, option=None):
            print(
                f"holopath: {old} is called {new} now. The next version will not accept the old name.",
                file=sys.stderr,
            )
            setattr(args, self.dest, self.const if self.nargs == 0 else value)

    dest = words.pop("dest", None) or new.removeprefix("--").replace("-", "_")
    parser.add_argument(
        old, dest=dest, action=OldName, default=argparse.SUPPRESS, help=argparse.SUPPRESS, **words
    )


def flag(name: str) -> str:
    """Option of a setting on the command line.

    Parameters
    ----------
    name : str
        Name of the setting.

    Returns
    -------
    str
    """
    return "--fix" if name == "fixed" else f"--{name.replace('_', '-')}"


def add(parser: argparse.ArgumentParser) -> None:
    """Add an option for each setting; settings that replace each other are mutually exclusive.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    """
    instead = {declared.instead_of: name for name, declared in DECLARED.items() if declared.instead_of}
    groups = {}
    for name, other in instead.items():
        groups[name] = groups[other] = parser.add_mutually_exclusive_group()
    for name, declared in DECLARED.items():
        words: dict[str, Any] = {"metavar": _value(name, declared), "type": _type(name, declared)}
        if declared.chosen:
            words = {"choices": tuple(declared.chosen), "type": partial(current_name, name, tell=say)}
        text = _meaning(declared, "{}")
        text += f". There are {', '.join(engine.FIXABLE)}" if name == "fixed" else ""
        groups.get(name, parser).add_argument(
            flag(name), dest=name, help=f"{text} (default: the file's, {_default(name)})", **words
        )
    for old, new in FORMER_NAMES["setting"].items():
        add_old_name(parser, flag(old), flag(new), type=_type(new, DECLARED[new]))


def settings_of(args: argparse.Namespace, base: Settings) -> Settings:
    """Settings by the options, or else a scene's own; a display sets the number of frames.

    Parameters
    ----------
    args : argparse.Namespace
    base : Settings
        Settings of the scene.

    Returns
    -------
    Settings
    """
    given = {name: getattr(args, name) for name in DECLARED if getattr(args, name) is not None}
    if args.display is not None and not {"frames", "speckle"} & set(given):
        given["frames"] = args.display.frames
    others = {name: default_of(name) for name, each in DECLARED.items() if each.instead_of in given}
    return replace(base, **others | given)


def guide_table() -> str:
    """Table of settings for the documentation.

    Returns
    -------
    str
        Markdown.
    """
    rows = ["| setting | on the command line | meaning | start with |", "|---|---|---|---|"]
    for name, declared in DECLARED.items():
        value = "" if declared.chosen else f" {_value(name, declared)}".replace("|", "\\|")
        meaning = "<br>".join([declared.help, *_choices(declared.chosen, "`{}`")])
        advice = declared.advice or _default(name)
        rows.append(f"| {declared.label} | `{flag(name)}{value}` | {meaning} | {advice} |")
    return "\n".join(rows)


def add_optics(parser: argparse.ArgumentParser, kept: str | None = None) -> None:
    """Add the options of the bench around the SLM.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    kept : str, optional
        Origin of the defaults, for the help texts. Default: flat light, and a circular stop.
    """
    parser.add_argument(
        "--beam",
        metavar=BEAM_WORDS,
        help="light that falls on the SLM, which the phases compensate: its tilt in degrees to the right and up; the "
        "distance in millimeters of the point before the SLM that it comes from, negative if it converges to a point "
        "behind it; waist and center of a Gaussian beam; or a file of complex numbers, amplitude=FILE or "
        f"intensity=FILE, with ,phase=FILE or without (default: {kept or 'flat'})",
    )
    parser.add_argument(
        "--carrier",
        metavar="X,Y|auto",
        help="center of the image's light in the Fourier plane, to the right and up of the zero order in units of the "
        f"band's edge; auto: the center of the stop (default: {kept or '0,0'}; auto with --stop half, 0,0 with another "
        "--stop)",
    )
    parser.add_argument(
        "--stop",
        metavar=STOP_WORDS,
        help="stop in the relay's Fourier plane, for binary and amplitude devices, or to block the zero order: a "
        "circle of radius R around the carrier, half of the band in a direction, a rectangle around the carrier, or an "
        f"image of the plane (default: {kept or 'the largest possible circle'})",
    )
    parser.add_argument(
        "--lens",
        metavar=LENS_WORDS,
        help="a lens behind the SLM: its focal length, its distance from the SLM (default: the focal length), and the "
        "distance of the image behind it (default: the focal length), all in millimeters; and the image's fraction of "
        "the width that light reaches there (default: 1). With --depth-mapping eyepiece the viewer looks through the "
        f"lens, and there is no image behind it (default: {kept or 'none'})",
    )
    parser.add_argument(
        "--color-scale",
        metavar="S[,S..]",
        help="magnification of each wavelength's image relative to the intended one, which the hologram compensates "
        f"(default: {kept or '1'})",
    )
    parser.add_argument(
        "--color-distance",
        metavar="MM[,MM..]",
        help="distance by which each wavelength's image lies too near to the viewer, millimeters, which the hologram "
        f"compensates (default: {kept or '0'})",
    )
    parser.add_argument(
        "--color-shift",
        metavar="X,Y[,X,Y..]",
        help="lateral offset of each wavelength's image, millimeters to the right and up, which the hologram "
        f"compensates (default: {kept or '0'})",
    )
    parser.add_argument(
        "--colors-from",
        metavar="FILE",
        help="the three color options from a calibration of each wavelength by `holopath calibrate`: scale and shift "
        "relative to the middle wavelength, as measured by the camera, and distance by the fitted defocus",
    )


def optics_changes(args: argparse.Namespace) -> dict[str, Any]:
    """Fields of `engine.Optics` that the options of `add_optics` set.

    Parameters
    ----------
    args : argparse.Namespace

    Returns
    -------
    dict
        Values by name; only those that are given.

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
    """Set the color errors of a hologram's optics by the calibration of `--colors-from`.

    Parameters
    ----------
    hologram : engine.Hologram
    args : argparse.Namespace

    Returns
    -------
    engine.Hologram

    Raises
    ------
    engine.InvalidInput
        If other options set them, too, or the calibration lacks them.
    """
    if args.colors_from is None:
        return hologram
    if given := [flag(name) for name in COLORS if getattr(args, name) is not None]:
        raise engine.InvalidInput(f"Expected either --colors-from or {given[0]}, got both. Omit one of them.")
    return replace(hologram, optics=replace(hologram.optics, **colors_of(args.colors_from, hologram)))


def on_bench(thing, args: argparse.Namespace):
    """Change the bench of a field or of phases by the options of `add_optics`.

    Parameters
    ----------
    thing : engine.WaveField or engine.PhaseHologram
    args : argparse.Namespace

    Returns
    -------
    engine.WaveField or engine.PhaseHologram

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
    """
    changes, hologram = optics_changes(args), with_colors(thing.hologram, args)
    thing = thing if hologram is thing.hologram else replace(thing, hologram=hologram)
    if not changes:
        return thing
    optics = replace(hologram.optics, **changes)
    ends: dict[str, Any] = {}
    if optics.lens != hologram.optics.lens:  # its volume follows from the lens
        ends = {"depth_far": None, "depth_near": None}
    return replace(thing, hologram=replace(hologram, optics=optics, **ends))


def say(text: str) -> None:
    """Print a note on standard error."""
    print(f"holopath: {text}", file=sys.stderr)


def _value(name, declared):
    auto = default_of(name) == "auto" and not declared.chosen
    return f"auto|{declared.metavar}" if auto else declared.metavar


def _type(name, declared):
    def parse_fixed(text):
        return engine.parse_fixed(text, say)

    def parse(text):
        if text == "auto":
            return text
        try:
            return declared.kind(text) * (1e-3 if declared.unit else 1)
        except ValueError:
            kind = "a distance in millimeters" if declared.unit else "a whole number"
            raise engine.InvalidInput(f"Expected auto or {kind}, got '{text}'") from None

    if name == "fixed":
        return argument(parse_fixed)
    return argument(parse) if default_of(name) == "auto" else declared.kind


def listed(chosen: Mapping[str, Choice], form: str) -> str:
    """Effects of a setting's choices in one sentence, without the methods for comparison.

    Parameters
    ----------
    chosen : mapping of str to Choice
    form : str
        Format of a choice's name.

    Returns
    -------
    str
    """
    return "; ".join(_choices(chosen, form))


def _choices(chosen, form):
    return [
        f"{form.format(name)}: {_small(each.help)}" for name, each in chosen.items() if name not in BASELINES
    ]


def _meaning(declared, form):
    text = f"{declared.help}. {listed(declared.chosen, form)}" if declared.chosen else declared.help
    return _small(text)


def _small(text):
    """A sentence with a lower-case first word, unless that is an abbreviation."""
    return text if text[1:2].isupper() else text[:1].lower() + text[1:]


def _default(name):
    default = default_of(name)
    return "none" if default is None or default == {} else str(default)
