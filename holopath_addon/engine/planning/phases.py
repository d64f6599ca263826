"""Which encoding is best in the seconds that there are, and how many more frames it goes towards."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from ..encoding.axis import on_axis
from ..encoding.encoder import EXTRA_FRAMES_END, FIRST_STAGE_END, NO_FRAMES_END
from ..encoding.encoder import MIN_STEPS as WORTH
from ..encoding.options import eyebox_for
from ..errors import InvalidInput
from ..memory import AT_ONCE, shortage
from ..plan import Decision
from ..settings import BASELINES, ENCODINGS
from ..waves.phase_fields import DESIGNED_STARTS, SETS, randomness_for

if TYPE_CHECKING:
    from ..hologram import Hologram
    from ..plan import Plan

# More frames and steps where nothing limits the seconds: as many as gain most, and all that gain anything.
ENOUGH, ALL = (96, 100), (192, 400)
# Steps of few frames, which begin far from their end. With 400 the whole pupil gains 0.1 to 0.4 dB more, and halves of
# it lose 1 to 2 dB.
FEW_STEPS = 200
# Where seconds do: the first frames, if none were traced along, and whole sets beside them, of which the most are
# chosen that fit. And steps from which on phases are better than those of `joint`, with frames traced along and without
# (docs/measurements.md, Seconds of encoding).
LEAST = SETS[-2]
BY_CLOCK = 7, 4, 2, 1, 0
LEAST_STEPS = 12, 20
GAINS = "up to 4 dB", "up to 2 dB"  # of `ENOUGH` over `joint`, and of `ALL` over that; the same measurement


@dataclass(frozen=True)
class EncodingPlan:
    """How phases will be found.

    Attributes
    ----------
    method : str
        Of `engine.encode`, never ``auto``.
    frames, steps : int
        More frames that it goes towards, and steps, at most; 0 where it does not, or the seconds say.
    seconds : float
        That it takes, foretold or given; 0 where nothing is foretold.
    reason : str
    better : float or None
        Seconds that would show more; None where they hardly would.
    memory_bytes : float
        That it takes at most, with the field; 0 where nothing is foretold.
    randomness : float or None
        Of the phases that the descent begins with, see `engine.encode`; None for the field's.
    eyebox : float
        Weight of parts of the pupil, see `engine.encode`.
    """

    method: str
    frames: int
    steps: int
    seconds: float
    reason: str
    better: float | None = None
    memory_bytes: float = 0.0
    randomness: float | None = None
    eyebox: float = 1.0

    @property
    def advice(self) -> str:
        """What more seconds would bring, a sentence; empty where that is hardly anything."""
        if self.better is None:
            return ""
        gain = GAINS[self.method == "refine"]
        return f"{_seconds(self.better)} of encoding would gain {gain}, as on the scenes measured."

    @property
    def warnings(self) -> list[str]:
        """What to know before it begins; see `memory.shortage`, which may raise."""
        return shortage(self.memory_bytes, "This encoding")

    @property
    def decision(self) -> Decision:
        """In words."""
        most = "" if self.steps else "up to "
        frames = f" towards {most}{self.frames} more frames" if self.frames else ""
        seconds = f", about {_seconds(self.seconds)}" if self.seconds else ""
        memory = f", {self.memory_bytes / 1e6:.0f} MB" if self.memory_bytes else ""
        return Decision("encoding", f"{self.method}{frames}{seconds}{memory}", self.reason)

    def to_dict(self) -> dict:
        """JSON-able form."""
        return {**asdict(self), "advice": self.advice}


def plan_encoding(
    plan: Plan,
    method: str = "auto",
    seconds: float | None = None,
    along: int = 0,
    eyebox: float | None = None,
) -> EncodingPlan:
    """Decide how a field becomes phases.

    Parameters
    ----------
    plan : Plan
        Of the field.
    method : str
        One of `ENCODINGS`; ``auto`` is left to this.
    seconds : float, optional
        That the encoding may take, from the field on.
    along : int
        More frames that the render traces with its own, see `frames_along`.
    eyebox : float, optional
        See `engine.encode`. Default: `eyebox_for` the frames.

    Returns
    -------
    EncodingPlan

    Raises
    ------
    InvalidInput
        If there is no such encoding, or none of such a field.
    """
    if method not in ENCODINGS:
        raise InvalidInput(f"There is no encoding '{method}': choose one of {', '.join(ENCODINGS)}.")
    chosen = _chosen(plan, method, seconds, along)
    memory, frames = plan.phases_memory.get(chosen.method, 0.0), plan.settings.frames
    eyebox = eyebox_for(frames) if eyebox is None else eyebox
    chosen, randomness = replace(chosen, memory_bytes=memory, eyebox=eyebox), _randomness(plan, eyebox)
    if chosen.method != "refine" or randomness is None:
        return chosen
    reason = f"{chosen.reason}; {_few(frames, randomness, chosen.eyebox)}"
    return replace(chosen, randomness=randomness, reason=reason)


def axis_decision(method: str, bits: int | None, hologram: Hologram) -> Decision | None:
    """Whether phases are on axis, where it was not said and makes a difference, and what that costs.

    Parameters
    ----------
    method : str
        Of an `EncodingPlan`.
    bits : int or None
        Of the panel; None for any phase.
    hologram : Hologram
    """
    reason = on_axis(method, bits, hologram)
    return Decision("axis", "on axis", reason) if reason else None


def frames_along(plan: Plan, hologram: Hologram, method: str, seconds: float | None = None) -> int:
    """More frames that a render had best trace with its own, for the encoding that follows: paths serve them all.

    Parameters
    ----------
    plan, method, seconds
        See `plan_encoding`; a method is also ``none``.
    hologram : Hologram

    Returns
    -------
    int
        Where phases will be found towards many frames, and they take little memory: all of them for a hologram of few
        frames, whose rays are few beside theirs, else a set. Otherwise 0.
    """
    own = plan.settings
    # what draws its random numbers by the chunks that fit, would be another field with more frames
    same = own.radiance == "grain" and own.estimator == "lattice"
    fits = _fit(SETS[-1], hologram) and same and not own.despeckle and own.phase_field != "random"
    if not fits or method not in ("auto", "refine") or own.method in BASELINES:
        return 0
    chosen = plan_encoding(plan, method, seconds, SETS[-1])
    if chosen.method != "refine":
        return 0
    return first_of(chosen.frames, plan, hologram) if seconds is None else SETS[-1]


def first_of(count: int, plan: Plan, hologram: Hologram) -> int:
    """How many of more frames a render traces with its own where no seconds are given.

    Parameters
    ----------
    count : int
        All of these frames.
    plan : Plan
        Of the render.
    hologram : Hologram

    Returns
    -------
    int
    """
    return count if _randomness(plan) is not None and _fit(count, hologram) else SETS[-1]


def _fit(frames, hologram):
    """Whether so many take little memory."""
    return frames * 8 * hologram.width * hologram.height * len(hologram.wavelengths) <= AT_ONCE


def _chosen(plan, method, seconds, along):
    """`plan_encoding` without the memory."""
    settings = plan.settings
    own, frames = settings.method not in BASELINES, settings.frames
    if method == "refine" and not own:
        raise InvalidInput(
            f"The encoding refine needs many frames, which the method {settings.method} has not: choose joint."
        )
    costs, several = _Costs(plan.phases, frames, along), frames > 1
    enough = seconds is None or not own or costs.joint <= seconds
    plain = "joint" if several and enough else "sgd"
    if method not in ("auto", "refine"):
        return EncodingPlan(method, 0, 0, _limited(plan.phases.get(method, 0.0), seconds), "as asked")
    if not own:
        reason = "other people's methods have no more frames to go towards"
        return EncodingPlan(plain, 0, 0, seconds or 0.0, reason)
    if not several and method == "auto" and _randomness(plan) is None:
        reason = "one frame keeps its speckle, whatever it goes towards"
        return EncodingPlan("sgd", 0, 0, _limited(plan.phases["sgd"], seconds), reason)
    if seconds is not None:
        frames = costs.within(seconds)
        if frames or method == "refine":
            reason = "as asked" if method == "refine" else "the best that so many seconds allow"
            frames = frames or costs.least
            if plan.traversals == 1 and frames > along:
                # with one traversal for all wavelengths the clock itself says when there are enough
                frames = costs.least + BY_CLOCK[0] * SETS[-1]
            return EncodingPlan("refine", frames, 0, seconds, reason)
        least = costs.worth()
        reason = f"more frames of the same light, which show more, take {_seconds(least)} to be worth it"
        better = _upwards(costs.better(*ENOUGH))
        return EncodingPlan(plain, 0, 0, _limited(plan.phases[plain], seconds), reason, better)
    most = method == "refine" or settings.method == "full"
    few = _randomness(plan) is not None
    more, steps = ALL if most else (ENOUGH[0], FEW_STEPS if frames < DESIGNED_STARTS else ENOUGH[1])
    frames = max(more, along)
    reason = "as asked" if method == "refine" else "towards more frames of the same light, for they show more"
    better = None if most or few else _upwards(costs.better(*ALL))
    return EncodingPlan("refine", frames, steps, costs.refine(frames, steps), reason, better)


def _randomness(plan, eyebox=0.0):
    """Of the phases that a descent begins with; None for those of the field."""
    settings = plan.requested
    if settings.randomness is not None:
        return settings.randomness
    if settings.phase_field not in ("auto", "smooth"):
        return None
    return randomness_for(plan.settings.frames, eyebox)


def _few(frames, randomness, eyebox):
    """What few frames show, in words."""
    frames = "one frame averages" if frames == 1 else f"{frames} frames average"
    looked = f"and {eyebox:.2g} of its parts" if eyebox else "as a whole"
    return (
        f"{frames} little speckle, so that phases begin with randomness {randomness:g} and the pupil counts "
        f"{looked}"
    )


@dataclass(frozen=True)
class _Costs:
    """Seconds of encodings, see `costs.phases`.

    Attributes
    ----------
    each : dict of str to float
    own : int
        Frames of the hologram.
    along : int
        More that the render traces with these.
    """

    each: dict[str, float]
    own: int
    along: int

    @property
    def least(self) -> int:
        """More frames that `refine` begins with."""
        return self.along or LEAST

    @property
    def joint(self) -> float:
        """From which on `joint` is worth it."""
        return self._enough(0, WORTH)

    def frames(self, count: int) -> float:
        """Of more frames; paths are found again for those that were not traced along."""
        rest = max(0, count - self.along)
        again = self.each["light"] + math.ceil(rest / SETS[-1]) * self.each["rays"] if rest > 0 else 0.0
        return again + rest * self.each["frame"] + count * self.each["look"]

    def refine(self, frames: int, steps: int) -> float:
        """To its end, with what the render takes longer for frames along: one set shares the rays of its own."""
        rays = max(0, math.ceil(self.along / SETS[-1]) - 1) * self.each["rays"]
        return self.each["sgd"] + self.along * self.each["frame"] + rays + self._together(frames, steps)

    def better(self, frames: int, steps: int) -> float:
        """From which on there are about so many frames, as whole sets, and steps in them."""
        return self._enough(self.least + min(frames // SETS[-1], BY_CLOCK[0]) * SETS[-1], steps)

    def worth(self) -> float:
        """From which on `refine` is."""
        return self._enough(self.least, self._least_steps)

    def within(self, seconds: float) -> int:
        """More frames that are worth their seconds; 0 where none are."""
        for count in (self.least + sets * SETS[-1] for sets in BY_CLOCK):
            if self._enough(count, self._least_steps) <= seconds:
                return count
        return 0

    @property
    def _least_steps(self):
        return LEAST_STEPS[not self.along]

    def _together(self, frames, steps):
        """Of all frames together. Views are of their own frames, too, and are looked at at both ends."""
        looks = 3 * self.own * self.each["look"]
        return looks + (self.frames(frames) if frames else 0.0) + steps * self.each["step"]

    def _enough(self, frames, steps):
        """Seconds given in which there is time for so many, and frames are there before the clock ends them."""
        enough = self._within_share(1, self._together(frames, steps))
        if frames > self.along:
            traced = self._within_share(
                NO_FRAMES_END if frames == self.least else EXTRA_FRAMES_END, self.frames(frames)
            )
            enough = max(enough, traced)
        return enough

    def _within_share(self, share, rest):
        """Seconds of which a share is enough for `sgd` and the rest; where they are few, `sgd` has a part of them."""
        return min((self.each["sgd"] + rest) / share, rest / (share - FIRST_STAGE_END))


def _limited(taken, seconds):
    return taken if seconds is None else min(taken, seconds) if taken else seconds


def _upwards(seconds):
    """Rounded up to two digits."""
    unit = 10 ** (math.floor(math.log10(seconds)) - 1)
    return unit * math.ceil(round(seconds / unit, 6))


def _seconds(seconds):
    return f"{seconds:.1f} s" if seconds < 9.95 else f"{math.ceil(seconds)} s"
