"""A network of your own: a function from an image with depth to a field, as in learned methods.

Such methods learn the field of RGB-D layers (Shi et al., Nature 591, 234 (2021)) or phases that show an image (Peng et
al., ACM TOG 39(6), 185 (2020)). HoloPath brings no network. The environment variable HOLOPATH_NETWORK names a function,
``package.module:function`` or ``/path/to/file.py:function``, which is called once for each frame as

    function(rgb, z, hologram, frame)

    rgb       numpy.ndarray, float32, shape (y, x, wavelength): linear radiance from the pupil's center, top row first
    z         numpy.ndarray, float32, shape (y, x): of the surface at each pixel, meters from the SLM
    hologram  Hologram: pitch, wavelengths, depths; light runs to +z, time dependence exp(-i omega t)
    frame     int, from 0

and returns numpy.ndarray, complex64, shape (wavelength, y, x): the wave at the SLM. Refocused at a surface, the frame
mean of its intensity should be the surface's radiance. HoloPath does not scale it.

The function is your code and runs with all your rights in this process: name only code that you trust. HoloPath itself
loads no weights, pickled or not. No network can show what an image with depth does not contain: surfaces behind edges,
several depths along a ray, and light that differs across the pupil.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput, cancelled
from .shots import picture_with_depth

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..progress import Progress
    from . import BaselineInput

VARIABLE = "HOLOPATH_NETWORK"


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Wave field by the function that HOLOPATH_NETWORK names; parameters and result as of `baselines.field`.

    Raises
    ------
    InvalidInput
        If there is no such function, or it fails or returns something else than it should.
    """
    name = os.environ.get(VARIABLE, "")
    function = load_function(name)
    radiance, z = picture_with_depth(job, lambda done, message: progress(0.5 * done, message))
    out = np.empty((job.settings.frames, *radiance.shape), np.complex64)
    rgb, z = np.moveaxis(radiance, 0, -1), z.astype(np.float32)
    for m in range(len(out)):
        progress(0.5 + 0.5 * m / len(out), "Network")
        try:
            wave = function(rgb.copy(), z.copy(), job.hologram, m)
        except Exception as error:
            if cancelled(error):
                raise
            raise InvalidInput(
                f"The network '{name}' failed in frame {m} ({_one_line(error)}). Fix the function."
            ) from error
        out[m] = checked(wave, radiance.shape, f"from the network '{name}' in frame {m}")
    return out


def digests() -> dict[str, str]:
    """SHA-256 of the function's own file, by its name; empty without one. Other files, as of weights, are not known."""
    name = os.environ.get(VARIABLE, "")
    module, _, _ = name.rpartition(":")
    try:
        found = None if module.endswith(".py") or not module else importlib.util.find_spec(module)
        file = module if found is None else found.origin
        return {f"network {name}": hashlib.sha256(Path(file or "").read_bytes()).hexdigest()}
    except Exception:  # of a package that is imported for its name; `load_function` says why
        return {}


def load_function(name: str) -> Callable:
    """Import a function by its name.

    Parameters
    ----------
    name : str
        ``package.module:function`` or ``file.py:function``.

    Returns
    -------
    callable

    Raises
    ------
    InvalidInput
        If the name has another form, the module cannot be imported, or it has no such function.
    """
    if not name:
        raise InvalidInput(
            f"The method 'network' needs your own function. Set the environment variable {VARIABLE} to "
            "'package.module:function' or '/path/to/file.py:function' and start again."
        )
    module_name, _, function_name = name.rpartition(":")
    if not module_name or not function_name:
        raise InvalidInput(
            f"Expected {VARIABLE} as 'package.module:function' or '/path/to/file.py:function', got '{name}'."
        )
    try:
        is_file = module_name.endswith(".py")
        module = _import_file(module_name) if is_file else importlib.import_module(module_name)
    except Exception as error:
        raise InvalidInput(
            f"{VARIABLE} names '{module_name}', which cannot be loaded ({_one_line(error)}). Fix the name or the code."
        ) from error
    function = getattr(module, function_name, None)
    if not callable(function):
        raise InvalidInput(
            f"{VARIABLE} names '{module_name}', which has no function '{function_name}'. Fix the name."
        )
    return function


def checked(wave: object, shape: tuple[int, ...], source: str) -> np.ndarray:
    """Return a wave if it is what a network should return.

    Parameters
    ----------
    wave : object
        Result of the network.
    shape : (int, int, int)
        Wavelengths, rows and columns.
    source : str
        Origin of the wave, for the message.

    Returns
    -------
    numpy.ndarray, complex64, `shape`

    Raises
    ------
    InvalidInput
        If it has another type or shape, or numbers that are not finite.
    """
    if not isinstance(wave, np.ndarray) or wave.dtype != np.complex64:
        kind = f"an array of {wave.dtype}" if isinstance(wave, np.ndarray) else type(wave).__name__
        raise InvalidInput(f"Expected a NumPy array of complex64 {source}, got {kind}.")
    if wave.shape != shape:
        raise InvalidInput(f"Expected the shape (wavelength, y, x) = {shape} {source}, got {wave.shape}.")
    if not np.isfinite(wave).all():
        raise InvalidInput(f"Expected finite numbers {source}, got NaN or infinity.")
    return wave


def _import_file(path):
    specification = importlib.util.spec_from_file_location("holopath_network", path)
    if specification is None or specification.loader is None:
        raise ImportError("no Python file")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def _one_line(error):
    """An error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".")
