"""Survey of a scene before planning decides: chains of mirrors and clear surfaces, depths in view, and light."""

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
from .probe import MIN_VIEW_FRACTION

if TYPE_CHECKING:
    from pathlib import Path

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..progress import PartProgress
    from ..settings import Settings
    from .machine import Slowness
    from .pilot_light import Light
    from .probe import Probe

MAX_CUT_FRACTION = 0.01  # of the view; the plan warns where chains do not reach more than that
MIN_GLOSSY_TURN = 0.15  # turn of the view across the pupil that is visible, in widths of a lobe
IMAGE_LIMITS = (-1.5, 1.5)  # over the near end's vergence; images beyond, as of caustics, are moved there


@dataclass(frozen=True)
class Chains:
    """Chains of hits over mirrors and clear surfaces.

    Attributes
    ----------
    probe : Probe
        With what chains show.
    image_finder : FirstHits or SpecularChains
    virtual_image : str
        Placement of images, of `Settings.virtual_image`.
    longest, splits : int
        Hits of a chain, 0 where none is followed, and hits that divide it.
    pupil : float
        Radius of the pupil where there are nearly smooth mirrors, meters; else 0.
    """

    probe: Probe
    image_finder: FirstHits | SpecularChains
    virtual_image: str
    longest: int = 0
    splits: int = 0
    pupil: float = 0.0

    @property
    def branches(self) -> int:
        """Number of branches of each ray; 0 without chains."""
        return 1 << self.splits if self.longest else 0


@dataclass(frozen=True, kw_only=True)
class Survey:
    """Everything about a scene that decisions are made from.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
    mapping : DepthMapping
    near : float
        World depth of the volume's near end, meters.
    beside : int
        Pixels beyond each edge of the picture, by which camera and hologram are `widened`.
    pilot : Pilot
        For further measurements.
    chain_decision : Decided of Chains
        Made during the survey, as the depths in view depend on it.
    probe : Probe
        That of the chains, without gloss that looks alike from all over the pupil.
    light : Light
    z_low, z_high : float
        Depths in view, meters from the SLM.
    slowness : Slowness
        Slowness of this machine.
    """

    scene: mi.Scene
    camera: Camera
    hologram: Hologram
    settings: Settings
    mapping: DepthMapping
    near: float
    beside: int
    pilot: Pilot
    chain_decision: Decided[Chains]
    probe: Probe
    light: Light
    z_low: float
    z_high: float
    slowness: Slowness

    @property
    def chains(self) -> Chains:
        """Chains that were chosen."""
        return self.chain_decision.value


def survey_scene(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    settings: Settings,
    folder: Path | None,
    progress: PartProgress,
) -> Survey:
    """Survey a scene with a few rays and paths.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
        Resolved, see `planner.resolved`.
    folder : path or None
        Where this machine's speed is kept.
    progress : callable
        ``progress(done)``, may raise `Cancelled`.

    Returns
    -------
    Survey
    """
    near = near_end(scene, camera, hologram, settings.seed)
    progress(0.2)
    beside = settings.fixed.get("beside", pixels_beside(hologram, camera, near))
    camera, hologram = widened(camera, hologram, beside)
    mapping = DepthMapping.of(hologram, camera, near)
    pilot = Pilot.of(scene, hologram, camera, mapping, settings)
    chain_decision = decide_chains(pilot, settings)
    progress(0.4)
    image_finder, probe = chain_decision.value.image_finder, chain_decision.value.probe
    max_depth = settings.max_depth
    min_depth = max_depth if "max_depth" in settings.fixed else 1
    firefly_limit = noise.firefly_limit(settings)
    light = pilot.light(PathTracer(max_depth), image_finder, min_depth, max_depth, firefly_limit)
    ends = probe.vergence_range([limit / near for limit in IMAGE_LIMITS])
    if probe.turn <= MIN_GLOSSY_TURN or settings.quality == "draft":  # it looks alike from all over the pupil
        probe = replace(probe, gloss=np.empty(0))
    z_low, z_high = (mapping.z_far + mapping.beta * end for end in ends)
    progress(0.6)
    return Survey(
        scene=scene,
        camera=camera,
        hologram=hologram,
        settings=settings,
        mapping=mapping,
        near=near,
        beside=beside,
        pilot=pilot,
        chain_decision=chain_decision,
        probe=probe,
        light=light,
        z_low=z_low,
        z_high=z_high,
        slowness=slowness(folder),
    )


def decide_chains(pilot: Pilot, settings: Settings) -> Decided[Chains]:
    """Decide how far chains of mirrors and clear surfaces are followed: not at all where hardly any are in view."""
    first, fixed, draft = pilot.first_hits(), settings.fixed, settings.quality == "draft"
    max_hits = fixed.get("chain", 0 if draft else settings.max_specular_depth)
    if max_hits and ("chain" in fixed or first.specular + first.nearly_specular > MIN_VIEW_FRACTION):
        return _longest_chains(pilot, settings, first, max_hits)
    chains = Chains(first, FirstHits(sky=pilot.camera.sees_sky), settings.virtual_image)
    if first.specular <= MIN_VIEW_FRACTION:
        return Decided(chains)
    consequence = (
        f"{first.specular:.0%} of the view is mirror or clear glass: it is shown as a picture on its own "
        f"surface, not at the depth of what it reflects"
    )
    if draft and settings.max_specular_depth:
        return Decided(chains, (Decision("specular hits", "none", f"{consequence}, as drafts do"),))
    return Decided(chains, warnings=(f"{consequence}; allow chains of mirrors to change that.",))


def _longest_chains(pilot, settings, first, max_hits):
    """Decide on the length, the branches and the images of chains with at most `max_hits` hits."""
    fixed, image = settings.fixed, settings.virtual_image
    pupil = pilot.pupil if first.nearly_specular > MIN_VIEW_FRACTION else 0.0
    chains_up_to = partial(SpecularChains, pilot.scene, image, sky=pilot.camera.sees_sky, pupil=pupil)
    probe = pilot.images(first, chains_up_to(max_hits))
    longest, lost = (max_hits, 0.0) if "chain" in fixed else pilot.longest_chain(chains_up_to, max_hits)
    splits = fixed.get("splits", probe.splits)
    exact = not probe.bent and "chain" not in fixed
    reason = f"{probe.specular + probe.nearly_specular:.1%} of the view mirrors or lets through; images by "
    reason += "optical path" if image == "opl" or exact else "curvature"
    reason += ", which is exact here" if exact and image != "opl" else ""
    reason += f"; {1 << splits} branches of each ray" if splits else ""
    saving = f"{max_hits - longest} hits of {max_hits}" if longest < max_hits else ""
    decision = Decision("specular hits", f"up to {longest}", reason, saving, math.sqrt(lost))
    chains = Chains(probe, chains_up_to(longest, splits), "opl" if exact else image, longest, splits, pupil)
    cut_off = (
        f"{probe.cut:.0%} of the view lies behind more than {max_hits} mirrors and clear surfaces and stays "
        "black. Follow more of them (--max-specular-depth, Mirrors, Glass)."
    )
    return Decided(chains, (decision,), (cut_off,) if probe.cut > MAX_CUT_FRACTION else ())
