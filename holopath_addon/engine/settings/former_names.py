"""Names of the version before. They work with a warning for one version, see docs/version-1.md."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial, wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

# Current names by kind of name and former name.
FORMER_NAMES = {
    "argument": {"aperture": "has_stop"},
    "setting": {"most_hits": "max_specular_depth"},
    "quality": {"full": "high"},
    "decision": {"grey": "gray"},
    "plan entry": {"grey": "gray", "most_passes": "max_passes", "wanted_error": "target_error"},
    "report entry": {
        "compared": "compare_reference",
        "encoded": "encode",
        "focus_asked": "requested_focus",
        "foretold": "estimated",
        "opened": "scene_state",
        "phases_before": "previous_phases",
    },
    "focus": {"centre": "center"},
    "packing": {"colour": "color"},
    "property": {
        "colours": "colors",
        "focus_dioptres": "focus_diopters",
        "most_hits": "max_specular_depth",
    },
}


def warn(text: str, stacklevel: int = 4) -> None:
    """Warn of a former name the caller of the function that looks it up."""
    warnings.warn(text, DeprecationWarning, stacklevel)


def current_name(kind: str, name: str, tell: Callable[[str], object] = warn) -> str:
    """Find the current name of a setting, a choice or a property.

    Parameters
    ----------
    kind : str
        A key of `FORMER_NAMES`; other kinds have no former names.
    name : str
        Former or current name.
    tell : callable
        ``tell(text)`` receives a sentence about a former name. Default: a DeprecationWarning.
    """
    new = FORMER_NAMES.get(kind, {}).get(name, name)
    if new != name:
        tell(f"The {kind} {name} is called {new} now. The next version will not accept the old name.")
    return new


_warn_from_dictionary = partial(warn, stacklevel=5)  # the look-up is one call deeper


def with_current_names(
    kind: str, values: dict, tell: Callable[[str], object] = _warn_from_dictionary
) -> dict:
    """Return a dictionary with current names as keys; parameters as of `current_name`."""
    current = {}
    for name, value in values.items():
        current[current_name(kind, name, tell)] = value
    return current


def accepts_former_names(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function whose keyword arguments may have their former names."""

    @wraps(function)
    def with_former_names(*args: P.args, **kwargs: P.kwargs) -> R:
        current = with_current_names("argument", kwargs)
        if len(current) < len(kwargs):
            raise TypeError(f"{function.__name__} got an argument by its former and its current name")
        return function(*args, **current)

    return with_former_names
