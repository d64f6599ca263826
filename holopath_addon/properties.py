"""Scene settings of HoloPath (`Scene.holopath`) and what they mean to the engine."""

import math
from contextlib import contextmanager

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

from . import engine, pipeline
from .device_properties import HoloPathDevice
from .engine import encoding
from .engine import settings as choices
from .engine.hologram import DEPTH_MAPPINGS

CUSTOM = "CUSTOM"
LARGEST_FOCUS = 1e5  # metres; what lies farther is at infinity
# Options of a path that may start at the .blend; older Blenders let any path do so.
_KNOWS_RELATIVE = "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
_RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if _KNOWS_RELATIVE else set()

_LABELS = {
    "auto": ("Auto", "Bake diffuse light where that takes less time than tracing it for this view"),
    "fast": (
        "Fast",
        "Bake diffuse light into a texture, once for all views and focus distances of the same scene",
    ),
    "direct": ("Direct", "Trace straight from the SLM with random directions: the paper's slow baseline"),
    "draft": (
        "Draft",
        "A true hologram at once, with much noise: mirrors and glass show pictures on their own surface",
    ),
    "preview": ("Preview", "Few rays and radiance samples, for a first look"),
    "balanced": ("Balanced", "Enough rays for every depth in view"),
    "full": ("Full", "A wider cone of rays and more radiance samples"),
    "lattice": ("Lattice", "Directions on a lattice with the exact kernel: no noise but the radiance's"),
    "paper": ("Paper", "Random directions with a spherical wave, as published"),
    "grain": (
        "Per Grain",
        "Average every grain's radiance before the root is taken: right where light is indirect",
    ),
    "ray": ("Per Ray", "Light paths of its own for each ray, as published: dark where light is indirect"),
    "designed": ("Designed", "Maps designed so that the frames' mean has little speckle, at any focus"),
    "random": (
        "Random",
        "Independent for each frame, as published: speckle of one over the root of the frames",
    ),
    "curvature": ("Wavefront", "Where neighboring rays cross: right for curved mirrors and lenses"),
    "opl": ("Path Length", "At the optical path length, as published: right for flat mirrors only"),
    "fit": ("Fit Scene", "Spread the scene from its near end to infinity over the depth range"),
    "dpac": (
        "Double Phase",
        "Neighboring pixels whose mean is the complex amplitude: at once, for a first look",
    ),
    "sgd": ("Each Frame", "Gradient descent towards each frame's complex field"),
    "joint": (
        "All Frames",
        "Each frame, then all together, so that what is seen through them is what the field shows",
    ),
    "refine": (
        "References",
        "Each frame, then all together towards pictures of the scene through a thin lens, which takes longer",
    ),
    "eyepiece": ("Eyepiece", "Place depths as an eyepiece that shows the hologram in the camera's view does"),
}


_ENCODING_LABELS = _LABELS | {
    "auto": (
        "Automatic",
        "References where the method Full traced all light; else All Frames, or Each Frame where there is one",
    )
}
_METHOD_LABELS = _LABELS | {"full": ("Full", "Trace all light for this view alone")}
_METHOD_LABELS |= {
    name: (label, f"To compare with: {what}") for name, (_, label, what) in choices.BASELINES.items()
}


# A .blend holds these numbers, as it holds the places of `_items`: a display keeps its own for ever.
_DISPLAY_NUMBERS = {
    CUSTOM: 0,
    "pluto-2": 1,
    "leto-3": 2,
    "gaea-2": 3,
    "meadowlark-1920": 4,
    "santec-slm-210": 5,
    "ti-plm-067": 6,
}


def _items(names, labels=_LABELS, numbered=None):
    """Items in this order; files hold their numbers, by that of `numbered`."""
    numbered = list(numbered or names)
    return [(name, *labels[name], numbered.index(name)) for name in names]


def _display_items():
    items = [
        (CUSTOM, "Custom", "Resolution, pixel pitch and bit depth as set below", _DISPLAY_NUMBERS[CUSTOM])
    ]
    for display in engine.DISPLAYS.values():
        size = f"{display.width} × {display.height} pixels of {display.pitch * 1e6:g} µm, {display.bits} bits"
        items.append((display.name, display.label, size, _DISPLAY_NUMBERS[display.name]))
    return items


