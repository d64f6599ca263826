"""Descents: of each frame towards its field, and of all frames together towards views."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..waves import arrays
from .phases import FEW_VIEWS_MEMORY
from .views import intensity

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..waves.arrays import Array
    from ..waves.modulator import Levels
    from .phases import Phases
    from .targets import AmplitudeTarget, ComplexTarget
    from .views import ViewTargets

RATE, WARM = 0.2, 0.05  # radians, Adam's longest step from the field's phases, and from an earlier hologram
FIXES, FEW = 20, 6  # number of times that pixels are fixed to levels, and of steps between
TYPICAL = 80  # steps of Adam, for its progress
WINDOW = 5  # steps whose mean loss is compared with that of those before
# Of `together`: longest step, radians, from the field's phases, where some scenes do not converge from 0.3 on; and from
# phases of a given randomness, from smooth ones to random ones, which are farther from their optimum. Longer steps from
# smooth phases end in grain on even surfaces, above all with one frame; none converges from 0.6 on.
MAX_STEP, MAX_STEP_SMOOTH, MAX_STEP_RANDOM = 0.2, 0.1, 0.3
MIN_AMPLITUDE = 1e-3  # of a target's root mean square; the slope of the square root is divided by amplitudes
WARM_UP, WARM_FRACTION = 20, 0.1  # steps, or fraction of all, in which their length rises
# Number of levels up to which the last steps have half the length; with more they are shorter, as levels are closer.
FEW_LEVELS = 16


@dataclass(frozen=True)
class Effort:
    """Effort of a descent.

    Attributes
    ----------
    rate : float
        Longest step, radians.
    levels : Levels or None
        Levels of the display that phases are to have at the end; None for any phase.
    max_steps : int
        Maximum number of steps, without those that bring phases to levels in `adam`.
    tolerance : float
        Relative decrease of the loss in a step, below which `adam` ends.
    seed : int
        Seed of the order of views in `together`.
    seconds : float or None
        Seconds of `together`; None for `max_steps`.
    """

    rate: float
    levels: Levels | None
    max_steps: int
    tolerance: float = 0.0
    seed: int = 0
    seconds: float | None = None


def adam(
    phases: Phases,
    target: ComplexTarget | AmplitudeTarget,
    effort: Effort,
    on_progress: Callable[[float, float], float],
    stage: dict,
) -> None:
    """Adam until the loss of a target stops decreasing; then, with levels, ever more pixels are fixed to theirs.

    Parameters
    ----------
    phases : Phases
    target : ComplexTarget or AmplitudeTarget
    effort : Effort
    on_progress : callable
        ``on_progress(done, loss)`` returns the PSNR in dB; may raise.
    stage : dict
        Receives steps, loss and PSNR.
    """
    losses = []

    def step(rate):
        loss, back, factors = target.gradient(phases.light)
        phases.descend(back, factors, rate)
        losses.append(loss)
        stage.update(steps=len(losses), loss=loss)
        stage["psnr_db"] = on_progress(len(losses) / max(TYPICAL, len(losses) + FEW), loss)

    while len(losses) < effort.max_steps and not _flat(losses, WINDOW, effort.tolerance):
        step(effort.rate)
    if effort.levels is not None:
        for fraction in np.arange(1, FIXES) / FIXES:
            phases.fix(fraction, effort.levels)
            for _ in range(FEW):
                step(effort.rate / 2)
        phases.fix(1, effort.levels)
        step(0)


def together(
    phases: Phases,
    targets: ViewTargets,
    gain: float,
    effort: Effort,
    on_progress: Callable[[float, float], object],
    stage: dict,
) -> float:
    """Adam on a few views in each step; the step length rises at once and falls as a cosine.

    L = sum over kinds of views of weight times the mean over views of sum over pixels of (g sqrt(I) - sqrt(t))^2 over
    sum t, where I is the mean of the frames' intensities in a view and t the target intensity: images are compared by
    their amplitudes, as the PSNR does. In a round each view of the whole pupil is evaluated once. The phases of the
    best round are kept.

    Parameters
    ----------
    phases : Phases
    targets : ViewTargets
    gain : float
        Amplitude of the light sent in, at the start.
    effort : Effort
        With levels, ever more pixels are fixed to theirs in the second half.
    on_progress : callable
        ``on_progress(done, psnr)`` with the PSNR through the whole pupil, may raise.
    stage : dict
        Receives steps, loss and PSNR.

    Returns
    -------
    float
        See `ViewLosses.brightness_gain`.
    """
    start, seconds, levels = time.perf_counter(), effort.seconds, effort.levels
    losses = ViewLosses(phases.light, targets, gain)
    if seconds is not None:  # all views are evaluated once more at the end
        seconds = max(1e-3, seconds - (time.perf_counter() - start))
    rng = np.random.default_rng(effort.seed)
    queues: list[list[int]] = [[] for _ in targets.views.kinds]
    best, min_loss = phases.values(), losses.loss
    steps, fixes, done = 0, 1, 0.0
    even = np.ones(phases.light.shape[0])
    # free pixels compensate for fixed ones, whose levels may be this far away
    min_rate = 0.0 if levels is None else 0.5 * min(1, FEW_LEVELS / len(levels))
    stage.update(steps=0, loss=losses.loss, psnr_db=losses.psnr)
    try:
        while done < 1:
            chosen = []
            for (kind, numbers), queue in zip(targets.views.kinds, queues, strict=True):
                for _ in range(kind.looks):
                    if not queue:
                        queue += rng.permutation(numbers).tolist()
                    chosen.append((queue.pop(), kind.weight / kind.looks))
            back = losses.gradient(phases.light, chosen)
            rate = effort.rate * max(0.5 * (1 + math.cos(math.pi * done)), min_rate)
            rate *= min(1, max((steps + 1) / WARM_UP, done / WARM_FRACTION))
            phases.descend(back, even, rate, FEW_VIEWS_MEMORY)
            steps += 1
            done = steps / effort.max_steps
            if seconds is not None:
                done = max(done, (time.perf_counter() - start) / seconds)
            if levels is not None and 2 * done - 1 > fixes / FIXES:
                phases.fix(min(1.0, 2 * done - 1), levels)
                fixes += 1
            if not queues[0]:
                losses.adjust()
                if losses.loss < min_loss and levels is None:
                    best, min_loss = phases.values(), losses.loss
            stage.update(steps=steps, loss=losses.loss, psnr_db=losses.psnr)
            on_progress(min(1.0, done), losses.psnr)
    except BaseException:  # keep the best phases, by the last loss of each view
        if levels is not None:
            phases.fix(1, levels)
        elif losses.loss > min_loss:
            phases.set(best)
        raise
    if levels is not None:
        phases.fix(1, levels)
    losses.evaluate(phases.light)
    if levels is None and losses.loss > min_loss:
        phases.set(best)
        losses.evaluate(phases.light)
    stage.update(loss=losses.loss, psnr_db=losses.psnr)
    return losses.brightness_gain


def max_step(randomness: float | None) -> float:
    """Longest step of `together`, radians, from phases of a randomness; None for the field's phases."""
    return MAX_STEP if randomness is None else min(MAX_STEP_SMOOTH + randomness, MAX_STEP_RANDOM)


