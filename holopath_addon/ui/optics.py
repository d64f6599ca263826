"""The panel of the bench around the SLM."""

from bpy.types import Context, UILayout

from .. import engine, properties
from ..operators import session
from ..properties.optics import HoloPathOptics
from .text import alert, wrapped

_RIGHT_UP = ("Right", "Up")
# Properties of each kind, and what each of their numbers is.
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


def optics(layout: UILayout, context: Context) -> None:
    """Beam, carrier and stop: of each its kind, and the numbers of that kind alone."""
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
        row = layout.row(heading="Radius")
        row.prop(props, "use_radius", text="")
        if props.use_radius:
            row.prop(props, "radius", text="")
    layout.prop(properties.of(context.scene), "show_bench")
    _state(layout, context)


def _numbers(layout, props, rows):
    column = layout.column(align=True)
    for name, words in rows.items():
        if not words:
            column.prop(props, name)
        for index, text in enumerate(words):
            column.prop(props, name, index=index, text=text)


def _state(layout, context):
    """What is wrong with the bench, or what it does to the picture."""
    try:
        bench = properties.hologram_of(properties.of(context.scene)).optics
    except (engine.InvalidInput, engine.BackendUnavailable) as error:
        alert(layout, context, str(error))
        return
    if bench.stopped:
        wrapped(layout, context, f"Pupil: {bench.opening[2]:.0%} as Wide as on Axis", icon="INFO")
    phase = session.current.phase
    if phase is not None and phase.hologram.optics != bench:
        wrapped(layout, context, "Phases Are for Another Bench: Encode Again", icon="ERROR")
