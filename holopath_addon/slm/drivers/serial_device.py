"""Frames over a serial line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...engine.errors import InvalidInput
from ..driver import Info
from .controller import BAUD, Controller
from .packets import Can

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..driver import Picture

MOST_PIXELS = 1 << 26


class SerialDriver:
    """A device that takes frames by the protocol of docs/serial-protocol.md.

    It is told the number of the picture and the wavelength, and shows each picture, however late.

    Parameters
    ----------
    port : str, optional
    baud : int
        See `Controller`.

    Attributes
    ----------
    controller : Controller
        Of the same device, for its triggers and focus.
    """

    def __init__(self, port: str | None = None, baud: int = BAUD) -> None:
        self.controller = Controller(port, baud)
        self.info = Info("serial")

    def open(self, rate: float | None, told: Callable[[int, str], None]) -> None:
        """Shake hands; see `Driver`."""
        self.controller.open()
        device = self.controller.link.device
        assert device is not None  # it has answered
        if Can.FRAMES not in device.can:
            self.controller.close()
            raise InvalidInput(
                f"The device '{device.name}' on {self.controller.name} takes no frames: name it for triggers or focus, "
                "and show the pictures with another driver."
            )
        if device.width * device.height > MOST_PIXELS:
            self.controller.close()
            raise InvalidInput(
                f"The device '{device.name}' on {self.controller.name} says that it has {device.width} x "
                f"{device.height} pixels: correct its firmware."
            )
        self.info = Info(
            device.name, device.width, device.height, device.bits, note=f"on {self.controller.name}"
        )

    def show(self, number: int, picture: Picture) -> None:
        """Send a picture; returns when the device has all of it."""
        self.controller.frame(number, picture.pixels, picture.bits, picture.parts[0][1])

    def close(self, finish: bool = False) -> None:
        """Let go of the port."""
        self.controller.close()
