"""The methods of the chart, and how much work each is given."""

import importlib.util
from dataclasses import dataclass, field, replace

from holopath_addon import engine
from holopath_addon.engine.settings.choices import BASELINES

from . import peers

FRAMES = (1, 3, 8, 24)
M = 8  # frames of all figures but those that tell frames apart


@dataclass(frozen=True)
class Method:
    """A method at several efforts.

    Attributes
    ----------
    name : str
    kind : {'ours', 'paper', 'baseline', 'peer'}
    efforts : dict of str to dict
        `engine.Settings` by the effort's name, from the least; ``encode`` among them are words of `pipeline.encode`,
        and what is compared is then the light of its phases.
    usual : str
        The effort of the seconds over frames and of Table 1.
    phases : bool
        Whether what it finds are phases already.
    shown : dict of str to tuple of int
        Efforts that are phases, which an SLM shows, and of how many frames other than `M` they are measured.
    """

    name: str
    kind: str
    efforts: dict
    usual: str = "balanced"
    phases: bool = False
    shown: dict = field(default_factory=dict)

    def __post_init__(self):
        for effort in (self.usual, *self.shown):
            if effort not in self.efforts:
                raise ValueError(f"{self.name} has no effort {effort!r}: it has {', '.join(self.efforts)}.")

    def settings(self, effort, frames):
        """The `engine.Settings` of an effort."""
        own = {name: value for name, value in self.efforts[effort].items() if name != "encode"}
        method = own.get("method", self.name if self.kind != "peer" else "rgbd")
        return engine.Settings(**{"method": method, "frames": frames} | own)

    def encoding(self, effort):
        """Words of `pipeline.encode` by which an effort finds phases; None where it leaves the complex field."""
        return self.efforts[effort].get("encode")

    def missing(self):
        """Why it cannot be run, a sentence; None where it can."""
        if self.kind == "peer":
            return peers.missing(self.name)
        if self.kind == "baseline":
            module = f"holopath_addon.engine.baselines.{BASELINES[self.name][0]}"
            if importlib.util.find_spec(module) is None:
                return f"{self.name} is skipped: there is no {module}."
        return None


QUALITIES = {quality: {"quality": quality} for quality in engine.settings.choices.QUALITIES}
OTHERS = tuple(frames for frames in FRAMES if frames != M)
DESCENTS = {
    name: settings | {"fixed": {"steps": steps}}
    for (name, settings), steps in zip(QUALITIES.items(), (30, 100, 200, 600), strict=True)
}
# As good as `focal-stack` gets within a hundred seconds on two cores: noise of its pictures is what is left.
STACKS = {name: DESCENTS[name] for name in ("draft", "preview", "balanced")} | {
    "balanced, 128 paths": {"quality": "balanced", "spp": 128, "fixed": {"steps": 400}},
    "high": DESCENTS["high"],
}
SUPERVISED = {
    "rgbd-sgd": (DESCENTS, {"preview": OTHERS}),
    "focal-stack": (STACKS, {"preview": (1,), "balanced": (3, 24)}),
    "light-field": (DESCENTS, {"preview": OTHERS}),
}
TUNED = """`rgbd-sgd`, `focal-stack` and `light-field` take 30 to 600 Adam steps a color, at the rate and memory with
which they gain most. Their pictures have 4 to 256 paths a pixel and color, those of `focal-stack` also 128, for noise
of the pictures is what holds it back. With fewer than six frames `rgbd-sgd` and `focal-stack` begin as `auto` does,
with phases that are nearly constant, around a checkerboard and aimed at places of their own in the pupil. With more
they begin at random. A smooth start (`--randomness 0.3`) was tried for eight frames, 128 x 128, one color, with
the start and steps of before 29 November: `focal-
stack` gained 0.6 dB on tea and lost 0.7 on planes, and in the worst view it lost 2.5 and 3.3 dB; `rgbd-sgd` gained
0.3 and lost 0.9 dB. `light-field` stays random: with other starts it loses light through parts of the pupil. `rgbd`
is there as a complex field, as phases by `sgd` and by `joint`, which begins nearly constant with few frames, and as
double phase (*dpac*), whose best is with fewer than six frames: it does not hold the random phases of more.
"""
MORE = {
    "balanced, despeckled": {"quality": "balanced", "despeckle": 60},
    "high, despeckled": {"quality": "high", "despeckle": 200},
    "preview, encoded 1 s": {"quality": "preview", "encode": {"method": "auto", "seconds": 1.0}},
    "preview, encoded 5 s": {"quality": "preview", "encode": {"method": "auto", "seconds": 5.0}},
    "balanced, encoded 7 s": {"quality": "balanced", "encode": {"method": "auto", "seconds": 7.0}},
    "balanced, encoded 20 s": {"quality": "balanced", "encode": {"method": "auto", "seconds": 20.0}},
    "balanced, encoded": {"quality": "balanced", "encode": {"method": "auto"}},
    "high, encoded 45 s": {"quality": "high", "encode": {"method": "auto", "seconds": 45.0}},
}
MORE_SHOWN = {name: () for name, words in MORE.items() if "encode" in words} | {
    "preview, encoded 5 s": (1, 3),
    "balanced, encoded": OTHERS,
}
ENCODED = "balanced, encoded"  # phases of `auto` by the default encoding, in its own time
# Light of other methods as phases: `sgd` takes a second or so, and of few frames shows as much as other encodings.
SHOWN = "phases"
JOINT = {
    "joint phases": QUALITIES["balanced"] | {"encode": {"method": "joint"}}
}  # few frames begin nearly constant
DOUBLE_PHASE = {"dpac": QUALITIES["balanced"] | {"encode": {"method": "dpac"}}}
SHOWN_BUDGETS = (10, 100)  # seconds of phases of any number of frames
PAPER = {"estimator": "paper", "phase_field": "random", "virtual_image": "opl"}


