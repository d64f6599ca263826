"""Exceptions of the engine, whose messages are for the user."""

from __future__ import annotations

from typing import Any


class InvalidInput(ValueError):
    """Scene, display or settings that cannot be used; the message says what was expected and what to do."""


def real_numbers(values: Any, what: str) -> tuple[float, ...]:
    """Numbers of any type as floats.

    Parameters
    ----------
    values : iterable of number
    what : str
        Name of the numbers for the message.

    Raises
    ------
    InvalidInput
        If they are not numbers.
    """
    try:
        return tuple(map(float, values))
    except (TypeError, ValueError):
        raise InvalidInput(f"Expected {what} as a list of numbers, got {values!r:.60}.") from None


def real_number(value: Any, what: str) -> float:
    """A number of any type as a float; raises as `real_numbers`."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InvalidInput(f"Expected {what} as a number, got {value!r:.60}.") from None


class FolderInUse(OSError):
    """Folder that another program uses; the message says where the new one is."""


class BackendUnavailable(RuntimeError):
    """Mitsuba that cannot compute on this machine; the message says what to install."""


class Cancelled(Exception):
    """Exception for progress callbacks to raise: it stops the work and leaves nothing half done.

    Attributes
    ----------
    kept : object or None
        Partial result, where it is useful, see `encode`.
    """

    kept = None


def cancelled(error: BaseException | None) -> bool:
    """Whether an exception, or one that caused it, is a `Cancelled` or Ctrl-C.

    Mitsuba wraps exceptions of progress callbacks within its own loops into a RuntimeError.

    Parameters
    ----------
    error : BaseException or None

    Returns
    -------
    bool
    """
    checked = set()
    while error is not None and id(error) not in checked:
        if isinstance(error, (Cancelled, KeyboardInterrupt)):
            return True
        checked.add(id(error))
        error = error.__cause__ or error.__context__
    return False
