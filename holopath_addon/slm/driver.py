"""The interface of device drivers: open a device, ask for its properties, show pictures, close it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

SHOWN, LATE, DROPPED = "shown", "late", "dropped"


@dataclass(frozen=True)
class Info:
    """Properties of a device.

    Attributes
    ----------
    name : str
    width, height : int
        Pixels; 0 for any.
    bits : int
        Bits of a pixel's level; 0 for any.
    rate : float or None
        Pictures per second of a device that keeps time itself; None where the streamer does.
    drops : bool
        Whether a picture whose time has passed is dropped; otherwise each is shown, however late.
    channels : int
        1, or 3 for pictures of red, green and blue.
    note : str
        A remark for the user, in a few words.
    """

    name: str
    width: int = 0
    height: int = 0
    bits: int = 8
    rate: float | None = None
    drops: bool = False
    channels: int = 1
    note: str = ""


@dataclass(frozen=True)
class Picture:
    """A picture for a device.

    Attributes
    ----------
    pixels : numpy.ndarray, uint8 or uint16, shape (y, x) or (y, x, 3)
        Levels; row 0 is the top.
    key : object
        Equal for equal pictures.
    parts : tuple of (int, int)
        Indices of frame and wavelength of each hologram in it, in the order of display.
    bits : int
        Bits of each hologram's levels.
    """

    pixels: np.ndarray
    key: object
    parts: tuple
    bits: int = 8


class Driver(Protocol):
    """A driver of a device.

    Attributes
    ----------
    info : Info
        Valid once the device is open.
    """

    info: Info

    def open(self, rate: float | None, on_picture: Callable[[int, str], None]) -> None:
        """Open the device.

        Parameters
        ----------
        rate : float or None
            Requested pictures per second; None for the device's own rate.
        on_picture : callable
            A device that keeps time itself calls ``on_picture(number, outcome)`` for each picture, in any thread, with
            `SHOWN`, `LATE` (shown, but too late) or `DROPPED`. For other devices the streamer counts them.

        Raises
        ------
        engine.InvalidInput
            If there is no such device.
        DeviceLost
            If the device does not answer; it may be opened again.
        """

    def show(self, number: int, picture: Picture) -> bool | None:
        """Show a picture, and return when the device accepts the next one.

        Parameters
        ----------
        number : int
            Number of the picture, from 0 on.
        picture : Picture

        Returns
        -------
        bool or None
            False, soon, if the device is busy: show the picture again.

        Raises
        ------
        engine.InvalidInput
            If the picture does not fit the device.
        DeviceLost
        """

    def close(self, finish: bool = False) -> bool | None:
        """Release the device, even if it is lost or was never open.

        Parameters
        ----------
        finish : bool
            Show the pictures that still wait first. Only then may it raise `DeviceLost`, or return False: call again.
        """
