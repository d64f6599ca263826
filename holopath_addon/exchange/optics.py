"""The bench by words, as `--beam`, `--carrier`, `--stop`, `--lens` and `--color-scale` take them, and with arrays of
other programs' files.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..engine import Beam, InvalidInput, Lens, Stop
from .containers import read
from .parts import AMPLITUDE, FIELD, INTENSITY, PHASE, role_of

BEAM_WORDS = "flat|tilt:DX,DY|point:MM|gaussian:WAIST_MM[,X,Y]|FILE"
STOP_WORDS = "circle[:R]|half[:DEGREES]|rectangle:W,H|FILE"
LENS_WORDS = "MM[@MM[@MM[@SHARE]]]|none"
COLOR_WORDS = {
    "color_scale": ("scale of colors", "S[,S..], one for each wavelength"),
    "color_distance": ("distance of colors", "MM[,MM..], one for each wavelength"),
    "color_shift": ("shift of colors", "X,Y[,X,Y..] in millimeters, two for each wavelength"),
}
# Unit of each kind's numbers in words, in that of `Beam`.
_UNITS = {"tilt": math.radians(1), "point": 1e-3, "gaussian": 1e-3}
_ROLES = ({FIELD}, {AMPLITUDE}, {INTENSITY}, {AMPLITUDE, PHASE}, {INTENSITY, PHASE})


def parse_beam(text: str) -> Beam:
    """The beam of words: degrees of a tilt, millimeters of all others, to the right and up; or of a file.

    A file is one of complex numbers, or ``amplitude=FILE`` or ``intensity=FILE``, with ``,phase=FILE`` in radians
    where that was measured, too. Its numbers are taken in proportion, whatever the largest is.

    Raises
    ------
    InvalidInput
        If the words are none, or the file cannot be read or can be read in two ways.
    BackendUnavailable
        If the library for the file is not installed.
    """
    kind, colon, numbers = text.partition(":")
    if text == "flat":
        return Beam()
    if kind in _UNITS:
        return Beam(kind, tuple(_UNITS[kind] * number for number in _numbers(text, numbers)))
    if not beam_files(text):
        raise InvalidInput(f"'{text}' is no beam: give {BEAM_WORDS}.")
    return measured_beam(beam_files(text))


def measured_beam(files: dict[str, Path]) -> Beam:
    """The beam of files by what they hold, see `beam_files`; raises as `parse_beam` does."""
    return Beam("measured", measured=_measured(files))


def beam_files(text: str | None) -> dict[str, Path]:
    """Files that the words of a beam name, by what they hold."""
    if text is None or text == "flat" or text.partition(":")[0] in _UNITS:
        return {}
    if "=" not in text:
        return {FIELD: Path(text)} if Path(text).suffix else {}
    pairs = [part.partition("=") for part in text.split(",")]
    return {role: Path(path) for role, _, path in pairs}


def parse_carrier(text: str) -> tuple[float, float] | str:
    """The carrier of words, see `engine.Optics`.

    Raises
    ------
    InvalidInput
    """
    if text == "auto":
        return text
    numbers = _numbers(text, text, "carrier", "X,Y in units of the band's edge, or auto")
    if len(numbers) != 2:
        raise InvalidInput(f"'{text}' is no carrier: give X,Y in units of the band's edge, or auto.")
    return numbers[0], numbers[1]


def parse_colors(name: str, text: str) -> tuple:
    """Where colors lie by words, see `engine.Optics`, in millimeters: a scale, a distance, or x and y for each.

    Parameters
    ----------
    name : str
        Of `engine.optics.COLORS`.
    text : str

    Raises
    ------
    InvalidInput
    """
    words, unit = COLOR_WORDS[name], 1.0 if name == "color_scale" else 1e-3
    numbers = [unit * number for number in _numbers(text, text, words[0], words[1])]
    if name != "color_shift":
        return tuple(numbers)
    if len(numbers) % 2:
        raise InvalidInput(f"'{text}' is no {words[0]}: give {words[1]}.")
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))


def parse_stop(text: str) -> Stop:
    """The stop of words, with the angle of a half in degrees; or of a picture, which is open where it is bright.

    Raises
    ------
    InvalidInput
        If the words are none, or the picture cannot be read.
    BackendUnavailable
        If the library for it is not installed.
    """
    kind, colon, numbers = text.partition(":")
    if kind in ("circle", "half", "rectangle"):
        unit = math.radians(1) if kind == "half" else 1.0
        given = _numbers(text, numbers, "stop", STOP_WORDS) if colon else []
        return Stop(kind, tuple(unit * number for number in given))
    if not stop_files(text):
        raise InvalidInput(f"'{text}' is no stop: give {STOP_WORDS}.")
    return measured_stop(Path(text))


def measured_stop(path: Path) -> Stop:
    """The stop of a picture, which is open where it is bright; raises as `parse_stop` does."""
    array = _array("stop", path)
    return Stop("measured", measured=array > array.max() / 2)


def parse_lens(text: str) -> Lens | None:
    """The lens of words: its focal length, how far behind the SLM it stands, and how far behind it the picture does, in
    millimeters, and what share of the width there the picture has; None of ``none``.

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
        raise InvalidInput(f"'{text}' is no lens: give {LENS_WORDS}.")
    return Lens(*(1e-3 * number for number in numbers[:3]), *numbers[3:])


