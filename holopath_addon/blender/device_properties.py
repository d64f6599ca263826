"""Settings of the device that shows holograms, and what they mean to `slm`."""

from collections.abc import Mapping

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from .. import engine, slm
from ..engine.settings import Choice
from ..slm.drivers.controller import BAUD, MIN_BAUD
from ..slm.drivers.slmsuite_device import DEVICES, options_of

# A .blend holds the numbers.
_DRIVERS = [
    ("display", "Monitor", "Full screen on a monitor that is an SLM", 0),
    ("serial", "Serial Port", "A controller that takes frames over a serial line", 1),
    ("slmsuite", "slmsuite", "Any SLM that the library slmsuite drives, where it is installed", 2),
    ("files", "Files", "Pictures in a folder, for a device's own program", 3),
    ("virtual", "Virtual Bench", "A simulated SLM with its optics and a camera", 4),
]
_MODELS = {"holoeye": "HOLOEYE", "ti-plm": "TI PLM"}  # names that are not their words with capitals
_ORDERS = [(order, order, f"{order[0]}, then {order[1]}, then {order[2]}", n) for n, order in enumerate(
    ("RGB", "GRB", "BRG", "RBG", "GBR", "BGR"))]  # fmt: skip


# what was last looked for, a line each: ``monitors`` and ``ports``
found = {}


def _found(kind):
    return lambda props, context, text: [name for name in found.get(kind, ()) if text.lower() in name.lower()]


# The packing that a text names, and its number in a .blend.
BIT_LAYOUT = (
    "layout",
    "Bits of Channels",
    "Levels of any number of bits in those bits of red, green and blue that are named",
    7,
)


def menu(chosen: Mapping[str, Choice]) -> list[tuple]:
    """A menu's items; files hold their numbers."""
    return [(each.name, each.label, each.help, each.number) for each in chosen.values()]


class HoloPathDevice(bpy.types.PropertyGroup):
    """What `Scene.holopath.device` holds."""

    driver: EnumProperty(name="Device", description="What shows the hologram", items=_DRIVERS)
    monitor: StringProperty(
        name="Monitor",
        description="The SLM's monitor: its name or geometry. Empty: the only one besides the primary",
        search=_found("monitors"),
        search_options={"SUGGESTION"},
    )
    primary: BoolProperty(
        name="Primary Monitor",
        description="Allow the monitor that you work at to show the hologram; Esc there closes it",
        default=False,
    )
    port: StringProperty(
        name="Port",
        description="Serial port of the controller. Empty: the only one there is",
        search=_found("ports"),
        search_options={"SUGGESTION"},
    )
    baud: IntProperty(
        name="Baud Rate",
        description="Speed of the serial line, in bits per second",
        default=BAUD,
        min=MIN_BAUD,
        max=100_000_000,
    )
    model: EnumProperty(
        name="Model",
        description="Which of slmsuite's devices",
        items=[
            (name, _MODELS.get(name, name.title()), path, n) for n, (name, path) in enumerate(DEVICES.items())
        ],
        default="simulated",
    )
    options: StringProperty(
        name="Options",
        description='Arguments of slmsuite\'s class as JSON, for example {"slm_number": 1}',
    )
    folder: StringProperty(name="Folder", description="Where the pictures are written", subtype="DIR_PATH")
    calibration: StringProperty(
        name="Calibration",
        description="JSON file of the device: phase of its levels, correction, flips and shift. Empty: 8 bits, even",
        subtype="FILE_PATH",
    )
    falling: BoolProperty(
        name="Phase Falls",
        description="The phase of the light falls as the level rises, as on some SLMs. A calibration says it itself",
    )
    packing: EnumProperty(
        name="Packing",
        description="Holograms that one picture holds, and how",
        items=[*menu(slm.PACKINGS), BIT_LAYOUT],
    )
    bit_layout: StringProperty(
        name="Bits",
        description="Bits of the channels that a level is on this panel, from its highest on. R7-5,G7-5,B7-4: the "
        "highest three bits are bits 7 to 5 of red",
    )
    order: EnumProperty(
        name="Channel Order",
        description="Order in which the SLM shows the channels of a picture",
        items=_ORDERS,
    )
    rate: FloatProperty(
        name="Rate",
        description="Pictures per second, in hertz; 0: as the device does best",
        default=0.0,
        min=0.0,
        max=1e4,
        soft_max=240.0,
        precision=1,
        unit="NONE",
    )
    loops: IntProperty(name="Loops", description="Rounds; 0: until it is stopped", default=0, min=0)
    trigger: BoolProperty(
        name="Trigger", description="Have the controller give a pulse for each picture", default=False
    )
    pulse: IntProperty(
        name="Pulse (µs)",
        description="Length of the trigger pulse in microseconds",
        default=100,
        min=1,
        max=10_000_000,
    )
    planes: StringProperty(
        name="Focus Planes",
        description="JSON file of the planes at which the camera can look, each with the motor's position",
        subtype="FILE_PATH",
    )
    plane: IntProperty(
        name="Plane",
        description="Focus plane at which the camera looks, counted from 0",
        default=0,
        min=0,
        max=99,
    )
    camera: StringProperty(
        name="Camera",
        description="Command that takes a picture; {file}, {plane} and {mm} stand for the file to write, the plane's "
        "number and its distance",
    )


