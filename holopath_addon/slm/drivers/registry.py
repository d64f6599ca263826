"""Which drivers there are, and what they lack."""

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
# what each imports only when it is used, and how to get it
NEEDS = {
    "display": ("sdl2", "install it with `pip install pysdl2 pysdl2-dll`"),
    "serial": ("serial", "install it with `pip install pyserial`"),
    "slmsuite": ("slmsuite", slmsuite_device.INSTALL),
}


def describe() -> list[dict]:
    """All drivers, in the form of `engine.scene.variants.describe`.

    Returns
    -------
    list of dict
        ``name``, ``available`` and ``detail``: what it drives, or how to get what it lacks.
    """
    rows = []
    for name, what in DRIVERS.items():
        module, remedy = NEEDS.get(name, (None, ""))
        there = module is None or importlib.util.find_spec(module) is not None
        rows.append({"name": name, "available": there, "detail": what if there else f"{what}; {remedy}"})
    return rows
