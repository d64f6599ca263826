"""What every device is to the streamer: open it, ask what it is, show pictures, close it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

SHOWN, LATE, DROPPED = "shown", "late", "dropped"


@dataclass(frozen=True)
class Info:
    """What a device is.

    Attributes
    ----------
    name : str
    width, height : int
        Pixels; 0 where it takes any.
    bits : int
        Of a pixel's level; 0 where it takes any.
    rate : float or None
        Pictures a second where the device keeps time itself, else None: the streamer does.
    drops : bool
        Whether a picture whose time has passed is left out; if not, each is shown, however late.
    channels : int
        1, or 3 where a picture has red, green and blue.
    note : str
        What else is to be known, in a few words.
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
    """What is sent to a device at once.

    Attributes
    ----------
    pixels : numpy.ndarray, uint8 or uint16, shape (y, x) or (y, x, 3)
        Levels, row 0 is the top.
    key : object
        Equal for pictures that are the same.
    parts : tuple of (int, int)
        Frame and wavelength of each hologram in it, in the order in which they are shown.
    bits : int
        Of each hologram's levels.
    """

    pixels: np.ndarray
    key: object
    parts: tuple
    bits: int = 8


class Driver(Protocol):
    """A device.

    Attributes
    ----------
    info : Info
        Once it is open.
    """

    info: Info

    def open(self, rate: float | None, told: Callable[[int, str], None]) -> None:
        """Take hold of the device.

        Parameters
        ----------
        rate : float or None
            Pictures a second that are wanted; None: as the device does best.
        told : callable
            A device that keeps time itself calls ``told(number, what)`` for each picture, in any thread, with `SHOWN`,
            `LATE` (shown, but too late) or `DROPPED`; for others the streamer sees it.

        Raises
        ------
        engine.InvalidInput
            If there is no such device.
        DeviceLost
            If it is there and does not answer; it may be opened again.
        """

    def show(self, number: int, picture: Picture) -> bool | None:
        """Show a picture; returns when the next one may be given, or soon with False: it was not taken, give it again.

        Raises
        ------
        engine.InvalidInput
            If it does not fit the device.
        DeviceLost
        """

    def close(self, finish: bool = False) -> bool | None:
        """Let go of the device; also where it is lost, or was never open.

        Parameters
        ----------
        finish : bool
            First show what still waits; then alone may this raise `DeviceLost`, or return False: ask again.
        """
