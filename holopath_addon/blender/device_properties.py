"""Settings of the device that shows holograms, and their conversion to objects of `slm`."""

from collections.abc import Mapping

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from .. import engine, slm
from ..engine.settings.choices import Choice
from ..slm.drivers.controller import BAUD, MIN_BAUD
from ..slm.drivers.slmsuite_device import DEVICES, options_of
from ..slm.sequence import check_responses

# Menu items: identifier, label, help, and the number that a .blend holds.
_DRIVERS = [
    ("display", "Monitor", "Full screen on a monitor that is an SLM", 0),
    ("serial", "Serial Port", "A controller that takes frames over a serial line", 1),
    ("slmsuite", "slmsuite", "Any SLM that the library slmsuite drives, where it is installed", 2),
    ("files", "Files", "Pictures in a folder, for a device's own program", 3),
    ("virtual", "Virtual Bench", "A simulated SLM with its optics and a camera", 4),
]
_MODELS = {"holoeye": "HOLOEYE", "ti-plm": "TI PLM"}  # labels that are not names in title case
_ORDERS = [(order, order, f"{order[0]}, then {order[1]}, then {order[2]}", n) for n, order in enumerate(
    ("RGB", "GRB", "BRG", "RBG", "GBR", "BGR"))]  # fmt: skip

# Results of *Find Devices*, a line per device: ``monitors`` and ``ports``.
found_devices = {}


def _suggest(kind):
    """Search function of a property: found devices of a kind that contain the typed text."""
    return lambda props, context, text: [
        name for name in found_devices.get(kind, ()) if text.lower() in name.lower()
    ]


# Menu item of the packing that a text describes.
BIT_LAYOUT = (
    "layout",
    "Bits of Channels",
    "Levels of any number of bits in chosen bits of red, green and blue",
    7,
)


def menu(chosen: Mapping[str, Choice]) -> list[tuple]:
    """Menu items of an `EnumProperty`, whose numbers a .blend holds, from choices by name."""
    return [(each.name, each.label, each.help, each.number) for each in chosen.values()]


class HoloPathDevice(bpy.types.PropertyGroup):
    """Settings of the device, `Scene.holopath.device`."""

    driver: EnumProperty(name="Device", description="Device that shows the hologram", items=_DRIVERS)
    monitor: StringProperty(
        name="Monitor",
        description="Name or geometry of the SLM's monitor. Empty: the only one besides the primary",
        search=_suggest("monitors"),
        search_options={"SUGGESTION"},
    )
    primary: BoolProperty(
        name="Primary Monitor",
        description="Allow the hologram on the primary monitor; Esc there closes it",
        default=False,
    )
    port: StringProperty(
        name="Port",
        description="Serial port of the controller. Empty: the only one",
        search=_suggest("ports"),
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
        description="Device of the library slmsuite",
        items=[
            (name, _MODELS.get(name, name.title()), path, n) for n, (name, path) in enumerate(DEVICES.items())
        ],
        default="simulated",
    )
    options: StringProperty(
        name="Options",
        description='Arguments of slmsuite\'s class as JSON, for example {"slm_number": 1}',
    )
    folder: StringProperty(name="Folder", description="Folder to write the pictures into", subtype="DIR_PATH")
    calibration: StringProperty(
        name="Calibration",
        description="JSON file of the device: phase of its levels, correction, flips and shift. Empty: 8 bits, linear",
        subtype="FILE_PATH",
    )
    falling: BoolProperty(
        name="Phase Falls",
        description="The phase of the light falls as the level rises, as on some SLMs. A calibration contains this",
    )
    packing: EnumProperty(
        name="Packing",
        description="Arrangement of holograms in a picture",
        items=[*menu(slm.PACKINGS), BIT_LAYOUT],
    )
    bit_layout: StringProperty(
        name="Bits",
        description="Bits of the channels that make a level on this panel, highest first. In R7-5,G7-5,B7-4 the "
        "highest three bits are bits 7 to 5 of red",
    )
    order: EnumProperty(
        name="Channel Order",
        description="Order in which the SLM shows the channels of a picture",
        items=_ORDERS,
    )
    rate: FloatProperty(
        name="Rate",
        description="Pictures per second, in hertz; 0: the device's own rate",
        default=0.0,
        min=0.0,
        max=1e4,
        soft_max=240.0,
        precision=1,
        unit="NONE",
    )
    loops: IntProperty(
        name="Loops",
        description="Number of times to show the sequence; 0: until it is stopped",
        default=0,
        min=0,
    )
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
        description="JSON file of the planes at which the camera can focus, each with the motor's position",
        subtype="FILE_PATH",
    )
    plane: IntProperty(
        name="Plane",
        description="Focus plane of the camera, counted from 0",
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
    """The `slm.Calibration` of `HoloPathDevice` settings; None without a file.

    Raises
    ------
    engine.InvalidInput
        If the file cannot be read.
    """
    return slm.Calibration.load(bpy.path.abspath(device.calibration)) if device.calibration else None


def packing_of(device):
    """Packing of `HoloPathDevice` settings, for `slm.Sequence`: its name, or the bits of channels.

    Raises
    ------
    engine.InvalidInput
        If no bits are named.
    """
    if device.packing != BIT_LAYOUT[0]:
        return device.packing
    if not device.bit_layout.strip():
        raise engine.InvalidInput("The bits of the channels are missing: name them, such as R7-5,G7-5,B7-4.")
    return device.bit_layout


def has_order(device):
    """Whether the channel order matters for the packing of `HoloPathDevice` settings."""
    return device.packing not in ("time", BIT_LAYOUT[0]) and slm.PACKINGS[device.packing].layout is None


def has_trigger(device):
    """Whether pictures of a device give pulses; files show none."""
    return device.trigger and device.driver != "files"


def sequence_of(device, phase):
    """Sequence of a hologram for a device.

    Parameters
    ----------
    device : HoloPathDevice
    phase : engine.PhaseHologram

    Returns
    -------
    slm.Sequence

    Raises
    ------
    engine.InvalidInput
        If calibration or packing do not fit the hologram.
    """
    calibration = calibration_of(device)
    falling = calibration is None and device.falling
    order = device.order if has_order(device) else "RGB"
    check_responses(packing_of(device), calibration)
    return slm.Sequence([phase], calibration, packing_of(device), order, falling=falling)


def driver_of(device, sequence):
    """Driver of a device.

    Parameters
    ----------
    device : HoloPathDevice
    sequence : slm.Sequence
        Sequence to show.

    Returns
    -------
    slm.Driver

    Raises
    ------
    engine.InvalidInput
        If an option is missing or invalid.
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
    """Focus planes of a device; for the virtual bench without a file five over the hologram's volume.

    Parameters
    ----------
    device : HoloPathDevice
    phase : engine.PhaseHologram or None

    Returns
    -------
    slm.FocusPlanes

    Raises
    ------
    engine.InvalidInput
        If there are no planes, or their file cannot be read.
    """
    if device.planes:
        return slm.FocusPlanes.load(bpy.path.abspath(device.planes))
    if device.driver != "virtual" or phase is None:
        raise engine.InvalidInput("There are no focus planes: choose their file, or make one with New.")
    return slm.FocusPlanes.spread(phase.hologram.depth_far, phase.hologram.depth_near)
