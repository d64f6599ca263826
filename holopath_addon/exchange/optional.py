"""Import of libraries that only some kinds of files need."""

from typing import Any

from ..engine import BackendUnavailable


def import_library(module: str) -> Any:
    """Import a module by its name.

    Raises
    ------
    BackendUnavailable
        If its library is not installed.
    """
    try:
        return __import__(module, fromlist=["numpy"])
    except ImportError as error:
        name = module.partition(".")[0]
        raise BackendUnavailable(f"Such files need {name}. Run `pip install {name}`.") from error