def _display_changed(props, context):
    display = display_of(props)
    if display is None:
        return
    props.bits = display.bits
    props.resolution_x, props.resolution_y, props.pitch_um = (
        display.width,
        display.height,
        display.pitch * 1e6,
    )
    far, near = pipeline.default_depth_range(display.width, display.height, display.pitch)
    props.depth_far_mm, props.depth_near_mm = far * 1e3, near * 1e3


_noting = []  # not empty while focus or index are written, but nothing is to be refocused


def _distance_changed(props, context):
    if not _noting:
        props.focus_auto = False
        _focus_changed(props, context)


def _focus_changed(props, context):
    from .operators import session

    session.request_refocus(*seen_of(props))


def _get_infinity(props):
    return props.focus >= LARGEST_FOCUS


def _set_infinity(props, value):
    if value != _get_infinity(props):
        props.focus = LARGEST_FOCUS if value else 1.0


def _get_dioptres(props):
    return 0.0 if _get_infinity(props) else 1 / props.focus


def _set_dioptres(props, value):
    props.focus = min(1 / max(value, 1e-9), LARGEST_FOCUS)


def _phase_frame_changed(props, context):
    from .operators import session

    if session.current.phase is not None:
        session.show_phase(props.phase_frame)


def _focus_chosen(props, context):
    """A distance of the list is clicked: look there."""
    if not _noting and props.focus_index < len(props.focus_list):
        focus = props.focus_list[props.focus_index].focus
        if focus != props.focus:
            props.focus = focus


class _Focus:
    """Other ways to write the property `focus` of a class."""

    focus_infinity: BoolProperty(
        name="Infinity", description="Focus at infinity", get=_get_infinity, set=_set_infinity
    )
    focus_dioptres: FloatProperty(
        name="Focus (D)",
        description="The same distance in diopters, one over meters; 0 is infinity",
        get=_get_dioptres,
        set=_set_dioptres,
        min=0.0,
        max=1e3,
        soft_max=5.0,
        step=5,
        precision=2,
    )


class HoloPathFocus(_Focus, bpy.types.PropertyGroup):
    """A distance of the focus list."""

    focus: FloatProperty(
        name="Focus (m)",
        description="Distance from the camera, in meters",
        default=1.0,
        min=1e-3,
        max=LARGEST_FOCUS,
        soft_min=0.05,
        soft_max=100.0,
        step=5,
        precision=3,
    )


