"""Spatial light modulators: drivers, calibration, streaming and focus control. Imports no bpy.

A `Sequence` turns holograms into pictures, and `stream` shows them on a `Driver`.
"""

from .bench import Bench, perturbed_bench
from .calibrating import PatternWindow, calibrate, calibration_of, nominal_setup, place_in_center
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
from .fitting import FitResult
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
    "FitResult",
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
    "perturbed_bench",
    "monitors",
    "nominal_setup",
    "packing_of",
    "place_in_center",
    "read_capture",
    "run_camera",
    "serial_ports",
    "stream",
    "sweep",
    "tune",
]
