"""Choice of the arrays that make a field or phases: complex numbers, two real arrays, or only phases."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import product
from pathlib import Path

import numpy as np

from ..engine import InvalidInput
from .containers import Container, read
from .pictures import CHANNELS

FIELD, PHASE = "field", "phase"  # also the names of HoloPath's arrays
AMPLITUDE, INTENSITY, REAL, IMAGINARY = "amplitude", "intensity", "real", "imaginary"
ROLES = (PHASE, AMPLITUDE, INTENSITY, REAL, IMAGINARY)
PAIRS = ((AMPLITUDE, PHASE), (INTENSITY, PHASE), (REAL, IMAGINARY))
COMPLETE = ({FIELD}, {PHASE}, *map(set, PAIRS))
# Words in names of arrays, by role.
_WORDS = {
    PHASE: "phase phases phi angle angles arg argument",
    AMPLITUDE: "amplitude amplitudes amp magnitude mag modulus abs",
    INTENSITY: "intensity intensities irradiance",
    REAL: "real re",
    IMAGINARY: "imaginary imag im",
    FIELD: "field fields wavefield",
}
_ROLE_OF = {word: role for role, words in _WORDS.items() for word in words.split()}
_PER_ARRAY = ("units", "bits")  # attributes of an array, not of the light
MAX_NAMES = 20  # in a message

Parts = dict[str, str]  # names of arrays by role


def read_parts(files: Mapping[str, Path | str], arrays: Mapping[str, str] | None = None) -> Container:
    """Read the arrays of a field from several files into one container, in which their names are their roles.

    Parameters
    ----------
    files : mapping of str to path
        A file for each role: amplitude and phase, intensity and phase, or real and imaginary.
    arrays : mapping of str to str, optional
        Name of the array in the role's file. Default: the only one, or the one with the role in its name.

    Raises
    ------
    InvalidInput
        If a file cannot be read, the roles do not make a field, an array is ambiguous, or the files contradict each
        other.
    BackendUnavailable
        If the library for a file is not installed.
    """
    _require_complete(set(files), "The files give")
    whole, shared = Container({}), {}
    for role, path in files.items():
        container = read(path)
        planes = _planes(container)
        name = (arrays or {}).get(role)
        if name is None:
            names = list(planes) if len(planes) == 1 else [n for n in planes if role_of(n, planes[n]) == role]
            if len(names) != 1:
                raise InvalidInput(
                    f"Expected one array for the {role} in {path}, found {_enumerate(planes)}. Choose by --array "
                    f"{role}=NAME."
                )
            name = names[0]
        array, has_colors = _array_of(container, name, path)
        if np.iscomplexobj(array) != (role == FIELD):
            kind, other = ("real", PHASE) if role == FIELD else ("complex", FIELD)
            raise InvalidInput(
                f"{path} has {kind} numbers, which cannot be a {role}. Give {other}={path} if they are a {other}."
            )
        whole.arrays[role] = array
        whole.color_arrays |= {role} if has_colors else set()
        attributes = {**container.attributes, **container.array_attributes.get(name, {})}
        whole.array_attributes[role] = {key: attributes.pop(key) for key in _PER_ARRAY if key in attributes}
        for key, value in attributes.items():
            if key in shared and shared[key] != value:
                raise InvalidInput(f"The files differ in {key}. Write the same in both.")
            shared[key] = value
    whole.attributes.update(shared)
    return whole


def choose(container: Container, names: str | Mapping[str, str] | None) -> Container:
    """Choose the arrays of a file that make a field or phases: a container in which their names are their roles.

    Parameters
    ----------
    container : Container
    names : str or mapping of str to str, optional
        Name of the only array, or of the array of each role. Default: by the roles in their names, if they are
        unambiguous.

    Raises
    ------
    InvalidInput
        If there is no such array, or more than one choice.
    """
    arrays = _planes(container)
    if names is None:
        names = _only_reading(arrays, container)
        name = names.get(FIELD, "")
        if _role_of_name(name) not in (None, FIELD, AMPLITUDE):
            raise InvalidInput(
                f"{name} has complex numbers, which contradict its name. Give --array field={name} if they are a "
                "field, or write real numbers."
            )
    elif isinstance(names, str):
        names = {role_of(names, _array_of(container, names)[0]) or PHASE: names}
    _require_complete(set(names), "The file gives")
    whole = Container({}, dict(container.attributes))
    for role, name in names.items():
        whole.arrays[role], has_colors = _array_of(container, name)
        whole.array_attributes[role] = container.array_attributes.get(name, {})
        whole.color_arrays |= {role} if has_colors else set()
        if np.iscomplexobj(whole.arrays[role]) != (role == FIELD):
            raise InvalidInput(
                f"{name} has complex numbers, which cannot be a {role}. Give --array {name} if they are a field."
                if role != FIELD
                else f"{name} has real numbers, which cannot be a field. Give --array phase={name} if they are phases, "
                "or write complex numbers."
            )
    return whole


def _planes(container):
    return {name: array for name, array in container.arrays.items() if array.ndim > 1}


def _array_of(container, name, where="the file"):
    """An array, or a channel of the only picture by its color; and whether the array has colors."""
    arrays = _planes(container)
    if name in arrays:
        return arrays[name], name in container.color_arrays
    if name in CHANNELS and len(container.color_arrays) == 1:
        return container.arrays[next(iter(container.color_arrays))][..., CHANNELS.index(name)], False
    names = [*arrays, *(CHANNELS if container.color_arrays else ())]
    raise InvalidInput(f"Expected an array of two or more axes in {where} ({_enumerate(names)}), got {name}.")


def role_of(name, array):
    """Role of an array by its type, or by its name; None if it is unknown."""
    return FIELD if np.iscomplexobj(array) else _role_of_name(name)


def _role_of_name(name):
    """Role in the last part of a name; None without one."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name.rpartition("/")[2])
    roles = {_ROLE_OF[word.lower()] for word in words if word.lower() in _ROLE_OF}
    if len(roles) > 1:
        roles.discard(FIELD)  # field_amplitude
    return roles.pop() if len(roles) == 1 else None


