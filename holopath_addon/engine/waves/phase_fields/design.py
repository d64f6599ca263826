"""Design of phase maps whose frame mean looks incoherent, once for all scenes (docs/theory.md, Designed phase fields).

Adam optimizes the phases of a periodic set of maps. Each step invents a small wave-optics scene, computes its images at
a few foci and through parts of the pupil, and reduces the squared difference between the frame mean of the intensity
and the image in incoherent light. Lengths are pixels. Defocus is the Fresnel number q = wavelength z / pitch^2 of a
pixel, on which alone paraxial images depend, so that one set is good for all wavelengths and pitches.
"""

from __future__ import annotations

import json
import math
import os
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ...errors import InvalidInput
from ..propagation import circular_band
from ..supervision import Adam, FramePool, TargetImage, relative, supervise

if TYPE_CHECKING:
    from collections.abc import Callable

PREFIXES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # numbers of first frames whose own mean is optimized
LAYERS, PUPILS, FLAT, IN_FOCUS = 0.3, 0.15, 0.2, 1 / 3  # probabilities in a step
# Radii of parts of the pupil, cycles per pixel: halves, and down to a sixth
PARTS, NARROW = (0.2, 0.4), (0.08, 0.3)
BRANCH = 37  # pixels, as tracer.BRANCH_SHIFT
VIEWS = 2  # images in a step
PLANE_VIEWS = 7  # evenly spread images of an even plane out of focus


@dataclass(frozen=True)
class Recipe:
    """Inputs of a design.

    Attributes
    ----------
    frames, size : int
        Number of maps, and their period in pixels.
    steps : int
        Number of steps.
    seed : int
        Seed of the scenes.
    reach : float
        Largest defocus |q|; 60 is 6 mm at 640 nm and 8 µm. Beyond the reach speckle returns.
    plane : float
        Fraction of the steps with an even plane through the whole pupil; the others have textures and parts of the
        pupil, which improve less with few frames.
    prefixes : float
        Total weight of the first 1, 2, 3, 4, 6, ... frames, against 1 for all frames.
    narrow : float
        Weight of an additional image in each step through a narrow part of the pupil.
    rate : float
        Adam's longest step, radians; smaller to improve good maps.

    Raises
    ------
    InvalidInput
    """

    frames: int
    size: int = 256
    steps: int = 12000
    seed: int = 0
    reach: float = 63.0
    plane: float = 0.6
    prefixes: float = 0.1
    narrow: float = 0.0
    rate: float = 0.1

    def __post_init__(self):
        if not 1 <= self.frames <= 256:
            raise InvalidInput(f"Expected 1 to 256 frames, got {self.frames}.")
        if self.size < 64 or self.size & (self.size - 1):
            raise InvalidInput(f"Expected a power of two of at least 64 as size of a map, got {self.size}.")
        lowest = min(self.steps - 1, self.seed, self.reach, self.prefixes, self.narrow, self.rate)
        if lowest < 0 or not 0 <= self.plane <= 1:
            raise InvalidInput(
                "Expected at least one step, seed, reach, prefixes, narrow and rate of 0 or more, and a fraction of "
                "planes from 0 to 1."
            )

    @property
    def stages(self) -> dict[int, float]:
        """Weights for `supervise`: the mean of m independent frames has the squared error 1/m."""
        before = [count for count in PREFIXES if count < self.frames]
        return {count: self.prefixes / len(before) * count for count in before} | {
            self.frames: float(self.frames)
        }


@dataclass(frozen=True)
class Layer:
    """Surface of a scene: its amplitude, its distance q from the focal plane, and the shift of its phases."""

    amplitude: np.ndarray
    defocus: float = 0.0
    shift: tuple = (0, 0)


@dataclass(frozen=True)
class DefocusedView:
    """View of a scene: focus beyond the first layer, part of the pupil, and weight of speckle."""

    defocus: float
    pupil: tuple | None = None
    speckle: float = 1.0


class MapOptics:
    """Propagation and pupils on the periodic grid of a map.

    Parameters
    ----------
    size : int
        Period of a map, pixels.
    """

    def __init__(self, size: int) -> None:
        f = scipy.fft.fftfreq(size).astype(np.float32)
        self.fx, self.fy = f[None, :], f[:, None]
        self.square = self.fx**2 + self.fy**2
        self.band = circular_band((size, size))

    def transfer(self, defocus: float, pupil: tuple[float, float, float] | None = None) -> np.ndarray:
        """Transfer function exp(-i pi q f^2) in the band, and in the pupil if given.

        Parameters
        ----------
        defocus : float
            q.
        pupil : tuple of float, optional
            Center x and y, and radius, cycles per pixel.
        """
        keep = self.band
        if pupil is not None:
            x, y, radius = pupil
            keep = keep & ((self.fx - x) ** 2 + (self.fy - y) ** 2 <= radius**2)
        angle = np.float32(-math.pi * defocus) * self.square
        out = np.empty(angle.shape, np.complex64)
        out.real, out.imag = np.cos(angle) * keep, np.sin(angle) * keep
        return out


