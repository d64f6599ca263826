"""Spatial light modulators: drivers, calibration, streaming and focus control. Imports no bpy.

A `Sequence` makes pictures of holograms, `stream` shows them on a `Driver`.
"""

from .bench import Bench, mis_set
from .calibrating import PatternWindow, calibrate, calibration_of, nominal, placed
from .calibration import Calibration, Response
from .driver import Driver, Info, Picture
from .drivers.controller import Controller, serial_ports
from .drivers.display import DisplayDriver, Monitor, monitors
from .drivers.files import FilesDriver
from .drivers.identify import identify
from .drivers.registry import DRIVERS, describe
from .drivers.serial_device import SerialDriver
from .drivers.slmsuite_device import SlmsuiteDriver
from .drivers.virtual import VirtualDriver
from .errors import DeviceLost
from .fitting import Fitted
from .focus import FocusPlanes, Plane, run_camera, sweep
from .packing import PACKINGS, packing_of
from .sensor import Sensor, read_capture
from .sequence import Sequence
from .streaming import Counts, Stills, stream
from .tuning import tune

__all__ = [
    "Bench",
    "Calibration",
    "Controller",
    "Counts",
    "DRIVERS",
    "DeviceLost",
    "DisplayDriver",
    "Driver",
    "FilesDriver",
    "Fitted",
    "FocusPlanes",
    "Info",
    "Monitor",
    "PACKINGS",
    "Picture",
    "Plane",
    "Response",
    "Sensor",
    "Sequence",
    "SerialDriver",
    "SlmsuiteDriver",
    "Stills",
    "VirtualDriver",
    "PatternWindow",
    "calibrate",
    "calibration_of",
    "describe",
    "identify",
    "mis_set",
    "monitors",
    "nominal",
    "packing_of",
    "placed",
    "read_capture",
    "run_camera",
    "serial_ports",
    "stream",
    "sweep",
    "tune",
]
