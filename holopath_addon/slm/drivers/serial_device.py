"""Displays that take frames over a serial line."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import TYPE_CHECKING

from ...engine.errors import InvalidInput
from ..driver import Info
from ..errors import DeviceLost
from .controller import BAUD, Controller
from .packets import Can

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..driver import Picture

MAX_PIXELS = 1 << 26
KEEP_ALIVE = 1.0  # seconds of silence: without the computer a device switches its lasers off after some


class SerialDriver:
    """A display that takes frames by the protocol of docs/serial-protocol.md.

    Each frame carries the number of the picture and the wavelength. Every picture is shown, however late.

    Parameters
    ----------
    port : str, optional
    baud : int
        See `Controller`.

    Attributes
    ----------
    controller : Controller
        The device's controller, which also has its triggers and focus.
    """

    def __init__(self, port: str | None = None, baud: int = BAUD) -> None:
        self.controller = Controller(port, baud)
        self.info = Info("serial")
        self._closed = threading.Event()
        self._keeper: threading.Thread | None = None

    def open(self, rate: float | None, on_picture: Callable[[int, str], None]) -> None:
        """Open the port and shake hands; see `Driver`."""
        self.controller.open()
        device = self.controller.link.device
        assert device is not None  # it has answered
        if Can.FRAMES not in device.can:
            self.controller.close()
            raise InvalidInput(
                f"The device '{device.name}' on {self.controller.name} takes no frames. Use it for triggers or focus, "
                "and show the pictures with another driver."
            )
        if device.width * device.height > MAX_PIXELS:
            self.controller.close()
            raise InvalidInput(
                f"The device '{device.name}' on {self.controller.name} reports {device.width} x {device.height} "
                "pixels, which is too many. Correct its firmware."
            )
        self.info = Info(
            device.name, device.width, device.height, device.bits, note=f"on {self.controller.name}"
        )
        self._stop_keeping()
        self._closed.clear()
        self._keeper = threading.Thread(target=self._keep_alive, name="HoloPath device", daemon=True)
        self._keeper.start()

    def _keep_alive(self):
        while not self._closed.wait(KEEP_ALIVE / 2):
            with suppress(DeviceLost):  # the next picture is told
                self.controller.keep_alive(KEEP_ALIVE)

    def _stop_keeping(self):
        self._closed.set()
        if self._keeper is not None:
            self._keeper.join()
            self._keeper = None

    def show(self, number: int, picture: Picture) -> None:
        """Send a picture, and return when the device has all of it; see `Driver`."""
        self.controller.frame(number, picture.pixels, picture.bits, picture.parts[0][1])

    def close(self, finish: bool = False) -> None:
        """Close the port; see `Driver`."""
        self._stop_keeping()
        self.controller.close()
