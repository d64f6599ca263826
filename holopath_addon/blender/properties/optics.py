"""Settings of the bench around the SLM (`Scene.holopath.optics`), and their conversion to the engine's objects."""

import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, StringProperty

from ... import engine
from ...engine.optics import MIN_SHARE
from ...exchange.optics import measured_beam, measured_stop
from .decimals import tidy

# Menu items: identifier, label, help, and the number that a .blend holds.
_BEAM_KINDS = [
    ("flat", "Flat", "Uniform light at normal incidence", 0),
    ("tilt", "Tilted", "A plane wave at an angle", 1),
    (
        "point",
        "Point Source",
        "Light that diverges from a point before the SLM, or converges to one behind it",
        2,
    ),
    ("gaussian", "Gaussian", "A laser beam whose waist is at the SLM", 3),
    ("measured", "Measured", "Light that was measured at each pixel, from a file", 4),
]
_BEAM_FILES = [
    ("amplitude", "Amplitude", "Numbers in proportion to the amplitude of the light", 0),
    ("intensity", "Intensity", "Numbers in proportion to the intensity, as a camera sees it", 1),
    ("field", "Complex", "Complex numbers, amplitude and phase in one", 2),
]
_CARRIERS = [
    ("stop", "By Stop", "On the zero order, or with a half stop in the middle of that half", 0),
    (
        "auto",
        "Middle of Stop",
        "In the middle of the stop, off axis: without the zero order and the twin",
        1,
    ),
    ("given", "Set by Hand", "At the place below", 2),
]
_STOP_KINDS = [
    ("circle", "Circle", "A circle around the carrier; by default, on axis, all light of the pixels", 0),
    ("half", "Half", "The half of the band on one side of the zero order", 1),
    ("rectangle", "Rectangle", "A rectangle around the carrier", 2),
    ("measured", "Picture", "The bright parts of a picture of the Fourier plane, from a file", 3),
]  # fmt: skip

_KNOWS_RELATIVE = "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
# Options of a path that may be relative to the .blend; in older Blenders any path may.
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if _KNOWS_RELATIVE else set()

# Functions called with the scene when its bench changes.
on_bench_change: list[Callable] = []


def _changed(props, context):
    for call in on_bench_change:
        call(props.id_data)


