"""What went wrong, in one sentence."""

from .engine import BackendUnavailable, Cancelled, InvalidInput

DONE, FAILED, BAD_INPUT = 0, 1, 2


def sentence(error):
    """One line for the user about any exception that work may raise.

    Parameters
    ----------
    error : BaseException

    Returns
    -------
    str
    """
    if isinstance(error, (InvalidInput, BackendUnavailable)):
        return _one_line(error)
    if cancelled(error):
        told = _one_line(error) if isinstance(error, Cancelled) and str(error) else ""
        return told or "Cancelled: nothing was written."
    if isinstance(error, MemoryError):
        return "Not enough memory: use fewer pixels, frames or wavelengths, or a lower quality."
    if isinstance(error, OSError):
        reason = error.strerror or _one_line(error)
        where = f" ({error.filename})" if error.filename else ""
        return (
            f"The files could not be written or read: {reason}{where}; free space or choose another folder."
        )
    return f"Unexpected {type(error).__name__}: {_one_line(error)} (a bug in HoloPath: please report it)."


def cancelled(error):
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


def status(error):
    """Exit status for an exception: 2 for bad input, else 1."""
    return BAD_INPUT if isinstance(error, InvalidInput) else FAILED


def _one_line(error):
    return " ".join(str(error).split()) or type(error).__name__
