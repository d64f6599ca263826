"""A camera in the loop: phases go down by what a camera sees of them, not by what a model says that it would.

With s the mean of the frames' intensities in a picture that the camera took at a focus, t what is wanted there, and u_m
the light of frame m there by the display's model, a step goes down

    L = sum over pixels of w (g s - t)^2,    dL / du_m = 2 g w (g s - t) conj(u_m) / frames

so that errors are the bench's own and only the way back is the model's (Peng et al., Neural holography with
camera-in-the-loop training, ACM TOG 39(6), 185 (2020), section 4). g makes the picture as bright as is wanted. At one
more distance in each step, where no camera looks, s is the model's own, so that phases do not serve the foci alone.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

import numpy as np
import scipy.ndimage

from ..engine.encoding.channel import MARGIN
from ..engine.encoding.phases import FEW_VIEWS_MEMORY, Phases
from ..engine.encoding.shown_light import ShownLight
from ..engine.errors import Cancelled, InvalidInput, cancelled
from ..engine.pixels import half_sides
from ..engine.viewing.reconstruction import Refocuser
from ..engine.waves import arrays
from ..engine.waves.arrays import on_processor
from ..engine.waves.propagation import TEACHING_GUARD, FreeSpace, padded_shape
from ..engine.waves.supervision import Frames, relative

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..engine.encoding.phase_hologram import PhaseHologram
    from ..engine.progress import Progress
    from ..engine.wavefield import WaveField
    from .calibration import Calibration

LONGEST = 0.1  # radians, the first steps
LEAST_SEEN = 0.1  # of the hologram's pixels
NEAR = 1e-9  # metres by which a focus may lie beyond the volume: numbers in files are rounded
BETWEEN = 8  # distances at which the model's own pictures count


def tune(
    phase: PhaseHologram,
    field: WaveField,
    look: Callable[[np.ndarray, float], np.ndarray],
    calibration: Calibration,
    wavelength: float,
    rounds: int = 12,
    progress: Progress | None = None,
) -> PhaseHologram:
    """Show phases of one wavelength, look at them, and make them better by that.

    Parameters
    ----------
    phase : PhaseHologram
        To begin with, encoded for the same calibration. The library of its data computes, as for `engine.encode`.
    field : WaveField
        What is to be seen.
    look : callable
        ``look(levels, distance)`` shows levels on the device, focuses at a distance from the SLM and gives the camera's
        picture, values of 0 to 1, shape (y, x).
    calibration : Calibration
        With the display's model and the camera, see `calibrate`.
    wavelength : float
        Metres, one of the hologram's.
    rounds : int
        In each all foci come up once: a picture of each frame at each.
    progress : callable, optional
        ``progress(done, message)`` with the PSNR that the camera sees, may raise `Cancelled`. What was best by then is
        in the attribute `kept` of whatever this raises once a round is done, a camera's failure too.

    Returns
    -------
    PhaseHologram
        The best that was seen. Its `report` has ``tuned``: the wavelength, and the PSNR in dB that the camera saw
        before each round and after the last one.

    Raises
    ------
    InvalidInput
        If the calibration has no such wavelength, no focus within the volume, or a camera that looks elsewhere.
    Cancelled
    """
    progress = progress or (lambda done, message: None)
    colours = [
        k for k, w in enumerate(phase.hologram.wavelengths) if math.isclose(w, wavelength, abs_tol=0.5e-9)
    ]
    if not colours:
        known = ", ".join(f"{w * 1e9:g}" for w in phase.hologram.wavelengths)
        raise InvalidInput(f"The hologram has no {wavelength * 1e9:g} nm, only {known} nm.")
    if field.data.shape != phase.data.shape:
        raise InvalidInput("The phases are of another field: encode this one, then tune its phases.")
    if phase.hologram.optics.colors_apart:
        raise InvalidInput(
            "Tuning looks at one color where the panel shows it: render and encode without --color-scale, "
            "--color-distance, --color-shift and --colors-from."
        )
    if not phase.hologram.flat_bench:
        raise InvalidInput(
            "A display that was fitted has a beam and a stop of its own, and no lens with a picture behind it: encode "
            "without --beam, --carrier and --stop, in free space, then tune."
        )
    if rounds < 1:
        raise InvalidInput(f"Phases are tuned in one round or more, not in {rounds}.")
    colour, best, decibels = colours[0], phase.data[:, colours[0], ...], []

    def kept():
        data = arrays.copied(phase.data)
        data[:, colour, ...] = best
        tuned = {"wavelength_m": phase.hologram.wavelengths[colour], "psnr_db": decibels}
        return replace(
            phase, data=data, report={**phase.report, "tuned": [*phase.report.get("tuned", ()), tuned]}
        )

    with Frames() as threads:
        loop = _Loop(phase, field, calibration, colour, threads)
        shots, taken = (rounds + 1) * len(loop.distances) * phase.data.shape[0], count()

        def shown(levels, distance):
            seen = f", {decibels[-1]:.1f} dB" if decibels else ""
            progress(next(taken) / shots, f"Captures{seen}")
            return look(levels, distance)

        try:
            for number in range(rounds + 1):  # after the last one it only looks
                psnr, errors = loop.seen(shown)
                if not decibels or psnr > max(decibels):
                    best = loop.phases.values()
                decibels.append(psnr)
                if number < rounds:
                    rate = LONGEST * 0.5 * (1 + math.cos(math.pi * number / rounds))
                    loop.descend(errors, rate)
        except (Exception, KeyboardInterrupt) as error:
            vars(error)["kept"] = kept() if decibels else None
            if not cancelled(error):
                raise
            stopped = Cancelled("Tuning was stopped.")
            stopped.kept = vars(error)["kept"]
            raise stopped from error
    return kept()


class _Loop:
    """Phases of one wavelength under way, and what is wanted at each focus."""

    def __init__(self, phase, field, calibration, colour, threads):
        hologram, data = phase.hologram, phase.data
        self._wavelength, self._calibration = hologram.wavelengths[colour], calibration
        models = calibration.display([self._wavelength])
        if models is None or not calibration.plain:
            raise InvalidInput(
                "Tuning needs a display that was fitted, and is shown neither turned, moved nor corrected: run "
                "`holopath calibrate` first."
            )
        model, self._sensor = models[0], calibration.sensor(self._wavelength)
        ends = sorted((hologram.depth_far, hologram.depth_near))
        self.distances = [z for z in self._sensor.homographies if ends[0] - NEAR <= z <= ends[1] + NEAR]
        if not self.distances:
            raise InvalidInput(
                f"No focus of the calibration lies within the volume, {ends[0] * 1e3:g} to {ends[1] * 1e3:g} mm."
            )
        self._between = list((np.arange(BETWEEN) + 0.5) / BETWEEN * (ends[1] - ends[0]) + ends[0])
        everywhere = [*self.distances, *self._between]
        depths = [float(field.mapping.z_to_depth(z)) for z in everywhere]
        field = replace(field, data=arrays.like(field.data, data))
        pictures = Refocuser(field, own_pixels=True)(depths)
        wanted = {z: pictures[number, ..., colour] for number, z in enumerate(everywhere)}
        shape = data.shape[-2:]
        shown = ShownLight(model, shape, hologram.pitch, MARGIN, data)
        ends = calibration.levels_of(hologram)[colour].ends
        self.phases = Phases(data[:, colour, ...], threads, shown, ends)
        self._table = calibration.table(self._wavelength)
        wide = tuple(n + 2 * MARGIN for n in shape)
        self._within = np.s_[:, MARGIN : MARGIN + shape[0], MARGIN : MARGIN + shape[1]]
        farthest = max(map(abs, everywhere))
        self._padded = padded_shape(wide, hologram.pitch, self._wavelength, farthest, TEACHING_GUARD)
        space = FreeSpace(self._padded, hologram.pitch, self._wavelength, on=data)
        self._transfers = {z: space(z) for z in everywhere}
        halves = half_sides(shape, hologram.pitch, model.half)
        eta, xi = ((np.arange(n) - (n - 1) / 2) / half for n, half in zip(shape, halves, strict=True))
        self._at, self._wanted = {}, {z: (wanted[z], relative(wanted[z])) for z in self._between}
        self._rng = np.random.default_rng(0)
        for z in self.distances:
            self._at[z] = self._sensor.pixels(z, xi[None, :], eta[:, None])
            rows, columns = self._at[z]
            seen = (rows >= 0) & (rows <= self._sensor.shape[0] - 1)
            seen &= (columns >= 0) & (columns <= self._sensor.shape[1] - 1)
            if seen.mean() < LEAST_SEEN:
                raise InvalidInput(
                    f"The camera sees {seen.mean():.0%} of the hologram at {z * 1e3:g} mm: let it look at more."
                )
            self._wanted[z] = wanted[z], relative(wanted[z]) * arrays.mask(seen, data)

    def seen(self, look):
        """Look at all frames at each focus: the mean PSNR, and how far each focus is from what is wanted."""
        values, psnrs, errors = on_processor(self.phases.values()), [], {}
        for distance in self.distances:
            wanted, weight = self._wanted[distance]
            total = np.zeros(wanted.shape, np.float32)
            for frame in values:
                levels = self._calibration.levels(frame, self._wavelength, self._table)
                picture = np.asarray(look(levels, distance), np.float32)
                if picture.shape != self._sensor.shape:
                    raise InvalidInput(
                        f"The camera's picture has {_pixels(picture.shape)}, at the calibration it had "
                        f"{_pixels(self._sensor.shape)}: let it take them alike."
                    )
                light = self._sensor.intensity(picture)
                total += scipy.ndimage.map_coordinates(light, self._at[distance], np.float32, 1, "nearest")
            total = arrays.like(total, wanted)
            total *= _gain(total, wanted, weight)  # as bright as is wanted
            psnrs.append(_psnr(*map(on_processor, (total, wanted, weight > 0))))
            errors[distance] = total - wanted
        return float(np.mean(psnrs)), errors

    def descend(self, errors, rate):
        """A step for each focus, and each time for one more distance, by the model's own picture there."""
        for distance, error in errors.items():
            light = self.phases.light
            frames, rows, columns = light.shape
            spectra = arrays.fft2(light, self._padded)
            slopes = self._slopes(spectra, distance, error)
            slopes += self._slopes(spectra, self._between[self._rng.integers(len(self._between))])
            back = arrays.ifft2(slopes)[:, :rows, :columns]
            self.phases.descend(back, np.ones(frames), rate, FEW_VIEWS_MEMORY)

    def _slopes(self, spectra, distance, error=None):
        """Spectra of dL / du at the SLM, of one distance; without an error seen the model's own counts."""
        (wanted, weight), transfer = self._wanted[distance], self._transfers[distance]
        waves, xp = arrays.ifft2(spectra * transfer), arrays.namespace(spectra)
        inner = waves[self._within]
        seen = xp.mean(xp.abs(inner) ** 2, axis=0)
        gain = _gain(seen, wanted, weight)
        error = gain * seen - wanted if error is None else error
        slope = xp.zeros_like(waves)
        slope[self._within] = inner * arrays.as_type(2 * gain / waves.shape[0] * weight * error, "float32")
        return arrays.fft2(slope) * xp.conj(transfer)


def _pixels(shape):
    return f"{shape[1]} x {shape[0]} pixels"


def _gain(seen, wanted, weight):
    square = arrays.total(weight * seen * seen)
    return arrays.total(weight * seen * wanted) / square if square > 0 else 0.0


def _psnr(seen, wanted, where):
    """Of roots, with the 95th percentile as white, as `metrics.psnr` has it; only where the camera sees it."""
    a, b = (np.sqrt(np.maximum(v[where], 0)) for v in (seen, wanted))
    white = float(np.percentile(b, 95)) or 1.0
    error = float(((np.minimum(a, white) - np.minimum(b, white)) ** 2).mean()) / white**2
    return -10 * math.log10(max(error, 1e-30))
