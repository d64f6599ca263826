"""The sketches of My bench: `holopath report` draws the same of any hologram."""

import math
from typing import Any

from holopath_addon import engine
from holopath_addon.cli.report_page import svg_sketch

from .pages import DOCS

# By picture: what differs from 256 x 256 pixels of 8 µm and a flat beam.
BENCHES: dict[str, dict[str, Any]] = {
    "bench-point": {"beam": engine.Beam("point", (-200e-3,))},
    "bench-gaussian": {"beam": engine.Beam("gaussian", (1.2e-3, 0.2e-3, 0.0))},
    "bench-carrier": {"carrier": "auto"},
    "bench-half": {"stop": engine.Stop("half", (math.radians(90),))},
    "bench-eyepiece": {"lens": engine.Lens(50e-3, 46e-3)},
    "bench-lens": {"lens": engine.Lens(100e-3)},
}


def write() -> None:
    """Write all into docs/images, in colors that can be read on any page: dark on white."""
    for name, optics in BENCHES.items():
        mapping = "eyepiece" if name == "bench-eyepiece" else "fit"
        hologram = engine.Hologram(
            256, 256, 8e-6, (516.5e-9,), depth_mapping=mapping, optics=engine.Optics(**optics)
        )
        own = 'xmlns="http://www.w3.org/2000/svg" style="background:#fff;color:#222"'
        text = svg_sketch(hologram).replace("<svg ", f"<svg {own} ", 1)
        (DOCS / "images" / f"{name}.svg").write_text(text + "\n", "utf-8")
