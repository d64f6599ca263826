"""Scene settings of HoloPath (`Scene.holopath`), and their conversion to the engine's objects.

Parameters `props` are always `HoloPathSettings`.
"""

import math
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ... import engine
from ...engine.settings import DECLARED, ENCODE_SECONDS, EYEBOX, default_of
from ...engine.settings.choices import DEPTH_MAPPINGS, ENCODINGS
from ..device_properties import HoloPathDevice, menu
from .decimals import tidy
from .former import FormerNames, adopt, adopt_animation
from .optics import RELATIVE, HoloPathOptics, optics_of

CUSTOM = "CUSTOM"
MAX_FOCUS = 1e5  # meters; farther distances count as infinity
_VALUES = {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}  # types of properties that hold a value


def _display_items():
    items = [(CUSTOM, "Custom", "Resolution, pixel pitch and bit depth as set below", 0)]
    for display in engine.DISPLAYS.values():
        size = f"{display.width} × {display.height} pixels of {display.pitch * 1e6:g} µm, {display.bits} bits"
        size += f", {display.frames} {'frame' if display.frames == 1 else 'frames'} a color"
        items.append((display.name, display.label, size, display.number))
    return items


def _declared_properties():
    """Blender's properties of the settings that the engine declares, by name; a switch comes before its setting."""
    made = {}
    for name, declared in DECLARED.items():
        made |= _properties_of(property_of(name), declared, default_of(name))
    for name, declared in {"encode_seconds": ENCODE_SECONDS, "eyebox": EYEBOX}.items():
        made |= _properties_of(name, declared, None)
    return made


def _properties_of(name, declared, default):
    """Property of a declared setting, after its switch if it has one."""
    made, switch = {}, declared.switch
    if switch is not None:
        made[switch.name] = BoolProperty(
            name=switch.label, description=switch.help, default=not switch.by_hand
        )
        default = declared.initial
    arguments: dict[str, Any] = {"name": declared.label, "description": declared.help, "default": default}
    if declared.chosen:
        made[name] = EnumProperty(**arguments, items=menu(declared.chosen))
    elif name == "fixed":
        arguments |= {"description": f"{declared.help}. There are {', '.join(engine.FIXABLE)}", "default": ""}
        made[name] = StringProperty(**arguments)
    else:
        min_value, max_value = declared.bounds
        low, high = declared.soft or declared.bounds
        ends = {"min": min_value, "max": max_value, "soft_min": low, "soft_max": high}
        arguments |= {key: end for key, end in ends.items() if math.isfinite(end)}
        if declared.unit:
            arguments |= {"name": f"{declared.label} ({declared.unit})", "step": 10, "precision": 2}
        elif declared.bounds[1] == 1.0:
            arguments |= {"subtype": "FACTOR", "precision": 2}
        kind = FloatProperty if declared.kind is float else IntProperty
        made[name] = kind(**arguments)
    return made


def property_of(name: str) -> str:
    """Name of the property that holds a setting, by the setting's name in `engine.Settings`."""
    unit = DECLARED[name].unit
    return f"{name}_{unit}" if unit else name


def _display_changed(props, context):
    display = display_of(props)
    if display is None:
        return
    props.bits = display.bits
    props.resolution_x, props.resolution_y, props.pitch_um, props.square_pixels = (
        display.width,
        display.height,
        display.pitch * 1e6,
        True,
    )
    props.frames = display.frames
    if props.optics.use_lens:  # which has a range of its own
        props.depth_auto = True
    else:
        props.depth_far_mm, props.depth_near_mm = (end * 1e3 for end in display.depth_range)


def _depth_set(props, context):
    props.depth_auto = False


def _ends_set(props):
    return props.is_property_set("depth_far_mm") or props.is_property_set("depth_near_mm")


def _depth_auto_changed(props, context):
    """Start a depth range set by hand with the automatic one."""
    if not props.depth_auto and not _ends_set(props):
        try:
            whole = hologram_of(props, depth_auto=True)
        except (engine.InvalidInput, engine.BackendUnavailable):  # which the panel says
            return
        props.depth_far_mm, props.depth_near_mm = whole.depth_far * 1e3, whole.depth_near * 1e3


# Functions called with the settings when focus or pupil change, and when another frame of the phases is chosen.
on_view_change: list[Callable] = []
on_frame_change: list[Callable] = []
_silenced = []  # not empty while focus or index are written without refocusing


