"""Standard input of programs that are told over it when to end."""

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

_winapi: Any = None
msvcrt: Any = None
with suppress(ImportError):  # not on Windows
    import _winapi
    import msvcrt

INTERVAL = 0.1  # seconds between two looks at a pipe


def blocks(descriptor: int = 0) -> Iterator[bytes]:
    """Read standard input as it comes, until it ends.

    Parameters
    ----------
    descriptor : int
        Of the input.
    """
    while _wait(descriptor) and (data := os.read(descriptor, 1 << 16)):
        yield data


def lines(descriptor: int = 0) -> Iterator[bytes]:
    """Read whole lines, without their ends; see `blocks`."""
    rest = b""
    for data in blocks(descriptor):
        *whole, rest = (rest + data).split(b"\n")
        yield from whole


def _wait(descriptor):
    """Wait on Windows until there is something to read; whether there may be.

    A read that waits for a pipe there holds up all that asks of what kind the input is: drivers' libraries while they
    are loaded, and programs that start with the same input.
    """
    if _winapi is None:
        return True
    while True:
        try:
            # pyrefly: ignore[missing-attribute]  # there are both on Windows
            if _winapi.PeekNamedPipe(msvcrt.get_osfhandle(descriptor), 0)[0]:
                return True
        except BrokenPipeError:
            return False
        except OSError:  # no pipe
            return True
        time.sleep(INTERVAL)