def _rays(counts, usual, **settings):
    """Efforts by rays a pixel; and the name of the usual one."""
    return {f"{count} rays": settings | {"spp": count} for count in counts}, f"{usual} rays"


def _with_phases(efforts, usual):
    """Efforts, and the usual one's light as phases."""
    return efforts | {SHOWN: efforts[usual] | {"encode": {"method": "sgd"}}}


def methods(hologram):
    """All methods for a hologram, by name."""
    once = {SHOWN: (1,)}
    supervised = [
        Method(name, "baseline", efforts, phases=True, shown=dict.fromkeys(efforts, ()) | frames)
        for name, (efforts, frames) in SUPERVISED.items()
    ]
    others = [
        Method(name, "baseline", _with_phases(QUALITIES, "balanced"), shown=once)
        for name in BASELINES
        if name
        not in ("network", "rgbd", *SUPERVISED)  # the first takes a user's own weights, and there are none
    ]
    layers = _with_phases(QUALITIES, "balanced") | JOINT | DOUBLE_PHASE
    direct, usual_direct = _rays((64, 512, 2048), 512, **PAPER)
    paper, usual_paper = _rays((64, 256, 1024), 1024, method="full", wrp=hologram.depth_far, **PAPER)
    opl = {"balanced": {"method": "auto", "virtual_image": "opl"}}
    every = [
        Method("rgbd", "baseline", layers, shown={SHOWN: OTHERS, "joint phases": (1, 3), "dpac": OTHERS}),
        *supervised,
        *others,
        *(
            Method(name, "peer", _with_phases({"balanced": QUALITIES["balanced"]}, "balanced"), shown=once)
            for name in peers.PEERS
        ),
        Method("direct", "paper", _with_phases(direct, usual_direct), usual_direct, shown=once),
        Method("paper", "paper", _with_phases(paper, usual_paper), usual_paper, shown=once),
        Method("full", "ours", QUALITIES),
        Method("fast", "ours", QUALITIES),
        Method("auto", "ours", QUALITIES | MORE, shown=MORE_SHOWN),
        Method("auto-opl", "ours", opl),
    ]
    return {method.name: method for method in every}


def warmed(settings):
    """The same kernels with hardly any work."""
    return replace(
        settings,
        spp=1,
        despeckle=min(settings.despeckle, 1),
        fixed=settings.fixed | {"passes": 1} | ({"steps": 1} if "steps" in settings.fixed else {}),
    )
