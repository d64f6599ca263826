"""What the engine raises. Callers turn each into one sentence for the user."""

from __future__ import annotations


class InvalidInput(ValueError):
    """The caller's scene, display or settings cannot be used; the text says what, where and what to do."""


class BackendUnavailable(RuntimeError):
    """Mitsuba cannot compute on this machine; the text says what to install."""


class Cancelled(Exception):
    """Raised by a progress callback to stop the work; nothing is left half done.

    Attributes
    ----------
    kept : object or None
        What was done by then, if it is of use, see `encode`.
    """

    kept = None


def cancelled(error: BaseException | None) -> bool:
    """Whether an exception comes from the user's wish to stop.

    Mitsuba wraps what Ctrl-C or a progress callback raises within its own loops into a RuntimeError.

    Parameters
    ----------
    error : BaseException

    Returns
    -------
    bool
    """
    seen = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, (Cancelled, KeyboardInterrupt)):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False
