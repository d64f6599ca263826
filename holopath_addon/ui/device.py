"""Panel of the device that shows the hologram."""

from bpy.types import Context, UILayout

from ..blender import properties
from ..blender.device_properties import BIT_LAYOUT, HoloPathDevice, has_order, has_trigger
from ..operators import devices
from .text import alert, wrapped


def device(layout: UILayout, context: Context) -> None:
    """Device, format and progress of its pictures, and the camera's focus."""
    props: HoloPathDevice = properties.of(context.scene).device
    row = layout.row(align=True)
    row.prop(props, "driver")
    row.operator("holopath.find_devices", text="", icon="FILE_REFRESH")
    _DEVICE[props.driver](layout, props)
    column = layout.column()
    column.active = not devices.streaming()
    column.prop(props, "calibration")
    if not props.calibration:
        column.prop(props, "falling")
    column.prop(props, "packing")
    if props.packing == BIT_LAYOUT[0]:
        column.prop(props, "bit_layout")
    elif has_order(props):
        column.prop(props, "order")
    if props.driver != "files":
        column.prop(props, "rate", text="Rate (Hz)")
        if props.driver != "virtual":
            column.prop(props, "loops")
    if props.driver != "files":
        row = layout.row(heading="Trigger")
        row.prop(props, "trigger", text="")
    if has_trigger(props):
        row.prop(props, "pulse", text="")
        if props.driver != "serial":
            _port(layout, props)
    _progress(layout, context)
    _focus(layout, context, props)


def _display(layout: UILayout, props: HoloPathDevice) -> None:
    row = layout.row(align=True)
    row.prop(props, "monitor")
    row.operator("holopath.identify_monitors", text="", icon="QUESTION")
    layout.prop(props, "primary")


def _port(layout: UILayout, props: HoloPathDevice) -> None:
    layout.prop(props, "port")
    layout.prop(props, "baud")


def _slmsuite(layout: UILayout, props: HoloPathDevice) -> None:
    layout.prop(props, "model")
    layout.prop(props, "options")


_DEVICE = {
    "display": _display,
    "serial": _port,
    "slmsuite": _slmsuite,
    "files": lambda layout, props: layout.prop(props, "folder"),
    "virtual": lambda layout, props: None,
}


def _progress(layout: UILayout, context: Context) -> None:
    """Draw the button, or the counts of a running stream, and the last failure."""
    current = devices.current
    column = layout.column()
    if devices.streaming():
        counts = current.counts
        column.operator("holopath.stop_streaming", icon="SNAP_FACE")
        text = "Opening Device…" if counts is None else f"{counts}"
    else:
        column.operator("holopath.stream", icon="PLAY")
        counts, text = current.counts, f"Last: {current.counts}" if current.counts else ""
    if text:
        wrapped(layout, context, text, icon="INFO")
    if devices.streaming() and counts is not None and counts.lost:
        alert(layout, context, f"{counts.lost} Waiting for it.")
    elif current.error:
        alert(layout, context, current.error)
    elif devices.streaming() and current.driver is not None and current.driver.info.note:
        wrapped(layout, context, f"{current.driver.info.name}: {current.driver.info.note}")


def _focus(layout: UILayout, context: Context, props: HoloPathDevice) -> None:
    """Draw the camera's focus planes."""
    layout.separator()
    layout.label(text="Camera")
    row = layout.row(align=True)
    row.prop(props, "planes")
    row.operator("holopath.new_planes", text="", icon="FILE_NEW")
    if props.driver != "virtual":
        if props.driver != "serial" and not has_trigger(props):
            _port(layout, props)
        layout.prop(props, "camera", text="Command")
    row = layout.row(align=True)
    row.prop(props, "plane")
    row.operator("holopath.focus_plane", text="", icon="VIEW_CAMERA")
    row.operator("holopath.store_plane", text="", icon="IMPORT")
    layout.operator("holopath.capture", icon="RENDER_STILL")
