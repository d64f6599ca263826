"""Fields and phases as the contents of a file, and the reverse, also of files that other programs wrote."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engine import Camera, Hologram, InvalidInput, Optics, PhaseHologram, WaveField
from ..engine.memory import shortage
from ..engine.optics import ON_AXIS
from ..engine.pixels import Pitch
from ..engine.waves.bit_layout import LAYOUTS, layout_beside
from ..engine.waves.propagation import propagate
from . import parts
from .containers import Container
from .conventions import AXES, SIGNS, Convention
from .parts import AMPLITUDE, FIELD, IMAGINARY, INTENSITY, PHASE, REAL
from .phases import CHOICES, LEVELS, TURN, known_units, radians_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

FORMAT_VERSION = 1
FOCAL = 50e-3  # metres, of the eyepiece that a field is seen through where nothing says so
NEAR = 1.0  # metres, of what is seen at the near end then
MOST_LAYERS = 1 << 12  # frames times wavelengths
IMPORTED = "imported"  # method of phases that nothing says more of
TRANSFERS = ("linear", "srgb")  # from light to the numbers of a picture of amplitudes or intensities
# holograms in a color picture: of slm.packing, those without a device's heights
PACKINGS = {"colour": 3, "bits": 24} | {name: layout.each for name, layout in LAYOUTS.items()}


@dataclass(frozen=True)
class Given:
    """What is said of a file's array; None stands for what the file says, and else for the default.

    Attributes
    ----------
    array : str or mapping of str to str
        Name of the only array, or of that of each role of `parts.ROLES`. Default: as the names say, in one way.
    convention : Convention
        Default: what the file says, else ours.
    pitch : float or (float, float)
        Metres; of pixels that are not square (x, y).
    wavelengths : sequence of float
        Metres.
    depth_range : (float, float)
        Distances of the far and the near end from the SLM, metres. Default: what the aperture can show.
    near : float
        World depth at the near end, metres. Default: `NEAR`.
    fov : float
        Horizontal field of view, radians. Default: that of an eyepiece with the focal length `FOCAL`.
    distance : float
        Of the plane that a field is given on from the SLM, metres. Default: 0.
    bits : int
        Of levels: 2^bits of them are a turn. Default: those of the array's type, if the levels fill it.
    units : str
        Of phases, of `phases.CHOICES`. Default: what the file says, else what the numbers alone can be.
    transfer : str
        Of amplitudes or intensities in whole numbers, of `TRANSFERS`.
    packing : str
        How a color picture holds phases, of `PACKINGS`, or which bits of its channels a level is, as
        `engine.waves.bit_layout` reads it. Default: three wavelengths.
    optics : Optics
        The bench around the SLM. Default: what the file says, else the default one.
    """

    array: str | Mapping[str, str] | None = None
    convention: Convention | None = None
    pitch: Pitch | None = None
    wavelengths: Sequence[float] | None = None
    depth_range: tuple[float, float] | None = None
    near: float | None = None
    fov: float | None = None
    distance: float | None = None
    bits: int | None = None
    units: str | None = None
    transfer: str | None = None
    packing: str | None = None
    optics: Optics | None = None


def container_of(thing: WaveField | PhaseHologram, convention: Convention | None = None) -> Container:
    """A field or phases for a file.

    Parameters
    ----------
    thing : WaveField or PhaseHologram
    convention : Convention, optional
        Default: ours.

    Raises
    ------
    InvalidInput
        If the convention has no axis for several frames or wavelengths.
    """
    convention = convention or Convention()
    hologram, phase = thing.hologram, isinstance(thing, PhaseHologram)
    attributes: dict[str, Any] = {
        "format": "HoloPath exchange",
        "format_version": FORMAT_VERSION,
        "kind": PHASE if phase else FIELD,
        "units": "radians" if phase else "amplitude; its squared modulus is scene radiance",
        "axes": ",".join(convention.axes or AXES),
        "time_dependence": SIGNS[convention.time],
        "row_0": convention.rows,
        "pitch_m": list(hologram.pitch) if isinstance(hologram.pitch, tuple) else hologram.pitch,
        "wavelengths_m": list(hologram.wavelengths),
        "depth_far_m": hologram.depth_far,
        "depth_near_m": hologram.depth_near,
        "depth_mapping": hologram.depth_mapping,
        "near_m": thing.near,
        "camera": json.dumps(thing.camera.to_dict()),
    }
    if hologram.optics != ON_AXIS:
        attributes["optics"] = json.dumps(hologram.optics.to_dict())
    if isinstance(thing, PhaseHologram):
        attributes |= {"method": thing.method, "gains": list(thing.gains)}
    else:
        attributes["plan"] = json.dumps(thing.plan)
    return Container({PHASE if phase else FIELD: convention.theirs(thing.data)}, attributes)


def hologram_of(container: Container, given: Given | None = None) -> WaveField | PhaseHologram:
    """A field or phases of a file's arrays: complex numbers, two real arrays, or phases alone.

    Parameters
    ----------
    container : Container
        Of a file, or of several by `read_parts`; attributes as `container_of` names them count, and none is needed.
    given : Given, optional
        What is said goes before what the file says.

    Raises
    ------
    InvalidInput
        If something is missing, does not fit, can be read in two ways, or no display can have it.
    """
    given = _with_bits(given or Given())
    chosen = parts.choose(container, given.array)
    main = next(role for role in (FIELD, PHASE, REAL) if role in chosen.arrays)
    attributes = chosen.attributes | chosen.own[main]
    pitch, wavelengths = _grid(given, attributes)
    convention = given.convention or _convention(attributes)
    layers = _laid_out(chosen, convention, given, wavelengths)
    data = layers[main]
    if len(wavelengths) != data.shape[1]:
        said = "is 1 wavelength" if len(wavelengths) == 1 else f"are {len(wavelengths)} wavelengths"
        raise InvalidInput(
            f"There {said} for {data.shape[1]} in the array, which has {_shape(chosen.arrays[main])}: name its axes by "
            "--axes, or other --wavelengths."
        )
    ends = given.depth_range or (
        _number(attributes, "depth_far_m"),
        _number(attributes, "depth_near_m"),
    )
    mapping = str(attributes.get("depth_mapping", "fit"))
    height, width = data.shape[-2:]
    # pyrefly: ignore[bad-argument-type]  # None for an end is its default
    hologram = Hologram(width, height, pitch, wavelengths, *ends, mapping, optics=_optics(attributes, given))
    near = given.near or _number(attributes, "near_m") or NEAR
    if not 0 < near < math.inf:
        raise InvalidInput(f"The near end of the scene must be a positive distance, not {near:g} m.")
    camera = _camera(attributes, given.fov, hologram)
    _refuse_unused(given, chosen)
    if given.distance and set(layers) == {PHASE}:
        raise InvalidInput("Phases are those of the SLM itself: leave out their distance from it.")
    angle = radians_of(layers[PHASE], *_units(attributes, given, layers[PHASE])) if PHASE in layers else None
    if set(layers) != {PHASE}:
        field = _at_slm(_field(layers, angle, chosen, given, convention), given.distance or 0.0, hologram)
        return WaveField(field, hologram, camera, near, _plan(attributes))
    gains = _numbers(attributes, "gains") or (1.0,) * len(wavelengths)
    if len(gains) != len(wavelengths):
        raise InvalidInput(f"There are {len(gains)} gains for {len(wavelengths)} wavelengths.")
    method = str(attributes.get("method", IMPORTED))
    return PhaseHologram(_phases(data, angle, convention), hologram, camera, near, method, gains)


def check_packing(name: str) -> str:
    """The name, if it is of `PACKINGS` or bits of channels.

    Raises
    ------
    InvalidInput
    """
    if name not in PACKINGS:
        layout_beside(PACKINGS, name)
    return name


def _layout(packing):
    """The `BitLayout` of a packing that is one, else None."""
    if packing is None or packing in ("colour", "bits"):
        return None
    return LAYOUTS.get(packing) or layout_beside(PACKINGS, packing)


def _with_bits(given: Given) -> Given:
    """What is said, with levels of the bits that a packing spreads over channels."""
    layout = _layout(given.packing)
    if layout is None:
        return given
    if given.bits not in (None, layout.bits):
        raise InvalidInput(
            f"The packing {given.packing} has levels of {layout.bits} bits, not {given.bits}: leave out --bits."
        )
    if given.units not in (None, LEVELS):
        raise InvalidInput(
            f"The packing {given.packing} has levels, not {given.units}: leave out --units, or --packing."
        )
    return replace(given, bits=layout.bits, units=LEVELS)


def _refuse_unused(given, chosen):
    """What is said of an array that is not there is a mistake."""
    arrays = chosen.arrays
    if PHASE not in arrays and (given.units or given.bits):
        raise InvalidInput(
            "Units and bits are those of phases, and there are none: leave out --units and --bits."
        )
    counted = [role for role in (AMPLITUDE, INTENSITY) if role in arrays and arrays[role].dtype.kind in "iu"]
    if given.transfer and not counted:
        raise InvalidInput(
            "--transfer is of amplitudes or intensities in whole numbers, and there are none: leave it out."
        )
    if given.transfer not in (None, *TRANSFERS):
        raise InvalidInput(
            f"There is no transfer function {given.transfer}: choose {' or '.join(TRANSFERS)}."
        )


def _units(attributes, given, array):
    """Units and bits of phases; what the file says of them counts where nothing else is said."""
    units, bits = given.units, given.bits
    if units is None and "units" in attributes:
        units = known_units(attributes["units"])
        if units is None:
            raise InvalidInput(
                f"The file's units are {str(attributes['units'])[:40]!r}: say by --units which of "
                f"{', '.join(CHOICES)} the phases are in."
            )
    said = _number(attributes, "bits")
    if said is not None and (units == LEVELS or (units is None and array.dtype.kind in "iub")):
        if bits not in (None, said):
            raise InvalidInput(f"The file's levels have {said:g} bits, not {bits}: leave out --bits.")
        units, bits = LEVELS, int(said)
    return units, bits


def _laid_out(chosen, convention, given, wavelengths):
    """Each role's numbers as shape (frame, wavelength, y, x), with the sign of time that the file has."""
    arrays, axes = dict(chosen.arrays), convention.axes
    if given.packing and (set(arrays) != {PHASE} or not chosen.colored):
        raise InvalidInput("--packing is of phases in a color picture, and there is none: leave it out.")
    if chosen.colored:
        of_frames = axes is not None and set(axes) == {"frame", "y", "x"}
        arrays, last = (arrays, ("frame",)) if of_frames else _of_channels(chosen, given, wavelengths)
        axes = tuple(name for name in axes or AXES if name in ("y", "x")) + last
    if len({array.shape for array in arrays.values()}) > 1:
        sizes = " and ".join(f"{role} has {_shape(array)}" for role, array in arrays.items())
        raise InvalidInput(f"The arrays differ: {sizes}: write both in one shape.")
    convention = replace(convention, axes=axes)
    stored = given.convention is None and not chosen.colored
    return {role: _layers(array, convention, stored) for role, array in arrays.items()}


