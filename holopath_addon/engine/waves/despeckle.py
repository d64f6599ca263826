"""Less speckle in one scene's fields: gradient steps towards the mean of many frames (docs/theory.md, Despeckling)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from . import arrays
from .arrays import PROCESSOR, Array
from .phase_fields import SETS, designed_phasors
from .pictures import Pictures, spread_vantages
from .supervision import Adam, Frames, supervise

if TYPE_CHECKING:
    from ..pixels import Pitch
    from ..progress import PartProgress

BATCHES = 4  # of the largest designed set, whose mean is what the picture should be
RATE = 0.05  # longest step, of the field's root mean square
VIEWS = 2  # pictures looked at in each step


def batch_phasors(number: int) -> np.ndarray:
    """Phasors of a batch of the many frames, `number` in 0..BATCHES - 1."""
    return designed_phasors(SETS[-1], seed=1 + number)


def targets(
    shape: tuple[int, int],
    pitch: Pitch,
    wavelength: float,
    low: float,
    high: float,
    seed: int,
    on: Array = PROCESSOR,
) -> Pictures:
    """Pictures of one wavelength, at depths from `low` to `high` beyond the fields' plane, see `spread_vantages`."""
    return Pictures(shape, pitch, wavelength, spread_vantages(pitch, wavelength, low, high, seed), on=on)


def despeckle(fields: Array, targets: Pictures, steps: int, seed: int, progress: PartProgress) -> Array:
    """Fields moved towards the wanted pictures.

    Parameters
    ----------
    fields : array, complex64, shape (frames, y, x)
        Of one wavelength.
    targets : Pictures
    steps : int
    seed : int
        Of the order in which pictures are looked at.
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
    with Frames() as threads:
        for step in range(steps):
            spectra = targets.spectra(arrays.of_pairs(values), threads)
            chosen = [targets.target(number) for number in rng.choice(len(targets), VIEWS, replace=False)]
            _, gradient = supervise(spectra, chosen, energy, {frames: 1.0}, threads)

            def slope(frame, gradient=gradient):
                part = arrays.ifft2(gradient[frame, ...], norm="forward")[:rows, :columns]
                return 2 * arrays.pairs(part)

            slopes = threads.each(slope, frames)
            adam.step(values, slopes, Adam.rate(step, steps, longest), threads)
            progress((step + 1) / steps)
        # the loss leaves the scale of the fields free
        spectra = targets.spectra(arrays.of_pairs(values), threads)
    now = sum(arrays.product(s, s).real for s in spectra) / (targets.space.band.size * frames)
    return arrays.of_pairs(values) * math.sqrt(energy / now)
