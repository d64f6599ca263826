"""Which library of arrays computes waves and phases, and how numbers come there from Dr.Jit."""

from __future__ import annotations

import importlib
import os
import sys
from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..errors import InvalidInput
from ..memory import on_card
from ..scene import variants
from .arrays import PROCESSOR, Array, like, namespace, of_pairs

if TYPE_CHECKING:
    from collections.abc import Callable

Result = TypeVar("Result")
NUMPY = "numpy"
# Those that compute on a card, by their modules. Of two that are there, the one that is loaded already; else the first,
# which is loaded in less time.
ON_CARDS = {"cupy": "CuPy", "torch": "PyTorch"}
VARIABLE = "HOLOPATH_ARRAYS"
EXTENSION = "HoloPath for NVIDIA Cards"  # which brings one to Blender
# What does elsewhere.
INSTALL = (
    f"add the extension {EXTENSION}" if __name__.startswith("bl_ext.") else "`pip install 'holopath[cuda]'`"
)
RAN_OUT = (
    "The graphics card's memory did not suffice, and the processor went on: choose fewer pixels, frames or "
    f"wavelengths, or set {VARIABLE}=numpy."
)


def choose() -> tuple[str, str]:
    """Library that waves and phases are computed by, with the backend that is set.

    It is NumPy but for CUDA, where it is one of `ON_CARDS`, whichever is installed. `HOLOPATH_ARRAYS` names another.

    Returns
    -------
    name : str
        ``numpy``, or a module of `ON_CARDS`.
    advice : str
        Where a card could compute them and does not, a sentence that says why, and what to do; else empty.

    Raises
    ------
    InvalidInput
        If `HOLOPATH_ARRAYS` names what there is not, or what cannot be used.
    """
    named, device = os.environ.get(VARIABLE, ""), _device()
    if named:
        if named not in (NUMPY, *ON_CARDS):
            raise InvalidInput(
                f"{VARIABLE} is '{named}': set it to one of {', '.join((NUMPY, *ON_CARDS))}, or unset it."
            )
        problem = "" if named == NUMPY else _problem(named, device)
        if problem:
            raise InvalidInput(f"{VARIABLE} is '{named}', and {problem}: {INSTALL}, or unset it.")
        return named, ""
    if device != "cuda":
        return NUMPY, ""
    problems = []
    for name in installed():
        problem = _problem(name, device)
        if not problem:
            return name, ""
        problems.append(problem)
    return NUMPY, advice("; ".join(problems))


def installed() -> list[str]:
    """Modules of `ON_CARDS` that can be found, the one to take first."""
    return sorted(filter(find_spec, ON_CARDS), key=lambda name: name not in sys.modules)


def advice(why: str = "") -> str:
    """Why the processor computes waves although there is a card, and what to do, a sentence.

    `why` is what keeps the libraries that are installed from it; by default none is.
    """
    if why:
        cure = "a newer NVIDIA driver, or a library that fits the one that is there, has the card do it"
    else:
        why, cure = (
            f"neither {' nor '.join(ON_CARDS.values())} is installed",
            f"{INSTALL}, and the card does it",
        )
    return f"Waves and phases are computed by the processor, as {why}: {cure}."


def describe() -> str:
    """What would compute waves and phases on a card, a sentence; nothing is loaded for that."""
    found = installed()
    return f"Waves and phases are computed on the card by {ON_CARDS[found[0]]}." if found else advice()


def empty_array(name: str) -> Array:
    """An empty array of a library, where it is to compute; NumPy's where the library cannot be used."""
    if name == NUMPY or _problem(name, _device()):
        return PROCESSOR
    module: Any = importlib.import_module(name)
    options = {"device": _device()} if name == "torch" else {}
    return module.empty(0, dtype=module.complex64, **options)


def by_card(work: Callable[[Array], Result], data: np.ndarray, needed: float) -> tuple[Result, str]:
    """Work on some numbers by the library of `choose`, or on the processor where the card's memory does not suffice.

    Parameters
    ----------
    work : callable
        ``work(data)``, with numbers in the namespace of the library.
    data : numpy.ndarray
    needed : float
        Bytes of the card's memory that it takes.

    Returns
    -------
    result
        Of the work.
    note : str
        Where the memory ran out meanwhile, a sentence; else empty.

    Raises
    ------
    InvalidInput
        As `choose`, and what the work raises.
    """
    on = empty_array(choose()[0])
    memory = on_card(on)
    if isinstance(on, np.ndarray) or (memory and memory[1] < needed):
        return work(data), ""
    try:
        return work(like(data, on)), ""
    except Exception as error:
        if not out_of_memory(error):
            raise
    return work(data), RAN_OUT


def out_of_memory(error: BaseException) -> bool:
    """Whether a card's memory ran out; libraries, FFTs in them and Dr.Jit each have an error of their own for that."""
    words = str(error)
    ran_out = "CUFFT_ALLOC_FAILED" in words or "out of memory" in words
    return type(error).__name__ == "OutOfMemoryError" or (isinstance(error, RuntimeError) and ran_out)


def from_drjit(values: Any, array: Array) -> Array:
    """Complex numbers of Dr.Jit's, real and imaginary parts in turn, in the namespace of an array.

    They stay in the memory where they lie, by DLPack.

    Parameters
    ----------
    values : drjit array of float32
    array : array
    """
    if isinstance(array, np.ndarray):
        return np.asarray(values).view(np.complex64)
    import drjit

    drjit.eval(values)
    drjit.sync_thread()  # other libraries have streams of their own
    xp = namespace(array)
    return of_pairs(xp.reshape(xp.from_dlpack(values), (-1, 2)))


def _device():
    """Where arrays of PyTorch lie that go with the backend."""
    return "cuda" if variants.on_card() else "cpu"


@lru_cache
def _problem(name, device):
    """What keeps a library from computing on a device; nothing if it can."""
    try:
        module: Any = importlib.import_module(name)
        options = {"device": device} if name == "torch" else {}
        float(module.ones(8, dtype=module.float32, **options).sum())
    except ImportError:
        return f"{ON_CARDS[name]} is not installed"
    except Exception as error:  # of a driver that is too old, or no card; each library has errors of its own
        said = str(error).strip() or type(error).__name__
        return f"{ON_CARDS[name]} cannot compute there ({said.splitlines()[0].rstrip('.')})"
    return ""