class HoloPathOptics(bpy.types.PropertyGroup):
    """Settings of the bench, `Scene.holopath.optics`."""

    beam: EnumProperty(
        name="Beam",
        description="Light that falls on the SLM. Phases are encoded for it",
        items=_BEAM_KINDS,
        update=_changed,
    )
    tilt_deg: FloatVectorProperty(
        name="Tilt (°)",
        description="Angles of the beam to the right and up, in degrees",
        size=2,
        min=-90.0,
        max=90.0,
        soft_min=-5.0,
        soft_max=5.0,
        step=10,
        precision=3,
        update=_changed,
    )
    point_mm: FloatProperty(
        name="Distance (mm)",
        description="Distance of the point before the SLM, in millimeters. If it is negative, the light converges to "
        "a point behind the SLM",
        default=200.0,
        soft_min=-1000.0,
        soft_max=1000.0,
        step=100,
        precision=2,
        update=_changed,
    )
    waist_mm: FloatProperty(
        name="Waist (mm)",
        description="Radius of the beam where its intensity is 1/e² of the middle's, in millimeters",
        default=2.0,
        min=1e-3,
        soft_max=50.0,
        step=10,
        precision=3,
        update=_changed,
    )
    middle_mm: FloatVectorProperty(
        name="Middle (mm)",
        description="Middle of the beam to the right of and above the middle of the SLM, in millimeters",
        size=2,
        soft_min=-20.0,
        soft_max=20.0,
        step=10,
        precision=3,
        update=_changed,
    )
    beam_file: StringProperty(
        name="File",
        description="Picture or array with a number for each pixel of the SLM. Row 0 is the top",
        subtype="FILE_PATH",
        options=RELATIVE,
        update=_changed,
    )
    beam_holds: EnumProperty(
        name="Numbers",
        description="Quantity that the numbers of the file stand for, in any unit",
        items=_BEAM_FILES,
        update=_changed,
    )
    beam_phase: StringProperty(
        name="Phase File",
        description="Array of the beam's phase at each pixel, in radians. Empty: not measured",
        subtype="FILE_PATH",
        options=RELATIVE,
        update=_changed,
    )
    carrier: EnumProperty(
        name="Carrier",
        description="Place of the center of the picture's light in the Fourier plane",
        items=_CARRIERS,
        update=_changed,
    )
    carrier_at: FloatVectorProperty(
        name="Place",
        description="Place of the carrier to the right of and above the zero order. 1 is the edge of the band",
        size=2,
        default=(0.5, 0.0),
        min=-1.0,
        max=1.0,
        step=1,
        precision=3,
        update=_changed,
    )
    stop: EnumProperty(
        name="Stop",
        description="Opening in the Fourier plane behind the SLM, which light passes",
        items=_STOP_KINDS,
        update=_changed,
    )
    use_radius: BoolProperty(
        name="Radius",
        description="Set the radius of the circle. Otherwise it is as large as possible",
        update=_changed,
    )
    radius: FloatProperty(
        name="Radius",
        description="Radius of the circle around the carrier. 1 is the edge of the band",
        default=0.5,
        min=1e-3,
        max=1.0,
        step=1,
        precision=3,
        update=_changed,
    )
    half_deg: FloatProperty(
        name="Side (°)",
        description="Direction of the half that passes, in degrees: 0 is to the right and 90 is up",
        soft_min=-180.0,
        soft_max=180.0,
        step=100,
        precision=1,
        update=_changed,
    )
    rectangle: FloatVectorProperty(
        name="Size",
        description="Width and height of the rectangle around the carrier. 2 is the whole band",
        size=2,
        default=(0.5, 0.5),
        min=1e-3,
        max=2.0,
        step=1,
        precision=3,
        update=_changed,
    )
    stop_file: StringProperty(
        name="File",
        description="Picture of the Fourier plane, from edge to edge of the band: bright is open. Row 0 is the top",
        subtype="FILE_PATH",
        options=RELATIVE,
        update=_changed,
    )
    use_lens: BoolProperty(
        name="Lens",
        description="A lens stands behind the SLM. With the depth mapping Eyepiece you look through it, otherwise the "
        "picture stands in the air behind it",
        update=_changed,
    )
    focal_mm: FloatProperty(
        name="Focal Length (mm)",
        description="Focal length of the lens, in millimeters. If it is negative the lens diverges, and needs both "
        "distances",
        default=50.0,
        soft_min=-1000.0,
        soft_max=1000.0,
        step=100,
        precision=2,
        update=_changed,
    )
    use_lens_distance: BoolProperty(
        name="Distance",
        description="Set the distance of the lens from the SLM. Otherwise it is the focal length",
        update=_changed,
    )
    lens_distance_mm: FloatProperty(
        name="Distance (mm)",
        description="Distance of the lens from the SLM, in millimeters",
        default=50.0,
        min=0.0,
        soft_max=1000.0,
        step=100,
        precision=2,
        update=_changed,
    )
    use_picture_distance: BoolProperty(
        name="Picture",
        description="Set the distance of the picture behind the lens. Otherwise it is the focal length",
        update=_changed,
    )
    picture_mm: FloatProperty(
        name="Picture (mm)",
        description="Distance from the lens to the plane around which the picture stands, in millimeters",
        default=50.0,
        min=1e-3,
        soft_max=1000.0,
        step=100,
        precision=2,
        update=_changed,
    )
    use_share: BoolProperty(
        name="Share",
        description="Leave room beside the picture, where phases of few frames put their errors. Otherwise the picture "
        "is as wide as the pixels' light reaches",
        update=_changed,
    )
    share: FloatProperty(
        name="Share",
        description="Width of the picture as a fraction of the width that the pixels' light reaches",
        default=0.7,
        min=MIN_SHARE,
        max=1.0,
        step=1,
        precision=3,
        update=_changed,
    )
    colors_apart: BoolProperty(
        name="Colors Apart",
        description="Correct in the phases that lenses show each wavelength's picture at another place or size",
        update=_changed,
    )
    color_scale: FloatVectorProperty(
        name="Scale",
        description="Magnification of each color's picture relative to the intended one. 1 is as intended",
        size=3,
        default=(1.0, 1.0, 1.0),
        min=0.5,
        max=2.0,
        step=0.1,
        precision=4,
        update=_changed,
    )
    color_distance_mm: FloatVectorProperty(
        name="Too Near (mm)",
        description="How far each color's picture lies too near to the viewer, in millimeters",
        size=3,
        soft_min=-10.0,
        soft_max=10.0,
        step=1,
        precision=3,
        update=_changed,
    )
    color_right_mm: FloatVectorProperty(
        name="Right (mm)",
        description="How far each color's picture lies too far to the right, in millimeters",
        size=3,
        soft_min=-1.0,
        soft_max=1.0,
        step=1,
        precision=4,
        update=_changed,
    )
    color_up_mm: FloatVectorProperty(
        name="Up (mm)",
        description="How far each color's picture lies too far up, in millimeters",
        size=3,
        soft_min=-1.0,
        soft_max=1.0,
        step=1,
        precision=4,
        update=_changed,
    )