def _distance_changed(props, context):
    if not _silenced:
        props.focus_auto = False
        _focus_changed(props, context)


def _focus_changed(props, context):
    for call in on_view_change:
        call(props)


def _get_infinity(props):
    return props.focus >= MAX_FOCUS


def _set_infinity(props, value):
    if value != _get_infinity(props):
        props.focus = MAX_FOCUS if value else 1.0


def _get_diopters(props):
    return 0.0 if _get_infinity(props) else 1 / props.focus


def _set_diopters(props, value):
    props.focus = min(1 / max(value, 1e-9), MAX_FOCUS)


def _phase_frame_changed(props, context):
    for call in on_frame_change:
        call(props)


def _focus_chosen(props, context):
    """Focus at the distance that was chosen in the list."""
    if not _silenced and props.focus_index < len(props.focus_list):
        focus = props.focus_list[props.focus_index].focus
        if focus != props.focus:
            props.focus = focus


class _Focus:
    """Other forms of a class's property `focus`."""

    focus_infinity: BoolProperty(
        name="Infinity", description="Focus at infinity", get=_get_infinity, set=_set_infinity
    )
    focus_diopters: FloatProperty(
        name="Focus (D)",
        description="The focus distance in diopters, that is, one over meters; 0 is infinity",
        get=_get_diopters,
        set=_set_diopters,
        min=0.0,
        max=1e3,
        soft_max=5.0,
        step=5,
        precision=2,
    )


class HoloPathFocus(_Focus, bpy.types.PropertyGroup):
    """Distance of the focus list."""

    focus: FloatProperty(
        name="Focus (m)",
        description="Distance from the camera, in meters",
        default=1.0,
        min=1e-3,
        max=MAX_FOCUS,
        soft_min=0.05,
        soft_max=100.0,
        step=5,
        precision=3,
    )


_Declared = type("_Declared", (), {"__annotations__": _declared_properties()})


