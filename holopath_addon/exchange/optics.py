"""Parsers of the bench: the options `--beam`, `--carrier`, `--stop`, `--lens` and `--color-scale`, and their files."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from ..engine import Beam, InvalidInput, Lens, Stop
from ..engine.optics import STOPS
from .containers import read
from .conventions import SIGNS
from .parts import AMPLITUDE, FIELD, INTENSITY, PHASE, role_of
from .phases import parse_units

BEAM_WORDS = "flat|tilt:DX,DY|point:MM|gaussian:WAIST_MM[,X,Y]|FILE"
STOP_WORDS = "circle[:R]|half[:DEGREES]|rectangle:W,H|FILE"
_SHAPES = set(STOPS) - {"measured"}
LENS_WORDS = "MM[@MM[@MM[@SHARE]]]|none"
COLOR_WORDS = {
    "color_scale": ("scale of colors", "S[,S..], one for each wavelength"),
    "color_distance": ("distance of colors", "MM[,MM..], one for each wavelength"),
    "color_shift": ("shift of colors", "X,Y[,X,Y..] in millimeters, two for each wavelength"),
}
# Factor from a number in the text to that of `Beam`.
_UNITS = {"tilt": math.radians(1), "point": 1e-3, "gaussian": 1e-3}
_ROLES = ({FIELD}, {AMPLITUDE}, {INTENSITY}, {AMPLITUDE, PHASE}, {INTENSITY, PHASE})


def parse_beam(text: str) -> Beam:
    """Parse a beam: `BEAM_WORDS`, with a tilt in degrees and other numbers in millimeters, to the right and up.

    A file has complex numbers, or is ``amplitude=FILE`` or ``intensity=FILE``, optionally with ``,phase=FILE`` in
    radians. Only the ratio of its numbers matters.

    Parameters
    ----------
    text : str

    Raises
    ------
    InvalidInput
        If the text is not a beam, or the file cannot be read or can be read in two ways.
    BackendUnavailable
        If the library for the file is not installed.
    """
    kind, colon, numbers = text.partition(":")
    if text == "flat":
        return Beam()
    if kind in _UNITS:
        return Beam(kind, tuple(_UNITS[kind] * number for number in _numbers(text, numbers)))
    if not beam_files(text):
        raise InvalidInput(f"Expected a beam {BEAM_WORDS}, got '{text}'.")
    return measured_beam(beam_files(text))


def measured_beam(files: dict[str, Path]) -> Beam:
    """Read a measured beam from files by role, see `beam_files`; raises as `parse_beam`."""
    return Beam("measured", measured=_measured(files))


def beam_files(text: str | None) -> dict[str, Path]:
    """Files in the text of a beam, by the role of their arrays."""
    if text is None or text == "flat" or text.partition(":")[0] in _UNITS:
        return {}
    if "=" not in text:
        return {FIELD: Path(text)} if Path(text).suffix else {}
    pairs = [part.partition("=") for part in text.split(",")]
    return {role: Path(path) for role, _, path in pairs}


def parse_carrier(text: str) -> tuple[float, float] | str:
    """Parse a carrier: ``X,Y`` in units of the band's edge, or ``auto``; see `engine.Optics`.

    Raises
    ------
    InvalidInput
    """
    if text == "auto":
        return text
    numbers = _numbers(text, text, "carrier", "X,Y in units of the band's edge, or auto")
    if len(numbers) != 2:
        raise InvalidInput(f"Expected a carrier X,Y in units of the band's edge, or auto, got '{text}'.")
    return numbers[0], numbers[1]


def parse_colors(name: str, text: str) -> tuple:
    """Parse the scale, distance or shift of each color, see `engine.Optics`.

    Parameters
    ----------
    name : str
        One of `engine.optics.COLORS`.
    text : str
        Numbers with commas, one per wavelength, two for shifts; distances and shifts in millimeters.

    Returns
    -------
    tuple
        In meters.

    Raises
    ------
    InvalidInput
    """
    words, unit = COLOR_WORDS[name], 1.0 if name == "color_scale" else 1e-3
    numbers = [unit * number for number in _numbers(text, text, words[0], words[1])]
    if name != "color_shift":
        return tuple(numbers)
    if len(numbers) % 2:
        raise InvalidInput(f"Expected a {words[0]} {words[1]}, got '{text}'.")
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))


def parse_stop(text: str) -> Stop:
    """Parse a stop: `STOP_WORDS`, with the angle of a half in degrees, or a picture that is bright where it is open.

    Raises
    ------
    InvalidInput
        If the text is not a stop, or the picture cannot be read.
    BackendUnavailable
        If the library for it is not installed.
    """
    kind, colon, numbers = text.partition(":")
    if kind in _SHAPES:
        unit = math.radians(1) if kind == "half" else 1.0
        values = _numbers(text, numbers, "stop", STOP_WORDS) if colon else []
        return Stop(kind, tuple(unit * value for value in values))
    if not stop_files(text):
        raise InvalidInput(f"Expected a stop {STOP_WORDS}, got '{text}'.")
    return measured_stop(Path(text))


def measured_stop(path: Path) -> Stop:
    """Read a stop from a picture that is bright where it is open; raises as `parse_stop`."""
    array = _array("stop", path)
    return Stop("measured", measured=array > array.max() / 2)


def parse_lens(text: str) -> Lens | None:
    """Parse a lens: `LENS_WORDS`; None for ``none``.

    The numbers are the focal length, the distance from the SLM to the lens, the distance from the lens to the picture,
    in millimeters, and the fraction of the width there that the picture fills.

    Raises
    ------
    InvalidInput
    """
    if text == "none":
        return None
    try:
        numbers = [float(part) for part in text.split("@")]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 4:
        raise InvalidInput(f"Expected a lens {LENS_WORDS}, got '{text}'.")
    return Lens(*(1e-3 * number for number in numbers[:3]), *numbers[3:])


def stop_files(text: str | None) -> dict[str, Path]:
    """The file in the text of a stop, by its role."""
    kind, _, numbers = (text or "").partition(":")
    is_shape = kind in _SHAPES or re.fullmatch(r"[-+.,\d]+", numbers)
    return {} if not text or is_shape or not Path(text).suffix else {"stop": Path(text)}


def _numbers(text, numbers, name="beam", words=BEAM_WORDS):
    try:
        return [float(part) for part in numbers.split(",")]
    except ValueError:
        raise InvalidInput(f"Expected a {name} {words}, got '{text}'.") from None


def _measured(files):
    if set(files) not in _ROLES:
        raise InvalidInput(
            "Expected a beam of amplitude=FILE or intensity=FILE, optionally with ,phase=FILE, got "
            f"{' and '.join(files)}."
        )
    arrays = {role: _array(role, path) for role, path in files.items()}
    if FIELD in arrays:
        return arrays[FIELD]
    if len({array.shape for array in arrays.values()}) > 1:
        sizes = " and ".join(f"{role} of {array.shape}" for role, array in arrays.items())
        raise InvalidInput(f"The beam's files differ, {sizes}. Write both in one shape.")
    size = arrays[AMPLITUDE] if AMPLITUDE in arrays else arrays[INTENSITY]
    if (size < 0).any():
        raise InvalidInput(
            f"{next(iter(files.values()))} has negative values. Subtract its background first."
        )
    size = size if AMPLITUDE in arrays else np.sqrt(size)
    return size * np.exp(1j * arrays[PHASE]) if PHASE in arrays else size


def _check_attributes(path, attributes, role):
    """Refuse a file whose attributes say that its numbers are not in HoloPath's own convention."""
    axes = attributes.get("axes", "y,x")
    names = axes if isinstance(axes, list) else str(axes).replace(" ", "").split(",")
    checks = {"axes": names[-2:] == ["y", "x"], "row_0": str(attributes.get("row_0", "top")) == "top"}
    if role in (FIELD, PHASE):
        checks["time_dependence"] = str(attributes.get("time_dependence", "-")) in ("-", SIGNS["-"])
    if role == PHASE:
        checks["units"] = parse_units(attributes.get("units", "radians")) == "radians"
    for name, fits in checks.items():
        if not fits:
            raise InvalidInput(
                f"Expected {path} in radians, with axes y,x, row 0 at the top and time {SIGNS['-']}, got {name} "
                f"{attributes[name]}. Write it so, or import it and export it with --axes wavelength,y,x."
            )


