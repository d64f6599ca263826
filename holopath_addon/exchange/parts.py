"""Which arrays of which files make a field or phases: complex numbers, or two real arrays, or phases alone."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import product
from pathlib import Path

import numpy as np

from ..engine import InvalidInput
from .containers import Container, read
from .pictures import CHANNELS

FIELD, PHASE = "field", "phase"  # also the names of our own arrays
AMPLITUDE, INTENSITY, REAL, IMAGINARY = "amplitude", "intensity", "real", "imaginary"
ROLES = (PHASE, AMPLITUDE, INTENSITY, REAL, IMAGINARY)
PAIRS = ((AMPLITUDE, PHASE), (INTENSITY, PHASE), (REAL, IMAGINARY))
COMPLETE = ({FIELD}, {PHASE}, *map(set, PAIRS))
# What an array is by the words of its name.
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
MAX_NAMES = 20  # in a sentence

Parts = dict[str, str]  # array's name by its role


def read_parts(files: Mapping[str, Path | str], arrays: Mapping[str, str] | None = None) -> Container:
    """The arrays of a field that lie in several files, as one container with a role's name for each.

    Parameters
    ----------
    files : mapping of str to path
        A file for each role, of amplitude and phase, intensity and phase, or real and imaginary.
    arrays : mapping of str to str, optional
        Which array of the role's file. Default: the only one, or that whose name says the role.

    Raises
    ------
    InvalidInput
        If a file cannot be read, the roles make no field, an array is not the only one, or the files say different
        things.
    BackendUnavailable
        If the library for a file is not installed.
    """
    _require_complete(set(files), "What the files give is")
    whole, said = Container({}), {}
    for role, path in files.items():
        container = read(path)
        found = _planes(container)
        name = (arrays or {}).get(role)
        if name is None:
            names = list(found) if len(found) == 1 else [n for n in found if role_of(n, found[n]) == role]
            if len(names) != 1:
                raise InvalidInput(
                    f"Which array of {path} is the {role}: {_listed(found)}? Say it by --array {role}=NAME."
                )
            name = names[0]
        array, colored = _taken(container, name, path)
        if np.iscomplexobj(array) != (role == FIELD):
            kind, other = ("real", PHASE) if role == FIELD else ("complex", FIELD)
            raise InvalidInput(
                f"{path} holds {kind} numbers, which are no {role}: give {other}={path} if they are a {other}."
            )
        whole.arrays[role] = array
        whole.colored |= {role} if colored else set()
        attributes = {**container.attributes, **container.own.get(name, {})}
        whole.own[role] = {key: attributes.pop(key) for key in _PER_ARRAY if key in attributes}
        for key, value in attributes.items():
            if key in said and said[key] != value:
                raise InvalidInput(f"The files say different things of {key}: write both alike.")
            said[key] = value
    whole.attributes.update(said)
    return whole


def choose(container: Container, named: str | Mapping[str, str] | None) -> Container:
    """The arrays of a file that make a field or phases, as a container with a role's name for each.

    Parameters
    ----------
    container : Container
    named : str or mapping of str to str, optional
        Name of the only array, or of one for each role. Default: as their names say, if they say it in one way.

    Raises
    ------
    InvalidInput
        If there is none, or more than one way.
    """
    arrays = _planes(container)
    if named is None:
        named = _only_reading(arrays, container)
        name = named.get(FIELD, "")
        if _named_role(name) not in (None, FIELD, AMPLITUDE):
            raise InvalidInput(
                f"{name} holds complex numbers, and its name says otherwise: say --array field={name} if they are a "
                "field, or write real numbers."
            )
    elif isinstance(named, str):
        named = {role_of(named, _taken(container, named)[0]) or PHASE: named}
    _require_complete(set(named), "What the file gives is")
    whole = Container({}, dict(container.attributes))
    for role, name in named.items():
        whole.arrays[role], colored = _taken(container, name)
        whole.own[role] = container.own.get(name, {})
        whole.colored |= {role} if colored else set()
        if np.iscomplexobj(whole.arrays[role]) != (role == FIELD):
            raise InvalidInput(
                f"{name} holds complex numbers, which are no {role}: say --array {name} if they are a field."
                if role != FIELD
                else f"{name} holds real numbers, which are no field: say --array phase={name} if they are phases, or "
                "write complex numbers."
            )
    return whole


def _planes(container):
    return {name: array for name, array in container.arrays.items() if array.ndim > 1}


def _taken(container, name, where="the file"):
    """An array and whether it has colors; a channel of the only picture by its color."""
    arrays = _planes(container)
    if name in arrays:
        return arrays[name], name in container.colored
    if name in CHANNELS and len(container.colored) == 1:
        return container.arrays[next(iter(container.colored))][..., CHANNELS.index(name)], False
    names = [*arrays, *(CHANNELS if container.colored else ())]
    raise InvalidInput(
        f"There is no array {name} of two or more axes in {where}: choose among {_listed(names)}."
    )


def role_of(name, array):
    """What an array is by its type, else by its name; None if that does not say it."""
    return FIELD if np.iscomplexobj(array) else _named_role(name)


def _named_role(name):
    """What an array is by the last part of its name; None if that does not say it."""
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
            f"The file can be read as {', '.join(ways[:-1])} or {ways[-1]}: choose by --array, as --array "
            f"{_option(readings[0])} or --array {_option(readings[-1])}."
        )
    if readings:
        others = [name for name in arrays if name not in readings[0].values()]
        if set(readings[0]) == {PHASE} and others:
            (name,) = readings[0].values()
            raise InvalidInput(
                f"The file has {_listed(others)} beside {name}: say --array {name} for phases alone, or the amplitude, "
                f"too, as --array amplitude={others[0]},phase={name}."
            )
        return readings[0]
    if len(arrays) == 1:
        ((name, array),) = arrays.items()
        return {role_of(name, array) or PHASE: name}
    if not arrays:
        raise InvalidInput(
            f"There is no array of two or more axes in the file: it has {_listed(container.arrays)}."
        )
    raise InvalidInput(
        f"Which of the arrays is it: {_listed(arrays)}? Name one by --array, or say what they are, as --array "
        "amplitude=NAME,phase=NAME or real=NAME,imaginary=NAME."
    )


def _option(reading):
    if len(reading) == 1:
        return next(iter(reading.values()))
    return ",".join(f"{role}={name}" for role, name in reading.items())


def _require_complete(roles, what):
    unknown = roles - {FIELD, *ROLES}
    if unknown:
        raise InvalidInput(
            f"There is no role {', '.join(map(str, unknown))}: choose among {', '.join(ROLES)}."
        )
    if roles not in COMPLETE:
        listed = " and ".join(role for role in (FIELD, *ROLES) if role in roles)
        raise InvalidInput(
            f"{what} {listed}, which makes no field: give phase with amplitude or intensity, real with imaginary, or "
            "phase alone, as --array amplitude=NAME,phase=NAME or as files amplitude=FILE phase=FILE."
        )


def _listed(names):
    names = list(names)
    return ", ".join(names[:MAX_NAMES]) + (", ..." if len(names) > MAX_NAMES else "")
