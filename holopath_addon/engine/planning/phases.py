"""Choice of the encoding for the seconds available, and of the extra frames whose mean it approximates."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from ..encoding.axis import on_axis
from ..encoding.encoder import EXTRA_FRAMES_END, FIRST_STAGE_END, NO_FRAMES_END
from ..encoding.encoder import MIN_STEPS as WORTH
from ..encoding.options import MAX_STEPS, eyebox_for, step_limit
from ..encoding.views import step_transforms, transforms
from ..errors import InvalidInput
from ..memory import AT_ONCE, shortage
from ..plan import Decision
from ..settings.choices import BASELINES, ENCODINGS
from ..waves.phase_fields import BEST_RANDOMNESS, DESIGNED_STARTS, SETS, randomness_for

if TYPE_CHECKING:
    from ..hologram import Hologram
    from ..plan import Plan

# Extra frames and steps of `refine` without a time limit: those that gain most, and all that gain anything.
DEFAULT_EFFORT, FULL_EFFORT = (96, 100), (192, 400)
# Steps of the default for few frames that have no `step_limit`: up to two, whose halves of the pupil are dark anyway,
# and with a larger eyebox than the default, whose phases begin random (docs/measurements.md, Few frames).
FEW_FRAMES_STEPS = 200
# With a time limit: the first extra frames, unless some were co-traced, and then whole sets, as many as fit.
MIN_EXTRA_FRAMES = SETS[-2]
EXTRA_SETS = 7, 4, 2, 1, 0  # in the order tried
# Steps from which `refine` beats `joint`, with co-traced frames and without (docs/measurements.md, Seconds of encoding)
MIN_STEPS = 12, 20
# Extra frames and steps that show nearly as much as `DEFAULT_EFFORT` (0.2 dB less), where extra frames take long
FEWER_FRAMES_EFFORT = SETS[-1], 200
# In less time than these take, fewer frames than the first number begin with nearly constant phases, as few frames do,
# and go towards the whole pupil alone; the steps that this takes at least, and at most, for more take light away from
# parts of the pupil (docs/measurements.md, Seconds of encoding). With 24 frames these lose more than the whole gains.
SHORT_DESCENT_FRAMES, MIN_SHORT_DESCENT_STEPS, MAX_SHORT_DESCENT_STEPS = 16, 8, 70
# Gains of `DEFAULT_EFFORT` over `joint`, of `FULL_EFFORT` over that, of parts of the pupil over all steps that pay off
# without them (the same measurement); of few frames at five foci, of `DEFAULT_EFFORT` over fewer steps and over `joint`
# (Few frames)
JOINT_GAIN, FULL_GAIN, STEPS_GAIN, FEW_FRAMES_GAIN = (f"up to {gain} dB" for gain in (4, 2, 5, 10))
PARTS_GAIN = "up to 2 dB and light all over the pupil"


@dataclass(frozen=True)
class EncodingPlan:
    """Plan of an encoding.

    Attributes
    ----------
    method : str
        A method of `engine.encode` other than ``auto``.
    frames : int
        Maximum extra frames whose mean the phases approximate; 0 for none.
    steps : int
        Maximum steps; 0 where only `seconds` limit them, or for the method's own.
    seconds : float
        Estimated seconds, or the time limit; 0 without either.
    reason : str
        Reason for the method.
    better : float or None
        Time limit in seconds that would show more; None where it hardly would.
    gain : str
        Gain by that, in words.
    memory_bytes : float
        Estimated peak with the field; 0 without an estimate.
    randomness : float or None
        Randomness of the phases that the descent begins with, see `engine.encode`; None for the field's phases.
    eyebox : float
        Weight of parts of the pupil, see `engine.encode`.
    has_limit : bool
        Whether a time limit can end extra frames and steps.
    """

    method: str
    frames: int
    steps: int
    seconds: float
    reason: str
    better: float | None = None
    gain: str = JOINT_GAIN
    memory_bytes: float = 0.0
    randomness: float | None = None
    eyebox: float = 1.0
    has_limit: bool = False

    @property
    def advice(self) -> str:
        """Sentence on the gain of more seconds; empty where that is hardly anything."""
        if self.better is None:
            return ""
        return f"{_seconds(self.better)} of encoding would gain {self.gain} on scenes like those measured."

    def memory_warnings(self) -> list[str]:
        """Warn where the encoding fills memory; raise `InvalidInput` where the machine has too little."""
        return shortage(self.memory_bytes, "This encoding")

    @property
    def decision(self) -> Decision:
        """Method, extra frames, seconds and memory in words, with the reason."""
        up_to = "up to " if self.has_limit else ""
        frames = f" towards {up_to}{self.frames} extra frames" if self.frames else ""
        seconds = f", about {_seconds(self.seconds)}" if self.seconds else ""
        memory = f", {self.memory_bytes / 1e6:.0f} MB" if self.memory_bytes else ""
        return Decision("encoding", f"{self.method}{frames}{seconds}{memory}", self.reason)

    def to_dict(self) -> dict:
        """Attributes and advice in types that JSON has."""
        return {**asdict(self), "advice": self.advice}


def plan_encoding(
    plan: Plan,
    method: str = "auto",
    seconds: float | None = None,
    co_traced: int = 0,
    eyebox: float | None = None,
) -> EncodingPlan:
    """Decide how a field becomes phases.

    Parameters
    ----------
    plan : Plan
        Plan of the field.
    method : str
        One of `ENCODINGS`; ``auto`` leaves the choice to this function.
    seconds : float, optional
        Time limit of the encoding, once the field is there. Default: none.
    co_traced : int
        Extra frames that the render co-traces, see `extra_frame_count`.
    eyebox : float, optional
        Weight of parts of the pupil, see `engine.encode`. Default: `eyebox_for` the frames.

    Returns
    -------
    EncodingPlan

    Raises
    ------
    InvalidInput
        If the encoding is unknown, or does not exist for such a field.
    """
    if method not in ENCODINGS:
        raise InvalidInput(f"There is no encoding '{method}'. Choose one of {', '.join(ENCODINGS)}.")
    frames = plan.settings.frames
    choice = _short_descent(plan, method, seconds, co_traced) if eyebox is None else None
    if choice is not None:
        return replace(choice, memory_bytes=plan.phases_memory.get("refine", 0.0))
    eyebox = eyebox_for(frames) if eyebox is None else eyebox
    randomness = _randomness(plan, eyebox)
    choice = _choose(plan, method, seconds, co_traced, eyebox, randomness)
    choice = replace(choice, memory_bytes=plan.phases_memory.get(choice.method, 0.0), eyebox=eyebox)
    falls_back = choice.method == "joint" != method and plan.settings.method not in BASELINES
    begins_so = choice.method == "refine" or (falls_back and _begins_smooth(randomness))
    if not begins_so or randomness is None:
        return choice
    if plan.requested.randomness is not None and frames >= DESIGNED_STARTS:
        start = f"phases begin with randomness {randomness:g}, as asked"
    else:
        start = _start_reason(frames, randomness, eyebox)
    reason = f"{choice.reason}; {start}"
    return replace(choice, randomness=randomness, reason=reason)


def axis_decision(method: str, bits: int | None, hologram: Hologram) -> Decision | None:
    """Report that phases are on axis, and the difference to off axis, where nobody chose and there is one.

    Parameters
    ----------
    method : str
        Method of an `EncodingPlan`.
    bits : int or None
        Bits of the panel; None for continuous phase.
    hologram : Hologram

    Returns
    -------
    Decision or None
    """
    reason = on_axis(method, bits, hologram)
    return Decision("axis", "on axis", reason) if reason else None


def extra_frame_count(
    plan: Plan, hologram: Hologram, method: str, seconds: float | None = None, eyebox: float | None = None
) -> int:
    """Number of extra frames to co-trace with a render for its encoding, as they share its paths.

    Parameters
    ----------
    plan, method, seconds, eyebox
        See `plan_encoding`; the method may also be ``none``.
    hologram : Hologram

    Returns
    -------
    int
        0 where the encoding needs none, or they need too much memory. All extra frames for a hologram of few frames,
        whose own rays are few; else, and with any time limit, one set.
    """
    settings = plan.settings
    # the rays of others depend on the number of frames, by random numbers that go by chunks
    same_field = settings.radiance == "grain" and settings.estimator == "lattice"
    same_field &= not settings.despeckle and settings.phase_field != "random"
    if not (same_field and _fit(SETS[-1], hologram)):
        return 0
    if method not in ("auto", "refine") or settings.method in BASELINES:
        return 0
    choice = plan_encoding(plan, method, seconds, SETS[-1], eyebox)
    if choice.method != "refine":
        return 0
    return co_traced_of(choice.frames, plan, hologram) if seconds is None else SETS[-1]


def co_traced_of(count: int, plan: Plan, hologram: Hologram) -> int:
    """Number of extra frames that a render co-traces without a time limit.

    Parameters
    ----------
    count : int
        All extra frames.
    plan : Plan
        Plan of the render.
    hologram : Hologram

    Returns
    -------
    int
    """
    is_smooth = _randomness(plan, eyebox_for(plan.settings.frames)) is not None
    return count if is_smooth and _fit(count, hologram) else SETS[-1]


def _fit(frames, hologram):
    """Whether fields of some frames need little memory."""
    return frames * 8 * hologram.width * hologram.height * len(hologram.wavelengths) <= AT_ONCE


def _short_descent(plan, method, seconds, co_traced):
    """`EncodingPlan` without memory for fewer seconds than the default takes; None where it fits, or nearly nothing."""
    settings, requested = plan.settings, plan.requested
    if seconds is None or method not in ("auto", "refine") or settings.method in BASELINES:
        return None
    if requested.randomness is not None or requested.phase_field != "auto":
        return None
    if not DESIGNED_STARTS <= settings.frames < SHORT_DESCENT_FRAMES:
        return None
    costs = _EncodingCosts(plan.phases, settings.frames, co_traced)
    short, enough = costs.of_whole_pupil().without_single_frames(True), costs.default_limit_seconds
    if enough <= seconds or short.limit_seconds(short.first_frames, MIN_SHORT_DESCENT_STEPS) > seconds:
        return None
    request = "as asked; " if method == "refine" else ""
    reason = f"{request}so few seconds show most with nearly constant phases at the start, and the pupil as a whole"
    choice = EncodingPlan(
        "refine", short.first_frames, MAX_SHORT_DESCENT_STEPS, seconds, reason, _rounded_up(enough), STEPS_GAIN,
        randomness=randomness_for(settings.frames, eyebox=0.0), eyebox=0.0, has_limit=True,
    )  # fmt: skip
    frames = max(SETS[-1], co_traced)
    if short.limit_seconds(frames, choice.steps) > seconds:
        return choice
    reason += f"; more than {choice.steps} such steps would show less"
    seconds = min(seconds, short.refine_seconds(frames, choice.steps))
    return replace(choice, frames=frames, seconds=seconds, reason=reason, gain=PARTS_GAIN)


def _choose(plan, method, seconds, co_traced, eyebox, randomness):
    """`EncodingPlan` for an eyebox and a randomness of the start, without these and without memory."""
    settings = plan.settings
    if method not in ("auto", "refine"):
        return EncodingPlan(method, 0, 0, _limited(plan.phases.get(method, 0.0), seconds), "as asked")
    if settings.method in BASELINES:
        if method == "refine":
            raise InvalidInput(
                f"The encoding refine needs extra frames, which the method {settings.method} does not have. Choose "
                "joint."
            )
        reason = "other people's methods have no extra frames to go towards"
        return EncodingPlan("joint" if settings.frames > 1 else "sgd", 0, 0, seconds or 0.0, reason)
    if method == "auto" and settings.frames == 1 and randomness is None:
        reason = "one frame keeps its speckle, whatever it goes towards"
        return EncodingPlan("sgd", 0, 0, _limited(plan.phases["sgd"], seconds), reason)
    costs = _EncodingCosts(plan.phases, settings.frames, co_traced)
    if settings.frames >= DESIGNED_STARTS and not eyebox:
        costs = costs.of_whole_pupil()
    if randomness is not None:
        costs = costs.without_single_frames(_begins_smooth(randomness))
    if seconds is None:
        return _choose_unlimited(plan, method, costs, eyebox, randomness)
    return _choose_within(plan, method, seconds, costs, eyebox)


def _choose_within(plan, method, seconds, costs, eyebox):
    """Choose by a time limit: `refine` with as many extra frames as fit, or what is left without them."""
    frames = costs.frames_within(seconds)
    if frames or method == "refine":
        reason = "as asked" if method == "refine" else "the best that so many seconds allow"
        frames = frames or costs.first_frames
        if plan.traversals == 1 and frames > costs.co_traced:
            # with one traversal for all wavelengths frames are added until the time is over
            frames = costs.first_frames + EXTRA_SETS[0] * SETS[-1]
        enough = costs.default_limit_seconds
        if seconds < enough:
            better = _rounded_up(enough)
            return EncodingPlan("refine", frames, 0, seconds, reason, better, STEPS_GAIN, has_limit=True)
        limit = step_limit(costs.frames, eyebox)
        if limit < MAX_STEPS:
            reason += f"; more than {limit} steps would show less"
            seconds = min(seconds, costs.refine_seconds(frames, limit))
        return EncodingPlan("refine", frames, 0, seconds, reason, has_limit=True)
    joins = costs.frames > 1 or costs.smooth_start
    method = "joint" if joins and costs.joint_limit_seconds <= seconds else "sgd"
    needed = _seconds(costs.refine_limit_seconds)
    reason = f"extra frames of the same light, which show more, take {needed} to be worth it"
    better = _rounded_up(costs.effort_limit_seconds(*DEFAULT_EFFORT))
    gain = FEW_FRAMES_GAIN if costs.smooth_start and costs.frames < DESIGNED_STARTS else JOINT_GAIN
    return EncodingPlan(method, 0, 0, _limited(plan.phases[method], seconds), reason, better, gain)


def _choose_unlimited(plan, method, costs, eyebox, randomness):
    """Choose without a time limit: `refine`, the same on all machines."""
    full = method == "refine" or plan.settings.method == "full"
    extra_frames, steps = FULL_EFFORT if full else DEFAULT_EFFORT
    limit = step_limit(costs.frames, eyebox)
    if not full and costs.frames < DESIGNED_STARTS and limit == MAX_STEPS:
        steps = FEW_FRAMES_STEPS
    steps = min(steps, limit)
    extra_frames = max(extra_frames, costs.co_traced)
    reason = (
        "as asked" if method == "refine" else "towards extra frames of the same light, for they show more"
    )
    enough = full or randomness is not None
    better = None if enough else _rounded_up(costs.effort_limit_seconds(*FULL_EFFORT))
    seconds = costs.refine_seconds(extra_frames, steps)
    return EncodingPlan("refine", extra_frames, steps, seconds, reason, better, FULL_GAIN)


def _randomness(plan, eyebox):
    """Randomness of the phases that a descent begins with; None for the field's phases."""
    settings = plan.requested
    if settings.randomness is not None:
        return settings.randomness
    if settings.phase_field not in ("auto", "smooth"):
        return None
    return randomness_for(plan.settings.frames, eyebox)


