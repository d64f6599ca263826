"""Gradient descent for phases that show target images, shared by the methods that start from images.

The frame mean of the light's intensity is compared with one image after another, and Adam moves the phases (Peng et
al., ACM TOG 39(6), 185 (2020); Choi et al., ACM TOG 40(6), 240 (2021), and with time-multiplexed frames SIGGRAPH 2022,
32). The brightness of the incident light is set so that all images together have the right brightness.

Many frames start with random phases. Few frames cannot average the speckle of these: they start with phases that vary
little, see `randomness_for`, around those of `even_double_phase`, and images are compared by their amplitudes, as in
Peng et al. Begun at half of the largest intensity, in steps of 0.2 radians, focal stacks at 256 x 256 of the chart's
suzanne showed 23.9 dB with one frame instead of 10.3, and 24.2 with three instead of 20.1; compared by intensities and
from a constant start 13.2 with one. A setting of `randomness` makes any number of frames start in this way. With eight
frames of randomness 0.3 focal stacks showed 0.6 dB more of the tea set and 0.7 dB less of the planes, and 2.5 to 3.3 dB
less through the worst part of the pupil.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..encoding.double_phase import even_double_phase, spread_for
from ..encoding.phases import Phases
from ..waves import arrays, libraries
from ..waves.phase_fields import FEW_FRAMES, aimed_waves, random_phasors, randomness_for
from ..waves.supervision import FramePool
from .frame_mean import FrameMean

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..progress import Progress
    from ..waves.arrays import Array
    from ..waves.target_images import TargetImages
    from . import BaselineInput

STEPS = {"draft": 30, "preview": 100, "balanced": 200, "high": 600}  # by quality; each step takes one image
RATE = 0.12  # radians, Adam's longest step; from 0.2 on it does not converge
MEMORY = 0.8  # Adam's weight of earlier gradients; at 0.9 focal stacks lose 1 dB, at 0.6 light fields 2 % of the light
BYTES = 64  # of a card's memory, for each pixel of a frame
# For few frames, by amplitudes. Longer steps lead dark places past zero: with 0.2 focal stacks of three frames show 0.5
# to 1.5 dB less of suzanne and tea, and 1 to 2 dB less in the worst view, with 30, 100 and 200 steps. Random phases are
# farther from their optimum: from this randomness on steps are longer, up to the second length.
FEW_RATES, FEW_SMOOTH, FEW_MEMORY = (0.05, 0.2), 0.1, 0.6


def phases_for(
    job: BaselineInput,
    pictures_of: Callable[[int, Array], TargetImages],
    progress: Progress,
    whole: bool = True,
) -> np.ndarray:
    """Light of phases that show target images; on the graphics card if one computes waves.

    Parameters
    ----------
    job : BaselineInput
    pictures_of : callable
        ``pictures_of(k, on)`` gives the `TargetImages` of wavelength index k, in the array library of `on`.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.
    whole : bool
        Whether images are through the whole pupil. For parts of it any number of frames starts with random phases,
        because others lose light there and gain nothing.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
        At the SLM, with one modulus in each wavelength.
    """
    frames, colors = job.settings.frames, len(job.hologram.wavelengths)
    out = np.empty((frames, colors, *job.shape), np.complex64)
    rng, seed = np.random.default_rng(job.settings.seed), job.settings.seed
    randomness = job.settings.randomness
    few = whole and (frames < FEW_FRAMES or randomness is not None)
    if randomness is None:
        randomness = randomness_for(frames, eyebox=0.0)
    steps = job.settings.fixed.get("steps", STEPS[job.settings.quality])  # in each wavelength
    rate, memory = (_few_rate(randomness), FEW_MEMORY) if few else (RATE, MEMORY)

    def descend(k, start):
        pictures = pictures_of(k, start)
        if few:
            start = start + _room_for(pictures, start)
        phases, mean = Phases(start, pool), FrameMean(pictures, 1.0, pool, few)
        brightness, numbers = (_AmplitudeBrightness if few else _Brightness)(mean, phases.light), []
        for step in range(steps):
            numbers = numbers or list(rng.permutation(len(pictures)))
            number = numbers.pop()
            loss, back = mean.gradient(phases.light, number)
            brightness.update(number, phases.light, back, loss)
            if not numbers:
                brightness.adjust()
            phases.descend(back, np.ones(frames), rate * math.sqrt(1 - step / steps), memory)
            progress((k + (step + 1) / steps) / colors, "Phases")
        return arrays.on_processor(brightness.amplitude * phases.light)

    with FramePool() as pool:
        for k in range(colors):
            if few:
                phasors = random_phasors(frames, *job.shape, seed + k, randomness)
                start = np.angle(phasors * aimed_waves(frames, job.shape))
            else:
                start = rng.uniform(0, 2 * math.pi, (frames, *job.shape)).astype(np.float32)
            out[:, k], note = libraries.by_card(partial(descend, k), start, BYTES * start.size)
            if note and note not in job.notes:
                job.notes.append(note)
    return out


def _few_rate(randomness):
    """Adam's longest step from phases of a randomness, radians."""
    shortest, longest = FEW_RATES
    return min(shortest + max(0.0, randomness - FEW_SMOOTH), longest)


