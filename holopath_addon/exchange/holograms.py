"""Conversion of fields and phases to the contents of a file, and of files of any program to them."""

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
from .phases import CHOICES, LEVELS, TURN, parse_units, radians_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

FORMAT_VERSION = 1
DEFAULT_FOCAL = 50e-3  # meters, of the eyepiece
DEFAULT_NEAR = 1.0  # meters, world depth of the near end
MAX_LAYERS = 1 << 12  # frames times wavelengths
DEFAULT_METHOD = "imported"  # of phases
TRANSFERS = (
    "linear",
    "srgb",
)  # functions from light to the numbers of a picture of amplitudes or intensities
# Numbers of holograms in a color picture; packings of slm.packing without a device's heights
PACKINGS = {"color": 3, "bits": 24} | {name: layout.each for name, layout in LAYOUTS.items()}


@dataclass(frozen=True)
class ReadOptions:
    """Options for reading a file's arrays; None stands for the file's attribute, or else for the default.

    Attributes
    ----------
    array : str or mapping of str to str
        Name of the only array, or of the array of each role of `parts.ROLES`. Default: by the roles in the names, if
        they are unambiguous.
    convention : Convention or mapping of str to Any
        The whole convention, or fields of `Convention` that differ from the file's. Default: HoloPath's.
    pitch : float or (float, float)
        Pixel pitch, meters; (x, y) of pixels that are not square. Required.
    wavelengths : sequence of float
        Meters. Required.
    depth_range : (float, float)
        Distances of the far and the near end from the SLM, meters. Default: the range of the aperture.
    near : float
        World depth at the near end, meters. Default: `DEFAULT_NEAR`.
    fov : float
        Horizontal field of view, radians. Default: that of an eyepiece with the focal length `DEFAULT_FOCAL`.
    distance : float
        Distance of a field's plane from the SLM, meters. Default: 0.
    bits : int
        Bits of levels: 2^bits of them are a turn. Default: those of the array's type, if the levels fill it.
    units : str
        Units of phases, one of `phases.CHOICES`. Default: the only units that fit the numbers.
    transfer : str
        Transfer function of amplitudes or intensities in integers, one of `TRANSFERS`.
    packing : str
        Packing of phases in a color picture: one of `PACKINGS`, or bits of its channels, see
        `engine.waves.bit_layout`. Default: three wavelengths.
    optics : Optics or mapping of str to Any
        The bench around the SLM, or fields of `Optics` that differ from the file's. Default: on-axis optics.
    """

    array: str | Mapping[str, str] | None = None
    convention: Convention | Mapping[str, Any] | None = None
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
    optics: Optics | Mapping[str, Any] | None = None


