"""Seconds of holograms on a graphics card by stages, from rays to pictures and phases, and of others beside them."""

import math
import time
from importlib.util import find_spec

import numpy as np

from holopath_addon.engine.encoding.views import Views
from holopath_addon.engine.memory import on_processor
from holopath_addon.engine.waves import arrays, libraries
from holopath_addon.engine.waves.propagation import padded_shape
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

from .full_hd import rendered, row
from .kernel import timed

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
        By stages of the render, reconstruction at three depths, and each encoding. Beside them two FFTs of each frame
        on the grid that propagation has, and a step of PyTorch's Adam on the views that `joint` looks at in one.
    """
    tables = []
    for resolution in resolutions.split(","):
        for count in map(int, str(frames).split(",")):
            made = rendered(resolution, count)
            tables.append("\n".join([*made.lines, *_beside(made), *_phases(made, methods.split(","), steps)]))
    return "\n".join(tables)


def _quiet(done, message):
    pass


def _beside(made):
    field, plan = made.field, made.plan
    yield row("reconstruction", _second(lambda: pipeline.reconstruct(field, FOCUS, None, _quiet)))
    on, (frames, colors, *shape) = libraries.beginning(plan.library), field.data.shape
    hologram = field.hologram
    padded = padded_shape(shape, hologram.pitch, max(hologram.wavelengths), abs(plan.z_gathered))
    waves = arrays.zeros(padded, "complex64", on)

    def transforms():
        for _ in range(frames * colors):
            arrays.ifft2(arrays.fft2(waves, workers=-1), workers=-1)
        on_processor(waves[:1, :1])  # a card is waited for

    yield row("two FFTs of each frame", _second(transforms))
    if find_spec("torch"):
        yield row("a step of torch's Adam", _torch_step(made))


def _torch_step(made):
    """Seconds of a step towards one view of each kind, and as many as `joint` looks at, one color, by autograd."""
    import torch

    on = libraries.beginning("torch")
    field, plan = made.field, made.plan
    wavelength = field.hologram.wavelengths[0]
    ends = plan.z_low, plan.z_high
    shape, frames = field.data.shape[-2:], len(field.data)
    views = Views(shape, field.hologram.pitch, wavelength, *ends, frames, 0, on=on)
    phases = torch.zeros((frames, *shape), device=on.device, requires_grad=True)
    adam = torch.optim.Adam([phases])
    chosen = [number for kind, numbers in views.kinds for number in numbers[: kind.looks]]

    def step():
        adam.zero_grad()
        spectra = torch.fft.fft2(torch.exp(1j * phases), s=views.padded)
        loss = torch.zeros((), device=on.device)
        for number in chosen:
            rows, columns = views.wanted[number].shape
            waves = views.waves(spectra, number)[:, :rows, :columns]
            image = (waves.real**2 + waves.imag**2).mean(0)
            loss = loss + (torch.sqrt(image + 1e-12) - 1).square().sum()
        loss.backward()
        adam.step()
        on_processor(phases[0, :1, :1])

    return _second(step)


def _phases(made, methods, steps):
    scene, _, _, settings = made.view
    options = {"max_steps": steps} if steps else {}
    for method in filter(None, methods):
        start = time.perf_counter()
        phase = pipeline.encode(made.field, Encoding(method), _quiet, scene, settings, **options)
        seconds = time.perf_counter() - start
        decibels = [stage["psnr_db"] for stage in phase.report["stages"] if "psnr_db" in stage]
        said = f"{np.mean(decibels):6.1f} dB" if decibels else ""
        yield row(method, seconds) + said


def _second(work):
    """Seconds of the second time of two: libraries load and compile in the first."""
    work()
    return timed(work)