class ViewLosses:
    """Losses of the light of all frames in views, the gain that makes it bright enough, and the gradient.

    Parameters
    ----------
    light : array, complex, shape (frame, y, x)
    targets : ViewTargets
    gain : float
        Amplitude of the light sent in, if views are black.

    Attributes
    ----------
    gain : float
        See `adjust`.
    losses : numpy.ndarray
        Loss of each view when it was last evaluated.
    """

    def __init__(self, light: Array, targets: ViewTargets, gain: float) -> None:
        self.gain, self._views, self._targets = gain, targets.views, targets.intensities
        # energies of the light in each view and of its target, and the scalar product of their amplitudes
        self.losses, self._energies, self._overlaps, self._weights = np.zeros((4, len(self._views)))
        self._totals = np.array([arrays.total(target) for target in self._targets])
        for kind, numbers in self._views.kinds:
            self._weights[numbers] = kind.weight / len(numbers)
        whole = self._views.kinds[0][1]
        self._psnrs = {number: _psnr_at_1(self._targets[number]) for number in whole if self._totals[number]}
        self.evaluate(light)

    @property
    def loss(self) -> float:
        """Weighted loss of all views."""
        return float(self._weights @ self.losses)

    @property
    def psnr(self) -> float:
        """Mean PSNR through the whole pupil, dB."""
        values = [scale - 10 * math.log10(max(self.losses[n], 1e-30)) for n, scale in self._psnrs.items()]
        return float(np.mean(values)) if values else 0.0

    @property
    def brightness_gain(self) -> float:
        """Gain with which the light of all views has the energy of their targets.

        Speckle's mean amplitude is too small for its energy, so that `gain` would make images too dark.
        """
        weights = self._view_weights()
        energy = float(weights @ self._energies)
        return math.sqrt(float(weights @ self._totals) / energy) if energy > 0 else 0.0

    def evaluate(self, light: Array) -> None:
        """Evaluate all views."""
        spectra = self._views.spectra(light)
        for number in range(len(self._views)):
            self._compare(number, self._image(spectra, number)[1])
        self.adjust()
        for number, total in enumerate(self._totals):
            error = self.gain**2 * self._energies[number] - 2 * self.gain * self._overlaps[number] + total
            self.losses[number] = max(0.0, error / total) if total else 0.0

    def adjust(self) -> None:
        """Set the gain of the least loss over all views: g sum w I = sum w sqrt(I t), with w each view's weight."""
        weights = self._view_weights()
        energy = float(weights @ self._energies)
        self.gain = float(weights @ self._overlaps) / energy if energy > 0 else 0.0

    def _view_weights(self):
        """Weights of the views over the energies of their targets."""
        return np.divide(
            self._weights, self._totals, out=np.zeros_like(self._weights), where=self._totals > 0
        )

    def gradient(self, light: Array, chosen: list[tuple[int, float]]) -> Array:
        """Gradient with respect to the light of the loss in some views, as numbers and weights.

        Returns
        -------
        array
            G with dL = 2 Re sum conj(G) du.
        """
        views, xp = self._views, arrays.namespace(light)
        spectra = views.spectra(light)
        gradient = xp.zeros_like(spectra)
        for number, weight in chosen:
            total = float(self._totals[number])
            if not total:
                continue
            waves, image = self._image(spectra, number)
            amplitude, target = self._compare(number, image)
            error = self.gain * amplitude - target
            self.losses[number] = arrays.total(error * error) / total
            min_amplitude = MIN_AMPLITUDE * math.sqrt(total / math.prod(target.shape))
            amplitude = arrays.into(amplitude, xp.maximum, amplitude, min_amplitude)
            slope = arrays.into(error, xp.divide, error, amplitude)
            slope = arrays.as_type(weight * self.gain / light.shape[0] / total * slope, waves.dtype)
            height, width = slope.shape
            waves[:, :height, :width] *= slope
            waves[:, height:, :] = 0.0
            waves[:, :height, width:] = 0.0
            views.back(waves, number, gradient)
        return views.light(gradient)

    def _image(self, spectra, number):
        """Waves of the frames in a view, and the mean of their intensities."""
        waves = self._views.waves(spectra, number)
        image = intensity(waves, self._targets[number].shape)
        image *= 1 / waves.shape[0]
        return waves, image

    def _compare(self, number, image):
        """Square roots of an intensity in a view and of its target, whose energies are noted."""
        xp, self._energies[number] = arrays.namespace(image), arrays.total(image)
        amplitude, target = arrays.into(image, xp.sqrt, image), xp.sqrt(self._targets[number])
        self._overlaps[number] = arrays.overlap(amplitude, target)
        return amplitude, target


def _flat(losses, window, tolerance):
    """Whether the mean loss of the last `window` steps is hardly less per step than that of those before them."""
    if len(losses) < 2 * window:
        return False
    before, now = np.mean(losses[-2 * window : -window]), np.mean(losses[-window:])
    return before - now <= tolerance * window * now


def _psnr_at_1(target):
    """PSNR of a target's square root at a loss of 1, dB; white is about that of `metrics.display_values`."""
    target = arrays.on_processor(target)
    white = float(np.percentile(target, 95)) or float(target.max())
    return 10 * math.log10(white * target.size / float(target.sum(dtype=float)))
