"""Libraries that only some kinds of files need."""

from typing import Any

from ..engine import BackendUnavailable


def needed(module: str) -> Any:
    """A library's module.

    Raises
    ------
    BackendUnavailable
        If it is not installed.
    """
    try:
        return __import__(module, fromlist=["numpy"])
    except ImportError as error:
        name = module.partition(".")[0]
        raise BackendUnavailable(f"Such files need {name}: install it with `pip install {name}`.") from error
