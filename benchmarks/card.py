"""Seconds of holograms on a graphics card by stages, from rays to pictures and phases, and of others beside them."""

import math
import time
from importlib.util import find_spec

import numpy as np

from holopath_addon.engine.encoding.views import ViewedVolume, Views
from holopath_addon.engine.memory import on_processor
from holopath_addon.engine.waves import arrays, libraries
from holopath_addon.engine.waves.propagation import padded_shape
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

from .full_hd import rendered, row
from .kernel import timed
from .parts import Incomplete, attempt, joined

FOCUS = 0.5, 1.0, math.inf


def run(resolutions="1920x1080,3840x2160", frames="8,24", methods="dpac,sgd,joint,refine", steps=0):
    """Tables of seconds, one a resolution and number of frames.

    Parameters
    ----------
    resolutions, frames, methods : str
        With commas between; methods are encodings.
    steps : int
        Of each encoding at most. Default: as many as it takes.

    Returns
    -------
    str
        By stages of the render, reconstruction at three depths, and each encoding, with what the plan foretold of
        them. Beside them two FFTs of each frame for each move on the grid that propagation has, and a step of
        PyTorch's Adam on the views that `joint` looks at in one.

    Raises
    ------
    Incomplete
        With the rest, if a table or a part of one fails, as where a card's memory does not suffice.
    """
    cases = {
        f"{resolution}, {count} frames": (resolution, int(count))
        for resolution in resolutions.split(",")
        for count in str(frames).split(",")
    }
    many = list(filter(None, methods.split(",")))
    return joined({name: lambda case=case: _table(*case, many, steps) for name, case in cases.items()})


def _table(resolution, count, methods, steps):
    made = rendered(resolution, count)
    parts = {
        "what was foretold": lambda: _foretold(made),
        "reconstruction": lambda: _reconstruction(made),
        "FFTs": lambda: _transforms(made),
        "PyTorch": lambda: _torch(made) if find_spec("torch") else "",
    }
    parts |= {method: lambda method=method: _phases(made, method, steps) for method in methods}
    faults = []
    lines = [*made.lines, *(attempt(faults, name, work) for name, work in parts.items())]
    table = "\n".join(filter(None, lines))
    if faults:
        raise Incomplete(table, faults)
    return table


def _quiet(done, message):
    pass


def _foretold(made):
    """Seconds of the plan, and what it says of a card's memory."""
    plan = made.plan
    lines = ["  foretold: " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in plan.stages.items())]
    lines += [f"  {each}" for each in plan.decisions if each.name == "card's memory"]
    return "\n".join(lines)


def _reconstruction(made):
    return row("reconstruction", _second(lambda: pipeline.reconstruct(made.field, FOCUS, None, _quiet)))


def _transforms(made):
    """Of all frames and colors, as often as propagation moves them: twice between planes, and to the SLM."""
    plan, field = made.plan, made.field
    on, (frames, colors, *shape) = libraries.empty_array(plan.library), field.data.shape
    images = sum(plane.sees == "images" for plane in plan.planes)
    moves = images + 2 * max(0, len(plan.planes) - images - 1) + 1
    padded = padded_shape(shape, field.hologram.pitch, max(field.hologram.wavelengths), abs(plan.z_gathered))
    waves = arrays.zeros(padded, "complex64", on)

    def transforms():
        for _ in range(frames * colors * moves):
            arrays.ifft2(arrays.fft2(waves, workers=-1), workers=-1)
        on_processor(waves[:1, :1])  # a card is waited for

    return row(f"two FFTs, {moves} moves", _second(transforms))


def _torch(made):
    return row("a step of torch's Adam", _torch_step(made), 4)


def _torch_step(made):
    """Seconds of a step towards one view of each kind, and as many as `joint` looks at, one color, by autograd."""
    import torch

    on = libraries.empty_array("torch")
    field, plan = made.field, made.plan
    wavelength = field.hologram.wavelengths[0]
    ends = plan.z_low, plan.z_high
    shape, frames = field.data.shape[-2:], len(field.data)
    views = Views(ViewedVolume(shape, field.hologram.pitch, wavelength, *ends), frames, 0, on=on)
    phases = torch.zeros((frames, *shape), device=on.device, requires_grad=True)
    adam = torch.optim.Adam([phases])
    chosen = [number for kind, numbers in views.kinds for number in numbers[: kind.looks]]

    def step():
        adam.zero_grad()
        spectra = torch.fft.fft2(torch.exp(1j * phases), s=views.padded)
        loss = torch.zeros((), device=on.device)
        for number in chosen:
            rows, columns = map(len, views.nearest_pixels(number))
            waves = views.waves(spectra, number)[:, :rows, :columns]
            image = (waves.real**2 + waves.imag**2).mean(0)
            loss = loss + (torch.sqrt(image + 1e-12) - 1).square().sum()
        loss.backward()
        adam.step()
        on_processor(phases[0, :1, :1])

    return _second(step)


def _phases(made, method, steps):
    scene, _, _, settings = made.view
    options = {"max_steps": steps} if steps else {}
    start = time.perf_counter()
    phase = pipeline.encode(made.field, Encoding(method), _quiet, scene, settings, **options)
    seconds = time.perf_counter() - start
    stages = phase.report["stages"]
    decibels = [stage["psnr_db"] for stage in stages if "psnr_db" in stage]
    said = [f"{np.mean(decibels):.1f} dB"] if decibels else []
    for name in dict.fromkeys(stage["stage"] for stage in stages if stage.get("steps")):
        of_it = [stage for stage in stages if stage["stage"] == name]
        count, taken = (sum(stage[key] for stage in of_it) for key in ("steps", "seconds"))
        said.append(f"{name} {count} steps of {taken / count:.4f} s")
    return row(method, seconds) + "".join(f"; {each}" for each in said)


def _second(work):
    """Seconds of the second time of two: libraries load and compile in the first."""
    work()
    return timed(work)
