"""Phases that show given pictures, found by gradient descent from random ones: what methods from pictures share.

The frame mean of the light's intensity is compared with one picture after another, the phases follow by Adam (Peng et
al., ACM TOG 39(6), 185 (2020); Choi et al., ACM TOG 40(6), 240 (2021), and with frames that are shown one after
another SIGGRAPH 2022, 32). The light sent in is as bright as makes all pictures together as bright as they should be.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..encoding.phases import Phases
from ..waves.supervision import Frames
from .frame_mean import FrameMean

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..progress import Progress
    from ..waves.pictures import Pictures
    from . import BaselineInput

STEPS = {"draft": 30, "preview": 100, "balanced": 200, "high": 600}  # each a look at one picture
RATE = 0.12  # radians, Adam's longest step; from 0.2 on it finds no rest
MEMORY = 0.8  # of earlier slopes; at 0.9 focal stacks lose a decibel, at 0.6 light fields 2 % of their light


def phases_for(job: BaselineInput, pictures_of: Callable[[int], Pictures], progress: Progress) -> np.ndarray:
    """The light of phases that show pictures.

    Parameters
    ----------
    job : BaselineInput
    pictures_of : callable
        ``pictures_of(k)`` gives the `Pictures` of wavelength number k.
    progress : callable
        ``progress(done, message)``, may raise.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
        At the SLM, of one modulus in each wavelength.
    """
    frames, colours = job.settings.frames, len(job.hologram.wavelengths)
    out = np.empty((frames, colours, *job.shape), np.complex64)
    rng = np.random.default_rng(job.settings.seed)
    steps = job.settings.fixed.get("steps", STEPS[job.settings.quality])  # in each wavelength
    with Frames() as threads:
        for k in range(colours):
            pictures = pictures_of(k)
            start = rng.uniform(0, 2 * math.pi, (frames, *job.shape)).astype(np.float32)
            phases, mean = Phases(start, threads), FrameMean(pictures, 1.0, threads)
            brightness = _Brightness(mean, phases.light)
            numbers = []
            for step in range(steps):
                numbers = numbers or list(rng.permutation(len(pictures)))
                number = numbers.pop()
                loss, back = mean.gradient(phases.light, number)
                brightness.seen(number, phases.light, back, loss)
                if not numbers:
                    brightness.adjust()
                phases.descend(
                    back, np.ones(frames, np.complex64), RATE * math.sqrt(1 - step / steps), MEMORY
                )
                progress((k + (step + 1) / steps) / colours, "Phases")
            out[:, k] = mean.gain * phases.light
    return out


class _Brightness:
    """The gain with which sum w t g^2 I = sum w t^2, over all pictures; symbols as of `FrameMean`."""

    def __init__(self, mean, light):
        self.mean, pictures = mean, mean.pictures
        self.wanted, shown = np.zeros((2, len(pictures)))
        for number, picture in enumerate(pictures.wanted):
            weighted = pictures.weight(number) * picture
            self.wanted[number] = (weighted * picture).sum(dtype=float)
            shown[number] = (weighted * mean.look(light, number)).sum(dtype=float)
        self.shown = shown
        self.adjust()

    def seen(self, number, light, back, loss):
        """Take note of a picture by what its gradient tells: Re<G, u> = 2 sum w (g^2 I - t) g^2 I."""
        self.shown[number] = self.wanted[number] + 0.5 * np.vdot(light, back).real - loss

    def adjust(self):
        """Set the gain."""
        shown, wanted = self.shown.sum(), self.wanted.sum()
        self.mean.gain *= math.sqrt(wanted / shown) if shown > 0 else 0.0
