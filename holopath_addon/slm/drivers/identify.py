"""Identification of monitors by a number on each of them."""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

import numpy as np

from ..driver import Picture
from .display import POLL_INTERVAL, DisplayDriver

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .display import Monitor

# Segments of a digit, from the top: rows 0 to 4 and columns 0 to 2 of a grid, as (rows, columns).
_SEGMENTS = {
    "top": (0, slice(0, 3)),
    "upper left": (slice(0, 3), 0),
    "upper right": (slice(0, 3), 2),
    "middle": (2, slice(0, 3)),
    "lower left": (slice(2, 5), 0),
    "lower right": (slice(2, 5), 2),
    "bottom": (4, slice(0, 3)),
}
_DARK = {  # segments that are dark in each digit
    "0": ("middle",),
    "1": ("top", "upper left", "middle", "lower left", "bottom"),
    "2": ("upper left", "lower right"),
    "3": ("upper left", "lower left"),
    "4": ("top", "lower left", "bottom"),
    "5": ("upper right", "lower left"),
    "6": ("upper right",),
    "7": ("upper left", "middle", "lower left", "bottom"),
    "8": (),
    "9": ("lower left",),
}
HEIGHT_FRACTION = 0.5  # of the monitor's


def numeral(number: int, width: int, height: int) -> np.ndarray:
    """Draw a white number in the center of a black picture, as large as fits.

    Parameters
    ----------
    number : int
    width, height : int
        Size of the picture in pixels.

    Returns
    -------
    numpy.ndarray, uint8, shape (height, width)
    """
    digits = []
    for digit in str(number):
        digit_pixels = np.zeros((5, 4), np.uint8)
        for name, where in _SEGMENTS.items():
            if name not in _DARK[digit]:
                digit_pixels[where] = 255
        digits.append(digit_pixels)
    text = np.concatenate(digits, axis=1)[:, :-1]
    size = min(int(HEIGHT_FRACTION * height) // text.shape[0], width // text.shape[1])
    large = np.kron(text, np.ones((size, size), np.uint8))
    picture = np.zeros((height, width), np.uint8)
    top, left = (height - large.shape[0]) // 2, (width - large.shape[1]) // 2
    picture[top : top + large.shape[0], left : left + large.shape[1]] = large
    return picture


def identify(
    monitors: Sequence[Monitor], seconds: float, on_wait: Callable[[float], object] = lambda seconds: None
) -> None:
    """Show the number of each monitor on it, counted from 1.

    Parameters
    ----------
    monitors : sequence of Monitor
    seconds : float
        Duration.
    on_wait : callable
        ``on_wait(seconds)`` with the remaining seconds, again and again; may raise.

    Raises
    ------
    InvalidInput, DeviceLost
    """
    with ExitStack() as stack:
        for number, monitor in enumerate(monitors, 1):
            driver = DisplayDriver(f"{monitor.name} {monitor.geometry}", primary=True)
            stack.callback(driver.close)
            driver.open(None, lambda number, outcome: None)
            picture = Picture(numeral(number, driver.info.width, driver.info.height), number, ((0, 0),))
            while not driver.show(0, picture):
                pass
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0:
            on_wait(remaining)
            time.sleep(min(remaining, POLL_INTERVAL))
