"""Options of `encode`: their resolution for a field, and their validation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..settings.choices import ENCODINGS
from ..waves import arrays
from ..waves.modulator import Levels
from ..waves.phase_fields import DESIGNED_STARTS, FEW_FRAMES, MIN_AIMED_FRAMES, randomness_for
from .phase_hologram import PhaseHologram

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import ArrayLike

    from ..progress import Progress
    from ..wavefield import WaveField
    from ..waves.arrays import Array
    from ..waves.display_model import DisplayModel

SUPERVISIONS = ("complex", "amplitude")
STARTS = ("arg", "dpac")
JOINT_METHODS = ("joint", "refine")
MAX_STEPS = 1000  # of a stage in one wavelength
JOINT_STEPS = {"joint": 100, "refine": 400}  # in each wavelength, without a limit of seconds
SMOOTH = 0.8  # correlation of a field's neighboring pixels; of random phases that fill the band it is 0.2
# Number of steps after which few frames, which begin with light all over the pupil, lose it in parts that hardly count:
# 800 steps instead of 100 cost 5 dB in the mean of views (docs/measurements.md, Few frames).
MAX_AIMED_STEPS = 100


def eyebox_for(frames: int) -> float:
    """Weight of parts of the pupil that a number of frames supports, see `encode`.

    With three frames parts of the pupil gain nothing from any weight, and the whole pupil loses 2 dB (docs/theory.md).
    """
    return float(np.clip((frames - FEW_FRAMES) / (DESIGNED_STARTS - FEW_FRAMES), 0, 1)) ** 2


def step_limit(frames: int, eyebox: float) -> int:
    """Number of steps of all frames together, from which on more of them show less.

    Parameters
    ----------
    frames : int
        Number of frames.
    eyebox : float
        Weight of parts of the pupil, see `encode`.

    Returns
    -------
    int
        `MAX_STEPS` where more show more, or hardly less.
    """
    are_few = MIN_AIMED_FRAMES <= frames < DESIGNED_STARTS
    return MAX_AIMED_STEPS if are_few and eyebox <= eyebox_for(frames) else MAX_STEPS


def is_smooth(waves: Iterable[Array]) -> bool:
    """Whether the phases of waves are smooth, so that a complex target leaves a phase-only hologram no freedom.

    Flat phases have a narrow spectrum, so neighboring pixels correlate. Their correlation is the same on all planes, as
    propagation keeps the power spectrum (Wiener and Khinchin).

    Parameters
    ----------
    waves : iterable of array, complex, shape (..., y, x)
    """
    energy = correlation = 0.0
    for wave in waves:
        energy += arrays.product(wave, wave).real
        correlation += abs(arrays.product(wave[..., :-1, :], wave[..., 1:, :]))
        correlation += abs(arrays.product(wave[..., :-1], wave[..., 1:]))
    return correlation > 2 * SMOOTH * energy > 0


@dataclass(frozen=True)
class EncodingOptions:
    """Options of `encode`, which explains them."""

    method: str
    bits: int | None
    levels: Sequence[ArrayLike | Levels] | None
    display: Sequence[DisplayModel] | None
    supervision: str
    compared_planes: int
    has_stop: bool
    start: str | PhaseHologram
    randomness: float | None
    eyebox: float | None
    extra_frames: Callable[[Progress], Iterable[tuple[list[int], Array]]] | None
    seconds: float | None
    tolerance: float
    max_steps: int | None
    seed: int

    def resolve(self, field: WaveField) -> EncodingOptions:
        """Options for a field, with its method, eyebox and randomness; checked.

        Raises
        ------
        InvalidInput
        """
        frames = field.data.shape[0]
        eyebox = eyebox_for(frames) if self.eyebox is None else self.eyebox
        method, randomness = self.method, self.randomness
        if method == "auto":
            is_plain = self.start == "arg" and self.supervision == "complex"
            is_plain &= self.has_stop and field.hologram.in_air is field.hologram
            smooth = frames > 1 or (is_plain and is_smooth([field.data[0, ...]]))
            method = "joint" if smooth else "sgd"
        else:  # with few frames the light of a smooth field behind a lens meets the center of the SLM alone
            smooth = method in JOINT_METHODS and field.hologram.in_air is not field.hologram
        if smooth and randomness is None and self.start == "arg":
            randomness = randomness_for(frames, eyebox)
        options = replace(self, method=method, eyebox=eyebox, randomness=randomness)
        options._check_values()
        options._check_combinations(field)
        options._check_sizes(field)
        return options

    @property
    def max_frame_steps(self) -> int:
        """Maximum number of steps of each frame by itself."""
        return MAX_STEPS if self.max_steps is None else self.max_steps

    def max_joint_steps(self, frames: int) -> int:
        """Maximum number of steps of a number of frames together, in each wavelength; `resolve` was called before."""
        if self.max_steps is not None:
            return self.max_steps
        usual = MAX_STEPS if self.seconds else JOINT_STEPS.get(self.method, MAX_STEPS)
        return min(usual, step_limit(frames, self.eyebox or 0.0))

    def levels_at(self, color: int) -> Levels | None:
        """`Levels` of a wavelength by its index; None for any phase."""
        if self.levels is None:
            return None if self.bits is None else Levels.even(self.bits)
        levels = self.levels[color]
        return levels if isinstance(levels, Levels) else Levels(levels)

    def _check_values(self):
        for value, known, name in (
            (self.method, ENCODINGS, "encoding"),
            (self.supervision, SUPERVISIONS, "supervision"),
            (self.start if isinstance(self.start, str) else STARTS[0], STARTS, "start"),
        ):
            if value not in known:
                raise InvalidInput(f"Expected one of {', '.join(known)}, got the {name} '{value}'.")
        if not isinstance(self.start, (str, PhaseHologram)):
            raise InvalidInput(
                f"Expected the start 'arg', 'dpac' or a PhaseHologram, got {type(self.start).__name__}."
            )
        if self.seconds is not None and not 0 < self.seconds < math.inf:
            raise InvalidInput(f"Expected seconds of more than 0, got {self.seconds}.")
        if not 0 <= self.tolerance < 1:
            raise InvalidInput(f"Expected a tolerance from 0 to below 1, got {self.tolerance}.")
        if self.max_steps is not None and self.max_steps < 1:
            raise InvalidInput(f"Expected at least one step, got {self.max_steps}.")
        for name, value, low, high in (
            ("bits", self.bits, 1, 16),
            ("compared_planes", self.compared_planes, 1, 64),
            ("randomness", self.randomness, 0, 1),
            ("eyebox", self.eyebox, 0, 1),
            ("seed", self.seed, 0, 2**63 - 1),
        ):
            if value is not None and not low <= value <= high:
                raise InvalidInput(f"Expected {name} from {low} to {high}, got {value}.")

    def _check_combinations(self, field):
        if self.bits is not None and self.levels is not None:
            raise InvalidInput("Measured levels have a number of their own. Omit the bits.")
        if self.display is not None and self.method == "dpac":
            raise InvalidInput(
                "Double phase does not support display models. Choose sgd or joint, or omit the model."
            )
        if self.display is not None and self.start == "dpac":
            raise InvalidInput(
                "Phases for a display model begin with those that its levels allow. Omit the start dpac, or the model."
            )
        if self.display is not None and not field.hologram.flat_bench:
            raise InvalidInput(
                "A fitted display has a beam and a stop of its own, and no lens behind it. Omit the display model or "
                "the hologram's optics."
            )
        if not self.has_stop and (self.method != "sgd" or self.supervision != "complex"):
            raise InvalidInput(
                "Without a stop in the Fourier plane, only sgd with complex supervision encodes. Choose it, or keep "
                "the stop."
            )
        if not self.has_stop and field.hologram.optics.stopped:
            raise InvalidInput("The optics have a stop, which has_stop=False excludes. Omit one of them.")
        if self.method == "refine" and self.extra_frames is None:
            raise InvalidInput(
                "The encoding refine needs extra frames of the scene. Use `holopath render --encode refine`, or choose "
                "joint."
            )
        if self.randomness is not None and self.method not in JOINT_METHODS:
            raise InvalidInput(
                f"The encoding {self.method} starts with the field's phases. Omit the randomness, or choose joint or "
                "refine."
            )
        if self.randomness is not None and (self.start == "dpac" or self.supervision != SUPERVISIONS[0]):
            raise InvalidInput(
                f"Phases begin with randomness {self.randomness:g} here, and no frame is optimized by itself. Omit "
                "the start dpac and the amplitude supervision, or choose sgd."
            )

    def _check_sizes(self, field):
        data = field.data
        for values, name in ((self.display, "display model"), (self.levels, "set of levels")):
            if values is not None and len(values) != data.shape[1]:
                raise InvalidInput(
                    f"Expected one {name} for each of the wavelengths, {data.shape[1]}, got {len(values)}."
                )
        for levels in self.levels or ():
            for name in ("correction", "variation"):
                values = getattr(levels, name, None)
                if values is not None and self.display is not None:
                    raise InvalidInput(
                        f"A display model does not support a {name} of the levels. Omit one of them."
                    )
                if values is not None and values.shape != data.shape[-2:]:
                    raise InvalidInput(
                        f"The {name} of the levels has {_pixels(values)}, the field {_pixels(data)}. Give one of its "
                        "size."
                    )
        if isinstance(self.start, PhaseHologram) and self.start.data.shape != data.shape:
            raise InvalidInput(
                f"The hologram to start with has {_size(self.start.data)}, the field {_size(data)}. Start with "
                "another."
            )
        xp = arrays.namespace(data)
        if not all(xp.all(xp.isfinite(data[frame, ...])) for frame in range(data.shape[0])):
            raise InvalidInput("The wave field has values that are not finite. Render it again.")


def _size(data):
    frames, colors = data.shape[:2]
    return f"{frames} frames and {colors} wavelengths of {_pixels(data)}"


def _pixels(data):
    rows, columns = data.shape[-2:]
    return f"{columns} x {rows} pixels"
