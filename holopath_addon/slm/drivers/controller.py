"""A controller on a serial port: pulses, focus, and frames where it has a display."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ...engine.errors import InvalidInput
from ..errors import DeviceLost
from .link import PATIENCE, START_PATIENCE, Link
from .packets import Can, Kind

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    import serial

BAUD = 115200
SLOWEST = 9600
READ_TIMEOUT = 0.002  # seconds that one look for answers may wait
WRITE_TIMEOUT = 1.0
ARRIVAL = 60.0  # seconds that a motion of the focus may take


def serial_ports() -> list[tuple[str, str]]:
    """Ports of this computer: device and description, as pyserial lists them."""
    from serial.tools import list_ports

    return sorted((port.device, port.description or "") for port in list_ports.comports())


class Controller:
    """Usable from several threads, one at a time.

    Parameters
    ----------
    port : str, optional
        Its name, or a URL that pyserial knows (``socket://host:port``). Default: the only one there is.
    baud : int

    Attributes
    ----------
    link : Link
        Keeps what was not taken while the device is lost.
    """

    def __init__(self, port: str | None = None, baud: int = BAUD) -> None:
        if not SLOWEST <= baud <= 100_000_000:
            raise InvalidInput(
                f"A line of {baud} baud is too slow or none: the usual is {BAUD}, {SLOWEST} the least."
            )
        self._name, self._baud = port, baud
        self._port: serial.Serial | None = None
        self._lock = threading.Lock()
        self._given = None  # number of the frame that is being sent
        self.link = Link()

    @property
    def name(self) -> str:
        """Of the port."""
        return self._name or "serial"

    def open(self) -> None:
        """Open the port and shake hands; where the device was lost, it goes on.

        Raises
        ------
        engine.InvalidInput
            If there is no such port.
        DeviceLost
            If nothing answers there.
        """
        import serial

        known = self.link.device is not None
        self.close()
        try:
            name = self._chosen()
            alone: dict[str, Any] = {} if "://" in name else {"exclusive": True}
            port = serial.serial_for_url(
                name, self._baud, timeout=READ_TIMEOUT, write_timeout=WRITE_TIMEOUT, **alone
            )
        except (OSError, ValueError) as error:
            text = f"The serial port {self.name} cannot be opened ({error})"
            if known:
                raise DeviceLost(f"{text}: plug the device in again.") from error
            raise InvalidInput(
                f"{text}: holopath devices lists those that are there; another program may hold it."
            ) from error
        try:
            with self._lock:
                self.link.connect(port, PATIENCE if known else START_PATIENCE)
        except BaseException:
            port.close()
            raise
        self._port = port

    def _chosen(self):
        if self._name is None:
            ports = serial_ports()
            if len(ports) != 1:
                there = ", ".join(name for name, _ in ports) or "none"
                raise InvalidInput(f"The serial port is to be named: there are {len(ports)} ({there}).")
            self._name = ports[0][0]
        return self._name

    def frame(self, number: int, pixels: np.ndarray, bits: int, wavelength: int) -> None:
        """Send a frame, and wait until the device has it.

        The frame that was being sent when the device was lost may be given again: it is sent only once.
        """
        with self._lock:
            if number != self._given:
                self._given = number
                self.link.frame(number, pixels, bits, wavelength)
            self.link.finish()
            self._given = None

    def trigger(self, number: int, microseconds: int = 100) -> None:
        """Have a pulse given, and wait until the device knows; opens the port if it is not, or was lost."""
        self._be_open()
        self._require(Can.TRIGGERS, "triggers")
        with self._lock, self._closing():
            self.link.trigger(number, microseconds)
            self.link.finish()

    def focus(self, position: int, progress: Callable[[int], None] | None = None) -> None:
        """Move the focus, and wait until it stands; opens the port if it is not, or was lost.

        Parameters
        ----------
        position : int
            In the device's own steps.
        progress : callable, optional
            ``progress(position)`` meanwhile; may raise `engine.Cancelled`.

        Raises
        ------
        DeviceLost
        """
        if not -(2**31) <= position < 2**31:
            raise InvalidInput(f"A position of {position} is beyond any motor's: it has 32 bits.")
        self._be_open()
        self._require(Can.FOCUS, "focus commands")
        end = time.perf_counter() + ARRIVAL
        with self._lock, self._closing():
            try:
                self.link.focus(int(position))
            finally:  # else it would be done much later, when the device is there again
                self.link.forget(Kind.FOCUS)
        while True:
            where = self.position()
            if not self.link.moving:
                return
            if progress is not None:
                progress(where)
            if time.perf_counter() > end:
                raise DeviceLost(
                    f"The focus has not arrived after {ARRIVAL:g} s: look whether the motor is blocked."
                )
            time.sleep(0.02)

    def position(self) -> int:
        """Where the focus is now, in the device's own steps."""
        self._be_open()
        with self._lock, self._closing():
            self.link.status()
            return self.link.position

    def _be_open(self):
        if self._port is None:
            self.open()

    @contextmanager
    def _closing(self):
        """Let go of the port where the device is lost."""
        try:
            yield
        except DeviceLost:
            self.close()
            raise

    def _require(self, ability, what):
        device = self.link.device
        if device is not None and ability not in device.can:
            raise InvalidInput(
                f"The device '{device.name}' on {self.name} takes no {what}: choose another port."
            )

    def close(self) -> None:
        """Let go of the port."""
        port, self._port = self._port, None
        self.link.disconnect()
        if port is not None:
            port.close()