class HoloPathSettings(FormerNames, _Declared, _Focus, bpy.types.PropertyGroup):
    """Settings of a scene, `Scene.holopath`."""

    if TYPE_CHECKING:  # the declared settings

        def __getattr__(self, name: str) -> Any: ...

    display: EnumProperty(
        name="Display",
        description="Spatial light modulator (SLM) to show the hologram on; sets resolution, pitch, bits and depths",
        items=_display_items(),
        update=_display_changed,
    )
    resolution_x: IntProperty(
        name="Width",
        description="Hologram width, in pixels",
        default=512,
        min=1,
        max=1 << 16,
        subtype="PIXEL",
    )
    resolution_y: IntProperty(
        name="Height",
        description="Hologram height, in pixels",
        default=512,
        min=1,
        max=1 << 16,
        subtype="PIXEL",
    )
    pitch_um: FloatProperty(
        name="Pixel Pitch (µm)",
        description="Distance between neighboring pixels, in micrometers; a smaller pitch spreads light wider",
        default=8.0,
        min=0.1,
        max=1000.0,
        soft_min=1.0,
        soft_max=40.0,
        step=10,
        precision=2,
    )
    square_pixels: BoolProperty(
        name="Square Pixels",
        description="Use the same pitch in x and y. Otherwise the larger pitch limits how far light spreads",
        default=True,
    )
    pitch_y_um: FloatProperty(
        name="Pixel Pitch Y (µm)",
        description="Distance between neighboring rows of pixels, in micrometers",
        default=8.0,
        min=0.1,
        max=1000.0,
        soft_min=1.0,
        soft_max=40.0,
        step=10,
        precision=2,
    )
    bits: IntProperty(
        name="Bit Depth",
        description="Bits of phase per pixel of the SLM: 8 bits are 256 levels",
        default=8,
        min=1,
        max=16,
        update=_focus_changed,
    )
    colors: EnumProperty(
        name="Colors",
        description="Wavelengths to compute: red, green and blue take three times as long as a single one",
        items=[
            ("RGB", "RGB", "Three wavelengths: red, green and blue", 0),
            ("MONO", "Single", "One wavelength", 1),
        ],
    )
    wavelengths_nm: FloatVectorProperty(
        name="Wavelengths (nm)",
        description="Vacuum wavelengths of the red, green and blue light, in nanometers",
        size=3,
        default=(640.0, 516.5, 455.4),
        min=100.0,
        max=10000.0,
        soft_min=380.0,
        soft_max=780.0,
        precision=1,
    )
    wavelength_nm: FloatProperty(
        name="Wavelength (nm)",
        description="Vacuum wavelength, in nanometers; shows the scene's red, green or blue light",
        default=516.5,
        min=100.0,
        max=10000.0,
        soft_min=380.0,
        soft_max=780.0,
        precision=1,
    )
    depth_mapping: EnumProperty(
        name="Depth Mapping",
        description="How the scene's depth fills the depth range of the hologram",
        items=menu(DEPTH_MAPPINGS),
    )
    depth_auto: BoolProperty(
        name="Near the SLM",
        description=(
            "Place the depth range as near to the SLM as its depth allows, so that no light passes beside the aperture "
            "and borders stay bright"
        ),
        default=True,
        update=_depth_auto_changed,
    )
    depth_far_mm: FloatProperty(
        name="Far End (mm)",
        description="Distance from the SLM at which infinity appears, in millimeters",
        default=10.0,
        soft_min=-200.0,
        soft_max=500.0,
        step=10,
        precision=2,
        update=_depth_set,
    )
    depth_near_mm: FloatProperty(
        name="Near End (mm)",
        description="Distance from the SLM at which the near end appears, in millimeters; larger than the far end",
        default=15.0,
        soft_min=-200.0,
        soft_max=500.0,
        step=10,
        precision=2,
        update=_depth_set,
    )
    near_auto: BoolProperty(
        name="Nearest Surface",
        description="Put the near end of the depth range at the nearest surface in view",
        default=True,
    )
    near: FloatProperty(
        name="Near (m)",
        description="Distance from the camera that appears at the near end of the depth range, in meters",
        default=0.5,
        min=1e-4,
        soft_min=0.05,
        soft_max=10.0,
        precision=3,
        step=5,
    )
    keep_fields: BoolProperty(
        name="Keep Wave Fields",
        description=(
            "Write each frame's wave field and pictures into its own folder in animation renders, and reuse frames "
            "there that were made of the same scene with the same settings"
        ),
        default=False,
        options=set(),
    )
    animation_folder: StringProperty(
        name="Wave Fields",
        description="Folder in which animation renders create frame_0001 and so on",
        default="//holopath",
        subtype="DIR_PATH",
        options=RELATIVE,
    )
    animation_encodes: BoolProperty(
        name="Encode",
        description="Also encode the phases of each frame, by the section Hologram and for the device's calibration",
        default=False,
    )
    animation_in_turn: BoolProperty(
        name="From the Frame Before",
        description="Start a frame's phases from those of the frame before, which flickers less with few frames per "
        "color. Frames are then computed one after the other, also by several processes",
        default=False,
    )
    focus_auto: BoolProperty(
        name="Auto",
        description="Focus on the middle of the view at every render; off once a focus is chosen",
        default=True,
    )
    focus: FloatProperty(
        name="Focus (m)",
        description="Distance at which the picture is sharp, in meters; changes refocus without rendering again",
        default=1.0,
        min=1e-3,
        max=MAX_FOCUS,
        soft_min=0.05,
        soft_max=100.0,
        step=5,
        precision=3,
        update=_distance_changed,
    )
    focus_list: CollectionProperty(
        type=HoloPathFocus,
        name="Focus List",
        description="Distances of focal stacks; empty: only the focus distance",
    )
    focus_index: IntProperty(
        name="Chosen Distance",
        description="Chosen distance of the focus list",
        update=_focus_chosen,
    )
    show_overlay: BoolProperty(
        name="Show in Viewport",
        description=(
            "Draw the focus distances, the near end and the pupil at the camera, while the sidebar's HoloPath tab is "
            "open or HoloPath is the render engine"
        ),
        default=True,
    )
    show_bench: BoolProperty(
        name="Sketch in Viewport",
        description=(
            "Draw beam, SLM, volume, lens, stop and eye to scale in the 3D View, while the sidebar's HoloPath tab is "
            "open or HoloPath is the render engine"
        ),
        default=False,
    )
    use_pupil: BoolProperty(
        name="Partial Pupil",
        description="Look through a part of the pupil: less light, more depth of field. Otherwise all light is seen",
        default=False,
        update=_focus_changed,
    )
    pupil_offset_mm: FloatVectorProperty(
        name="Offset (mm)",
        description="Pupil's center to the right of and above the camera's axis, in world millimeters",
        size=2,
        default=(0.0, 0.0),
        soft_min=-50.0,
        soft_max=50.0,
        step=10,
        precision=2,
        update=_focus_changed,
    )
    pupil_diameter_mm: FloatProperty(
        name="Diameter (mm)",
        description="Pupil's diameter, in world millimeters",
        default=4.0,
        min=1e-3,
        soft_max=100.0,
        step=10,
        precision=2,
        update=_focus_changed,
    )
    encoding: EnumProperty(
        name="Encoding",
        description="Method that turns complex amplitudes into the phases that an SLM shows",
        items=menu(ENCODINGS),
        default="auto",
    )
    refocused: EnumProperty(
        name="Shown",
        description="Light that the reconstruction in the Image Editor shows",
        items=[
            ("FIELD", "Wave Field", "The complex field that was rendered", 0),
            (
                "PHASE",
                "Hologram",
                "The encoded phases, on an SLM with the display's limits",
                1,
            ),
        ],
        update=_focus_changed,
    )
    pixel_shape: BoolProperty(
        name="Pixel Shape",
        description="Include the square shape of the pixels, which dims steep light. Otherwise they are points",
        update=_focus_changed,
    )
    fill_factor: FloatProperty(
        name="Fill Factor",
        description="Fraction of a pixel's area that modulates light; the rest is dark. 1 is a whole square pixel",
        default=1.0,
        min=0.01,
        max=1.0,
        update=_focus_changed,
    )
    unmodulated: FloatProperty(
        name="Zero Order",
        description="Fraction of the light that leaves the SLM unmodulated, from 0 to 1",
        default=0.0,
        min=0.0,
        max=1.0,
        update=_focus_changed,
    )
    crosstalk: FloatProperty(
        name="Crosstalk (px)",
        description="How far a pixel's field reaches into its neighbors: standard deviation of a Gaussian, in pixels",
        default=0.0,
        min=0.0,
        max=9.0,
        soft_max=2.0,
        step=1,
        update=_focus_changed,
    )
    phase_frame: IntProperty(
        name="Frame",
        description="Frame of the hologram that the picture of its phases shows, from 0",
        default=0,
        min=0,
        max=255,
        update=_phase_frame_changed,
    )
    optics: PointerProperty(type=HoloPathOptics, name="Optics", description="The bench around the SLM")
    device: PointerProperty(type=HoloPathDevice, name="Device", description="Device that shows the hologram")