def _of_channels(chosen, given, wavelengths):
    """Arrays of color pictures as phases and amplitudes, and the names of their axes after y and x."""
    arrays, count = chosen.arrays, len(wavelengths)
    if given.packing:
        array, layout = arrays[PHASE], _layout(given.packing)
        each = PACKINGS[given.packing] if layout is None else layout.each
        if given.packing != "colour" and array.dtype != np.uint8:
            raise InvalidInput(
                f"Holograms lie in the bits of 8-bit channels, not of {array.dtype}: leave out --packing."
            )
        if given.packing == "bits":
            array = np.unpackbits(array, axis=-1, bitorder="little").view(bool)
        elif layout is not None:
            if layout.stray(array):
                raise InvalidInput(
                    f"The picture has bits besides those of the packing {given.packing}: choose another packing, or "
                    "write it without them."
                )
            array = np.stack(layout.gathered(array), -1)
        if each % count:
            raise InvalidInput(
                f"{each} holograms are no whole frames of {count} wavelengths: give other --wavelengths."
            )
        return {PHASE: array.reshape(*array.shape[:2], each // count, count)}, ("frame", "wavelength")
    colored = [arrays[role] for role in chosen.colored]
    if all((array == array[..., :1]).all() for array in colored):  # gray that is stored as colors
        return {role: a[..., 0] if role in chosen.colored else a for role, a in arrays.items()}, ()
    ways = "say --packing colour or bits for phases that share it, --array red, green or blue for one channel"
    if count != 3:
        raise InvalidInput(
            f"The picture has three channels for {count} wavelength{'s' if count > 1 else ''}: give three "
            f"--wavelengths if they are its colors, or {ways}."
        )
    if not wavelengths[0] > wavelengths[1] > wavelengths[2]:
        raise InvalidInput(
            "The channels are red, green and blue, and the wavelengths have another order: give --wavelengths from the "
            "longest to the shortest, or say --packing colour to take them as they are."
        )
    return arrays, ("wavelength",)


def _field(layers, angle, chosen, given, convention):
    """Complex amplitude, complex64, of one complex array or of two real ones."""
    first = next(iter(layers.values()))
    field = np.empty(first.shape, np.complex64)
    scales = {role: _scale(chosen, role, given.transfer) for role in (AMPLITUDE, INTENSITY) if role in layers}
    for number in range(len(first)):
        frame = {role: data[number] for role, data in layers.items()}
        with np.errstate(over="ignore", invalid="ignore"):
            if FIELD in frame:
                light = frame[FIELD]
            elif REAL in frame:
                light = frame[REAL] + 1j * frame[IMAGINARY]
            else:
                (role,) = scales
                size = scales[role](frame[role])
                if (size < 0).any():
                    raise InvalidInput(
                        f"The {role} goes below 0: give it as real and imaginary, or write it without the sign."
                    )
                light = (np.sqrt(size) if role == INTENSITY else size) * np.exp(1j * angle(frame[PHASE]))
            field[number] = convention.signed(light)
        if not np.isfinite(field[number]).all():
            raise InvalidInput("The field has values that single precision does not hold: scale it down.")
    return field


def _scale(chosen, role, transfer):
    """The function from the numbers of an amplitude or intensity to values, with 1 for the largest whole number."""
    array = chosen.arrays[role]
    if array.dtype.kind in "fb":
        return lambda part: np.asarray(part, np.float64)
    if array.dtype.kind != "u" or array.dtype.itemsize > 2:
        raise InvalidInput(
            f"The {role} is of {array.dtype}, which has no largest value: write numbers with a fraction."
        )
    if transfer is None:
        raise InvalidInput(
            f"The {role} is in whole numbers, which can be proportional to it (--transfer linear) or encoded for "
            "screens (--transfer srgb): say which."
        )
    full = 2 ** int(chosen.own[role].get("bits", 8 * array.dtype.itemsize)) - 1

    def values(part):
        part = np.asarray(part, np.float64) / full
        if transfer == "linear":
            return part
        return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1

    return values


def _phases(data, angle, convention):
    """Radians in [0, 2 pi), float32."""
    phases = np.empty(data.shape, np.float32)
    for number, frame in enumerate(data):
        phases[number] = np.mod(convention.signed(angle(frame)), TURN)
    phases[phases >= np.float32(TURN)] = 0
    return phases


def _convention(attributes):
    axes = attributes.get("axes")
    times = {text: sign for sign, text in SIGNS.items()}
    time = str(attributes.get("time_dependence", SIGNS["-"]))
    return Convention(
        tuple(str(axes).replace(" ", "").split(",")) if axes else None,
        times.get(time, time),
        str(attributes.get("row_0", "top")),
    )


def _layers(array, convention, stored):
    """An array as a view of shape (frame, wavelength, y, x)."""
    if array.ndim > len(AXES):
        raise InvalidInput(
            f"The array has {array.ndim} axes, and at most {len(AXES)} have a meaning: write {', '.join(AXES)} alone, "
            "and amplitude and phase, or real and imaginary, as two arrays."
        )
    if stored and convention.axes is not None:  # MATLAB leaves out the last axes where they have one place
        array = array.reshape(*array.shape, *(1,) * (len(convention.axes) - array.ndim))
    data = convention.laid_out(array)
    if 0 in data.shape or math.prod(data.shape[:2]) > MOST_LAYERS:
        raise InvalidInput(f"An array of {_shape(array)} is no hologram's: see its axes.")
    shortage(4 * array.nbytes, "Reading the array")
    for frame in data:
        if not np.isfinite(frame).all():
            raise InvalidInput("The array holds values that are not finite: write it again.")
    return data


def _grid(given, attributes):
    pitch = given.pitch or _pitch(attributes)
    wavelengths = given.wavelengths or _numbers(attributes, "wavelengths_m")
    if not pitch:
        raise InvalidInput("The file does not say the pixel pitch: give --pitch, in micrometers.")
    if not wavelengths:
        raise InvalidInput("The file does not say the wavelengths: give --wavelengths, in nanometers.")
    return pitch, tuple(wavelengths)


def _pitch(attributes):
    """One number, or the two of pixels that are not square."""
    values = _numbers(attributes, "pitch_m")
    if values is not None and len(values) > 2:
        raise InvalidInput(
            f"The file's pitch_m are {len(values)} numbers: it should be one, or those of x and y."
        )
    return values[0] if values is not None and len(values) == 1 else values


def _number(attributes, name):
    values = _numbers(attributes, name)
    if values is not None and len(values) != 1:
        raise InvalidInput(f"The file's {name} are {len(values)} numbers: it should be one.")
    return values and values[0]


def _numbers(attributes, name):
    said = attributes.get(name)
    return (
        None
        if said is None
        else tuple(_finite(v, name) for v in (said if isinstance(said, list) else [said]))
    )


def _finite(value, name):
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InvalidInput(f"The file's {name} is {str(value)[:40]!r}: it should be a number.")
    return float(value)


def _optics(attributes, given):
    if given.optics is not None or "optics" not in attributes:
        return given.optics or ON_AXIS
    try:
        return Optics.from_dict(json.loads(attributes["optics"]))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidInput(
            f"The file's optics cannot be read ({error}): give --beam, --carrier, --stop and --lens."
        ) from error


def _camera(attributes, fov, hologram):
    said = attributes.get("camera")
    if said is None:
        grid, lens = hologram.in_air, hologram.optics.lens
        focal = lens.focal if lens and hologram.depth_mapping == "eyepiece" else FOCAL
        default = 2 * math.atan(grid.width * grid.pitch_x / (2 * focal))
        return Camera(np.eye(4), fov or default)
    try:
        camera = Camera.from_dict(json.loads(said))
    except InvalidInput:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidInput(f"The file's camera cannot be read ({error}): write the file again.") from error
    return replace(camera, fov_x=fov) if fov else camera


def _plan(attributes):
    try:
        plan = json.loads(attributes.get("plan", "{}"))
    except (TypeError, ValueError):
        plan = {}
    return plan if isinstance(plan, dict) else {}


def _at_slm(field, distance, hologram):
    if not distance:
        return field
    for colour, wavelength in enumerate(hologram.wavelengths):
        for frame in field:
            frame[colour] = propagate(frame[colour], -distance, hologram.pitch_at(wavelength), wavelength)
    return field


def _shape(array):
    return " x ".join(map(str, array.shape))
