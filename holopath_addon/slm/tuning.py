"""Camera-in-the-loop optimization: descents of phases by captures of a camera instead of predictions of a model.

With s the mean of the frames' intensities in a camera's picture at a focus, t the target there, and u_m the light of
frame m there by the display's model, a step reduces

    L = sum over pixels of w (g s - t)^2,    dL / du_m = 2 g w (g s - t) conj(u_m) / frames

so that errors are those of the bench, and only the gradient is the model's (Peng et al., Neural holography with
camera-in-the-loop training, ACM TOG 39(6), 185 (2020), section 4). g makes the picture as bright as the target. In each
step there is an additional distance without a camera, where s is the model's, so that images between the foci improve,
too.
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
from ..engine.waves.propagation import OPTIMIZATION_GUARD, FreeSpace, padded_shape
from ..engine.waves.supervision import FramePool, relative

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..engine.encoding.phase_hologram import PhaseHologram
    from ..engine.progress import Progress
    from ..engine.wavefield import WaveField
    from .calibration import Calibration

MAX_STEP = 0.1  # radians, of the first steps
MIN_VISIBLE_FRACTION = 0.1  # of the hologram's pixels
TOLERANCE = 1e-9  # meters by which a focus may be outside the volume, as numbers in files are rounded
MODEL_DISTANCES = 8  # number of distances at which the model's images count


def tune(
    phase: PhaseHologram,
    field: WaveField,
    look: Callable[[np.ndarray, float], np.ndarray],
    calibration: Calibration,
    wavelength: float,
    rounds: int = 12,
    progress: Progress | None = None,
) -> PhaseHologram:
    """Tune phases of one wavelength by captures of a camera.

    Parameters
    ----------
    phase : PhaseHologram
        Phases to start with, encoded for the same calibration. The library of its data computes, as for
        `engine.encode`.
    field : WaveField
        The target field.
    look : callable
        ``look(levels, distance)`` shows levels on the device, focuses at a distance from the SLM, and returns the
        camera's picture, values from 0 to 1, shape (y, x).
    calibration : Calibration
        Calibration with the display's model and the camera, see `calibrate`.
    wavelength : float
        One of the hologram's wavelengths, meters.
    rounds : int
        Number of rounds, each with a picture of each frame at each focus.
    progress : callable, optional
        ``progress(done, message)`` with the camera's PSNR, may raise `Cancelled`. The attribute `kept` of any exception
        after the first round, also of a camera's failure, is the best hologram so far.

    Returns
    -------
    PhaseHologram
        The hologram with the best captures. Its `report` has ``tuned``: the wavelength, and the camera's PSNR in dB
        before each round and after the last one.

    Raises
    ------
    InvalidInput
        If the calibration has no such wavelength, no focus within the volume, or a camera that looks elsewhere.
    Cancelled
    """
    progress = progress or (lambda done, message: None)
    colors = [
        k for k, w in enumerate(phase.hologram.wavelengths) if math.isclose(w, wavelength, abs_tol=0.5e-9)
    ]
    if not colors:
        known = ", ".join(f"{w * 1e9:g}" for w in phase.hologram.wavelengths)
        raise InvalidInput(f"Expected a wavelength of the hologram, {known} nm, got {wavelength * 1e9:g} nm.")
    if field.data.shape != phase.data.shape:
        raise InvalidInput("The phases are of another field. Encode this one, then tune its phases.")
    if phase.hologram.optics.colors_apart:
        raise InvalidInput(
            "Tuning does not support pixel positions that depend on color. Render and encode without --color-scale, "
            "--color-distance, --color-shift and --colors-from."
        )
    if not phase.hologram.flat_bench:
        raise InvalidInput(
            "A fitted display has a beam and a stop of its own, and no lens behind it. Encode without --beam, "
            "--carrier and --stop, in free space, then tune."
        )
    if rounds < 1:
        raise InvalidInput(f"Expected at least one round, got {rounds}.")
    color, best, decibels = colors[0], phase.data[:, colors[0], ...], []

    def kept():
        data = arrays.copied(phase.data)
        data[:, color, ...] = best
        tuned = {"wavelength_m": phase.hologram.wavelengths[color], "psnr_db": decibels}
        # without what tells that these are the phases of a command
        report = {
            key: value for key, value in phase.report.items() if key not in ("sha256", "job", "begun_with")
        }
        return replace(phase, data=data, report=report | {"tuned": [*report.get("tuned", ()), tuned]})

    with FramePool() as pool:
        loop = _Loop(phase, field, calibration, color, pool)
        shots, taken = (rounds + 1) * len(loop.distances) * phase.data.shape[0], count()

        def capture(levels, distance):
            psnr = f", {decibels[-1]:.1f} dB" if decibels else ""
            progress(next(taken) / shots, f"Captures{psnr}")
            return look(levels, distance)

        try:
            for number in range(rounds + 1):  # after the last one there are only captures
                psnr, errors = loop.compare(capture)
                if not decibels or psnr > max(decibels):
                    best = loop.phases.values()
                decibels.append(psnr)
                if number < rounds:
                    rate = MAX_STEP * 0.5 * (1 + math.cos(math.pi * number / rounds))
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
    """Phases of one wavelength during tuning, and the target at each distance."""

    def __init__(self, phase, field, calibration, color, pool):
        hologram, data = phase.hologram, phase.data
        self._wavelength, self._calibration = hologram.wavelengths[color], calibration
        models = calibration.display([self._wavelength])
        if models is None or not calibration.plain:
            raise InvalidInput(
                "Tuning needs a fitted display that is neither mirrored, shifted nor corrected. Run `holopath "
                "calibrate` first."
            )
        model, self._sensor = models[0], calibration.sensor(self._wavelength)
        ends = sorted((hologram.depth_far, hologram.depth_near))
        self.distances = [
            z for z in self._sensor.homographies if ends[0] - TOLERANCE <= z <= ends[1] + TOLERANCE
        ]
        if not self.distances:
            raise InvalidInput(
                f"No focus of the calibration is within the volume, {ends[0] * 1e3:g} to {ends[1] * 1e3:g} mm. "
                "Calibrate at foci within it."
            )
        steps = (np.arange(MODEL_DISTANCES) + 0.5) / MODEL_DISTANCES
        self._between = list(steps * (ends[1] - ends[0]) + ends[0])
        distances = [*self.distances, *self._between]
        depths = [float(field.mapping.z_to_depth(z)) for z in distances]
        field = replace(field, data=arrays.like(field.data, data))
        images = Refocuser(field, own_pixels=True)(depths)
        targets = {z: images[number, ..., color] for number, z in enumerate(distances)}
        shape = data.shape[-2:]
        display = ShownLight(model, shape, hologram.pitch, MARGIN, data)
        ends = calibration.levels_of(hologram)[color].ends
        self.phases = Phases(data[:, color, ...], pool, display, ends)
        self._table = calibration.table(self._wavelength)
        wide = tuple(n + 2 * MARGIN for n in shape)
        self._within = np.s_[:, MARGIN : MARGIN + shape[0], MARGIN : MARGIN + shape[1]]
        farthest = max(map(abs, distances))
        self._padded = padded_shape(wide, hologram.pitch, self._wavelength, farthest, OPTIMIZATION_GUARD)
        space = FreeSpace(self._padded, hologram.pitch, self._wavelength, on=data)
        self._transfers = {z: space(z) for z in distances}
        halves = half_sides(shape, hologram.pitch, model.half)
        eta, xi = ((np.arange(n) - (n - 1) / 2) / half for n, half in zip(shape, halves, strict=True))
        self._at, self._targets = {}, {z: (targets[z], relative(targets[z])) for z in self._between}
        self._rng = np.random.default_rng(0)
        for z in self.distances:
            self._at[z] = self._sensor.pixels(z, xi[None, :], eta[:, None])
            rows, columns = self._at[z]
            visible = (rows >= 0) & (rows <= self._sensor.shape[0] - 1)
            visible &= (columns >= 0) & (columns <= self._sensor.shape[1] - 1)
            if visible.mean() < MIN_VISIBLE_FRACTION:
                raise InvalidInput(
                    f"The camera sees {visible.mean():.0%} of the hologram at {z * 1e3:g} mm. Enlarge its view."
                )
            self._targets[z] = targets[z], relative(targets[z]) * arrays.mask(visible, data)

    def compare(self, capture):
        """Capture all frames at each focus: the mean PSNR, and the error at each focus."""
        values, psnrs, errors = on_processor(self.phases.values()), [], {}
        for distance in self.distances:
            target, weight = self._targets[distance]
            total = np.zeros(target.shape, np.float32)
            for frame in values:
                levels = self._calibration.levels(frame, self._wavelength, self._table)
                picture = np.asarray(capture(levels, distance), np.float32)
                if picture.shape != self._sensor.shape:
                    raise InvalidInput(
                        f"Expected {_pixels(self._sensor.shape)} in the camera's picture, as at the calibration, got "
                        f"{_pixels(picture.shape)}."
                    )
                light = self._sensor.intensity(picture)
                total += scipy.ndimage.map_coordinates(light, self._at[distance], np.float32, 1, "nearest")
            total = arrays.like(total, target)
            total *= _gain(total, target, weight)  # as bright as the target
            psnrs.append(_psnr(*map(on_processor, (total, target, weight > 0))))
            errors[distance] = total - target
        return float(np.mean(psnrs)), errors

    def descend(self, errors, rate):
        """Take a step for each focus, each with an additional distance and the model's image there."""
        for distance, error in errors.items():
            light = self.phases.light
            frames, rows, columns = light.shape
            spectra = arrays.fft2(light, self._padded)
            slopes = self._slopes(spectra, distance, error)
            slopes += self._slopes(spectra, self._between[self._rng.integers(len(self._between))])
            back = arrays.ifft2(slopes)[:, :rows, :columns]
            self.phases.descend(back, np.ones(frames), rate, FEW_VIEWS_MEMORY)

    def _slopes(self, spectra, distance, error=None):
        """Spectra of dL / du at the SLM for one distance; by default with the error of the model's image."""
        (target, weight), transfer = self._targets[distance], self._transfers[distance]
        waves, xp = arrays.ifft2(spectra * transfer), arrays.namespace(spectra)
        inner = waves[self._within]
        image = xp.mean(xp.abs(inner) ** 2, axis=0)
        gain = _gain(image, target, weight)
        error = gain * image - target if error is None else error
        slope = xp.zeros_like(waves)
        slope[self._within] = inner * arrays.as_type(2 * gain / waves.shape[0] * weight * error, "float32")
        return arrays.fft2(slope) * xp.conj(transfer)


def _pixels(shape):
    return f"{shape[1]} x {shape[0]} pixels"


def _gain(image, target, weight):
    square = arrays.total(weight * image * image)
    return arrays.total(weight * image * target) / square if square > 0 else 0.0


def _psnr(image, target, where):
    """PSNR of square roots within a mask, with the 95th percentile as white, as in `metrics.psnr`."""
    a, b = (np.sqrt(np.maximum(v[where], 0)) for v in (image, target))
    white = float(np.percentile(b, 95)) or 1.0
    error = float(((np.minimum(a, white) - np.minimum(b, white)) ** 2).mean()) / white**2
    return -10 * math.log10(max(error, 1e-30))
