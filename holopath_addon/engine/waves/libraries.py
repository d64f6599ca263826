"""Choice of the array library that computes waves and phases, and conversion of Dr.Jit's arrays."""

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
# Libraries that compute on a graphics card, by their modules. Of two that are installed, the loaded one is used, else
# the first, which loads faster.
ON_CARDS = {"cupy": "CuPy", "torch": "PyTorch"}
VARIABLE = "HOLOPATH_ARRAYS"
EXTENSION = "HoloPath for NVIDIA Cards"  # brings one to Blender
INSTALL = (
    f"add the extension {EXTENSION}"
    if __name__.startswith("bl_ext.")
    else "`pip install 'cupy-cuda12x[ctk]'`"
)
RAN_OUT = (
    "The graphics card ran out of memory, and the processor continued: choose fewer pixels, frames or wavelengths, or "
    f"set {VARIABLE}=numpy."
)


def choose() -> tuple[str, str]:
    """Choose the library that computes waves and phases with the current backend.

    It is one of `ON_CARDS` with CUDA, if any is installed, and otherwise NumPy. `HOLOPATH_ARRAYS` overrides the choice.

    Returns
    -------
    name : str
        ``numpy``, or a module of `ON_CARDS`.
    advice : str
        If a card could compute them and does not, a sentence with the reason and the remedy; else empty.

    Raises
    ------
    InvalidInput
        If `HOLOPATH_ARRAYS` names an unknown library, or one that cannot be used.
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
    """List the installed modules of `ON_CARDS`, the preferred one first."""
    return sorted(filter(find_spec, ON_CARDS), key=lambda name: name not in sys.modules)


def advice(problem: str = "") -> str:
    """Sentence why the processor computes waves although there is a card, and what to do.

    Parameters
    ----------
    problem : str
        Problem of the installed libraries. Default: none is installed.
    """
    if problem:
        remedy = "install a newer NVIDIA driver, or a library that fits the installed one"
    else:
        problem = f"neither {' nor '.join(ON_CARDS.values())} is installed"
        remedy = f"{INSTALL} to use the card"
    return f"Waves and phases are computed by the processor, as {problem}: {remedy}."


def describe() -> str:
    """Sentence that names the library for a card; it is not loaded."""
    names = installed()
    return f"Waves and phases are computed on the card by {ON_CARDS[names[0]]}." if names else advice()


def empty_array(name: str) -> Array:
    """Empty array of a library on the device where it computes; of NumPy if the library cannot be used."""
    if name == NUMPY or _problem(name, _device()):
        return PROCESSOR
    module: Any = importlib.import_module(name)
    options = {"device": _device()} if name == "torch" else {}
    return module.empty(0, dtype=module.complex64, **options)


def by_card(work: Callable[[Array], Result], data: np.ndarray, needed: float) -> tuple[Result, str]:
    """Run a function with the library of `choose`, or on the processor if the card's memory is too small.

    Parameters
    ----------
    work : callable
        ``work(data)``, with data of the library.
    data : numpy.ndarray
    needed : float
        Bytes of the card's memory that the function takes.

    Returns
    -------
    result
        Result of the function.
    note : str
        `RAN_OUT` if the card ran out of memory, else empty.

    Raises
    ------
    InvalidInput
        See `choose`; and any error of the function.
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
    """Whether a card ran out of memory; libraries, their FFTs and Dr.Jit each have an error of their own for that."""
    message = str(error)
    ran_out = "CUFFT_ALLOC_FAILED" in message or "out of memory" in message
    return type(error).__name__ == "OutOfMemoryError" or (isinstance(error, RuntimeError) and ran_out)


def from_drjit(values: Any, array: Array) -> Array:
    """Convert Dr.Jit's numbers to complex ones of the library of an array, in the same memory by DLPack.

    Parameters
    ----------
    values : drjit array of float32
        Real and imaginary parts in turn.
    array : array
        Array of the library.
    """
    if isinstance(array, np.ndarray):
        return np.asarray(values).view(np.complex64)
    import drjit

    drjit.eval(values)
    drjit.sync_thread()  # other libraries use other streams
    xp = namespace(array)
    return of_pairs(xp.reshape(xp.from_dlpack(values), (-1, 2)))


def _device():
    """PyTorch's device for the backend."""
    return "cuda" if variants.on_card() else "cpu"


@lru_cache
def _problem(name, device):
    """Reason why a library cannot compute on a device; empty if it can."""
    try:
        module: Any = importlib.import_module(name)
        options = {"device": device} if name == "torch" else {}
        float(module.ones(8, dtype=module.float32, **options).sum())
    except ImportError:
        return f"{ON_CARDS[name]} is not installed"
    except Exception as error:  # each library has errors of its own for an old driver, or no card
        message = str(error).strip() or type(error).__name__
        return f"{ON_CARDS[name]} cannot compute there ({message.splitlines()[0].rstrip('.')})"
    return ""