def _room_for(pictures, start):
    """Checkerboard around which few frames begin, so that pixels can show what is bright in any of the pictures."""
    brightest = arrays.on_processor(arrays.namespace(start).max(pictures.targets, axis=0))
    spread = spread_for(np.sqrt(np.maximum(brightest, 0)))
    return arrays.like(even_double_phase(brightest.shape, spread), start)


class _Brightness:
    """Gain with which sum w t g^2 I = sum w t^2, over all images; symbols as of `FrameMean`."""

    def __init__(self, mean, light):
        self.mean, pictures = mean, mean.pictures
        self.target, shown = np.zeros((2, len(pictures)))
        for number in range(len(pictures)):
            target = pictures.targets[number, ...]
            weighted = pictures.weight(number) * target
            self.target[number] = arrays.total(weighted * target)
            shown[number] = arrays.total(weighted * mean.image(light, number))
        self.shown = shown
        self.adjust()

    def update(self, number, light, back, loss):
        """Update the sums of an image from its gradient: Re<G, u> = 2 sum w (g^2 I - t) g^2 I."""
        self.shown[number] = self.target[number] + 0.5 * arrays.product(light, back).real - loss

    def adjust(self):
        """Set the gain."""
        shown, target = self.shown.sum(), self.target.sum()
        self.mean.gain *= math.sqrt(target / shown) if shown > 0 else 0.0

    @property
    def amplitude(self):
        """Amplitude of the resulting light."""
        return self.mean.gain


class _AmplitudeBrightness:
    """Gain of the minimum loss of amplitudes, g sum v I = sum v sqrt(I t), over all images.

    The resulting light has the energy of all images, g^2 sum v I = sum v t: the minimum loss of speckle is too dark.
    """

    def __init__(self, mean, light):
        self.mean, pictures = mean, mean.pictures
        self.target, self.shown, self.overlap = np.zeros((3, len(pictures)))
        for number in range(len(pictures)):
            target, weight, image = (
                pictures.targets[number, ...],
                mean.weight(number),
                mean.image(light, number),
            )
            self.target[number] = arrays.total(weight * target)
            self.shown[number] = arrays.total(weight * image)
            self.overlap[number] = arrays.total(weight * arrays.namespace(image).sqrt(image * target))
        self.adjust()

    def update(self, number, light, back, loss):
        """Update the sums of an image from its gradient: Re<G, u> = sum v (g sqrt(I) - sqrt(t)) g sqrt(I)."""
        gain, slope = self.mean.gain, arrays.product(light, back).real
        overlap = self.target[number] + slope - loss
        if gain:
            self.overlap[number], self.shown[number] = overlap / gain, (slope + overlap) / gain**2

    def adjust(self):
        """Set the gain."""
        shown = self.shown.sum()
        self.mean.gain = float(self.overlap.sum() / shown) if shown > 0 else 0.0

    @property
    def amplitude(self):
        """Amplitude of the resulting light."""
        shown = self.shown.sum()
        return math.sqrt(self.target.sum() / shown) if shown > 0 else 0.0
