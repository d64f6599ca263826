"""The table of drivers, and the packages that they need."""

from __future__ import annotations

import importlib.util

from . import slmsuite_device

DRIVERS = {
    "display": "full screen on a monitor that is an SLM",
    "serial": "a controller on a serial port, docs/serial-protocol.md",
    "slmsuite": f"by slmsuite: {', '.join(slmsuite_device.DEVICES)}",
    "files": "pictures for a device's own program",
    "virtual": "a simulated bench with a camera",
}
# the module that each driver imports when it is used, and how to get it
NEEDS = {
    "display": ("sdl2", "install it with `pip install pysdl2 pysdl2-dll`"),
    "serial": ("serial", "install it with `pip install pyserial`"),
    "slmsuite": ("slmsuite", slmsuite_device.INSTALL),
}


def describe() -> list[dict]:
    """Describe all drivers, in the form of `engine.scene.variants.describe`.

    Returns
    -------
    list of dict
        ``name``, ``available`` and ``detail``: what the driver drives, and how to get a missing package.
    """
    rows = []
    for name, detail in DRIVERS.items():
        module, remedy = NEEDS.get(name, (None, ""))
        available = module is None or importlib.util.find_spec(module) is not None
        detail = detail if available else f"{detail}; {remedy}"
        rows.append({"name": name, "available": available, "detail": detail})
    return rows