def optics_of(settings: Any) -> engine.Optics:
    """Optics that a scene's settings describe.

    Parameters
    ----------
    settings : properties.HoloPathSettings

    Returns
    -------
    engine.Optics

    Raises
    ------
    engine.InvalidInput
        If there is no such bench, or a file cannot be read.
    engine.BackendUnavailable
        If the library for a file is not installed.
    """
    props, count = settings.optics, 3 if settings.colours == "RGB" else 1
    colors = _colors(props, count) if props.colors_apart else {}
    return engine.Optics(
        beam=_beam(props),
        carrier=_carrier(props),
        stop=_stop(props),
        lens=_lens(props, settings.depth_mapping) if props.use_lens else None,
        **colors,
    )


def set_colors(props: HoloPathOptics, colors: dict[str, Any]) -> None:
    """Set place and scale of colors.

    Parameters
    ----------
    props : HoloPathOptics
    colors : dict
        Arguments of `engine.Optics` for one wavelength or three: ``color_scale``, ``color_distance``, meters, and
        ``color_shift``, pairs of meters.
    """
    shift = colors["color_shift"]
    numbers = {
        "color_scale": colors["color_scale"],
        "color_distance_mm": [1e3 * distance for distance in colors["color_distance"]],
        "color_right_mm": [1e3 * right for right, _ in shift],
        "color_up_mm": [1e3 * up for _, up in shift],
    }
    for name, values in numbers.items():
        own = list(getattr(props, name))
        setattr(props, name, [*values, *own[len(values) :]])
    props.colors_apart = True


def files_of(props: HoloPathOptics) -> dict[str, str]:
    """Measured files that the settings use: ``amplitude``, ``intensity``, ``field``, ``phase`` or ``stop`` to path."""
    files = {}
    if props.beam == "measured":
        files[props.beam_holds] = props.beam_file
        if props.beam_phase and props.beam_holds != "field":
            files["phase"] = props.beam_phase
    if props.stop == "measured":
        files["stop"] = props.stop_file
    return files


def _beam(props):
    if props.beam == "measured":
        return _measured("beam", {role: path for role, path in files_of(props).items() if role != "stop"})
    numbers = {
        "tilt": lambda: _all(props.tilt_deg, math.radians(1)),
        "point": lambda: _all([props.point_mm], 1e-3),
        "gaussian": lambda: _all([props.waist_mm, *props.middle_mm], 1e-3),
    }
    return engine.Beam(props.beam, numbers[props.beam]() if props.beam in numbers else ())


def _carrier(props) -> Any:
    if props.carrier == "given":
        return _all(props.carrier_at)
    return "auto" if props.carrier == "auto" else None


def _stop(props):
    if props.stop == "measured":
        return _measured("stop", {"stop": props.stop_file})
    numbers = {
        "circle": lambda: _all([props.radius]) if props.use_radius else (),
        "half": lambda: _all([props.half_deg], math.radians(1)) if props.half_deg else (),
        "rectangle": lambda: _all(props.rectangle),
    }
    return engine.Stop(props.stop, numbers[props.stop]())


def _lens(props, depth_mapping):
    (focal,) = _all([props.focal_mm], 1e-3)
    distance: Any = _all([props.lens_distance_mm], 1e-3)[0] if props.use_lens_distance else None
    if depth_mapping == "eyepiece":  # no picture stands behind it
        return engine.Lens(focal, distance)
    (picture,) = _all([props.picture_mm], 1e-3) if props.use_picture_distance else (None,)
    (share,) = _all([props.share]) if props.use_share else (1.0,)
    return engine.Lens(focal, distance, picture, share)


def _colors(props, count):
    right, up = (_all(each, 1e-3)[:count] for each in (props.color_right_mm, props.color_up_mm))
    return {
        "color_scale": _all(props.color_scale)[:count],
        "color_distance": _all(props.color_distance_mm, 1e-3)[:count],
        "color_shift": tuple(zip(right, up, strict=True)),
    }


def _all(values, unit=1.0):
    """Tidy numbers in SI units."""
    return tuple(tidy(value) * unit for value in values)


def _measured(kind, files) -> Any:
    """Measured beam or stop, by the word ``beam`` or ``stop``, from files by role."""
    if not all(files.values()):
        raise engine.InvalidInput(f"A file of the measured {kind} is missing: choose one, or another {kind}.")
    paths = tuple((role, Path(bpy.path.abspath(path))) for role, path in files.items())
    return _read(kind, paths, tuple(_stamp(path) for _, path in paths))


@lru_cache(maxsize=4)
def _read(kind, paths, stamps):
    """Read `_measured` files when their stamps have changed: panels call this whenever they are drawn."""
    files = dict(paths)
    return measured_beam(files) if kind == "beam" else measured_stop(files["stop"])


def _stamp(path):
    """Modification time and size of a file; None for a missing file."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size
