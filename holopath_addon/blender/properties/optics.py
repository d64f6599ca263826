"""Settings of the bench around the SLM (`Scene.holopath.optics`), and what they mean to the engine."""

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

# A .blend holds the numbers.
_BEAM_KINDS = [
    ("flat", "Flat", "Even light from straight behind", 0),
    ("tilt", "Tilted", "A plane wave that comes at an angle", 1),
    ("point", "Point Source", "Light that spreads from a point before the SLM, or runs to one behind it", 2),
    ("gaussian", "Gaussian", "A laser beam whose waist is at the SLM", 3),
    ("measured", "Measured", "Light as it was measured at each pixel, from a file", 4),
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
        "In the middle of the stop, off axis: the zero order and the twin are left out",
        1,
    ),
    ("given", "Set by Hand", "At the place below", 2),
]
_STOP_KINDS = [
    ("circle", "Circle", "A circle around the carrier: on axis all that the pixels send out", 0),
    ("half", "Half", "The half of the band on one side of the zero order", 1),
    ("rectangle", "Rectangle", "A rectangle around the carrier", 2),
    ("measured", "Picture", "What is bright in a picture of the Fourier plane, from a file", 3),
]  # fmt: skip

_KNOWS_RELATIVE = "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
# Options of a path that may start at the .blend; older Blenders let any path do so.
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if _KNOWS_RELATIVE else set()

# Called with the scene when its bench changes: callables.
bench_changed: list[Callable] = []


def _changed(props, context):
    for call in bench_changed:
        call(props.id_data)


class HoloPathOptics(bpy.types.PropertyGroup):
    """What `Scene.holopath.optics` holds."""

    beam: EnumProperty(
        name="Beam",
        description="Light that falls on the SLM. The phases are found for it",
        items=_BEAM_KINDS,
        update=_changed,
    )
    tilt_deg: FloatVectorProperty(
        name="Tilt (°)",
        description="Angles at which the beam runs to the right and up, in degrees",
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
        description="Distance of the point before the SLM, in millimeters. If it is negative, the light runs to a "
        "point behind the SLM",
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
        description="What the numbers of the file are; of any scale",
        items=_BEAM_FILES,
        update=_changed,
    )
    beam_phase: StringProperty(
        name="Phase File",
        description="Array of the beam's phase at each pixel, in radians. Empty: it was not measured",
        subtype="FILE_PATH",
        options=RELATIVE,
        update=_changed,
    )
    carrier: EnumProperty(
        name="Carrier",
        description="Where in the Fourier plane the middle of the picture's light lies",
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
        description="What passes in the Fourier plane behind the SLM",
        items=_STOP_KINDS,
        update=_changed,
    )
    use_radius: BoolProperty(
        name="Radius",
        description="Set the radius of the circle. Otherwise it is as large as it can be",
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
        description="Distance of the plane around which the picture stands from the lens, in millimeters",
        default=50.0,
        min=1e-3,
        soft_max=1000.0,
        step=100,
        precision=2,
        update=_changed,
    )
    use_share: BoolProperty(
        name="Share",
        description="Leave room beside the picture, in which few frames leave their errors. Otherwise it is as wide as "
        "light of the pixels reaches",
        update=_changed,
    )
    share: FloatProperty(
        name="Share",
        description="Share of the width that light of the pixels reaches which the picture has",
        default=0.7,
        min=MIN_SHARE,
        max=1.0,
        step=1,
        precision=3,
        update=_changed,
    )
    colors_apart: BoolProperty(
        name="Colors Apart",
        description="Lenses show each wavelength's picture elsewhere, or of another size. The phases make up for it",
        update=_changed,
    )
    color_scale: FloatVectorProperty(
        name="Scale",
        description="Magnification of each color's picture over what it should be. 1 is as it should be",
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
    """Engine's optics of the scene's settings, `Scene.holopath`.

    Raises
    ------
    engine.InvalidInput
        If there can be no such bench, or a file cannot be read.
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
    """Set where colors lie, given as `engine.Optics` takes it for one wavelength or three."""
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
    """Files that were measured and count, as the settings have them, by what they hold."""
    found = {}
    if props.beam == "measured":
        found[props.beam_holds] = props.beam_file
        if props.beam_phase and props.beam_holds != "field":
            found["phase"] = props.beam_phase
    if props.stop == "measured":
        found["stop"] = props.stop_file
    return found


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
    if depth_mapping == "eyepiece":  # then no picture stands behind it
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
    return tuple(tidy(value) * unit for value in values)


def _measured(what, files) -> Any:
    """The beam or the stop of files."""
    if not all(files.values()):
        raise engine.InvalidInput(f"A file of the measured {what} is missing: choose one, or another {what}.")
    paths = tuple((role, Path(bpy.path.abspath(path))) for role, path in files.items())
    return _read(what, paths, tuple(_stamp(path) for _, path in paths))


@lru_cache(maxsize=4)
def _read(what, paths, stamps):
    """`_measured` of paths, read again once their stamps are others: panels ask whenever they are drawn."""
    files = dict(paths)
    return measured_beam(files) if what == "beam" else measured_stop(files["stop"])


def _stamp(path):
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
