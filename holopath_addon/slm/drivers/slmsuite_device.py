"""Any SLM that slmsuite knows, where slmsuite is installed."""

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
    """Arguments of a device's class from JSON; the simulated one gets the pictures' size where none is given.

    Raises
    ------
    engine.InvalidInput
    """
    try:
        options = json.loads(text or "{}")
        if not isinstance(options, dict):
            raise ValueError("no object")
    except ValueError as error:
        raise InvalidInput(f"The options {text} are no JSON object ({error}).") from None
    return {"resolution": list(size)} | options if device == "simulated" else options


class SlmsuiteDriver:
    """An SLM of slmsuite.

    It is given levels, not phases: slmsuite would flip the sign of phases (0 becomes the highest level), add its own
    correction and round in its own way; whole numbers it shows as they are.

    Parameters
    ----------
    device : str
        Of `DEVICES`, or ``module.Class`` in ``slmsuite.hardware.slms``.
    options : dict
        Arguments of that class, for example ``{"slm_number": 1, "wav_um": 0.5165}``; of the simulated one
        ``resolution``, width and height.

    Attributes
    ----------
    slm : slmsuite.hardware.slms.slm.SLM
        Once it is open.

    Raises
    ------
    engine.InvalidInput
    """

    def __init__(self, device: str, options: dict | None = None) -> None:
        if importlib.util.find_spec("slmsuite") is None:
            raise InvalidInput(f"The driver slmsuite needs slmsuite, which is not there: {INSTALL}.")
        self._path = DEVICES.get(device, device)
        if self._path.count(".") != 1:
            raise InvalidInput(
                f"slmsuite's device '{device}' is unknown: choose one of {', '.join(DEVICES)}."
            )
        self._options = dict(options or {})
        self.slm: Any = None  # of any of slmsuite's classes
        self.info = Info("slmsuite")

    def open(self, rate: float | None, told: Callable[[int, str], None]) -> None:
        """Import the class and make its SLM; see `Driver`."""
        module, name = self._path.split(".")
        try:
            kind = getattr(importlib.import_module(f"slmsuite.hardware.slms.{module}"), name)
        except Exception as error:  # makers' libraries that are missing raise of all kinds
            raise InvalidInput(
                f"slmsuite's {self._path} cannot be loaded ({type(error).__name__}: {error}): install its "
                "maker's library, or choose another device."
            ) from error
        try:
            self.slm = kind(**self._options)
        except ImportError as error:
            raise InvalidInput(
                f"slmsuite's {self._path} lacks the library of its maker ({error}): install that."
            ) from error
        except TypeError as error:
            raise InvalidInput(
                f"slmsuite's {self._path} takes other options ({error}): see its documentation."
            ) from error
        except Exception as error:
            raise DeviceLost(
                f"slmsuite's {self._path} does not open ({type(error).__name__}: {error}): check cable and power."
            ) from error
        height, width = self.slm.shape
        self.info = Info(
            str(self.slm.name), width, height, int(self.slm.bitdepth), drops=True, note="by slmsuite"
        )

    def show(self, number: int, picture: Picture) -> None:
        """Show the levels as they are."""
        try:
            self.slm.set_phase(picture.pixels.astype(np.uint8 if self.info.bits <= 8 else np.uint16))
        except Exception as error:
            raise DeviceLost(
                f"{self.info.name} does not take the picture ({type(error).__name__}: {error}): check cable and power."
            ) from error

    def close(self, finish: bool = False) -> None:
        """Let go of the SLM."""
        slm, self.slm = self.slm, None
        if slm is not None:
            with suppress(Exception):  # a device that is gone cannot be closed, either
                slm.close()