def container_of(thing: WaveField | PhaseHologram, convention: Convention | None = None) -> Container:
    """Convert a field or phases to the contents of a file.

    Parameters
    ----------
    thing : WaveField or PhaseHologram
    convention : Convention, optional
        Default: HoloPath's.

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
    return Container({PHASE if phase else FIELD: convention.from_holopath(thing.data)}, attributes)


def hologram_of(container: Container, options: ReadOptions | None = None) -> WaveField | PhaseHologram:
    """Convert a file's arrays to a field or phases: complex numbers, two real arrays, or only phases.

    Parameters
    ----------
    container : Container
        Contents of a file, or of several by `read_parts`, with optional attributes as `container_of` writes them.
    options : ReadOptions, optional
        These override the file's attributes.

    Raises
    ------
    InvalidInput
        If information is missing, contradictory or ambiguous, or does not fit any display.
    """
    options = _with_bits(options or ReadOptions())
    selection = parts.choose(container, options.array)
    main = next(role for role in (FIELD, PHASE, REAL) if role in selection.arrays)
    attributes = selection.attributes | selection.array_attributes[main]
    pitch, wavelengths = _grid(options, attributes)
    convention = _convention(attributes, options.convention)
    layers = _reorder(selection, convention, options, wavelengths)
    data = layers[main]
    if len(wavelengths) != data.shape[1]:
        raise InvalidInput(
            f"The array of {_shape(selection.arrays[main])} has {data.shape[1]} on the axis of wavelengths, got "
            f"{len(wavelengths)}. Name its axes by --axes, or give other --wavelengths."
        )
    ends = options.depth_range or (
        _number(attributes, "depth_far_m"),
        _number(attributes, "depth_near_m"),
    )
    mapping = str(attributes.get("depth_mapping", "fit"))
    height, width = data.shape[-2:]
    optics = _optics(attributes, options.optics)
    # pyrefly: ignore[bad-argument-type]  # None for an end is its default
    hologram = Hologram(width, height, pitch, wavelengths, *ends, mapping, optics=optics)
    near = next(
        each for each in (options.near, _number(attributes, "near_m"), DEFAULT_NEAR) if each is not None
    )
    if not 0 < near < math.inf:
        raise InvalidInput(f"The near end of the scene must be at a positive distance, got {near:g} m.")
    camera = _camera(attributes, options.fov, hologram)
    _refuse_unused(options, selection)
    distance = options.distance or 0.0
    if not math.isfinite(distance):
        raise InvalidInput(f"Expected a finite distance of the field from the SLM, got {distance:g}.")
    if distance and set(layers) == {PHASE}:
        raise InvalidInput("Phases are those of the SLM itself. Omit the distance from it.")
    angle = (
        radians_of(layers[PHASE], *_units(attributes, options, layers[PHASE])) if PHASE in layers else None
    )
    if set(layers) != {PHASE}:
        field = _at_slm(_field(layers, angle, selection, options, convention), distance, hologram)
        return WaveField(field, hologram, camera, near, _plan(attributes))
    gains = _numbers(attributes, "gains") or (1.0,) * len(wavelengths)
    if len(gains) != len(wavelengths):
        raise InvalidInput(f"Expected a gain for each of {len(wavelengths)} wavelengths, got {len(gains)}.")
    method = str(attributes.get("method", DEFAULT_METHOD))
    return PhaseHologram(_phases(data, angle, convention), hologram, camera, near, method, gains)


def check_packing(name: str) -> str:
    """Check that a name is one of `PACKINGS` or bits of channels, and return it.

    Raises
    ------
    InvalidInput
    """
    if name not in PACKINGS:
        layout_beside(PACKINGS, name)
    return name


def _layout(packing):
    """The `BitLayout` of a packing; None for other packings."""
    if packing is None or packing in ("color", "bits"):
        return None
    return LAYOUTS.get(packing) or layout_beside(PACKINGS, packing)


def _with_bits(options: ReadOptions) -> ReadOptions:
    """The options with units and bits of a packing that spreads levels over channels."""
    layout = _layout(options.packing)
    if layout is None:
        return options
    if options.bits not in (None, layout.bits):
        raise InvalidInput(
            f"The packing {options.packing} has levels of {layout.bits} bits, not {options.bits}. Omit --bits."
        )
    if options.units not in (None, LEVELS):
        raise InvalidInput(
            f"The packing {options.packing} has levels, not {options.units}. Omit --units, or --packing."
        )
    return replace(options, bits=layout.bits, units=LEVELS)


def _refuse_unused(options, selection):
    """Refuse options for arrays that do not exist."""
    arrays = selection.arrays
    if PHASE not in arrays and (options.units or options.bits):
        raise InvalidInput("Units and bits apply to phases, and there are none. Omit --units and --bits.")
    integers = [role for role in (AMPLITUDE, INTENSITY) if role in arrays and arrays[role].dtype.kind in "iu"]
    if options.transfer and not integers:
        raise InvalidInput(
            "--transfer applies to amplitudes or intensities in whole numbers, and there are none. Omit it."
        )
    if options.transfer not in (None, *TRANSFERS):
        raise InvalidInput(f"Expected a transfer function {' or '.join(TRANSFERS)}, got {options.transfer}.")


def _units(attributes, options, array):
    """Units and bits of phases: the options', else the file's."""
    units, bits = options.units, options.bits
    if units is None and "units" in attributes:
        units = parse_units(attributes["units"])
        if units is None:
            raise InvalidInput(
                f"The file's units are {str(attributes['units'])[:40]!r}. Give those of the phases by --units: "
                f"{', '.join(CHOICES)}."
            )
    stored = _number(attributes, "bits")
    if stored is not None and (units == LEVELS or (units is None and array.dtype.kind in "iub")):
        if bits not in (None, stored):
            raise InvalidInput(f"The file's levels have {stored:g} bits, not {bits}. Omit --bits.")
        units, bits = LEVELS, int(stored)
    return units, bits


def _reorder(selection, convention, options, wavelengths):
    """Numbers of each role, shape (frame, wavelength, y, x), with the file's sign of time."""
    arrays, axes = dict(selection.arrays), convention.axes
    if options.packing and (set(arrays) != {PHASE} or not selection.color_arrays):
        raise InvalidInput("--packing applies to phases in a color picture, and there is none. Omit it.")
    if selection.color_arrays:
        of_frames = axes is not None and set(axes) == {"frame", "y", "x"}
        arrays, last = (arrays, ("frame",)) if of_frames else _of_channels(selection, options, wavelengths)
        axes = tuple(name for name in axes or AXES if name in ("y", "x")) + last
    if len({array.shape for array in arrays.values()}) > 1:
        sizes = " and ".join(f"{role} has {_shape(array)}" for role, array in arrays.items())
        raise InvalidInput(f"The arrays differ in shape: {sizes}. Write both in one shape.")
    convention = replace(convention, axes=axes)
    given = options.convention
    from_file = not (isinstance(given, Convention) or "axes" in (given or ()) or selection.color_arrays)
    return {role: _layers(array, convention, from_file) for role, array in arrays.items()}


