"""Which method for which display: what several displays show of a head with hair, a row and a picture each."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.scene import variants
from holopath_addon.engine.viewing.metrics import display_values
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

from .chart.looks import HALVES, border_of, slope_of
from .chart.scenes import SCENES, built
from .parts import attempt, drawn
from .scenes import GREEN

SCENE = "portrait"
RIGHT = list(HALVES).index("right")  # of the half of the pupil that a picture shows beside the whole
QUARTERS = [(x, y, 0.25) for x in (-0.53, 0.53) for y in (-0.53, 0.53)]  # at the rim; place and radius


@dataclass(frozen=True)
class Display:
    """A display, and how to make phases for it.

    Attributes
    ----------
    what : str
        The display, and what counts.
    frames, bits : int
        That it shows.
    words : str
        Of `holopath render`, besides frames.
    encode : dict
        Of `pipeline.encode`; ``bits`` are added where they are few.
    method : str
        Of `engine.Settings`.
    """

    what: str
    frames: int
    bits: int
    words: str
    encode: dict
    method: str = "auto"


DISPLAYS = {
    "look": Display("60 Hz, first look", 1, 8, "--encode dpac", {"method": "dpac"}),
    "one": Display("60 Hz, an eye in the middle", 1, 8, "--encode auto", {"method": "auto"}),
    "soon": Display(
        "180 Hz, in seconds", 3, 8, "--encode auto --encode-seconds 3", {"method": "auto", "seconds": 3.0}
    ),
    "three": Display("180 Hz, an eye in the middle", 3, 8, "--encode auto", {"method": "auto"}),
    "eyebox": Display(
        "180 Hz, an eye anywhere", 3, 8, "--encode auto --eyebox 1", {"method": "auto", "eyebox": 1.0}
    ),
    "stack": Display(
        "180 Hz, depths that are known",
        3,
        8,
        "--method focal-stack --encode sgd",
        {"method": "sgd"},
        "focal-stack",
    ),
    "eight": Display("480 Hz", 8, 8, "--encode auto", {"method": "auto"}),
    "middle": Display(
        "480 Hz, an eye in the middle", 8, 8, "--encode auto --eyebox 0", {"method": "auto", "eyebox": 0.0}
    ),
    "levels": Display("480 Hz, 16 levels", 8, 4, "--encode auto --bits 4", {"method": "auto"}),
    "many": Display("1440 Hz", 24, 8, "--encode auto", {"method": "auto"}),
    "binary": Display("1440 Hz, two levels", 24, 1, "--encode auto --bits 1", {"method": "auto"}),
}


def run(out, pixels=256, paths=64, displays=None):
    """The table of docs/how-to/which-method.md; ``which_method`` in `out` has it, and a picture a row.

    Parameters
    ----------
    out : path
    pixels, paths : int
        Of the holograms, a side, and of the references, a pixel.
    displays : int, optional
        How many of `DISPLAYS`; default: all.
    """
    variants.activate()
    nearer = min(1.0, pixels / 256)
    hologram = engine.Hologram(pixels, pixels, 8e-6, (GREEN,), 1e-3 * nearer, 6e-3 * nearer)
    scene, camera = built(SCENE, pixels)
    bench, folder = Bench(scene, camera, hologram, paths), Path(out) / "which_method"
    folder.mkdir(parents=True, exist_ok=True)
    faults, rows, shown = [], [], {"truth": bench.truth}
    for name, display in list(DISPLAYS.items())[:displays]:
        row = attempt(faults, name, lambda display=display: bench.row(display))
        if row:
            shown[name], (seconds, *means) = row
            figures = " | ".join([f"{seconds:.0f}", *(f"{mean:.1f}" for mean in means)])
            picture = f"![{display.what}](../images/which-{name}.webp)"
            rows.append(
                f"| {display.what} | {display.frames} | {display.bits} | `{display.words}` | {figures} | {picture} |"
            )
    header = (
        "| pictures a second of each color | frames | bits | `holopath render` with | s | whole pupil, dB | halves, dB "
        "| quarters at the rim, dB | what it shows |"
    )
    table = "\n".join([header, "|" + " --- |" * 9, *rows, *faults])
    (folder / "table.md").write_text(table + "\n")
    return drawn(table, lambda: bench.draw(shown, folder))


class Bench:
    """A scene, what a thin lens shows of it, and what phases show.

    Parameters
    ----------
    scene, camera, hologram :
        As of `engine.render`.
    paths : int
        A pixel and picture of the reference.
    """

    def __init__(self, scene, camera, hologram, paths):
        self._view, self._foci, self._border = (
            (scene, camera, hologram),
            SCENES[SCENE].foci,
            border_of(hologram),
        )
        near = engine.plan(*self._view).near
        radius = DepthMapping.of(hologram, camera, near).pupil_radius(slope_of(hologram))

        def truth(depths, pupil=None):
            return engine.reference(*self._view, depths, pupil, paths, near, halves=True)

        self._whole = truth(self._foci)
        self._parts = []
        for places in (HALVES.values(), QUARTERS):
            pupils = [engine.Pupil(*(radius * np.array((x, y, 2 * part)))) for x, y, part in places]
            self._parts.append([(pupil, truth(self._foci[1:2], pupil)[0]) for pupil in pupils])
        self.truth = self._whole[1].mean(0), self._parts[0][RIGHT][1].mean(0)

    def row(self, display):
        """What a display shows.

        Returns
        -------
        tuple of numpy.ndarray
            The middle focus through the whole pupil and through its right half.
        (float, float, float, float)
            Seconds from the scene to the phases, and mean PSNR in dB through the whole pupil, halves and quarters.
        """
        settings = engine.Settings(method=display.method, frames=display.frames)
        self._light(display, settings, 1)  # programs are compiled by then
        start = time.perf_counter()
        light = self._light(display, settings)
        seconds = time.perf_counter() - start
        refocuser = engine.Refocuser(light)
        whole = refocuser(self._foci)
        pairs = [list(zip(whole, self._whole, strict=True))]
        for part in self._parts:
            pairs.append([(refocuser(self._foci[1:2], pupil)[0], truth) for pupil, truth in part])
        means = [float(np.mean([engine.psnr(*pair, self._border) for pair in own])) for own in pairs]
        return (whole[1], pairs[1][RIGHT][0]), (seconds, *means)

    def _light(self, display, settings, steps=None):
        """The light of a display's phases; of as many steps at most."""
        encoding, options = Encoding(**display.encode), {}
        if display.bits < 8:
            encoding = replace(encoding, bits=display.bits)
        if steps is not None:
            options["max_steps"] = steps
            settings = replace(settings, fixed={"steps": steps})
        plan = engine.plan(*self._view, settings)
        asked = encoding.method, encoding.seconds, encoding.eyebox
        extra_frames = engine.extra_frame_count(plan, self._view[2], *asked)
        field = engine.render(*self._view, settings, plan, extra_frames=extra_frames)
        phases = pipeline.encode(field, encoding, lambda *_: None, self._view[0], settings, **options)
        return phases.field(engine.Modulator(bits=display.bits))

    def draw(self, shown, folder):
        """Write each pair of pictures side by side, as bright as the reference."""
        for name, pair in shown.items():
            own = []
            for picture, truth in zip(pair, self.truth, strict=True):
                values, _, _ = display_values(picture, truth, self._border)
                own.append((255 * np.clip(values[..., 0], 0, 1)).astype(np.uint8))
            Image.fromarray(np.concatenate(own, axis=1)).save(folder / f"{name}.png")