def _only_reading(arrays, container) -> Parts:
    by_role: dict[str | None, list[str]] = {}
    for name, array in arrays.items():
        by_role.setdefault(role_of(name, array), []).append(name)

    def of(role):
        return by_role.get(role, [])

    fields = [name for name in of(FIELD) if np.iscomplexobj(arrays[name])]
    readings: list[Parts] = [{FIELD: name} for name in fields]
    for first, second in PAIRS:
        readings += [{first: a, second: b} for a, b in product(of(first), of(second))]
    if not (of(AMPLITUDE) or of(INTENSITY)):
        readings += [{PHASE: name} for name in of(PHASE)]
    if len(readings) > 1:
        ways = [" and ".join(reading.values()) for reading in readings[:MAX_NAMES]]
        raise InvalidInput(
            f"The file can be read as {', '.join(ways[:-1])} or {ways[-1]}. Choose by --array, such as --array "
            f"{_option(readings[0])} or --array {_option(readings[-1])}."
        )
    if readings:
        others = [name for name in arrays if name not in readings[0].values()]
        if set(readings[0]) == {PHASE} and others:
            (name,) = readings[0].values()
            raise InvalidInput(
                f"The file has {_enumerate(others)} besides {name}. Give --array {name} for only phases, or the "
                f"amplitude, too, such as --array amplitude={others[0]},phase={name}."
            )
        return readings[0]
    if len(arrays) == 1:
        ((name, array),) = arrays.items()
        return {role_of(name, array) or PHASE: name}
    if not arrays:
        raise InvalidInput(
            f"Expected an array of two or more axes in the file, found {_enumerate(container.arrays)}."
        )
    raise InvalidInput(
        f"Expected one array, found {_enumerate(arrays)}. Name one by --array, or give their roles, such as --array "
        "amplitude=NAME,phase=NAME or real=NAME,imaginary=NAME."
    )


def _option(reading):
    if len(reading) == 1:
        return next(iter(reading.values()))
    return ",".join(f"{role}={name}" for role, name in reading.items())


def _require_complete(roles, subject):
    unknown = roles - {FIELD, *ROLES}
    if unknown:
        raise InvalidInput(f"Expected roles among {', '.join(ROLES)}, got {', '.join(map(str, unknown))}.")
    if roles not in COMPLETE:
        names = " and ".join(role for role in (FIELD, *ROLES) if role in roles)
        raise InvalidInput(
            f"{subject} {names}, but a field needs phase with amplitude or intensity, real with imaginary, or only "
            "phase. Give them as --array amplitude=NAME,phase=NAME or as files amplitude=FILE phase=FILE."
        )


def _enumerate(names):
    names = list(names)
    return ", ".join(names[:MAX_NAMES]) + (", ..." if len(names) > MAX_NAMES else "")
