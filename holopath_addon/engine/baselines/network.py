"""A network of your own: a function from a picture with depth to a field, as learned methods have it.

Such methods learn the field of RGB-D layers (Shi et al., Nature 591, 234 (2021)) or phases that show a picture (Peng et
al., ACM TOG 39(6), 185 (2020)). HoloPath brings no network: the environment variable HOLOPATH_NETWORK names a function,
``package.module:function`` or ``/path/to/file.py:function``, which is called once a frame as

    function(rgb, z, hologram, frame)

    rgb       numpy.ndarray, float32, shape (y, x, wavelength): linear radiance from the pupil's center, top row first
    z         numpy.ndarray, float32, shape (y, x): of the surface at each pixel, meters from the SLM
    hologram  Hologram: pitch, wavelengths, depths; light runs to +z, time dependence exp(-i omega t)
    frame     int, from 0

and returns numpy.ndarray, complex64, shape (wavelength, y, x): the wave at the SLM, of which the frame mean of the
intensity, refocused at a surface, is meant to be its radiance. Nothing is scaled afterwards.

The function is code of yours that runs with all your rights, in this process: name only what you trust. HoloPath itself
loads no weights, pickled or not. What a picture with depth does not hold no network can show: what lies behind edges,
several depths along a ray, light that differs across the pupil.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
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
    """As of `layers.field`, by the function that HOLOPATH_NETWORK names."""
    name = os.environ.get(VARIABLE, "")
    function = named(name)
    radiance, z = picture_with_depth(job, lambda done, what: progress(0.5 * done, what))
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
                f"The network '{name}' failed in frame {m} ({_told(error)}): mend the function."
            ) from error
        out[m] = checked(wave, radiance.shape, f"The network '{name}' returned in frame {m}")
    return out


def named(name: str) -> Callable:
    """The function of a name.

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
    """
    if not name:
        raise InvalidInput(
            f"The method 'network' needs a function of yours: set the environment variable {VARIABLE} to "
            "'package.module:function' or '/path/to/file.py:function' and start again."
        )
    where, _, what = name.rpartition(":")
    if not where or not what:
        raise InvalidInput(
            f"{VARIABLE} is '{name}': write 'package.module:function' or '/path/to/file.py:function'."
        )
    try:
        module = _file(where) if where.endswith(".py") else importlib.import_module(where)
    except Exception as error:
        raise InvalidInput(
            f"{VARIABLE} names '{where}', which cannot be loaded ({_told(error)}): mend the name or the code."
        ) from error
    function = getattr(module, what, None)
    if not callable(function):
        raise InvalidInput(f"{VARIABLE} names '{where}', which has no function '{what}': mend the name.")
    return function


def checked(wave: object, shape: tuple[int, ...], returned: str) -> np.ndarray:
    """A wave as a network should return it.

    Parameters
    ----------
    wave : object
    shape : tuple of int
        Wavelengths, rows and columns.
    returned : str
        Begin of the sentence that says what is wrong.

    Returns
    -------
    numpy.ndarray, complex64, `shape`

    Raises
    ------
    InvalidInput
    """
    if not isinstance(wave, np.ndarray) or wave.dtype != np.complex64:
        kind = f"an array of {wave.dtype}" if isinstance(wave, np.ndarray) else type(wave).__name__
        raise InvalidInput(f"{returned} {kind}: return a NumPy array of complex64.")
    if wave.shape != shape:
        raise InvalidInput(f"{returned} the shape {wave.shape}: return (wavelength, y, x), here {shape}.")
    if not np.isfinite(wave).all():
        raise InvalidInput(f"{returned} values that are not finite: return finite numbers only.")
    return wave


def _file(path):
    specification = importlib.util.spec_from_file_location("holopath_network", path)
    if specification is None or specification.loader is None:
        raise ImportError("no Python file")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def _told(error):
    """An error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".")
