"""Phase maps whose frame mean looks incoherent: designed once, for every scene (docs/theory.md, Designed phase fields).

Adam on the phases of a periodic set of maps. Each step invents a small wave-optics scene, looks at it through a few
foci and pupils, and descends the squared difference between the frame mean of the intensity and the picture in
incoherent light. Lengths are pixels, and defocus is the Fresnel number q = wavelength z / pitch^2 of a pixel, on
which alone paraxial pictures depend; so one set serves all wavelengths and pitches.
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
from ..supervision import Adam, Frames, TargetImage, relative, supervise

if TYPE_CHECKING:
    from collections.abc import Callable

STOPS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # first frames whose own mean is looked at
LAYERS, PUPILS, FLAT, IN_FOCUS = 0.3, 0.15, 0.2, 1 / 3  # how often a step has what
# radii of parts of the pupil, cycles a pixel: halves, and down to a sixth
PARTS, NARROW = (0.2, 0.4), (0.08, 0.3)
BRANCH = 37  # pixels, as tracer.BRANCH_SHIFT
VIEWS = 2  # pictures a step
PLANE_VIEWS = 7  # of an even plane out of focus, spread evenly


@dataclass(frozen=True)
class Recipe:
    """What a design depends on, besides this program.

    Attributes
    ----------
    frames, size : int
        Maps and their period in pixels.
    steps : int
    seed : int
    reach : float
        Largest defocus |q|; 60 is 6 mm at 640 nm and 8 µm, and beyond the reach speckle comes back.
    plane : float
        Share of the steps that look at an even plane through the whole pupil; the others at textures and through
        parts of the pupil, which with few frames come short otherwise.
    prefixes : float
        How much the first 1, 2, 3, 4, 6, ... frames count in all, against one for all frames.
    narrow : float
        How much a picture through a narrow part of the pupil counts, which each step has besides.
    rate : float
        Adam's longest step, radians; less where good maps are only to be bettered.
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
            raise InvalidInput(f"A set has 1 to 256 frames, not {self.frames}.")
        if self.size < 64 or self.size & (self.size - 1):
            raise InvalidInput(f"The size of a map is a power of two, at least 64, not {self.size}.")
        least = min(self.steps - 1, self.seed, self.reach, self.prefixes, self.narrow, self.rate)
        if least < 0 or not 0 <= self.plane <= 1:
            raise InvalidInput(
                "Steps must be positive; seed, reach, prefixes, narrow, rate not negative; the share of planes 0 to 1."
            )

    @property
    def stages(self) -> dict[int, float]:
        """Weights for `supervise`: the mean of m independent frames has the squared error 1/m."""
        before = [count for count in STOPS if count < self.frames]
        return {count: self.prefixes / len(before) * count for count in before} | {
            self.frames: float(self.frames)
        }


@dataclass(frozen=True)
class Layer:
    """A surface of a scene: its amplitude, its distance q from the focal plane, and where it looks up its phases."""

    amplitude: np.ndarray
    defocus: float = 0.0
    shift: tuple = (0, 0)


@dataclass(frozen=True)
class DefocusedView:
    """How a scene is looked at: focus beyond the first layer, part of the pupil, and how much speckle counts."""

    defocus: float
    pupil: tuple | None = None
    speckle: float = 1.0


class MapOptics:
    """Propagation and pupils on the periodic grid of a map.

    Parameters
    ----------
    size : int
    """

    def __init__(self, size: int) -> None:
        f = scipy.fft.fftfreq(size).astype(np.float32)
        self.fx, self.fy = f[None, :], f[:, None]
        self.square = self.fx**2 + self.fy**2
        self.band = circular_band((size, size))

    def transfer(self, defocus: float, pupil: tuple[float, float, float] | None = None) -> np.ndarray:
        """exp(-i pi q f^2) in the band, and in the pupil (centre x, centre y, radius; cycles a pixel) if given."""
        keep = self.band
        if pupil is not None:
            x, y, radius = pupil
            keep = keep & ((self.fx - x) ** 2 + (self.fy - y) ** 2 <= radius**2)
        angle = np.float32(-math.pi * defocus) * self.square
        out = np.empty(angle.shape, np.complex64)
        out.real, out.imag = np.cos(angle) * keep, np.sin(angle) * keep
        return out