def _of_channels(selection, options, wavelengths):
    """Arrays of color pictures, and the names of their axes after y and x."""
    arrays, count = selection.arrays, len(wavelengths)
    if options.packing:
        array, layout = arrays[PHASE], _layout(options.packing)
        each = PACKINGS[options.packing] if layout is None else layout.each
        if options.packing != "color" and array.dtype != np.uint8:
            raise InvalidInput(
                f"Holograms are packed in the bits of 8-bit channels, not of {array.dtype}. Omit --packing."
            )
        if options.packing == "bits":
            array = np.unpackbits(array, axis=-1, bitorder="little").view(bool)
        elif layout is not None:
            if layout.stray(array):
                raise InvalidInput(
                    f"The picture has bits besides those of the packing {options.packing}. Choose another packing, or "
                    "write it without them."
                )
            array = np.stack(layout.gather(array), -1)
        if each % count:
            raise InvalidInput(
                f"{each} holograms are not a multiple of {count} wavelengths. Give other --wavelengths."
            )
        return {PHASE: array.reshape(*array.shape[:2], each // count, count)}, ("frame", "wavelength")
    colors = [arrays[role] for role in selection.color_arrays]
    if all((array == array[..., :1]).all() for array in colors):  # gray stored as RGB
        return {role: a[..., 0] if role in selection.color_arrays else a for role, a in arrays.items()}, ()
    ways = "--packing color or bits for phases that share it, or --array red, green or blue for one channel"
    if count != 3:
        raise InvalidInput(
            f"The picture has three channels for {count} wavelength{'s' if count > 1 else ''}. Give three "
            f"--wavelengths if they are its colors, {ways}."
        )
    if not wavelengths[0] > wavelengths[1] > wavelengths[2]:
        raise InvalidInput(
            "The channels are red, green and blue, but the wavelengths have another order. Give --wavelengths from the "
            "longest to the shortest, or --packing color to keep their order."
        )
    return arrays, ("wavelength",)


def _field(layers, angle, selection, options, convention):
    """Complex amplitude, complex64, from one complex array or two real ones."""
    first = next(iter(layers.values()))
    field = np.empty(first.shape, np.complex64)
    scales = {
        role: _scale(selection, role, options.transfer) for role in (AMPLITUDE, INTENSITY) if role in layers
    }
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
                        f"The {role} has negative values. Give it as real and imaginary, or write it without the sign."
                    )
                light = (np.sqrt(size) if role == INTENSITY else size) * np.exp(1j * angle(frame[PHASE]))
            field[number] = convention.convert_sign(light)
        if not np.isfinite(field[number]).all():
            raise InvalidInput("The field has values beyond single precision. Scale it down.")
    return field


def _scale(selection, role, transfer):
    """Make the function from numbers of an amplitude or intensity to values; the largest integer becomes 1."""
    array = selection.arrays[role]
    if array.dtype.kind in "fb":
        return lambda part: np.asarray(part, np.float64)
    if array.dtype.kind != "u" or array.dtype.itemsize > 2:
        raise InvalidInput(
            f"The {role} is of {array.dtype}, whose largest value is unclear. Write floating-point numbers."
        )
    if transfer is None:
        raise InvalidInput(
            f"The {role} is in whole numbers, which can be proportional to it (--transfer linear) or encoded for "
            "screens (--transfer srgb). Choose one."
        )
    bits = _number(selection.array_attributes[role], "bits")
    if bits is not None and bits not in range(1, 17):
        raise InvalidInput(f"Expected 1 to 16 bits of the {role} in the file, got {bits:g}.")
    full = 2 ** int(8 * array.dtype.itemsize if bits is None else bits) - 1

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
        phases[number] = np.mod(convention.convert_sign(angle(frame)), TURN)
    phases[phases >= np.float32(TURN)] = 0
    return phases


def _convention(attributes, given):
    """The given convention, or the file's with what is given of one."""
    if isinstance(given, Convention):
        return given
    axes = attributes.get("axes")
    times = {text: sign for sign, text in SIGNS.items()}
    time = str(attributes.get("time_dependence", SIGNS["-"]))
    stored: dict[str, Any] = {
        "axes": tuple(str(axes).replace(" ", "").split(",")) if axes else None,
        "time": times.get(time, time),
        "rows": str(attributes.get("row_0", "top")),
    }
    return Convention(**stored | dict(given or {}))


def _layers(array, convention, from_file):
    """A view of an array, shape (frame, wavelength, y, x); `from_file`: the convention is the file's."""
    if array.ndim > len(AXES):
        raise InvalidInput(
            f"Expected an array of at most {len(AXES)} axes, {', '.join(AXES)}, got {array.ndim}. Write amplitude and "
            "phase, or real and imaginary, as two arrays."
        )
    if from_file and convention.axes is not None:  # MATLAB omits trailing axes of length 1
        array = array.reshape(*array.shape, *(1,) * (len(convention.axes) - array.ndim))
    data = convention.reorder(array)
    if 0 in data.shape or math.prod(data.shape[:2]) > MAX_LAYERS:
        raise InvalidInput(f"An array of {_shape(array)} cannot be a hologram. Name its axes by --axes.")
    shortage(4 * array.nbytes, "Reading the array")
    for frame in data:
        if not np.isfinite(frame).all():
            raise InvalidInput("The array has values that are not finite. Write it again.")
    return data


def _grid(options, attributes):
    pitch = _pitch(attributes) if options.pitch is None else options.pitch
    wavelengths = options.wavelengths or _numbers(attributes, "wavelengths_m")
    if pitch is None:
        raise InvalidInput("The file has no pixel pitch. Give --pitch, in micrometers.")
    if not wavelengths:
        raise InvalidInput("The file has no wavelengths. Give --wavelengths, in nanometers.")
    return pitch, tuple(wavelengths)


def _pitch(attributes):
    """The pixel pitch: one number, or two for pixels that are not square."""
    values = _numbers(attributes, "pitch_m")
    if values is not None and len(values) > 2:
        raise InvalidInput(
            f"Expected pitch_m of the file to be one number, or those of x and y, got {len(values)} numbers."
        )
    return values[0] if values is not None and len(values) == 1 else values


def _number(attributes, name):
    values = _numbers(attributes, name)
    if values is not None and len(values) != 1:
        raise InvalidInput(f"Expected {name} of the file to be one number, got {len(values)}.")
    return values and values[0]


def _numbers(attributes, name):
    values = attributes.get(name)
    if values is None:
        return None
    return tuple(_finite(value, name) for value in (values if isinstance(values, list) else [values]))


def _finite(value, name):
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InvalidInput(f"Expected {name} of the file to be a number, got {str(value)[:40]!r}.")
    return float(value)


def _optics(attributes, given):
    """The given bench, or the file's with what is given of one, which need not be in the file then."""
    if isinstance(given, Optics):
        return given
    changes = dict(given or {})
    try:
        stored = json.loads(attributes.get("optics", "{}"))
        kept = Optics.from_dict({name: value for name, value in stored.items() if name not in changes})
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidInput(
            f"The file's optics cannot be read ({error}). Give --beam, --carrier, --stop and --lens."
        ) from error
    return replace(kept, **changes)


def _camera(attributes, fov, hologram):
    text = attributes.get("camera")
    if text is None:
        grid, lens = hologram.in_air, hologram.optics.lens
        focal = lens.focal if lens and hologram.depth_mapping == "eyepiece" else DEFAULT_FOCAL
        default = 2 * math.atan(grid.width * grid.pitch_x / (2 * focal))
        return Camera(np.eye(4), default if fov is None else fov)
    try:
        camera = Camera.from_dict(json.loads(text))
    except InvalidInput:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidInput(f"The file's camera cannot be read ({error}). Write the file again.") from error
    return camera if fov is None else replace(camera, fov_x=fov)


def _plan(attributes):
    try:
        plan = json.loads(attributes.get("plan", "{}"))
    except (TypeError, ValueError):
        plan = {}
    return plan if isinstance(plan, dict) else {}


def _at_slm(field, distance, hologram):
    if not distance:
        return field
    for color, wavelength in enumerate(hologram.wavelengths):
        for frame in field:
            frame[color] = propagate(frame[color], hologram.pitch_at(wavelength), wavelength, -distance)
    return field


def _shape(array):
    return " x ".join(map(str, array.shape))