def _begins_smooth(randomness):
    """Whether phases of a randomness are nearly constant, as few steps need them."""
    return randomness is not None and randomness <= max(BEST_RANDOMNESS)


def _start_reason(frames, randomness, eyebox):
    """Reason for the randomness of the start, in words."""
    if frames >= DESIGNED_STARTS and not eyebox:
        return f"for the pupil as a whole phases that begin with randomness {randomness:g} show least grain"
    average = "one frame averages" if frames == 1 else f"{frames} frames average"
    pupil = f"counts in parts, too, with a weight of {eyebox:.2g}" if eyebox else "counts as a whole"
    return f"{average} little speckle, so that phases begin with randomness {randomness:g}; the pupil {pupil}"


@dataclass(frozen=True)
class _EncodingCosts:
    """Seconds of encodings, and the time limits that suffice for them.

    Attributes
    ----------
    seconds : dict of str to float
        `CostModel.encoding_seconds`.
    frames : int
        Frames of the hologram.
    co_traced : int
        Extra frames that the render co-traces.
    smooth_start : bool
        Whether descents begin with nearly constant phases, and show a picture after few steps.
    """

    seconds: dict[str, float]
    frames: int
    co_traced: int
    smooth_start: bool = False

    @property
    def first_frames(self) -> int:
        """Extra frames that `refine` begins with."""
        return self.co_traced or MIN_EXTRA_FRAMES

    @property
    def joint_limit_seconds(self) -> float:
        """Minimum time limit at which `joint` pays off."""
        return self.limit_seconds(0, WORTH)

    @property
    def refine_limit_seconds(self) -> float:
        """Minimum time limit at which `refine` pays off."""
        return self.limit_seconds(self.first_frames, self._min_steps(self.first_frames))

    @property
    def default_limit_seconds(self) -> float:
        """Minimum time limit that shows about as much as no limit does."""
        limit = self.effort_limit_seconds(*DEFAULT_EFFORT)
        if self.frames < DESIGNED_STARTS:  # more steps would show less
            return limit
        return min(limit, self.limit_seconds(*FEWER_FRAMES_EFFORT))

    def effort_limit_seconds(self, frames: int, steps: int) -> float:
        """Time limit for about so many extra frames, in whole sets, and steps."""
        sets = min(frames // SETS[-1], EXTRA_SETS[0])
        return self.limit_seconds(self.first_frames + sets * SETS[-1], steps)

    def frames_within(self, seconds: float) -> int:
        """Maximum extra frames that pay off within a time limit; 0 for none."""
        for count in (self.first_frames + sets * SETS[-1] for sets in EXTRA_SETS):
            if self.limit_seconds(count, self._min_steps(count)) <= seconds:
                return count
        return 0

    def of_whole_pupil(self) -> _EncodingCosts:
        """Costs without parts of the pupil."""
        looks = transforms(self.frames, 0.0) / transforms(self.frames, 1.0)
        steps = step_transforms(0.0) / step_transforms(1.0)
        changed = {"look": looks * self.seconds["look"], "step": steps * self.seconds["step"]}
        return replace(self, seconds=self.seconds | changed)

    def without_single_frames(self, smooth_start: bool) -> _EncodingCosts:
        """Costs of descents that begin with phases of a randomness, instead of frames by themselves."""
        return replace(self, seconds=self.seconds | {"sgd": 0.0}, smooth_start=smooth_start)

    def extra_frames_seconds(self, count: int) -> float:
        """Seconds of `count` extra frames; those that were not co-traced need paths and rays of their own."""
        rest = max(0, count - self.co_traced)
        again = 0.0
        if rest > 0:
            again = self.seconds["light"] + math.ceil(rest / SETS[-1]) * self.seconds["rays"]
        return again + rest * self.seconds["frame"] + count * self.seconds["look"]

    def refine_seconds(self, frames: int, steps: int) -> float:
        """Seconds of `refine`, with those that co-traced frames add to the render; one set shares its rays."""
        rays = max(0, math.ceil(self.co_traced / SETS[-1]) - 1) * self.seconds["rays"]
        single = self.seconds["sgd"] + self.co_traced * self.seconds["frame"] + rays
        return single + self._joint_seconds(frames, steps)

    def _min_steps(self, count):
        """Steps that pay off towards `count` extra frames; the first ones of a smooth start need fewer."""
        is_first = self.smooth_start and count == self.first_frames
        return MIN_SHORT_DESCENT_STEPS if is_first else MIN_STEPS[not self.co_traced]

    def _joint_seconds(self, frames, steps):
        """Seconds of all frames together, towards extra frames and views of their own, evaluated twice."""
        looks = 3 * self.frames * self.seconds["look"]
        return looks + (self.extra_frames_seconds(frames) if frames else 0.0) + steps * self.seconds["step"]

    def limit_seconds(self, frames: int, steps: int) -> float:
        """Minimum time limit for extra frames and steps, in which the frames are there before their deadline."""
        limit = self._limit_for(1, self._joint_seconds(frames, steps))
        if frames > self.co_traced:
            deadline = NO_FRAMES_END if frames == self.first_frames else EXTRA_FRAMES_END
            limit = max(limit, self._limit_for(deadline, self.extra_frames_seconds(frames)))
        return limit

    def _limit_for(self, fraction, rest):
        """Time limit of which a fraction suffices for `sgd` and the rest; `sgd` has at most `FIRST_STAGE_END` of it."""
        return min((self.seconds["sgd"] + rest) / fraction, rest / (fraction - FIRST_STAGE_END))


def _limited(estimate, limit):
    """Estimate, within a time limit if there is one."""
    if limit is None:
        return estimate
    return min(estimate, limit) if estimate else limit


def _rounded_up(seconds):
    """Seconds rounded up to two digits."""
    unit = 10 ** (math.floor(math.log10(seconds)) - 1)
    return unit * math.ceil(round(seconds / unit, 6))


def _seconds(seconds):
    return f"{seconds:.1f} s" if seconds < 9.95 else f"{math.ceil(seconds)} s"