def calibration_of(device):
    """The device's `slm.Calibration`; None where none is chosen.

    Raises
    ------
    engine.InvalidInput
    """
    return slm.Calibration.load(bpy.path.abspath(device.calibration)) if device.calibration else None


def packing_of(device):
    """Name of the device's packing, or the bits of channels that it takes.

    Raises
    ------
    engine.InvalidInput
        If none are named.
    """
    if device.packing != BIT_LAYOUT[0]:
        return device.packing
    if not device.bit_layout.strip():
        raise engine.InvalidInput("The bits of the channels are missing: name them, such as R7-5,G7-5,B7-4.")
    return device.bit_layout


def has_order(device):
    """Whether the order of channels counts for the device's packing."""
    return device.packing not in ("time", BIT_LAYOUT[0]) and slm.PACKINGS[device.packing].layout is None


def sequence_of(device, phase):
    """`slm.Sequence` of a hologram for the device."""
    calibration = calibration_of(device)
    falling = calibration is None and device.falling
    order = device.order if has_order(device) else "RGB"
    return slm.Sequence([phase], calibration, packing_of(device), order, falling=falling)


def driver_of(device, sequence):
    """The `slm.Driver` that is chosen.

    Raises
    ------
    engine.InvalidInput
    """
    if device.driver == "display":
        return slm.DisplayDriver(device.monitor or None, device.primary, sequence.size)
    if device.driver == "serial":
        return slm.SerialDriver(device.port or None, device.baud)
    if device.driver == "files":
        if not device.folder:
            raise engine.InvalidInput("No folder is given: choose one for the pictures.")
        return slm.FilesDriver(bpy.path.abspath(device.folder))
    if device.driver == "virtual":
        return slm.VirtualDriver(
            sequence.holograms[0], sequence.calibration, packing=sequence.packing, order=sequence.order
        )
    return slm.SlmsuiteDriver(device.model, options_of(device.options, device.model, sequence.size))


def planes_of(device, phase):
    """The device's `slm.FocusPlanes`; of the virtual bench five over the hologram's volume, where no file is given.

    Raises
    ------
    engine.InvalidInput
    """
    if device.planes:
        return slm.FocusPlanes.load(bpy.path.abspath(device.planes))
    if device.driver != "virtual" or phase is None:
        raise engine.InvalidInput("There are no focus planes: choose their file, or make one with New.")
    return slm.FocusPlanes.spread(phase.hologram.depth_far, phase.hologram.depth_near)
