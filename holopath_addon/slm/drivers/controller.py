"""Controllers on a serial port: pulses, focus, and frames for those with a display."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager, suppress
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
MIN_BAUD = 9600
READ_TIMEOUT = 0.002  # seconds
WRITE_TIMEOUT = 1.0
FOCUS_TIMEOUT = 60.0  # seconds that a motion of the focus may take


def serial_ports() -> list[tuple[str, str]]:
    """Serial ports of this computer: device and description, as pyserial lists them."""
    from serial.tools import list_ports

    return sorted((port.device, port.description or "") for port in list_ports.comports())


class Controller:
    """A controller on a serial port; several threads may share it.

    Parameters
    ----------
    port : str, optional
        Name of the port, or a URL for pyserial (``socket://host:port``). Default: the only port there is, or the only
        one on USB.
    baud : int
        Speed of the line.

    Attributes
    ----------
    link : Link
        The connection. It keeps unsent messages while the device is lost.

    Raises
    ------
    InvalidInput
        If no line has such a speed.
    """

    def __init__(self, port: str | None = None, baud: int = BAUD) -> None:
        if not MIN_BAUD <= baud <= 100_000_000:
            raise InvalidInput(
                f"Expected a speed from {MIN_BAUD} to 100000000 baud, got {baud}. {BAUD} is usual."
            )
        self._name, self._baud = port, baud
        self._port: serial.Serial | None = None
        self._lock = threading.Lock()
        self._sending = None  # number of the frame in transmission
        self.link = Link()

    @property
    def name(self) -> str:
        """Name of the port."""
        return self._name or "serial"

    def open(self) -> None:
        """Open the port and shake hands; a lost device resumes.

        Raises
        ------
        engine.InvalidInput
            If there is no such port.
        DeviceLost
            If nothing answers there.
        """
        import serial

        lost = self.link.device is not None
        self.close()
        name = self._port_name()
        try:
            alone: dict[str, Any] = {} if "://" in name else {"exclusive": True}
            port = serial.serial_for_url(
                name, self._baud, timeout=READ_TIMEOUT, write_timeout=WRITE_TIMEOUT, **alone
            )
        except (OSError, ValueError) as error:
            text = f"The serial port {self.name} cannot be opened ({error})"
            if lost:
                raise DeviceLost(f"{text}. Plug the device in again.") from error
            raise InvalidInput(
                f"{text}. Close other programs that may use it, or choose a port that holopath devices lists."
            ) from error
        try:
            with self._lock:
                self.link.connect(port, PATIENCE if lost else START_PATIENCE)
        except BaseException:
            port.close()
            raise
        self._port = port

    def _port_name(self):
        from serial.tools import list_ports

        if self._name is None:
            ports = list_ports.comports()
            on_usb = [port for port in ports if port.vid is not None]
            if len(ports) > 1 and len(on_usb) == 1:  # the others are built in, such as those of Bluetooth
                ports = on_usb
            if len(ports) != 1:
                there = ", ".join(port.device for port in ports) or "none"
                raise InvalidInput(f"Expected one serial port, found {len(ports)} ({there}). Name the port.")
            self._name = ports[0].device
        return self._name

    def frame(self, number: int, pixels: np.ndarray, bits: int, wavelength: int) -> None:
        """Send a frame, and wait until the device has it.

        A frame that was in transmission when the device was lost may be sent again: the device gets it once.

        Parameters
        ----------
        number, pixels, bits, wavelength
            See `Link.frame`.

        Raises
        ------
        InvalidInput
            If the device does not show it.
        DeviceLost
        """
        with self._lock:
            if number != self._sending:
                self._sending = number
                self.link.frame(number, pixels, bits, wavelength)
            self.link.finish()
            self._sending = None
            device = self.link.device
            if self.link.refused and device is not None:
                raise InvalidInput(
                    f"The device '{device.name}' on {self.name} has received picture {number}, and does not show it. "
                    f"Check whether its firmware takes {pixels.shape[1]} x {pixels.shape[0]} pixels of {bits} bits."
                )

    def trigger(self, number: int, microseconds: int = 100) -> None:
        """Request a pulse, and wait until the device has the request; opens the port if needed.

        Parameters
        ----------
        number : int
            Number of the picture.
        microseconds : int
            Length of the pulse.

        Raises
        ------
        InvalidInput
            If the device has no triggers.
        DeviceLost
        """
        self._ensure_open()
        self._require(Can.TRIGGERS, "triggers")
        with self._lock, self._closing():
            self.link.trigger(number, microseconds)
            self.link.finish()

    def focus(self, position: int, progress: Callable[[int], None] | None = None) -> None:
        """Move the focus, and wait until it has stopped; opens the port if needed.

        A motion that is canceled, or takes too long, stops at the position that was reported last.

        Parameters
        ----------
        position : int
            Target position in the device's own steps.
        progress : callable, optional
            ``progress(position)`` meanwhile; may raise `engine.Cancelled`.

        Raises
        ------
        InvalidInput
            If the device has no focus, or no motor such a position. Once after a restart of the device, which forgets
            its position.
        DeviceLost
        """
        if not -(2**31) <= position < 2**31:
            raise InvalidInput(f"Expected a motor position of 32 bits, got {position}.")
        self._ensure_open()
        self._require(Can.FOCUS, "focus commands")
        self._check_position()
        end = time.perf_counter() + FOCUS_TIMEOUT
        try:
            self._send_focus(int(position))
            while True:
                where = self.position()
                if not self.link.moving:
                    return
                if progress is not None:
                    progress(where)
                if time.perf_counter() > end:
                    raise DeviceLost(
                        f"The focus has not arrived after {FOCUS_TIMEOUT:g} s. Check whether the motor is blocked."
                    )
                time.sleep(0.02)
        except BaseException:
            with suppress(DeviceLost):  # the motor would go on
                self._send_focus(self.link.position)
            raise

    def _check_position(self):
        """Say once that the device has restarted, as its positions are others now."""
        lost, self.link.lost_position = self.link.lost_position, 0
        if lost:
            raise InvalidInput(
                f"The controller has restarted and forgot its position: it says 0, and was at {lost}. Move the motor "
                "to its zero by hand, or store the focus planes again, then go on."
            )

    def _send_focus(self, position):
        with self._lock, self._closing():
            try:
                self.link.focus(position)
            finally:  # otherwise a device that comes back later would still move
                self.link.forget(Kind.FOCUS)

    def position(self) -> int:
        """Current position of the focus in the device's own steps."""
        self._ensure_open()
        with self._lock, self._closing():
            self.link.status()
            return self.link.position

    def resting_position(self) -> int:
        """Current position of the focus, which must not move: one to store.

        Raises
        ------
        InvalidInput
            If the focus moves. Once after a restart of the device.
        DeviceLost
        """
        position = self.position()
        self._check_position()
        if self.link.moving:
            raise InvalidInput(
                f"The focus still moves, now at {position}. Wait until it has stopped, then store its position."
            )
        return position

    def keep_alive(self, silence: float) -> None:
        """Ask the device for a report if there was none for some seconds, while the port is open.

        Raises
        ------
        DeviceLost
        """
        with self._lock:
            if self._port is not None and self.link.silence > silence:
                self.link.status()

    def _ensure_open(self):
        if self._port is None:
            self.open()

    @contextmanager
    def _closing(self):
        """Close the port if the block loses the device."""
        try:
            yield
        except DeviceLost:
            self.close()
            raise

    def _require(self, ability, name):
        device = self.link.device
        if device is not None and ability not in device.can:
            raise InvalidInput(
                f"The device '{device.name}' on {self.name} takes no {name}. Choose another port."
            )

    def close(self) -> None:
        """Close the port."""
        port, self._port = self._port, None
        self.link.disconnect()
        if port is not None:
            port.close()
