"""Spatial light modulators: drivers, calibration, streaming and focus control. Imports no bpy.

A `Sequence` makes pictures of holograms, `stream` shows them on a `Driver`.
"""

from .calibration import Calibration, Response
from .controller import Controller, serial_ports
from .display import DisplayDriver, Monitor, monitors
from .driver import Driver, Info, Picture
from .errors import DeviceLost
from .files import FilesDriver
from .focus import FocusPlanes, Plane, run_camera, sweep
from .registry import DRIVERS, describe
from .sequence import PACKINGS, Sequence
from .serial_device import SerialDriver
from .slmsuite_device import SlmsuiteDriver
from .streaming import Counts, stream
from .virtual import VirtualDriver

__all__ = [
    "Calibration",
    "Controller",
    "Counts",
    "DRIVERS",
    "DeviceLost",
    "DisplayDriver",
    "Driver",
    "FilesDriver",
    "FocusPlanes",
    "Info",
    "Monitor",
    "PACKINGS",
    "Picture",
    "Plane",
    "Response",
    "Sequence",
    "SerialDriver",
    "SlmsuiteDriver",
    "VirtualDriver",
    "describe",
    "monitors",
    "run_camera",
    "serial_ports",
    "stream",
    "sweep",
]