class HoloPathSettings(_Focus, bpy.types.PropertyGroup):
    """What `Scene.holopath` holds."""

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
    bits: IntProperty(
        name="Bit Depth",
        description="Bits of phase that a pixel of the SLM takes: two to that power are the levels it shows",
        default=8,
        min=1,
        max=16,
        update=_focus_changed,
    )
    colours: EnumProperty(
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
        description="Vacuum wavelength, in nanometers; it shows the scene's red, green or blue light",
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
        items=_items(DEPTH_MAPPINGS),
    )
    depth_far_mm: FloatProperty(
        name="Far End (mm)",
        description="Distance from the SLM at which infinity appears, in millimeters",
        default=10.0,
        soft_min=-200.0,
        soft_max=500.0,
        step=10,
        precision=2,
    )
    depth_near_mm: FloatProperty(
        name="Near End (mm)",
        description="Distance from the SLM at which the near end appears, in millimeters; larger than the far end",
        default=15.0,
        soft_min=-200.0,
        soft_max=500.0,
        step=10,
        precision=2,
    )
    near_auto: BoolProperty(
        name="Nearest Surface",
        description="Let the near end of the depth range be the nearest surface in view",
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
    frames: IntProperty(
        name="Frames",
        description="Time-multiplexed frames per color; more have less speckle and take longer",
        default=8,
        min=1,
        max=256,
        soft_max=32,
    )
    wish_speckle: BoolProperty(
        name="Frames by Speckle",
        description="Take as many frames as the wanted speckle contrast needs",
    )
    speckle: FloatProperty(
        name="Speckle",
        description="Speckle contrast that may be left: standard deviation over mean of the intensity, from 0 to 1",
        subtype="FACTOR",
        default=0.15,
        min=0.01,
        max=1.0,
        soft_max=0.6,
        precision=2,
    )
    phase_field: EnumProperty(
        name="Phase Fields",
        description="Where the phases of the frames come from; they cost the same",
        items=_items(choices.PHASE_FIELDS),
    )
    despeckle: IntProperty(
        name="Despeckle",
        description=(
            "Steps that take speckle out of this scene's own fields after tracing, towards the mean of 96 frames, "
            "which are traced for it and multiply the time; 60 do most. 0: none"
        ),
        default=0,
        min=0,
        max=1 << 16,
        soft_max=200,
    )
    quality: EnumProperty(
        name="Quality",
        description="Rays and radiance samples per pixel: more take longer and leave less noise",
        items=_items(choices.QUALITIES, numbered=("preview", "balanced", "full", "draft")),
        default="balanced",
    )
    method: EnumProperty(
        name="Method",
        description="Where the light that surfaces scatter diffusely comes from",
        items=_items(choices.METHODS, _METHOD_LABELS),
    )
    limit_rays: BoolProperty(
        name="Limit Rays", description="Set the largest number of rays per pixel by hand", default=False
    )
    spp: IntProperty(
        name="Rays per Pixel",
        description="Most rays per pixel, on average; fewer than are needed fill a narrower cone",
        default=256,
        min=1,
        max=1 << 20,
        soft_max=4096,
    )
    estimator: EnumProperty(
        name="Estimator",
        description="How the rays of a pixel are chosen and summed",
        items=_items(choices.ESTIMATORS),
    )
    radiance: EnumProperty(
        name="Radiance",
        description="How path-traced light becomes amplitude",
        items=_items(choices.RADIANCES),
    )
    paths: IntProperty(
        name="Paths per Ray",
        description="Radiance paths that are averaged for each ray; few are dark where light is indirect",
        default=1,
        min=1,
        max=1 << 16,
        soft_max=64,
    )
    planes_auto: BoolProperty(
        name="Automatic Number of Planes",
        description="As many recording planes as are worth their time, by the depths, edges and mirrors in view",
        default=True,
    )
    planes: IntProperty(
        name="Recording Planes",
        description=(
            "Most planes that rays start from, each near its part of the scene: more planes need fewer rays, and "
            "keep the edges of near things free of dark rims"
        ),
        default=4,
        min=1,
        max=32,
        soft_max=8,
    )
    most_hits: IntProperty(
        name="Specular Hits",
        description=(
            "Most mirrors and clear surfaces in a row that are followed to what is seen in them; what is beyond is "
            "black. 0: none are followed, and reflections lie on the mirror's surface"
        ),
        default=8,
        min=0,
        max=64,
        soft_max=16,
    )
    fixed: StringProperty(
        name="Fixed Decisions",
        description=(
            "Decisions of the plan that you take yourself, for example: chain=4 passes=64. "
            f"There are {', '.join(engine.FIXABLE)}"
        ),
    )
    virtual_image: EnumProperty(
        name="Virtual Images",
        description="Depth at which things seen in mirrors and through clear glass come into focus",
        items=_items(choices.VIRTUAL_IMAGES),
    )
    wrp_auto: BoolProperty(
        name="Automatic Recording Plane",
        description="Put wave recording planes amid the depths in view, where they need the fewest rays",
        default=True,
    )
    wrp_mm: FloatProperty(
        name="Recording Plane (mm)",
        description="Distance of the wave recording plane from the SLM, in millimeters",
        default=12.5,
        soft_min=-200.0,
        soft_max=500.0,
        step=10,
        precision=2,
    )
    max_depth: IntProperty(
        name="Max Path Depth",
        description="Longest light path, in vertices: 1 is emission only, 2 direct light, each further one a bounce",
        default=8,
        min=1,
        max=64,
        soft_max=16,
    )
    seed: IntProperty(
        name="Seed", description="Seed of all random numbers: another one gives other noise", default=0, min=0
    )
    keep_fields: BoolProperty(
        name="Keep Wave Fields",
        description=(
            "Animation renders write each frame's wave field and pictures into a folder of its own, and take frames "
            "from there that were made of the same scene with the same settings"
        ),
        default=False,
        options=set(),
    )
    animation_folder: StringProperty(
        name="Wave Fields",
        description="Folder in which an animation render makes frame_0001 and so on",
        default="//holopath",
        subtype="DIR_PATH",
        options=_RELATIVE,
    )
    focus_auto: BoolProperty(
        name="Auto",
        description="Focus on the middle of the view at every render; off once a focus is chosen",
        default=True,
    )
    focus: FloatProperty(
        name="Focus (m)",
        description="Distance at which the picture is sharp, in meters; refocuses without rendering again",
        default=1.0,
        min=1e-3,
        max=LARGEST_FOCUS,
        soft_min=0.05,
        soft_max=100.0,
        step=5,
        precision=3,
        update=_distance_changed,
    )
    focus_list: CollectionProperty(
        type=HoloPathFocus,
        name="Focus List",
        description="Distances that focal stacks are made of; empty: the focus distance alone",
    )
    focus_index: IntProperty(
        name="Chosen Distance",
        description="Distance of the focus list that is looked at",
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
    use_pupil: BoolProperty(
        name="Partial Pupil",
        description="Look through a part of the pupil only: less light, more depth of field; off: all of the light",
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
        description="How complex amplitudes become the phases that an SLM shows",
        items=_items(encoding.METHODS, _ENCODING_LABELS),
        default="auto",
    )
    refocused: EnumProperty(
        name="Shown",
        description="What the reconstruction in the Image Editor shows",
        items=[
            ("FIELD", "Wave Field", "The complex field that was rendered", 0),
            (
                "PHASE",
                "Hologram",
                "The phases that an SLM shows, once they are encoded, with the display's limits",
                1,
            ),
        ],
        update=_focus_changed,
    )
    fill_factor: FloatProperty(
        name="Fill Factor",
        description="Share of a pixel's area that modulates light, from 0 to 1; the rest is dark",
        default=1.0,
        min=0.01,
        max=1.0,
        update=_focus_changed,
    )
    unmodulated: FloatProperty(
        name="Zeroth Order",
        description="Share of the light that leaves the SLM unmodulated, from 0 to 1",
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
        description="Which of the hologram's frames the picture of its phases shows, from 0",
        default=0,
        min=0,
        max=255,
        update=_phase_frame_changed,
    )
    device: PointerProperty(type=HoloPathDevice, name="Device", description="What shows the hologram")


class HoloPathMaterial(bpy.types.PropertyGroup):
    """What `Material.holopath` holds."""

    abbe_number: FloatProperty(
        name="Abbe Number",
        description=(
            "How little clear glass of this material spreads colors: 59 is crown glass, 36 flint glass, and "
            "0 means that it spreads none. The node's IOR is that of yellow light, 587.6 nm"
        ),
        default=0.0,
        min=0.0,
        soft_min=20.0,
        soft_max=90.0,
        step=100,
        precision=1,
    )


class HoloPathViewLayer(bpy.types.PropertyGroup):
    """What `ViewLayer.holopath` holds: the passes of F12."""

    use_pass_focus: BoolProperty(
        name="Focus",
        description="Deliver a picture for each distance of the focus list, if it is empty for the focus distance",
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


# Where Blender's own things hold them: as `holopath`, of which only Blender knows when it runs.
_NAME = "holopath"
_GROUPS = {
    bpy.types.Scene: HoloPathSettings,
    bpy.types.Material: HoloPathMaterial,
    bpy.types.ViewLayer: HoloPathViewLayer,
}


def of(scene: bpy.types.Scene | None) -> HoloPathSettings:
    """`Scene.holopath`; Blender's contexts may lack a scene, but not where anything of ours is asked for."""
    return getattr(scene, _NAME)


def of_material(material: bpy.types.Material | None) -> HoloPathMaterial:
    """`Material.holopath`, see `of`."""
    return getattr(material, _NAME)


def of_layer(layer: bpy.types.ViewLayer | None) -> HoloPathViewLayer:
    """`ViewLayer.holopath`, see `of`."""
    return getattr(layer, _NAME)


def hologram_of(props, resolution=None):
    """Engine's hologram of the settings.

    Parameters
    ----------
    props : HoloPathSettings
    resolution : tuple of int, optional
        Width and height in pixels in place of the settings' own.

    Returns
    -------
    engine.Hologram

    Raises
    ------
    engine.InvalidInput
    """
    width, height = resolution or (props.resolution_x, props.resolution_y)
    wavelengths = tuple(props.wavelengths_nm) if props.colours == "RGB" else (props.wavelength_nm,)
    return engine.Hologram(
        width,
        height,
        _tidy(props.pitch_um * 1e-6),
        tuple(_tidy(w * 1e-9) for w in wavelengths),
        depth_far=_tidy(props.depth_far_mm * 1e-3),
        depth_near=_tidy(props.depth_near_mm * 1e-3),
        depth_mapping=props.depth_mapping,
        near=None if props.near_auto else _tidy(props.near),
    )


def display_of(props):
    """The `engine.Display` chosen; None where it is custom."""
    return engine.DISPLAYS.get(props.display)


def settings_of(props):
    """Engine's settings, see `hologram_of`."""
    return engine.Settings(
        frames=props.frames,
        speckle=_tidy(props.speckle) if props.wish_speckle else None,
        method=props.method,
        phase_field=props.phase_field,
        despeckle=props.despeckle,
        estimator=props.estimator,
        radiance=props.radiance,
        quality=props.quality,
        spp=props.spp if props.limit_rays else None,
        wrp="auto" if props.wrp_auto else _tidy(props.wrp_mm * 1e-3),
        max_depth=props.max_depth,
        paths=props.paths,
        planes="auto" if props.planes_auto else props.planes,
        most_hits=props.most_hits,
        virtual_image=props.virtual_image,
        seed=props.seed,
        fixed=engine.parse_fixed(props.fixed),
    )


def focus_of(props):
    """Focus distance in metres, infinity included."""
    return math.inf if props.focus_infinity else _tidy(props.focus)


def focus_list_of(props):
    """Distances of the focus list in metres, infinity included; the focus alone where the list is empty.

    In the list's order, each once.
    """
    return list(dict.fromkeys(focus_of(item) for item in props.focus_list)) or [focus_of(props)]


def modulator_of(props):
    """`engine.Modulator` of the display that the settings describe."""
    return engine.Modulator(props.bits, None, props.fill_factor, props.unmodulated, props.crosstalk)


def seen_of(props):
    """What the reconstruction shows: focus in metres, `engine.Pupil` and, of phases, `engine.Modulator`, or None."""
    modulator = modulator_of(props) if props.refocused == "PHASE" else None
    return focus_of(props), pupil_or_none(props), modulator


def pupil_or_none(props):
    """`engine.Pupil`, or None for the whole cone."""
    if not props.use_pupil:
        return None
    return engine.Pupil(*(_tidy(v * 1e-3) for v in (*props.pupil_offset_mm, props.pupil_diameter_mm)))


def set_focus(props, metres):
    """Focus at a distance in metres, infinity included."""
    props.focus = min(metres, LARGEST_FOCUS)


def note_focus(props, metres):
    """Write down the focus that automatic focusing found, whose picture is there already."""
    with _quietly():
        set_focus(props, metres)


def choose(props, index):
    """Mark a distance of the focus list, without looking there."""
    with _quietly():
        props.focus_index = index


@contextmanager
def _quietly():
    _noting.append(True)
    try:
        yield
    finally:
        _noting.pop()


def _tidy(value):
    """Blender's single precision as the decimal number that was meant."""
    return float(f"{value:.6g}")


CLASSES = (HoloPathDevice, HoloPathFocus, HoloPathSettings, HoloPathMaterial, HoloPathViewLayer)


def register():
    """Register the settings alone, for the command line in the bpy module."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    attach()


@bpy.app.handlers.persistent
def _settle(*_):
    """Choices that only a later version of HoloPath knows are at their defaults in this one."""
    for scene in bpy.data.scenes:
        for props in (of(scene), of(scene).device):
            for prop in props.bl_rna.properties:
                if prop.type == "ENUM" and not getattr(props, prop.identifier) and scene.library is None:
                    props.property_unset(prop.identifier)


def attach():
    """Add the settings to scenes, view layers and materials."""
    for owner, group in _GROUPS.items():
        setattr(owner, _NAME, PointerProperty(type=group))
    bpy.app.handlers.load_post.append(_settle)


def detach():
    """Take the settings from scenes, view layers and materials."""
    if _settle in bpy.app.handlers.load_post:  # another add-on may have cleared the list
        bpy.app.handlers.load_post.remove(_settle)
    for owner in _GROUPS:
        delattr(owner, _NAME)