def texture(rng: np.random.Generator, size: int) -> np.ndarray:
    """Amplitudes of a random image: even, or blocks of 2 to 32 pixels, gray or of two levels."""
    if rng.random() < FLAT:
        return np.ones((size, size), np.float32)
    block = 2 ** int(rng.integers(1, 6))
    levels = rng.random((size // block,) * 2, dtype=np.float32)
    if rng.random() < 0.5:
        levels = (levels > 0.5) * np.float32(0.9) + np.float32(0.1 * rng.random())
    blocks = np.kron(np.sqrt(levels), np.ones((block, block), np.float32))
    return np.roll(blocks, rng.integers(0, size, 2), (0, 1))


def invent(
    rng: np.random.Generator, size: int, reach: float, plane: float, narrow: float = 0.0
) -> tuple[list, list]:
    """Invent layers of a random scene, and views of it.

    A scene is an even plane, a textured one, or two at different depths: one in front of the other, or both at once
    with shifted phases, as the branches of a clear surface. With `narrow` there is an additional view of this weight,
    through a narrow part of the pupil.

    Parameters
    ----------
    rng : numpy.random.Generator
    size : int
        Period of a map, pixels.
    reach, plane, narrow : float
        See `Recipe`.

    Returns
    -------
    layers : list of Layer
    views : list of DefocusedView
    """
    layers, views = _invented(rng, size, reach, plane)
    if narrow:
        views.append(DefocusedView(float(rng.uniform(-reach, reach)), _part(rng, *NARROW), narrow))
    return layers, views


def _part(rng, low, high):
    """Random part of the pupil of a radius from `low` to `high`."""
    radius, angle = float(rng.uniform(low, high)), 2 * math.pi * rng.random()
    aside = (0.5 - radius) * math.sqrt(rng.random())
    return aside * math.cos(angle), aside * math.sin(angle), radius


def _invented(rng, size, reach, plane):
    """Layers and views: of an even plane with a probability of `plane`, or of textures."""

    def focus():
        return float(rng.uniform(-reach, reach))

    def part():
        return _part(rng, *PARTS)

    if rng.random() < plane:
        places = (np.arange(PLANE_VIEWS) + rng.random(PLANE_VIEWS)) / PLANE_VIEWS
        views = [DefocusedView(0.0)] + [DefocusedView(reach * (2 * place - 1)) for place in places]
        # the light must fill the pupil evenly
        views.append(DefocusedView(focus(), part(), 1e-4))
        return [Layer(np.ones((size, size), np.float32))], views
    layers = [Layer(texture(rng, size))]
    if rng.random() < LAYERS:
        front, back = layers[0].amplitude, texture(rng, size)
        if rng.random() < 0.5:
            block = 2 ** int(rng.integers(3, 7))
            mask = np.kron(rng.random((size // block,) * 2) > 0.5, np.ones((block, block), bool))
            mask = np.roll(mask, rng.integers(0, size, 2), (0, 1))
            front, back = front * mask, back * ~mask
        shift, kind = (0, 0), rng.random()
        if kind > 0.8:
            shift = (BRANCH, BRANCH)
        elif kind > 0.6:
            shift = tuple(int(v) for v in rng.integers(0, size, 2))
        layers = [Layer(front), Layer(back, focus(), shift)]
    views = []
    for _ in range(VIEWS):
        defocus = 0.0 if rng.random() < IN_FOCUS else focus()
        views.append(DefocusedView(defocus, part() if rng.random() < PUPILS else None))
    return layers, views


def incoherent_target(optics: MapOptics, layers: list[Layer], view: DefocusedView) -> TargetImage:
    """Image of layers in incoherent light: the intensity of each, blurred by the intensity of its kernel.

    Errors are divided by the intensity, as in the variance of a square root, so that m independent frames have the loss
    1/m.

    Parameters
    ----------
    optics : MapOptics
    layers : list of Layer
    view : DefocusedView
    """
    target = 0
    for layer in layers:
        kernel = scipy.fft.ifft2(optics.transfer(view.defocus + layer.defocus, view.pupil))
        blur = scipy.fft.fft2(kernel.real**2 + kernel.imag**2)
        target = target + scipy.fft.ifft2(scipy.fft.fft2(layer.amplitude**2) * blur).real
    target = np.maximum(target, 0)
    transfer = optics.transfer(view.defocus, view.pupil)
    return TargetImage(transfer, target, view.speckle * relative(target))


class Design:
    """Maps during their design.

    Parameters
    ----------
    recipe : Recipe
    start : numpy.ndarray, float32, shape (frames, size, size)
        Phases to start with, radians.
    """

    def __init__(self, recipe: Recipe, start: np.ndarray) -> None:
        self.recipe, self.phases = recipe, start.copy()
        self.optics = MapOptics(recipe.size)
        self.adam = Adam(start.shape)
        self.done = 0

    def slopes(
        self, layers: list[Layer], views: list[DefocusedView], pool: FramePool
    ) -> tuple[dict[int, float], list[np.ndarray]]:
        """Compute losses by number of frames, and their gradient with respect to the phases."""
        optics, frames = self.optics, self.recipe.frames
        transfers = [None if not layer.defocus else optics.transfer(layer.defocus) for layer in layers]
        phasors = np.empty(self.phases.shape, np.complex64)

        def spectrum(frame):
            phasor, total = phasors[frame], 0
            phasor.real, phasor.imag = np.cos(self.phases[frame]), np.sin(self.phases[frame])
            for layer, transfer in zip(layers, transfers, strict=True):
                shifted = np.roll(phasor, [-s for s in layer.shift], (0, 1)) if any(layer.shift) else phasor
                part = scipy.fft.fft2(layer.amplitude * shifted)
                total = total + (part if transfer is None else part * transfer)
            return total * optics.band

        spectra = pool.each(spectrum, frames)
        targets = [incoherent_target(optics, layers, view) for view in views]
        energy = sum(float((layer.amplitude**2).sum()) for layer in layers) * optics.band.mean()
        losses, gradient = supervise(spectra, targets, energy, self.recipe.stages, pool)

        def slope(frame):
            total = 0
            for layer, transfer in zip(layers, transfers, strict=True):
                part = gradient[frame] if transfer is None else gradient[frame] * np.conj(transfer)
                # the adjoint of the FFT
                part = scipy.fft.ifft2(part, norm="forward") * layer.amplitude
                total = total + (np.roll(part, layer.shift, (0, 1)) if any(layer.shift) else part)
            return 2 * (total.imag * phasors[frame].real - total.real * phasors[frame].imag)

        return losses, pool.each(slope, frames)

    def step(self, pool: FramePool) -> dict[int, float]:
        """Take a step, and return the losses by number of frames, in terms of those of independent frames."""
        recipe = self.recipe
        rng = np.random.default_rng((recipe.seed, self.done))
        layers, views = invent(rng, recipe.size, recipe.reach, recipe.plane, recipe.narrow)
        losses, slopes = self.slopes(layers, views, pool)
        rate = Adam.rate(self.done, recipe.steps, recipe.rate)
        self.adam.step(self.phases, slopes, rate, pool)
        self.done += 1
        count = sum(view.speckle for view in views)
        return {frames: loss * frames / count for frames, loss in losses.items()}

    def save(self, path: Path | str) -> None:
        """Write the state that `load` continues from, to another file that is then renamed."""
        state = {
            "recipe": json.dumps(asdict(self.recipe)),
            "phases": self.phases,
            "mean": self.adam.mean,
            "square": self.adam.square,
            "done": self.done,
        }
        _write(path, lambda file: np.savez(file, **state))

    @classmethod
    def load(cls, path: Path | str, recipe: Recipe) -> Design:
        """Load the state of a design of the same recipe.

        Raises
        ------
        InvalidInput
            If the file has another recipe or is damaged.
        """
        try:
            with np.load(path, allow_pickle=False) as state:
                kept, design = json.loads(str(state["recipe"])), cls(recipe, state["phases"])
                design.adam.mean, design.adam.square = state["mean"], state["square"]
                design.adam.count = design.done = int(state["done"])
        except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise InvalidInput(
                f"{path} is not a readable state of a design. Remove it to start again."
            ) from error
        if kept != asdict(recipe):
            raise InvalidInput(
                f"{path} has another design, {kept}. Use the same options, or another --state."
            )
        return design

    def save_maps(self, path: Path | str) -> None:
        """Write the maps for `designed_phasors`, as bytes of 256 levels per turn."""
        levels = np.round(self.phases * (256 / (2 * math.pi))).astype(np.int64) % 256
        _write(path, lambda file: np.save(file, levels.astype(np.uint8)))


def _write(path, save):
    unfinished = Path(f"{path}.unfinished")
    with open(unfinished, "wb") as file:
        save(file)
    os.replace(unfinished, path)


def run(
    design: Design,
    state: Path | str,
    report: Callable[[int, dict[int, float]], None],
    stop: Callable[[], bool],
    every: int = 500,
) -> bool:
    """Run a design until it is finished or stopped, with its state on disk.

    Parameters
    ----------
    design : Design
    state : path
        File of the state, written at the start, every `every` steps, and at the end.
    report : callable
        ``report(step, losses)`` every `every` steps, with their mean losses by number of frames.
    stop : callable
        ``stop()`` is called between steps, so that a state is never that of half a step.
    every : int
        Number of steps between states and reports.

    Returns
    -------
    bool
        Whether it is finished.

    Raises
    ------
    OSError
        If the state cannot be written.
    """
    losses = []
    design.save(state)
    with FramePool() as pool:
        while design.done < design.recipe.steps and not stop():
            losses.append(design.step(pool))
            if design.done % every == 0 or design.done == design.recipe.steps:
                report(
                    design.done,
                    {count: float(np.mean([loss[count] for loss in losses])) for count in losses[0]},
                )
                losses = []
                design.save(state)
    design.save(state)
    return design.done == design.recipe.steps
