"""Panel of the bench around the SLM."""

from bpy.types import Context, UILayout

from .. import engine
from ..blender import properties
from ..blender.properties.optics import HoloPathOptics
from ..operators import session
from .text import alert, wrapped

_RIGHT_UP = ("Right", "Up")
# Properties of each kind, and the labels of their numbers.
_BEAM = {
    "tilt": {"tilt_deg": ("Right (°)", "Up (°)")},
    "point": {"point_mm": ()},
    "gaussian": {"waist_mm": (), "middle_mm": ("Right (mm)", "Up (mm)")},
    "measured": {"beam_holds": (), "beam_file": ()},
}
_STOP = {
    "half": {"half_deg": ()},
    "rectangle": {"rectangle": ("Width", "Height")},
    "measured": {"stop_file": ()},
}
_COLORS = {
    "color_scale": "Scale",
    "color_distance_mm": "Too Near (mm)",
    "color_right_mm": "Right (mm)",
    "color_up_mm": "Up (mm)",
}


def optics(layout: UILayout, context: Context) -> None:
    """Beam, carrier, stop, lens and colors: the kind of each, and the numbers of that kind."""
    props: HoloPathOptics = properties.of(context.scene).optics
    layout.prop(props, "beam")
    _numbers(layout, props, _BEAM.get(props.beam, {}))
    if props.beam == "measured" and props.beam_holds != "field":
        layout.prop(props, "beam_phase")
    layout.prop(props, "carrier")
    if props.carrier == "given":
        _numbers(layout, props, {"carrier_at": _RIGHT_UP})
    layout.prop(props, "stop")
    _numbers(layout, props, _STOP.get(props.stop, {}))
    if props.stop == "circle":
        _switched(layout, props, "use_radius", "radius", "Radius")
    _lens(layout, props, properties.of(context.scene).depth_mapping)
    layout.prop(props, "colors_apart")
    if props.colors_apart:
        _colors(layout, props, properties.of(context.scene).colors)
    layout.prop(properties.of(context.scene), "show_bench")
    _state(layout, context)


def _switched(layout, props, switch, name, heading):
    """Draw a number after its switch."""
    row = layout.row(heading=heading)
    row.prop(props, switch, text="")
    if getattr(props, switch):
        row.prop(props, name, text="")


def _lens(layout, props, depth_mapping):
    _switched(layout, props, "use_lens", "focal_mm", "Lens (mm)")
    if props.use_lens:
        _switched(layout, props, "use_lens_distance", "lens_distance_mm", "Distance (mm)")
        if depth_mapping != "eyepiece":  # no picture stands behind it
            _switched(layout, props, "use_picture_distance", "picture_mm", "Picture (mm)")
            _switched(layout, props, "use_share", "share", "Share")


def _colors(layout, props, colors):
    suffixes = ("Red", "Green", "Blue") if colors == "RGB" else ("",)
    for name, label in _COLORS.items():
        _numbers(layout, props, {name: [f"{label} {suffix}".rstrip() for suffix in suffixes]})
    layout.operator("holopath.colors_from", icon="FILEBROWSER")


def _numbers(layout, props, rows):
    """Draw properties, given with the labels of their numbers; none for a single number."""
    column = layout.column(align=True)
    for name, labels in rows.items():
        if not labels:
            column.prop(props, name)
        for index, text in enumerate(labels):
            column.prop(props, name, index=index, text=text)


def _state(layout, context):
    """Draw the bench's error, or its effects on the picture."""
    try:
        bench = properties.hologram_of(properties.of(context.scene)).optics
    except (engine.InvalidInput, engine.BackendUnavailable) as error:
        alert(layout, context, str(error))
        return
    if bench.stopped:
        wrapped(layout, context, f"Pupil: {bench.stop_circle[2]:.0%} as Wide as on Axis", icon="INFO")
    field, phase = session.current.field, session.current.phase
    if field is not None and field.hologram.optics.lens != bench.lens:
        wrapped(layout, context, "Wave Field Is for Another Lens: Render Again", icon="ERROR")
    elif phase is not None and phase.hologram.optics != bench:
        wrapped(layout, context, "Phases Are for Another Bench: Encode Again", icon="ERROR")