def texture(rng: np.random.Generator, size: int) -> np.ndarray:
    """Amplitudes of a random picture: even, or blocks of 2 to 32 pixels, grey or of two levels."""
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
    """Layers of a random scene, and pictures of it.

    An even plane; or a textured one; or two at different depths, one in front of the other or both at once, as
    the branches of a clear surface are, which look up their phases elsewhere. With `narrow` there is one more
    picture, through a narrow part of the pupil, which counts so much.
    """
    layers, pictures = _invented(rng, size, reach, plane)
    if narrow:
        pictures.append(DefocusedView(float(rng.uniform(-reach, reach)), _part(rng, *NARROW), narrow))
    return layers, pictures


def _part(rng, low, high):
    """A part of the pupil of a radius from `low` to `high`, anywhere."""
    radius, angle = float(rng.uniform(low, high)), 2 * math.pi * rng.random()
    aside = (0.5 - radius) * math.sqrt(rng.random())
    return aside * math.cos(angle), aside * math.sin(angle), radius


def _invented(rng, size, reach, plane):
    """Layers of light, and the pictures to be even in: of one plane, as likely as `plane`, or of several."""

    def focus():
        return float(rng.uniform(-reach, reach))

    def part():
        return _part(rng, *PARTS)

    if rng.random() < plane:
        places = (np.arange(PLANE_VIEWS) + rng.random(PLANE_VIEWS)) / PLANE_VIEWS
        pictures = [DefocusedView(0.0)] + [DefocusedView(reach * (2 * place - 1)) for place in places]
        # the light must fill the pupil evenly
        pictures.append(DefocusedView(focus(), part(), 1e-4))
        return [Layer(np.ones((size, size), np.float32))], pictures
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
    pictures = []
    for _ in range(VIEWS):
        defocus = 0.0 if rng.random() < IN_FOCUS else focus()
        pictures.append(DefocusedView(defocus, part() if rng.random() < PUPILS else None))
    return layers, pictures


def incoherent_target(optics: MapOptics, layers: list, picture: DefocusedView) -> TargetImage:
    """The picture of layers in incoherent light: each one's intensity, blurred by the intensity of its kernel.

    Errors are divided by the intensity, as in the variance of a root, so that independent frames have the loss 1/m.
    """
    target = 0
    for layer in layers:
        kernel = scipy.fft.ifft2(optics.transfer(picture.defocus + layer.defocus, picture.pupil))
        blur = scipy.fft.fft2(kernel.real**2 + kernel.imag**2)
        target = target + scipy.fft.ifft2(scipy.fft.fft2(layer.amplitude**2) * blur).real
    target = np.maximum(target, 0)
    transfer = optics.transfer(picture.defocus, picture.pupil)
    return TargetImage(transfer, target, picture.speckle * relative(target))


