"""Fields and phases as the contents of a file, and the reverse, also of files that other programs wrote."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engine import Camera, Hologram, InvalidInput, PhaseHologram, WaveField
from ..engine.memory import shortage
from ..engine.waves.propagation import propagate
from .containers import Container
from .conventions import AXES, SIGNS, Convention

if TYPE_CHECKING:
    from collections.abc import Sequence

FORMAT_VERSION = 1
FIELD, PHASE = "field", "phase"  # names of the arrays
FOCAL = 50e-3  # metres, of the eyepiece that a field is seen through where nothing says so
NEAR = 1.0  # metres, of what is seen at the near end then
MOST_LAYERS = 1 << 12  # frames times wavelengths
IMPORTED = "imported"  # method of phases that nothing says more of


@dataclass(frozen=True)
class Given:
    """What is said of a file's array; None stands for what the file says, and else for the default.

    Attributes
    ----------
    array : str
        Its name. Default: `FIELD` or `PHASE`, or the only one.
    convention : Convention
        Default: what the file says, else ours.
    pitch : float
        Metres.
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
        Of levels: 2^bits of them are a turn. Default: those of the array's type.
    """

    array: str | None = None
    convention: Convention | None = None
    pitch: float | None = None
    wavelengths: Sequence[float] | None = None
    depth_range: tuple[float, float] | None = None
    near: float | None = None
    fov: float | None = None
    distance: float | None = None
    bits: int | None = None


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
        "pitch_m": hologram.pitch,
        "wavelengths_m": list(hologram.wavelengths),
        "depth_far_m": hologram.depth_far,
        "depth_near_m": hologram.depth_near,
        "depth_mapping": hologram.depth_mapping,
        "near_m": thing.near,
        "camera": json.dumps(thing.camera.to_dict()),
    }
    if isinstance(thing, PhaseHologram):
        attributes |= {"method": thing.method, "gains": list(thing.gains)}
    else:
        attributes["plan"] = json.dumps(thing.plan)
    return Container({PHASE if phase else FIELD: convention.theirs(thing.data)}, attributes)


def hologram_of(container: Container, given: Given | None = None) -> WaveField | PhaseHologram:
    """A field of complex numbers, or phases: of real numbers, radians, or of whole ones, levels.

    Parameters
    ----------
    container : Container
        Of a file; attributes as `container_of` names them count, and none is needed.
    given : Given, optional
        What is said goes before what the file says.

    Raises
    ------
    InvalidInput
        If something is missing, does not fit, or no display can have it.
    """
    given, attributes = given or Given(), container.attributes
    array = _array(container, given.array)
    data = _layers(array, given.convention or _convention(attributes), given.convention is None)
    pitch, wavelengths = _grid(given, attributes)
    if len(wavelengths) != data.shape[1]:
        raise InvalidInput(
            f"There are {len(wavelengths)} wavelengths for {data.shape[1]} in the array, which has "
            f"{_shape(array)}: name its axes by --axes, or other --wavelengths."
        )
    ends = given.depth_range or (
        _number(attributes, "depth_far_m"),
        _number(attributes, "depth_near_m"),
    )
    mapping = str(attributes.get("depth_mapping", "fit"))
    height, width = data.shape[-2:]
    # pyrefly: ignore[bad-argument-type]  # None for an end is its default
    hologram = Hologram(width, height, pitch, wavelengths, *ends, mapping)
    near = given.near or _number(attributes, "near_m") or NEAR
    if not 0 < near < math.inf:
        raise InvalidInput(f"The near end of the scene must be a positive distance, not {near:g} m.")
    camera = _camera(attributes, given.fov, hologram)
    if np.iscomplexobj(array):
        field = _at_slm(np.ascontiguousarray(data, np.complex64), given.distance or 0.0, hologram)
        return WaveField(field, hologram, camera, near, _plan(attributes))
    if given.distance:
        raise InvalidInput("Phases are those of the SLM itself: leave out their distance from it.")
    gains = _numbers(attributes, "gains") or (1.0,) * len(wavelengths)
    if len(gains) != len(wavelengths):
        raise InvalidInput(f"There are {len(gains)} gains for {len(wavelengths)} wavelengths.")
    method = str(attributes.get("method", IMPORTED))
    return PhaseHologram(_phases(data, array.dtype, given.bits), hologram, camera, near, method, gains)


def _array(container, name):
    arrays = {key: value for key, value in container.arrays.items() if value.ndim > 1}
    if name is None:
        named = [key for key in (FIELD, PHASE) if key in arrays] or list(arrays)
        if len(named) != 1:
            names = ", ".join(list(container.arrays)[:20])
            raise InvalidInput(f"Which of the arrays is it: {names}? Name one by --array.")
        name = named[0]
    if name not in arrays:
        raise InvalidInput(f"There is no array {name} of two or more axes: choose among {', '.join(arrays)}.")
    return arrays[name]


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
    """Of shape (frame, wavelength, y, x)."""
    if array.ndim > len(AXES):
        raise InvalidInput(f"The array has {array.ndim} axes, and at most {len(AXES)} have a meaning.")
    if stored and convention.axes is not None:  # MATLAB leaves out the last axes where they have one place
        array = array.reshape(*array.shape, *(1,) * (len(convention.axes) - array.ndim))
    data = convention.ours(array)
    if 0 in data.shape or math.prod(data.shape[:2]) > MOST_LAYERS:
        raise InvalidInput(f"An array of {_shape(array)} is no hologram's: see its axes.")
    shortage(4 * array.nbytes, "Reading the array")
    for frame in data:
        if not np.isfinite(frame).all():
            raise InvalidInput("The array holds values that are not finite: write it again.")
    return data


def _grid(given, attributes):
    pitch = given.pitch or _number(attributes, "pitch_m")
    wavelengths = given.wavelengths or _numbers(attributes, "wavelengths_m")
    if not pitch:
        raise InvalidInput("The file does not say the pixel pitch: give --pitch, in micrometers.")
    if not wavelengths:
        raise InvalidInput("The file does not say the wavelengths: give --wavelengths, in nanometers.")
    return pitch, tuple(wavelengths)


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


def _camera(attributes, fov, hologram):
    said = attributes.get("camera")
    if said is None:
        default = 2 * math.atan(hologram.width * hologram.pitch / (2 * FOCAL))
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
            frame[colour] = propagate(frame[colour], -distance, hologram.pitch, wavelength)
    return field


def _phases(data, dtype, bits):
    if dtype.kind in "iu":
        bits = bits or 8 * dtype.itemsize
        if not 1 <= bits <= 16:
            raise InvalidInput(f"An SLM has 1 to 16 bits, not {bits}: give those of the levels by --bits.")
        data = data.astype(np.float64) * (2 * math.pi / 2**bits)
    elif bits:
        raise InvalidInput("Phases in radians have no bits: leave them out, or give whole numbers.")
    turn = np.float32(2 * math.pi)
    phases = np.mod(np.asarray(data, np.float64), 2 * math.pi).astype(np.float32)
    phases[phases >= turn] = 0
    return phases


def _shape(array):
    return " x ".join(map(str, array.shape))