class HoloPathMaterial(bpy.types.PropertyGroup):
    """Settings of a material, `Material.holopath`."""

    abbe_number: FloatProperty(
        name="Abbe Number",
        description=(
            "Abbe number of clear glass, which spreads colors less the higher it is: 59 is crown glass, 36 flint "
            "glass, and 0 spreads none. The node's IOR is that of yellow light, 587.6 nm"
        ),
        default=0.0,
        min=0.0,
        soft_min=20.0,
        soft_max=90.0,
        step=100,
        precision=1,
    )


class HoloPathViewLayer(bpy.types.PropertyGroup):
    """Settings of a view layer, `ViewLayer.holopath`: the passes of F12."""

    use_pass_focus: BoolProperty(
        name="Focus",
        description="Deliver a picture for each distance of the focus list, or for the focus distance if it is empty",
        default=False,
    )
    use_pass_phase: BoolProperty(
        name="Phase",
        description="Deliver the phase of the wave field at the SLM in radians from 0 to 2π, of the first frame shown",
        default=False,
    )
    use_pass_amplitude: BoolProperty(
        name="Amplitude",
        description="Deliver the amplitude of the wave field at the SLM, of the first frame shown",
        default=False,
    )
    use_pass_depth: BoolProperty(
        name="Depth",
        description="Deliver the distance of the first surface along the camera's axis, in scene units",
        default=False,
    )


# Attribute of Blender's own types, which the type checker does not know.
_NAME = "holopath"
_GROUPS = {
    bpy.types.Scene: HoloPathSettings,
    bpy.types.Material: HoloPathMaterial,
    bpy.types.ViewLayer: HoloPathViewLayer,
}


def of(scene: bpy.types.Scene | None) -> HoloPathSettings:
    """Settings of a scene. None is accepted for the type checker: contexts that reach this have a scene."""
    return getattr(scene, _NAME)


def of_material(material: bpy.types.Material | None) -> HoloPathMaterial:
    """Settings of a material, see `of`."""
    return getattr(material, _NAME)


def of_layer(layer: bpy.types.ViewLayer | None) -> HoloPathViewLayer:
    """Settings of a view layer, see `of`."""
    return getattr(layer, _NAME)


