"""What the engine raises. Callers turn each into one sentence for the user."""


class InvalidInput(ValueError):
    """The caller's scene, display or settings cannot be used; the text says what, where and what to do."""


class BackendUnavailable(RuntimeError):
    """Mitsuba cannot compute on this machine; the text says what to install."""


class Cancelled(Exception):
    """Raised by a progress callback to stop the work; nothing is left half done."""
