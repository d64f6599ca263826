"""Messages and exit statuses of exceptions."""

from ..engine import BackendUnavailable, Cancelled, InvalidInput
from ..engine.errors import FolderInUse, cancelled
from ..farm.errors import FarmFailed
from ..slm.errors import DeviceLost

DONE, FAILED, BAD_INPUT = 0, 1, 2


def sentence(error):
    """One-line message for the user about any exception that work may raise.

    Parameters
    ----------
    error : BaseException

    Returns
    -------
    str
    """
    if isinstance(error, (InvalidInput, BackendUnavailable, DeviceLost, FarmFailed, FolderInUse)):
        return one_line(error)
    if cancelled(error):
        message = one_line(error) if isinstance(error, Cancelled) and str(error) else ""
        return message or "Canceled: nothing was written."
    if isinstance(error, MemoryError):
        return "Not enough memory. Use fewer pixels, frames or wavelengths, or a lower quality."
    if isinstance(error, OSError):
        reason = error.strerror or one_line(error)
        path = error.filename2 or error.filename  # of a rename, the place and not the temporary file
        where = f" ({path})" if path else ""
        remedy = "Free space or choose another folder"
        if isinstance(error, PermissionError):
            remedy = "Close programs that have it open, or choose another folder"
        return f"Files could not be written or read: {reason}{where}. {remedy}."
    return (
        f"Unexpected {type(error).__name__}: {one_line(error)}. This is a bug in HoloPath: please report it."
    )


def status(error):
    """Exit status of the command line for an exception: 2 for bad input, else 1."""
    return BAD_INPUT if isinstance(error, InvalidInput) else FAILED


def one_line(error):
    """Text of an exception on one line, or its type's name if it has none."""
    return " ".join(str(error).split()) or type(error).__name__
