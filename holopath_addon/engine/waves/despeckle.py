"""Despeckling of a scene's fields: gradient steps towards the mean of many frames (docs/theory.md, Despeckling)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from . import arrays
from .arrays import PROCESSOR, Array
from .phase_fields import SETS, designed_phasors
from .supervision import Adam, FramePool, supervise
from .target_images import TargetImages, spread_viewpoints

if TYPE_CHECKING:
    from ..pixels import Pitch
    from ..progress import PartProgress

BATCHES = 4  # of the largest designed set, whose mean is the target
RATE = 0.05  # longest step in terms of the field's root mean square
VIEWS = 2  # target images in each step


def batch_phasors(number: int) -> np.ndarray:
    """Phasors of a batch of the extra frames, `number` in 0..BATCHES - 1."""
    return designed_phasors(SETS[-1], seed=1 + number)


def targets(
    shape: tuple[int, int],
    pitch: Pitch,
    wavelength: float,
    low: float,
    high: float,
    seed: int,
    on: Array = PROCESSOR,
) -> TargetImages:
    """Target images of one wavelength at `spread_viewpoints`; see there, and `TargetImages`, for the parameters."""
    return TargetImages(
        shape, pitch, wavelength, spread_viewpoints(pitch, wavelength, low, high, seed), on=on
    )


def despeckle(fields: Array, targets: TargetImages, steps: int, seed: int, progress: PartProgress) -> Array:
    """Optimize fields towards target images.

    Parameters
    ----------
    fields : array, complex64, shape (frames, y, x)
        Fields of one wavelength.
    targets : TargetImages
    steps : int
        Number of steps of Adam.
    seed : int
        Seed of the order of target images.
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    array, complex64, as `fields`
    """
    rows, columns = targets.shape
    if not targets.energy:
        return fields
    rng, frames = np.random.default_rng(seed), fields.shape[0]
    values = arrays.pairs(arrays.copied(fields))
    adam = Adam(values.shape, on=values)
    longest = RATE * math.sqrt(float(arrays.namespace(values).mean(values**2)))
    energy = targets.energy
    with FramePool() as pool:
        for step in range(steps):
            spectra = targets.spectra(arrays.of_pairs(values), pool)
            chosen = [targets.target(number) for number in rng.choice(len(targets), VIEWS, replace=False)]
            _, gradient = supervise(spectra, chosen, energy, {frames: 1.0}, pool)

            def slope(frame, gradient=gradient):
                part = arrays.ifft2(gradient[frame, ...], norm="forward")[:rows, :columns]
                return 2 * arrays.pairs(part)

            slopes = pool.each(slope, frames)
            adam.step(values, slopes, Adam.rate(step, steps, longest), pool)
            progress((step + 1) / steps)
        # the loss does not depend on the scale of the fields
        spectra = targets.spectra(arrays.of_pairs(values), pool)
    current_energy = sum(arrays.product(s, s).real for s in spectra) / (targets.space.band.size * frames)
    return arrays.of_pairs(values) * math.sqrt(energy / current_energy)