def hologram_of(props, resolution=None, depth_auto=None):
    """Hologram that the settings describe.

    Parameters
    ----------
    props : HoloPathSettings
    resolution : tuple of int, optional
        Width and height, pixels, of its picture; None: the panel is that of the settings.
    depth_auto : bool, optional
        Whether the depth range is automatic. Default: as the settings say.

    Returns
    -------
    engine.Hologram

    Raises
    ------
    engine.InvalidInput
        If the settings contradict each other, or a measured file cannot be read.
    engine.BackendUnavailable
        If the library for a measured file is not installed.
    """
    wavelengths = tuple(props.wavelengths_nm) if props.colors == "RGB" else (props.wavelength_nm,)
    ends: dict = {"depth_far": props.depth_far_mm, "depth_near": props.depth_near_mm}
    is_auto = depth_is_auto(props) if depth_auto is None else depth_auto
    ends = {} if is_auto else {name: tidy(mm * 1e-3) for name, mm in ends.items()}
    optics = optics_of(props)
    arguments: dict[str, Any] = {
        "pitch": pitch_of(props),
        "wavelengths": tuple(tidy(w * 1e-9) for w in wavelengths),
        "depth_mapping": props.depth_mapping,
        "near": None if props.near_auto else tidy(props.near),
        **ends,
    }
    size = props.resolution_x, props.resolution_y
    if resolution:  # a measured beam fits only the panel to be found
        size = engine.Hologram(*size, **arguments, optics=replace(optics, beam=engine.Beam())).panel_for(
            *resolution
        )
    return engine.Hologram(*size, **arguments, optics=optics)


def pitch_of(props):
    """Pixel pitch of the display, meters; a pair (x, y) if pixels are not square."""
    across, down = (tidy(um * 1e-6) for um in (props.pitch_um, props.pitch_y_um))
    return across if props.square_pixels else (across, down)


def depth_is_auto(props):
    """Whether the depth range is automatic; in scenes of earlier versions, without the switch, if no end is set."""
    return props.depth_auto and (props.is_property_set("depth_auto") or not _ends_set(props))


def display_of(props):
    """The chosen `engine.Display`; None for a custom one."""
    return engine.DISPLAYS.get(props.display)


def settings_of(props):
    """The `engine.Settings`.

    Raises
    ------
    engine.InvalidInput
        If a value is invalid.
    """
    values = {name: _value(props, name, declared) for name, declared in DECLARED.items()}
    if not may_be_smooth(props):
        values["randomness"] = None
    return engine.Settings(**values)


def may_be_smooth(props):
    """Whether the phase field may be smooth, so that its randomness counts."""
    return props.phase_field in ("auto", "smooth")


def _value(props, name, declared) -> Any:
    """Value of a declared setting in the engine's units."""
    switch = declared.switch
    if switch is not None and getattr(props, switch.name) != switch.by_hand:
        return default_of(name)
    value = getattr(props, property_of(name))
    if name == "fixed":
        return engine.parse_fixed(value)
    if isinstance(value, float):
        return tidy(value * (1e-3 if declared.unit else 1))
    return value


def encode_seconds_of(props):
    """Time limit of encoding, seconds; None without a limit."""
    limited = props.limit_encoding and props.encoding != "dpac"
    return tidy(props.encode_seconds) if limited else None


def eyebox_of(props):
    """Weight of parts of the pupil in encoding; None: the plan decides."""
    return None if props.eyebox_auto else tidy(props.eyebox)


def focus_of(props):
    """Focus distance, meters; may be infinite."""
    return math.inf if props.focus_infinity else tidy(props.focus)


def focus_list_of(props):
    """Distances of the focus list, meters, in its order and without repetition; if it is empty the focus distance."""
    return list(dict.fromkeys(focus_of(item) for item in props.focus_list)) or [focus_of(props)]


def modulator_of(props):
    """The `engine.Modulator`: limits of the display."""
    fill_factor = props.fill_factor if props.pixel_shape else None
    return engine.Modulator(props.bits, fill_factor, props.unmodulated, props.crosstalk)


def reconstruction_of(props):
    """Arguments of `session.refocus` that the settings describe.

    Parameters
    ----------
    props : HoloPathSettings

    Returns
    -------
    focus : float
        Distance, meters.
    pupil : engine.Pupil or None
        None: the whole pupil.
    modulator : engine.Modulator or None
        Limits of the display that shows the phases; None: the field itself.
    optics : engine.Optics
        Bench.

    Raises
    ------
    engine.InvalidInput
        If there is no such bench.
    engine.BackendUnavailable
        If the library for a measured file is not installed.
    """
    modulator = modulator_of(props) if props.refocused == "PHASE" else None
    return focus_of(props), pupil_or_none(props), modulator, optics_of(props)


