"""Which encoding is best in the seconds that there are, and how many more frames it goes towards."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from ..encoding.encoder import LEAST_STEPS as WORTH
from ..encoding.encoder import TRACED
from ..errors import InvalidInput
from ..memory import shortage
from ..plan import Decision
from ..settings import BASELINES, ENCODINGS
from ..waves.phase_fields import SETS
from .planner import resolved

if TYPE_CHECKING:
    from ..plan import Plan
    from ..settings import Settings

SET = SETS[-1]  # frames that are traced together
MOST, LEAST = 8, 1  # sets
# Sets and steps where nothing limits the seconds: as many as gain most, and all that gain anything. And steps from
# which on phases are better than those of `joint` (docs/measurements.md, Seconds of encoding).
ENOUGH, ALL, LEAST_STEPS = (4, 100), (MOST, 400), 30
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
    """

    method: str
    frames: int
    steps: int
    seconds: float
    reason: str
    better: float | None = None
    memory_bytes: float = 0.0

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
    plan: Plan, settings: Settings, method: str = "auto", seconds: float | None = None
) -> EncodingPlan:
    """Decide how a field becomes phases.

    Parameters
    ----------
    plan : Plan
        Of the field.
    settings : Settings
        By which it was made.
    method : str
        One of `ENCODINGS`; ``auto`` is left to this.
    seconds : float, optional
        That the encoding may take, from the field on.

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
    chosen = _chosen(plan, settings, method, seconds)
    return replace(chosen, memory_bytes=plan.phases_memory.get(chosen.method, 0.0))


def _chosen(plan, settings, method, seconds):
    """`plan_encoding` without the memory."""
    costs, own = plan.phases, settings.method not in BASELINES
    if method == "refine" and not own:
        raise InvalidInput(
            f"The encoding refine needs many frames, which the method {settings.method} has not: choose joint."
        )
    several = resolved(settings).frames > 1
    enough = seconds is None or not own or _joint_least(costs) <= seconds
    plain = "joint" if several and enough else "sgd"
    if method not in ("auto", "refine"):
        return EncodingPlan(method, 0, 0, _limited(costs.get(method, 0.0), seconds), "as asked")
    if not own:
        reason = "other people's methods have no more frames to go towards"
        return EncodingPlan(plain, 0, 0, seconds or 0.0, reason)
    if not several and method == "auto":
        reason = "one frame keeps its speckle, whatever it goes towards"
        return EncodingPlan("sgd", 0, 0, _limited(costs["sgd"], seconds), reason)
    if seconds is not None:
        sets = _sets(costs, seconds)
        if sets or method == "refine":
            reason = "as asked" if method == "refine" else "the best that so many seconds allow"
            # with one traversal for all wavelengths the clock itself says when there are enough
            frames = SET * (MOST if plan.traversals == 1 else max(sets, LEAST))
            return EncodingPlan("refine", frames, 0, seconds, reason)
        least = _refining(costs, LEAST, LEAST_STEPS)
        reason = f"more frames of the same light, which show more, take {_seconds(least)} to be worth it"
        better = _upwards(_refining(costs, *ENOUGH))
        return EncodingPlan(plain, 0, 0, _limited(costs[plain], seconds), reason, better)
    most = method == "refine" or settings.method == "full"
    sets, steps = ALL if most else ENOUGH
    reason = "as asked" if method == "refine" else "towards more frames of the same light, for they show more"
    better = None if most else _upwards(_refining(costs, *ALL))
    return EncodingPlan("refine", sets * SET, steps, _refining(costs, sets, steps), reason, better)


def _joint_least(costs):
    """Seconds from which on `joint` is worth it: all views are wanted, and looked at twice."""
    return costs["sgd"] + 3 * costs["views"] + WORTH * costs["step"]


def _refining(costs, sets, steps):
    """Seconds of `refine`."""
    return costs["sgd"] + costs["light"] + sets * costs["set"] + steps * costs["step"]


def _sets(costs, seconds):
    """Sets of more frames that are worth their seconds; 0 where none are."""
    sets = MOST
    while sets >= LEAST:
        traced = costs["light"] + sets * costs["set"]
        if _refining(costs, sets, LEAST_STEPS) <= seconds and (sets == LEAST or traced <= TRACED * seconds):
            return sets
        sets //= 2
    return 0


def _limited(taken, seconds):
    return taken if seconds is None else min(taken, seconds) if taken else seconds


def _upwards(seconds):
    """Rounded up to two digits."""
    unit = 10 ** (math.floor(math.log10(seconds)) - 1)
    return unit * math.ceil(round(seconds / unit, 6))


def _seconds(seconds):
    return f"{seconds:.1f} s" if seconds < 9.95 else f"{math.ceil(seconds)} s"