class Design:
    """The maps under way.

    Parameters
    ----------
    recipe : Recipe
    start : numpy.ndarray, float32, shape (frames, size, size)
        Phases to begin with, radians.
    """

    def __init__(self, recipe: Recipe, start: np.ndarray) -> None:
        self.recipe, self.phases = recipe, start.copy()
        self.optics = MapOptics(recipe.size)
        self.adam = Adam(start.shape)
        self.done = 0

    def slopes(
        self, layers: list, pictures: list, threads: Frames
    ) -> tuple[dict[int, float], list[np.ndarray]]:
        """Losses by number of frames, and their gradient with respect to the phases."""
        optics, frames = self.optics, self.recipe.frames
        moved = [None if not layer.defocus else optics.transfer(layer.defocus) for layer in layers]
        phasors = np.empty(self.phases.shape, np.complex64)

        def spectrum(frame):
            phasor, total = phasors[frame], 0
            phasor.real, phasor.imag = np.cos(self.phases[frame]), np.sin(self.phases[frame])
            for layer, transfer in zip(layers, moved, strict=True):
                seen = np.roll(phasor, [-s for s in layer.shift], (0, 1)) if any(layer.shift) else phasor
                part = scipy.fft.fft2(layer.amplitude * seen)
                total = total + (part if transfer is None else part * transfer)
            return total * optics.band

        spectra = threads.each(spectrum, frames)
        targets = [incoherent_target(optics, layers, picture) for picture in pictures]
        energy = sum(float((layer.amplitude**2).sum()) for layer in layers) * optics.band.mean()
        losses, gradient = supervise(spectra, targets, energy, self.recipe.stages, threads)

        def slope(frame):
            total = 0
            for layer, transfer in zip(layers, moved, strict=True):
                part = gradient[frame] if transfer is None else gradient[frame] * np.conj(transfer)
                # the adjoint of the FFT
                part = scipy.fft.ifft2(part, norm="forward") * layer.amplitude
                total = total + (np.roll(part, layer.shift, (0, 1)) if any(layer.shift) else part)
            return 2 * (total.imag * phasors[frame].real - total.real * phasors[frame].imag)

        return losses, threads.each(slope, frames)

    def step(self, threads: Frames) -> dict[int, float]:
        """One step; returns the losses by number of frames, 1 being that of independent frames."""
        recipe = self.recipe
        rng = np.random.default_rng((recipe.seed, self.done))
        layers, pictures = invent(rng, recipe.size, recipe.reach, recipe.plane, recipe.narrow)
        losses, slopes = self.slopes(layers, pictures, threads)
        rate = Adam.rate(self.done, recipe.steps, recipe.rate)
        self.adam.step(self.phases, slopes, rate, threads)
        self.done += 1
        count = sum(picture.speckle for picture in pictures)
        return {frames: loss * frames / count for frames, loss in losses.items()}

    def save(self, path: Path | str) -> None:
        """Everything that `load` needs to go on, written beside and renamed."""
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
        """Go on with a saved design of the same recipe.

        Raises
        ------
        InvalidInput
            If the file is of another recipe or damaged.
        """
        try:
            with np.load(path, allow_pickle=False) as state:
                kept, design = json.loads(str(state["recipe"])), cls(recipe, state["phases"])
                design.adam.mean, design.adam.square = state["mean"], state["square"]
                design.adam.count = design.done = int(state["done"])
        except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise InvalidInput(
                f"{path} is no state of a design that can be read: remove it to begin anew."
            ) from error
        if kept != asdict(recipe):
            raise InvalidInput(
                f"{path} is of another design, {kept}: give the same options, or another --state."
            )
        return design

    def save_maps(self, path: Path | str) -> None:
        """The maps as bytes, 256 levels a turn: what `designed_phasors` reads."""
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
    """Go on with a design until it is finished or asked to stop; its state is kept on disk.

    Parameters
    ----------
    design : Design
    state : path
        Written at once, every few hundred steps and at the end.
    report : callable
        ``report(step, losses)`` every `every` steps, losses their mean since the last time, by number of frames.
    stop : callable
        ``stop()`` is asked after every step, so that a state is never that of half a step.
    every : int

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
    with Frames() as threads:
        while design.done < design.recipe.steps and not stop():
            losses.append(design.step(threads))
            if design.done % every == 0 or design.done == design.recipe.steps:
                report(
                    design.done,
                    {count: float(np.mean([loss[count] for loss in losses])) for count in losses[0]},
                )
                losses = []
                design.save(state)
    design.save(state)
    return design.done == design.recipe.steps