def stop_files(text: str | None) -> dict[str, Path]:
    """The file that the words of a stop name."""
    named = text is not None and text.partition(":")[0] not in ("circle", "half", "rectangle")
    return {"stop": Path(text)} if text and named and Path(text).suffix else {}


def _numbers(text, numbers, what="beam", words=BEAM_WORDS):
    try:
        return [float(part) for part in numbers.split(",")]
    except ValueError:
        raise InvalidInput(f"'{text}' is no {what}: give {words}.") from None


def _measured(files):
    if set(files) not in _ROLES:
        raise InvalidInput(
            f"{' and '.join(files)} make no beam: give amplitude=FILE or intensity=FILE, with ,phase=FILE or without."
        )
    arrays = {role: _array(role, path) for role, path in files.items()}
    if FIELD in arrays:
        return arrays[FIELD]
    if len({array.shape for array in arrays.values()}) > 1:
        sizes = " and ".join(f"{role} of {array.shape}" for role, array in arrays.items())
        raise InvalidInput(f"The beam's files differ, {sizes}: write both in one shape.")
    size = arrays[AMPLITUDE] if AMPLITUDE in arrays else arrays[INTENSITY]
    if (size < 0).any():
        raise InvalidInput(f"{next(iter(files.values()))} goes below 0: take off its background first.")
    size = size if AMPLITUDE in arrays else np.sqrt(size)
    return size * np.exp(1j * arrays[PHASE]) if PHASE in arrays else size


def _array(role, path):
    """The only array of a file that can have a role."""
    container = read(path)
    found = {name: array for name, array in container.arrays.items() if array.ndim > 1}
    named = {name: array for name, array in found.items() if role_of(name, array) == role}
    found = named if len(named) == 1 else found
    if len(found) != 1:
        raise InvalidInput(
            f"{path} has {len(found)} arrays of two or more axes: write the {role} to a file of its own."
        )
    ((name, array),) = found.items()
    if name in container.colored:
        if not (array == array[..., :1]).all():
            raise InvalidInput(f"{path} has colors: write the {role} as a gray picture.")
        array = array[..., 0]
    if (role == FIELD) != np.iscomplexobj(array):
        if role == FIELD:
            raise InvalidInput(
                f"{path} can be a beam's amplitude or its intensity: say amplitude={path} or intensity={path}."
            )
        raise InvalidInput(
            f"{path} holds complex numbers, which are no {role}: give it without {role}=, as a beam."
        )
    if role == PHASE and array.dtype.kind != "f":
        raise InvalidInput(f"{path} has whole numbers: write the phases of a beam in radians.")
    return array if role == FIELD else array.astype(float)
