"""The ways down: Adam against each frame's field, and one picture after another for all frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from .frame_mean import FrameMean
    from .phases import Phases
    from .targets import AmplitudeTarget, ComplexTarget

RATE, WARM = 0.2, 0.05  # radians, Adam's longest step from the field's phases, and from an earlier hologram
FIXES, FEW = 20, 6  # how often pixels are brought to levels, and steps between
TYPICAL = 80  # steps of Adam, for its progress
WINDOW = 5  # steps whose mean loss is compared with that of those before


@dataclass(frozen=True)
class Effort:
    """How much is done.

    Attributes
    ----------
    tolerance : float
        Least relative gain of a step.
    most_steps : int
        Of a stage.
    seed : int
        Of the order of pictures.
    """

    tolerance: float
    most_steps: int
    seed: int


@dataclass(frozen=True)
class Manner:
    """How pictures are taken one after another.

    Attributes
    ----------
    relaxation : float
        Length of a step: 1 for one that mends the picture; under 2.
    lasts : int
        Rounds of ever smaller steps at the end.
    worth : float
        How many tolerances a step gains on the mean of a round, as long as the steps stay as long as they are.
    """

    relaxation: float
    lasts: int
    worth: float


# A few frames cannot show all pictures exactly: they need an average, not the last word.
JOINT, REFINE = Manner(1.2, 4, 8.0), Manner(0.7, 18, 1e6)


def adam(
    phases: Phases,
    target: ComplexTarget | AmplitudeTarget,
    rate: float,
    bits: int | None,
    effort: Effort,
    told: Callable[[float, float], object],
    stage: dict,
) -> None:
    """Adam until the loss of a target stops falling; then, with few bits, ever more pixels come to their levels.

    Parameters
    ----------
    phases : Phases
    target : ComplexTarget or AmplitudeTarget
    rate : float
        Longest step, radians.
    bits : int or None
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
        psnr = told(len(losses) / max(TYPICAL, len(losses) + FEW), loss)
        stage.update(steps=len(losses), loss=loss, psnr_db=psnr)

    while len(losses) < effort.most_steps and not _flat(losses, WINDOW, effort.tolerance):
        step(rate)
    if bits is not None:
        for share in np.arange(1, FIXES) / FIXES:
            phases.fix(share, bits)
            for _ in range(FEW):
                step(rate / 2)
        phases.fix(1, bits)
        step(0)


def kaczmarz(
    phases: Phases,
    mean: FrameMean,
    manner: Manner,
    bits: int | None,
    effort: Effort,
    told: Callable[[float, float], object],
    stage: dict,
) -> None:
    """Take the pictures one after another, each time the step that would mend that one.

    In a round of as many steps as there are pictures each comes up as often as its error is large, in the first one
    once. When a round gains too little over the one before, the last ones follow with ever smaller steps, so that no
    picture is favoured for having come last.

    Parameters
    ----------
    phases : Phases
    mean : FrameMean
        Of the pictures.
    manner : Manner
    bits : int or None
        With few, ever more pixels come to their levels in the last rounds.
    effort, stage :
        As in `adam`.
    told : callable
        ``told(done, psnr)``, may raise.
    """
    pictures = mean.pictures
    if not any(wanted.any() for wanted in pictures.wanted):
        if bits is not None:
            phases.fix(1, bits)
        return
    rng = np.random.default_rng(effort.seed)
    errors = np.array([float(wanted.any()) for wanted in pictures.wanted])
    rounds, numbers, steps = [], [], 0
    lasts = min(effort.most_steps, manner.lasts * len(pictures) * (1 if bits is None else 2))
    least = manner.worth * effort.tolerance * len(pictures)
    left = None
    while left != 0 and errors.sum() > 0:
        if not numbers:
            numbers = _round(errors, rng)
            rounds.append(errors.mean())
            if steps and left is None and _flat(rounds[1:], 1, least):
                left = lasts
        if left is None and steps + lasts >= effort.most_steps:
            left = lasts
        shorter = 1 if left is None else 0.5 + 0.5 * math.cos(math.pi * (1 - left / lasts))
        if bits is not None and left is not None and left % max(1, lasts // FIXES) == 0:
            phases.fix(1 - left / lasts, bits)
        number = numbers.pop()
        loss, back = mean.gradient(phases.light, number)
        phases.relax(back, loss, manner.relaxation * shorter)
        errors[number] = loss
        steps, left = steps + 1, None if left is None else left - 1
        psnr = _psnr(loss, pictures.wanted[number])
        told(steps / (steps + (lasts + len(pictures) if left is None else left)), psnr)
        stage.update(steps=steps, loss=float(errors.mean()), psnr_db=psnr)
    reached = [_psnr(e, w) for e, w in zip(errors, pictures.wanted, strict=True) if w.any()]
    stage["psnr_db"] = float(np.mean(reached))
    if bits is not None:
        phases.fix(1, bits)


def _round(errors, rng):
    """Numbers of pictures in random order, each as often as its share of the errors says, to the nearest whole."""
    ends = np.cumsum(errors) * (len(errors) / errors.sum())
    points = np.arange(len(errors)) + rng.random()
    numbers = np.searchsorted(ends, np.minimum(points, ends[-1] * (1 - 1e-12)), side="right")
    return list(rng.permutation(numbers))


def _flat(losses, window, tolerance):
    """Whether the mean loss of the last `window` steps is hardly less a step than that of those before them."""
    if len(losses) < 2 * window:
        return False
    before, now = np.mean(losses[-2 * window : -window]), np.mean(losses[-window:])
    return before - now <= tolerance * window * now


def _psnr(loss, wanted):
    """About that of the root of a picture, in dB, from its loss; white is as in `metrics.display_values`."""
    # errors of the root are half those of the intensity, over the root
    square = loss * float(wanted.sum(dtype=float)) / (4 * wanted.size)
    white = float(np.percentile(wanted, 95)) or float(wanted.max())
    return 10 * math.log10(white / max(square, 1e-30))