def pupil_or_none(props):
    """The `engine.Pupil`; None for the whole pupil."""
    if not props.use_pupil:
        return None
    return engine.Pupil(*(tidy(v * 1e-3) for v in (*props.pupil_offset_mm, props.pupil_diameter_mm)))


def set_focus(props, distance):
    """Focus at a distance, meters, which may be infinite."""
    props.focus = min(distance, MAX_FOCUS)


def note_focus(props, distance):
    """Write down the distance, meters, of automatic focusing, without refocusing: its picture is shown already."""
    # auto-saves lack `_stamp`: without this a file that is recovered would count as one of an earlier version
    if not props.is_property_set("depth_auto"):
        props.depth_auto = depth_is_auto(props)
    with _without_refocusing():
        set_focus(props, distance)


def mark_distance(props, index):
    """Mark the distance of an index in the focus list, without refocusing."""
    with _without_refocusing():
        props.focus_index = index


@contextmanager
def _without_refocusing():
    """Write focus or index within the block without refocusing."""
    _silenced.append(True)
    try:
        yield
    finally:
        _silenced.pop()


CLASSES = (
    HoloPathDevice,
    HoloPathOptics,
    HoloPathFocus,
    HoloPathSettings,
    HoloPathMaterial,
    HoloPathViewLayer,
)


def register():
    """Register only the settings, for the command line in the bpy module."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    attach()


def _anything_set(props):
    """Whether any value was set, by a user or a script."""
    own = [prop for prop in props.bl_rna.properties if prop.type in _VALUES]
    # other forms of a property always count as set
    return any(
        props.is_property_set(prop.identifier)
        for prop in own
        if prop.identifier not in _Focus.__annotations__
    )


@bpy.app.handlers.persistent
def _stamp(*_):
    """Save whether the depth range is automatic. Files of earlier versions, with 10 to 15 mm, lack this."""
    for scene in bpy.data.scenes:
        if scene.library is None and _anything_set(of(scene)):
            of(scene).depth_auto = depth_is_auto(of(scene))


@bpy.app.handlers.persistent
def _settle(*_):
    """Adapt a file of another version.

    Values and animations by former names are adopted. Choices that only a later version knows are reset to their
    defaults. Scenes of earlier versions keep their default depth range, and the shape of pixels with a fill factor
    below 1.
    """
    adopt_animation()
    for scene in bpy.data.scenes:
        _settle_scene(scene)


@bpy.app.handlers.persistent
def _settle_imported(context, *_):
    """Adapt the scenes that were appended or linked, as `_settle`; others in the file are of this version."""
    adopt_animation()
    for item in context.import_items:
        if isinstance(item.id, bpy.types.Scene):
            _settle_scene(item.id)


def _settle_scene(scene):
    props = of(scene)
    adopt(props)
    if scene.library is None and props.fill_factor < 1 and not props.is_property_set("pixel_shape"):
        props.pixel_shape = True
    if scene.library is None and _anything_set(props) and not props.is_property_set("depth_auto"):
        props.depth_far_mm, props.depth_near_mm = props.depth_far_mm, props.depth_near_mm
    for props in (of(scene), of(scene).device, of(scene).optics):
        for prop in props.bl_rna.properties:
            if prop.type == "ENUM" and not getattr(props, prop.identifier) and scene.library is None:
                props.property_unset(prop.identifier)


def _handlers():
    """Lists of Blender's handlers, each with a function of ours; Blender 4.2 has no handler of appended scenes."""
    handlers = bpy.app.handlers
    imported = getattr(handlers, "blend_import_post", None)
    own = [(handlers.load_post, _settle), (handlers.save_pre, _stamp)]
    return own if imported is None else [*own, (imported, _settle_imported)]


def attach():
    """Add the settings to scenes, view layers and materials."""
    for owner, group in _GROUPS.items():
        setattr(owner, _NAME, PointerProperty(type=group))
    for handlers, own in _handlers():
        handlers.append(own)


def detach():
    """Remove the settings from scenes, view layers and materials."""
    for handlers, own in _handlers():
        if own in handlers:  # another add-on may have cleared the list
            handlers.remove(own)
    for owner in _GROUPS:
        delattr(owner, _NAME)
