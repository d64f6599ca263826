"""SLMs of slmsuite, where it is installed."""

from __future__ import annotations

import importlib
import importlib.util
import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from ...engine.errors import InvalidInput
from ..driver import Info
from ..errors import DeviceLost

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..driver import Picture

# module and class in slmsuite.hardware.slms
DEVICES = {
    "holoeye": "holoeye.Holoeye",
    "meadowlark": "meadowlark.Meadowlark",
    "santec": "santec.Santec",
    "hamamatsu": "hamamatsu.Hamamatsu",
    "ti-plm": "texasinstruments.PLM",
    "mirrored": "screenmirrored.ScreenMirrored",
    "remote": "remote.RemoteSLM",
    "simulated": "simulated.SimulatedSLM",
}
INSTALL = "install it with `pip install slmsuite` for the Python that runs HoloPath"


def options_of(text: str, device: str, size: tuple[int, int]) -> dict:
    """Parse the arguments of a device's class.

    Parameters
    ----------
    text : str
        A JSON object; empty for none.
    device : str
        A key of `DEVICES`.
    size : (int, int)
        Width and height of the pictures, the default resolution of the simulated SLM.

    Raises
    ------
    engine.InvalidInput
        If the text is not a JSON object.
    """
    try:
        options = json.loads(text or "{}")
        if not isinstance(options, dict):
            raise ValueError("not an object")
    except ValueError as error:
        raise InvalidInput(f"Expected options as a JSON object, got {text} ({error}).") from None
    return {"resolution": list(size)} | options if device == "simulated" else options


class SlmsuiteDriver:
    """An SLM of slmsuite.

    The driver sends levels, not phases. slmsuite would flip the sign of phases (0 becomes the highest level), and add a
    correction and rounding of its own; it shows whole numbers unchanged.

    Parameters
    ----------
    device : str
        A key of `DEVICES`, or ``module.Class`` in ``slmsuite.hardware.slms``.
    options : dict
        Arguments of that class, for example ``{"slm_number": 1, "wav_um": 0.5165}``; for the simulated SLM
        ``resolution``, width and height.

    Attributes
    ----------
    slm : slmsuite.hardware.slms.slm.SLM
        Set once the device is open.

    Raises
    ------
    engine.InvalidInput
        If slmsuite is not installed, or has no such device.
    """

    def __init__(self, device: str, options: dict | None = None) -> None:
        if importlib.util.find_spec("slmsuite") is None:
            raise InvalidInput(f"The driver slmsuite needs the package slmsuite: {INSTALL}.")
        self._path = DEVICES.get(device, device)
        if self._path.count(".") != 1:
            raise InvalidInput(f"Expected a device of slmsuite ({', '.join(DEVICES)}), got '{device}'.")
        self._options = dict(options or {})
        self.slm: Any = None  # of any of slmsuite's classes
        self.info = Info("slmsuite")

    def open(self, rate: float | None, on_picture: Callable[[int, str], None]) -> None:
        """Import the class and create its SLM; see `Driver`."""
        module, name = self._path.split(".")
        try:
            kind = getattr(importlib.import_module(f"slmsuite.hardware.slms.{module}"), name)
        except Exception as error:  # missing libraries of makers raise errors of all kinds
            raise InvalidInput(
                f"slmsuite's {self._path} cannot be loaded ({type(error).__name__}: {error}). Install its maker's "
                "library, or choose another device."
            ) from error
        try:
            self.slm = kind(**self._options)
        except ImportError as error:
            raise InvalidInput(
                f"slmsuite's {self._path} lacks its maker's library ({error}). Install that library."
            ) from error
        except TypeError as error:
            raise InvalidInput(
                f"slmsuite's {self._path} takes other options ({error}). See its documentation."
            ) from error
        except Exception as error:
            raise DeviceLost(
                f"slmsuite's {self._path} does not open ({type(error).__name__}: {error}). Check cable and power."
            ) from error
        height, width = self.slm.shape
        self.info = Info(
            str(self.slm.name), width, height, int(self.slm.bitdepth), drops=True, note="by slmsuite"
        )

    def show(self, number: int, picture: Picture) -> None:
        """Show the levels unchanged; see `Driver`."""
        try:
            self.slm.set_phase(picture.pixels.astype(np.uint8 if self.info.bits <= 8 else np.uint16))
        except Exception as error:
            raise DeviceLost(
                f"{self.info.name} does not take the picture ({type(error).__name__}: {error}). Check cable and power."
            ) from error

    def close(self, finish: bool = False) -> None:
        """Close the SLM; see `Driver`."""
        slm, self.slm = self.slm, None
        if slm is not None:
            with suppress(Exception):  # a lost device cannot be closed, either
                slm.close()
