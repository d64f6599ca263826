"""Phases that show given pictures, found by gradient descent: what methods from pictures share.

The frame mean of the light's intensity is compared with one picture after another, the phases follow by Adam (Peng et
al., ACM TOG 39(6), 185 (2020); Choi et al., ACM TOG 40(6), 240 (2021), and with frames that are shown one after
another SIGGRAPH 2022, 32). The light sent in is as bright as makes all pictures together as bright as they should be.

Many frames begin with random phases. Few ones cannot average the speckle of these: they begin with phases that are
hardly random, see `randomness_for`, around those of `even_double_phase`, and pictures are compared by their
amplitudes, as Peng et al. do. At 256 x 256 focal stacks of the chart's suzanne then show 23.9 dB with one frame instead
of 10.3, and 24.2 with three instead of 20.1; by their intensities, and from an even start, 13.2 with one.
A `randomness` that is set has any number of frames begin so. With eight frames of randomness 0.3 focal stacks then show
0.6 dB more of the tea set and 0.7 dB less of the planes, and 2.5 to 3.3 dB less through the worst part of the pupil.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..encoding.double_phase import even_double_phase
from ..encoding.phases import Phases
from ..waves import arrays, libraries
from ..waves.phase_fields import FEW_FRAMES, aimed_waves, random_phasors, randomness_for
from ..waves.supervision import Frames
from .frame_mean import FrameMean

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..progress import Progress
    from ..waves.arrays import Array
    from ..waves.target_images import TargetImages
    from . import BaselineInput

STEPS = {"draft": 30, "preview": 100, "balanced": 200, "high": 600}  # each a look at one picture
RATE = 0.12  # radians, Adam's longest step; from 0.2 on it finds no rest
MEMORY = 0.8  # of earlier slopes; at 0.9 focal stacks lose a decibel, at 0.6 light fields 2 % of their light
BYTES = 64  # of a card's memory, of a pixel of a frame
FEW_RATE, FEW_MEMORY = 0.2, 0.6  # of few frames, by amplitudes: 0.1 to 0.4 dB more than with the others


def phases_for(
    job: BaselineInput,
    pictures_of: Callable[[int, Array], TargetImages],
    progress: Progress,
    whole: bool = True,
) -> np.ndarray:
    """The light of phases that show pictures, by the card where one computes waves.

    Parameters
    ----------
    job : BaselineInput
    pictures_of : callable
        ``pictures_of(k, on)`` gives the `TargetImages` of wavelength number k, in the namespace of an array.
    progress : callable
        ``progress(done, message)``, may raise.
    whole : bool
        Whether pictures are of the whole pupil. To show parts of it, phases begin at random however few frames there
        are: with others these lose light, and gain nothing.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
        At the SLM, of one modulus in each wavelength.
    """
    frames, colors = job.settings.frames, len(job.hologram.wavelengths)
    out = np.empty((frames, colors, *job.shape), np.complex64)
    rng, seed = np.random.default_rng(job.settings.seed), job.settings.seed
    randomness = job.settings.randomness
    few = whole and (frames < FEW_FRAMES or randomness is not None)
    if randomness is None:
        randomness = randomness_for(frames) or 0.0
    rate, memory = (FEW_RATE, FEW_MEMORY) if few else (RATE, MEMORY)
    steps = job.settings.fixed.get("steps", STEPS[job.settings.quality])  # in each wavelength

    def found(k, start):
        pictures = pictures_of(k, start)
        phases, mean = Phases(start, threads), FrameMean(pictures, 1.0, threads, few)
        brightness, numbers = (_AmplitudeBrightness if few else _Brightness)(mean, phases.light), []
        for step in range(steps):
            numbers = numbers or list(rng.permutation(len(pictures)))
            number = numbers.pop()
            loss, back = mean.gradient(phases.light, number)
            brightness.seen(number, phases.light, back, loss)
            if not numbers:
                brightness.adjust()
            phases.descend(back, np.ones(frames), rate * math.sqrt(1 - step / steps), memory)
            progress((k + (step + 1) / steps) / colors, "Phases")
        return arrays.on_processor(brightness.of_light * phases.light)

    with Frames() as threads:
        for k in range(colors):
            if few:
                begun = random_phasors(frames, *job.shape, seed + k, randomness)
                start = np.angle(begun * aimed_waves(frames, job.shape))
                start += even_double_phase(job.shape)
            else:
                start = rng.uniform(0, 2 * math.pi, (frames, *job.shape)).astype(np.float32)
            out[:, k], note = libraries.by_card(partial(found, k), start, BYTES * start.size)
            if note and note not in job.notes:
                job.notes.append(note)
    return out


class _Brightness:
    """The gain with which sum w t g^2 I = sum w t^2, over all pictures; symbols as of `FrameMean`."""

    def __init__(self, mean, light):
        self.mean, pictures = mean, mean.pictures
        self.wanted, shown = np.zeros((2, len(pictures)))
        for number in range(len(pictures)):
            picture = pictures.targets[number, ...]
            weighted = pictures.weight(number) * picture
            self.wanted[number] = arrays.total(weighted * picture)
            shown[number] = arrays.total(weighted * mean.look(light, number))
        self.shown = shown
        self.adjust()

    def seen(self, number, light, back, loss):
        """Take note of a picture by what its gradient tells: Re<G, u> = 2 sum w (g^2 I - t) g^2 I."""
        self.shown[number] = self.wanted[number] + 0.5 * arrays.product(light, back).real - loss

    def adjust(self):
        """Set the gain."""
        shown, wanted = self.shown.sum(), self.wanted.sum()
        self.mean.gain *= math.sqrt(wanted / shown) if shown > 0 else 0.0

    @property
    def of_light(self):
        """Amplitude of the light, in the end."""
        return self.mean.gain


class _AmplitudeBrightness:
    """The gain of the least loss of amplitudes, g sum v I = sum v sqrt(I t), over all pictures.

    In the end light has the energy of all pictures, g^2 sum v I = sum v t: of speckle the least loss is too dark.
    """

    def __init__(self, mean, light):
        self.mean, pictures = mean, mean.pictures
        self.wanted, self.shown, self.overlap = np.zeros((3, len(pictures)))
        for number in range(len(pictures)):
            picture, weight, image = (
                pictures.targets[number, ...],
                mean.weight(number),
                mean.look(light, number),
            )
            self.wanted[number] = arrays.total(weight * picture)
            self.shown[number] = arrays.total(weight * image)
            self.overlap[number] = arrays.total(weight * arrays.namespace(image).sqrt(image * picture))
        self.adjust()

    def seen(self, number, light, back, loss):
        """Take note of a picture by what its gradient tells: Re<G, u> = sum v (g sqrt(I) - sqrt(t)) g sqrt(I)."""
        gain, slope = self.mean.gain, arrays.product(light, back).real
        overlap = self.wanted[number] + slope - loss
        if gain:
            self.overlap[number], self.shown[number] = overlap / gain, (slope + overlap) / gain**2

    def adjust(self):
        """Set the gain."""
        shown = self.shown.sum()
        self.mean.gain = float(self.overlap.sum() / shown) if shown > 0 else 0.0

    @property
    def of_light(self):
        """Amplitude of the light, in the end."""
        shown = self.shown.sum()
        return math.sqrt(self.wanted.sum() / shown) if shown > 0 else 0.0
