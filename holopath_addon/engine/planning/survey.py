"""What planning sees of a scene before it decides: how far rays are followed, the depths in view, and the light."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..light.path_tracer import PathTracer
from ..mapping import DepthMapping, pixels_beside, widened
from ..plan import Decided, Decision
from ..scene.specular_chains import FirstHits, SpecularChains
from . import noise
from .machine import slowness
from .pilot import Pilot, near_end
from .probe import LEAST_SHARE

if TYPE_CHECKING:
    from pathlib import Path

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..settings import Settings
    from .machine import Slowness
    from .pilot_light import Light
    from .probe import Probe

CUT_OFF = 0.01  # of the view: more that chains do not reach is told of
GLOSSY_TURN = 0.15  # of a lobe's width across the pupil: less is not seen
IMAGE_LIMITS = (-1.5, 1.5)  # of the near end's vergence: images beyond, as of caustics, are put there


@dataclass(frozen=True)
class Chains:
    """How mirrors and clear surfaces are followed.

    Attributes
    ----------
    seen : Probe
        What is seen by them.
    optics : FirstHits or SpecularChains
    virtual_image : str
        How images are placed.
    longest, splits : int
        Hits of a chain, 0 where none is followed, and those that divide it.
    pupil : float
        Radius of the pupil where there are nearly smooth mirrors, metres; else 0.
    """

    seen: Probe
    optics: FirstHits | SpecularChains
    virtual_image: str
    longest: int = 0
    splits: int = 0
    pupil: float = 0.0

    @property
    def branches(self) -> int:
        """Of rays that are followed; 0 without chains."""
        return 1 << self.splits if self.longest else 0


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What was seen of a scene, all that decisions are made from.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
    mapping : DepthMapping
    near : float
        World depth of the volume's near end, metres.
    beside : int
        Pixels beyond each edge of the picture, by which camera and hologram are `widened`.
    pilot : Pilot
        Whom to ask for more.
    hits : Decided of Chains
        Made on the way, for what is seen depends on it.
    seen : Probe
        Without gloss that looks alike from all over the pupil.
    light : Light
    z_low, z_high : float
        Depths in view, metres from the SLM.
    slowness : Slowness
        Of this machine.
    """

    scene: mi.Scene
    camera: Camera
    hologram: Hologram
    settings: Settings
    mapping: DepthMapping
    near: float
    beside: int
    pilot: Pilot
    hits: Decided[Chains]
    seen: Probe
    light: Light
    z_low: float
    z_high: float
    slowness: Slowness

    @property
    def chains(self) -> Chains:
        """How mirrors and clear surfaces are followed."""
        return self.hits.value


def look_at(
    scene: mi.Scene, camera: Camera, hologram: Hologram, settings: Settings, folder: Path | None
) -> Survey:
    """Look at a scene with a few rays and paths; `folder` keeps this machine's speed."""
    near = near_end(scene, camera, hologram, settings.seed)
    beside = settings.fixed.get("beside", pixels_beside(hologram))
    camera, hologram = widened(camera, hologram, beside)
    mapping = DepthMapping.of(hologram, camera, near)
    pilot = Pilot.of(scene, hologram, camera, mapping, settings)
    hits = specular_hits(pilot, settings)
    chains, seen = hits.value, hits.value.seen
    most = settings.max_depth
    least = most if "max_depth" in settings.fixed else 1
    light = pilot.light(PathTracer(most), chains.optics, least, most, noise.firefly(settings))
    ends = seen.vergence_range([limit / near for limit in IMAGE_LIMITS])
    if seen.turn <= GLOSSY_TURN or settings.quality == "draft":  # it looks alike from all over the pupil
        seen = replace(seen, gloss=np.empty(0))
    z_low, z_high = (mapping.z_far + mapping.beta * end for end in ends)
    return Survey(
        scene=scene,
        camera=camera,
        hologram=hologram,
        settings=settings,
        mapping=mapping,
        near=near,
        beside=beside,
        pilot=pilot,
        hits=hits,
        seen=seen,
        light=light,
        z_low=z_low,
        z_high=z_high,
        slowness=slowness(folder),
    )


def specular_hits(pilot: Pilot, settings: Settings) -> Decided[Chains]:
    """How mirrors and clear surfaces are followed."""
    first, fixed, draft = pilot.first_hits(), settings.fixed, settings.quality == "draft"
    most = fixed.get("chain", 0 if draft else settings.most_hits)
    if most and ("chain" in fixed or first.specular + first.nearly > LEAST_SHARE):
        return _followed(pilot, settings, first, most)
    chains = Chains(first, FirstHits(sky=pilot.camera.sees_sky), settings.virtual_image)
    if first.specular <= LEAST_SHARE:
        return Decided(chains)
    what = (
        f"{first.specular:.0%} of the view is mirror or clear glass: it is shown as a picture on its own "
        f"surface, not at the depth of what it reflects"
    )
    if draft and settings.most_hits:
        return Decided(chains, (Decision("specular hits", "none", f"{what}, as drafts do"),))
    return Decided(chains, warnings=(f"{what}; allow chains of mirrors to change that.",))


def _followed(pilot, settings, first, most):
    """The same where chains of so many hits are followed at most."""
    fixed, image = settings.fixed, settings.virtual_image
    pupil = pilot.pupil if first.nearly > LEAST_SHARE else 0.0
    optics_of = partial(SpecularChains, pilot.scene, image, sky=pilot.camera.sees_sky, pupil=pupil)
    seen = pilot.images(first, optics_of(most))
    longest, lost = (most, 0.0) if "chain" in fixed else pilot.longest_chain(optics_of, most)
    splits = fixed.get("splits", seen.splits)
    exact = not seen.bent and "chain" not in fixed
    reason = f"{seen.specular + seen.nearly:.1%} of the view mirrors or lets through; images by "
    reason += "optical path" if image == "opl" or exact else "curvature"
    reason += ", which is exact here" if exact and image != "opl" else ""
    reason += f"; {1 << splits} branches of each ray" if splits else ""
    saving = f"{most - longest} hits of {most}" if longest < most else ""
    decision = Decision("specular hits", f"up to {longest}", reason, saving, math.sqrt(lost))
    chains = Chains(seen, optics_of(longest, splits), "opl" if exact else image, longest, splits, pupil)
    cut_off = (
        f"{seen.cut:.0%} of the view is seen by way of more than {most} mirrors and clear surfaces and stays "
        "black: follow more of them (--most-hits, Mirrors, Glass)."
    )
    return Decided(chains, (decision,), (cut_off,) if seen.cut > CUT_OFF else ())