def _array(role, path):
    """The only array of a file that can have a role."""
    container = read(path)
    arrays = {name: array for name, array in container.arrays.items() if array.ndim > 1}
    matches = {name: array for name, array in arrays.items() if role_of(name, array) == role}
    arrays = matches if len(matches) == 1 else arrays
    if len(arrays) != 1:
        raise InvalidInput(
            f"{path} has {len(arrays)} arrays of two or more axes. Write the {role} to a separate file."
        )
    ((name, array),) = arrays.items()
    _check_attributes(path, container.attributes | container.array_attributes.get(name, {}), role)
    if name in container.color_arrays:
        if not (array == array[..., :1]).all():
            raise InvalidInput(f"{path} has colors. Write the {role} as a gray picture.")
        array = array[..., 0]
    if (role == FIELD) != np.iscomplexobj(array):
        if role == FIELD:
            raise InvalidInput(
                f"{path} can be a beam's amplitude or its intensity. Give amplitude={path} or intensity={path}."
            )
        raise InvalidInput(
            f"{path} has complex numbers, which cannot be a {role}. Give it without {role}=, as a beam."
        )
    if role == PHASE and array.dtype.kind != "f":
        raise InvalidInput(f"{path} has whole numbers. Write the phases of a beam in radians.")
    return array if role == FIELD else array.astype(float)
