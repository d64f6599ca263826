"""The ways down: of each frame towards its field, and of all frames together towards views."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..waves import arrays
from .phases import PARTLY
from .views import intensity

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..waves.arrays import Array
    from ..waves.modulator import Levels
    from .phases import Phases
    from .targets import AmplitudeTarget, ComplexTarget
    from .views import Views

RATE, WARM = 0.2, 0.05  # radians, Adam's longest step from the field's phases, and from an earlier hologram
FIXES, FEW = 20, 6  # how often pixels are brought to levels, and steps between
TYPICAL = 80  # steps of Adam, for its progress
WINDOW = 5  # steps whose mean loss is compared with that of those before
# Of `together`.
LONGEST = 0.2  # radians; from 0.3 on some scenes find no rest
LONGEST_SMOOTH = (
    0.3  # from phases of a given randomness, which are farther from their end; from 0.6 on none rests
)
DARKEST = 1e-3  # of a target's root mean square: amplitudes that the slope of the root is divided by
WARM_UP, WARM_SHARE = 20, 0.1  # steps, or share of all, until they are as long
FEW_LEVELS = (
    16  # up to which the last steps are half as long; with more they are as much shorter as levels are closer
)


@dataclass(frozen=True)
class Effort:
    """How much is done.

    Attributes
    ----------
    tolerance : float
        Least relative gain of a step.
    max_steps : int
        Of a stage.
    seed : int
        Of the order of pictures.
    """

    tolerance: float
    max_steps: int
    seed: int


def adam(
    phases: Phases,
    target: ComplexTarget | AmplitudeTarget,
    rate: float,
    levels: Levels | None,
    effort: Effort,
    told: Callable[[float, float], object],
    stage: dict,
) -> None:
    """Adam until the loss of a target stops falling; then, where there are levels, ever more pixels come to theirs.

    Parameters
    ----------
    phases : Phases
    target : ComplexTarget or AmplitudeTarget
    rate : float
        Longest step, radians.
    levels : Levels or None
        That phases are to have.
    effort : Effort
    told : callable
        ``told(done, loss)`` gives the PSNR; may raise.
    stage : dict
        Takes steps and PSNR.
    """
    losses = []

    def step(rate):
        loss, back, factors = target.gradient(phases.light)
        phases.descend(back, factors, rate)
        losses.append(loss)
        stage.update(steps=len(losses), loss=loss)
        stage["psnr_db"] = told(len(losses) / max(TYPICAL, len(losses) + FEW), loss)

    while len(losses) < effort.max_steps and not _flat(losses, WINDOW, effort.tolerance):
        step(rate)
    if levels is not None:
        for share in np.arange(1, FIXES) / FIXES:
            phases.fix(share, levels)
            for _ in range(FEW):
                step(rate / 2)
        phases.fix(1, levels)
        step(0)


def together(
    phases: Phases,
    views: Views,
    gain: float,
    longest: float,
    levels: Levels | None,
    effort: Effort,
    seconds: float | None,
    told: Callable[[float, float], object],
    stage: dict,
) -> float:
    """Adam on some views a step, with steps that rise at once and fall as a cosine; the best round's phases are kept.

    L = sum over kinds of views of weight times the mean over views of sum over pixels of (g sqrt(I) - sqrt(t))^2 over
    sum t, where I is the mean of the frames' intensities in a view and t the target intensity: pictures are compared by
    their amplitudes, as the PSNR does. In a round each view of the whole pupil comes up once.

    Parameters
    ----------
    phases : Phases
    views : Views
    gain : float
        Amplitude of the light sent in, to begin with.
    longest : float
        Step, radians.
    levels : Levels or None
        That phases are to have. Ever more pixels come to their levels in the second half.
    effort : Effort
    seconds : float or None
        That it takes; None for as many steps as the effort's.
    told : callable
        ``told(done, psnr)``, the PSNR by the whole pupil, may raise.
    stage : dict
        Takes steps, loss and PSNR.

    Returns
    -------
    float
        See `Seen.brightness_gain`.
    """
    begun = time.perf_counter()
    seen = Seen(phases.light, views, gain)
    if seconds is not None:  # views are looked at once more at the end
        seconds = max(1e-3, seconds - (time.perf_counter() - begun))
    rng = np.random.default_rng(effort.seed)
    queues: list[list[int]] = [[] for _ in views.kinds]
    kept, least = phases.values(), seen.loss
    steps, fixes, done = 0, 1, 0.0
    even = np.ones(phases.light.shape[0])
    # what is free makes up for what has its level, as far away as that may be
    least_rate = 0.0 if levels is None else 0.5 * min(1, FEW_LEVELS / len(levels))
    stage.update(steps=0, loss=seen.loss, psnr_db=seen.psnr)
    try:
        while done < 1:
            chosen = []
            for (kind, numbers), queue in zip(views.kinds, queues, strict=True):
                for _ in range(kind.looks):
                    if not queue:
                        queue += rng.permutation(numbers).tolist()
                    chosen.append((queue.pop(), kind.weight / kind.looks))
            back = seen.gradient(phases.light, chosen)
            rate = longest * max(0.5 * (1 + math.cos(math.pi * done)), least_rate)
            phases.descend(back, even, rate * min(1, max((steps + 1) / WARM_UP, done / WARM_SHARE)), PARTLY)
            steps += 1
            done = steps / effort.max_steps
            if seconds is not None:
                done = max(done, (time.perf_counter() - begun) / seconds)
            if levels is not None and 2 * done - 1 > fixes / FIXES:
                phases.fix(min(1.0, 2 * done - 1), levels)
                fixes += 1
            if not queues[0]:
                seen.adjust()
                if seen.loss < least and levels is None:
                    kept, least = phases.values(), seen.loss
            stage.update(steps=steps, loss=seen.loss, psnr_db=seen.psnr)
            told(min(1.0, done), seen.psnr)
    except BaseException:  # what there is, by losses as views were last looked at
        if levels is not None:
            phases.fix(1, levels)
        elif seen.loss > least:
            phases.set(kept)
        raise
    if levels is not None:
        phases.fix(1, levels)
    seen.look(phases.light)
    if levels is None and seen.loss > least:
        phases.set(kept)
        seen.look(phases.light)
    stage.update(loss=seen.loss, psnr_db=seen.psnr)
    return seen.brightness_gain


class Seen:
    """Light of all frames in views: their losses, the gain that makes them bright enough, and the way down.

    Parameters
    ----------
    light : array, complex, shape (frame, y, x)
    views : Views
    gain : float
        Amplitude of the light sent in, where views are black.

    Attributes
    ----------
    gain : float
        See `adjust`.
    losses : numpy.ndarray
        Of each view, as it was when last looked at.
    """

    def __init__(self, light: Array, views: Views, gain: float) -> None:
        self.gain, self._views = gain, views
        # energies of the light in each view and of its target, and the scalar product of their amplitudes
        self.losses, self._energies, self._overlaps, self._weights = np.zeros((4, len(views)))
        self._totals = np.array([arrays.total(wanted) for wanted in views.wanted])
        for kind, numbers in views.kinds:
            self._weights[numbers] = kind.weight / len(numbers)
        whole = views.kinds[0][1]
        self._psnrs = {number: _psnr_at_1(views.wanted[number]) for number in whole if self._totals[number]}
        self.look(light)

    @property
    def loss(self) -> float:
        """Over all views."""
        return float(self._weights @ self.losses)

    @property
    def psnr(self) -> float:
        """Through the whole pupil, dB."""
        reached = [scale - 10 * math.log10(max(self.losses[n], 1e-30)) for n, scale in self._psnrs.items()]
        return float(np.mean(reached)) if reached else 0.0

    @property
    def brightness_gain(self) -> float:
        """The gain with which the light of all views has the energy of their targets.

        Amplitudes of speckle are too small in the mean for their energy, so that `gain` would make pictures too dark.
        """
        weights = self._view_weights()
        energy = float(weights @ self._energies)
        return math.sqrt(float(weights @ self._totals) / energy) if energy > 0 else 0.0

    def look(self, light: Array) -> None:
        """Look at all views."""
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
        """Weight of each view over the energy of its target."""
        return np.divide(
            self._weights, self._totals, out=np.zeros_like(self._weights), where=self._totals > 0
        )

    def gradient(self, light: Array, chosen: list[tuple[int, float]]) -> Array:
        """With respect to the light, of the loss in some views: their numbers and weights.

        Returns
        -------
        array
            G with dL = 2 Re sum conj(G) du.
        """
        views, xp = self._views, arrays.namespace(light)
        spectra = views.spectra(light)
        gradient = xp.zeros_like(spectra)
        for number, share in chosen:
            whole = float(self._totals[number])
            if not whole:
                continue
            waves, image = self._image(spectra, number)
            amplitude, target = self._compare(number, image)
            error = self.gain * amplitude - target
            self.losses[number] = arrays.total(error * error) / whole
            darkest = DARKEST * math.sqrt(whole / math.prod(target.shape))
            amplitude = arrays.into(amplitude, xp.maximum, amplitude, darkest)
            slope = arrays.into(error, xp.divide, error, amplitude)
            slope = arrays.as_type(share * self.gain / light.shape[0] / whole * slope, waves.dtype)
            height, width = slope.shape
            waves[:, :height, :width] *= slope
            waves[:, height:, :] = 0.0
            waves[:, :height, width:] = 0.0
            views.back(waves, number, gradient)
        return views.light(gradient)

    def _image(self, spectra, number):
        """Each frame's wave in a view, and the mean of their intensities."""
        waves = self._views.waves(spectra, number)
        image = intensity(waves, self._views.wanted[number].shape)
        image *= 1 / waves.shape[0]
        return waves, image

    def _compare(self, number, image):
        """Roots of an intensity in a view, and of its target; their energies are noted."""
        xp, self._energies[number] = arrays.namespace(image), arrays.total(image)
        amplitude, target = arrays.into(image, xp.sqrt, image), xp.sqrt(self._views.wanted[number])
        self._overlaps[number] = arrays.overlap(amplitude, target)
        return amplitude, target


def _flat(losses, window, tolerance):
    """Whether the mean loss of the last `window` steps is hardly less a step than that of those before them."""
    if len(losses) < 2 * window:
        return False
    before, now = np.mean(losses[-2 * window : -window]), np.mean(losses[-window:])
    return before - now <= tolerance * window * now


def _psnr_at_1(wanted):
    """PSNR of the root of a picture, in dB, whose loss is 1; white is about as in `metrics.display_values`."""
    wanted = arrays.on_processor(wanted)
    white = float(np.percentile(wanted, 95)) or float(wanted.max())
    return 10 * math.log10(white * wanted.size / float(wanted.sum(dtype=float)))
