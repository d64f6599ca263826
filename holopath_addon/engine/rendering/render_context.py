"""Context of a render under way: what rays need before they are traced; and its report."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..hologram import AerialImage
from ..mapping import filled, traced, widened
from ..planning import planner
from ..scene import variants
from ..waves.phase_fields import phasors_of, straight_share

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.bake_store import BakeStore
    from ..light.baking import Bake
    from ..light.radiance_cache import RadianceCache
    from ..plan import Plan
    from ..progress import Clock, Progress
    from ..tracing.recording import Recording


class RenderContext:
    """Scene, plan, phasors and baked light of a render under way.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    plan : Plan
    clock : Clock

    Attributes
    ----------
    camera, hologram : Camera, Hologram
        Those that rays are traced for: with square pixels, as wide as the plan says, and behind a lens of the image
        there.
    cache : RadianceCache or None
        Baked light, after `bake`.
    baked : Bake or None
        Record of the bake.
    """

    def __init__(self, scene: mi.Scene, camera: Camera, hologram: Hologram, plan: Plan, clock: Clock) -> None:
        self.scene, self.plan, self.clock = scene, plan, clock
        self.camera, self.hologram = widened(*traced(camera, hologram), plan.beside)
        self.cache: RadianceCache | None = None
        self.baked: Bake | None = None

    @cached_property
    def phasors(self) -> np.ndarray:
        """Unit phasors exp(iφ) of the hologram's frames, see `phasors_of`."""
        hologram, settings = self.hologram, self.plan.settings
        with self.clock("phase fields"):
            size = settings.frames, hologram.height, hologram.width
            return phasors_of(settings.phase_field, *size, settings.seed, settings.randomness)

    @property
    def straight(self) -> float:
        """Fraction of even surfaces' light that the phasors send straight on, see `straight_share`."""
        settings = self.plan.settings
        return straight_share(settings.randomness) if settings.phase_field == "smooth" else 0.0

    def bake(self, store: BakeStore | None, progress: Progress) -> None:
        """Bake light, or load it from a store, if the plan says so."""
        if not self.plan.cached:
            return
        from ..light.baking import bake

        with self.clock("bake"):
            self.cache, self.baked = bake(
                self.scene, self.camera, self.hologram, self.plan, store=store, progress=progress
            )

    @cached_property
    def groups(self) -> Sequence[tuple[float, ...]]:
        """Wavelengths that share rays: all; each for itself behind a lens, or where glass in view disperses."""
        from ..scene.dispersion import wavelength_groups

        wavelengths = self.hologram.wavelengths
        if isinstance(self.hologram, AerialImage):
            return [(wavelength,) for wavelength in wavelengths]
        return [wavelengths] if self.plan.traversals == 1 else wavelength_groups(self.scene, wavelengths)

    @contextmanager
    def recording(self, group: tuple[float, ...]) -> Iterator[Recording]:
        """Context manager of a group's `Recording`, with the scene's refractive indices at its wavelengths."""
        from ..scene.dispersion import tuned

        with tuned(self.scene, group):
            yield self._recording(group)

    def _recording(self, group):
        from ..tracing.recording import Recording

        # a beam has its own place for each wavelength of the whole, and does not affect rays
        optics = self.hologram.optics.of_rays
        camera, plan = self.camera, self.plan
        part = replace(self.hologram, wavelengths=group, optics=optics)
        if isinstance(part, AerialImage):
            camera, part = filled(camera, part)
        if self.cache is not None:
            with self.clock("radiance"):
                plan = planner.replan_after_bake(plan, self.scene, camera, part, self.cache)
        with self.clock("optics"):
            return Recording(self.scene, camera, part, plan, self.clock, cache=self.cache)

    def error(self, errors: Sequence[float | None]) -> float | None:
        """Relative standard error of the field by the noise of radiance maps and baked light; None where unknown.

        Parameters
        ----------
        errors : sequence of float or None
            `Recording.error` of each group.
        """
        known = [error for error in errors if error is not None]
        if len(known) < len(errors):
            return None
        texels = 0.0
        if self.baked is not None:
            texels = self.plan.error if self.baked.error is None else 0.5 * self.baked.error
        return float(np.hypot(max(known), texels))


def report_of(
    plan: Plan,
    seconds: dict[str, float],
    rays: dict[str, int],
    passes: int | None,
    error: float | None,
    baked: dict[str, Any] | None,
) -> dict[str, Any]:
    """`WaveField.report` of a render.

    Parameters
    ----------
    plan : Plan
    seconds : dict of str to float
        Seconds of each stage.
    rays : dict of str to int
        Numbers of traced rays, by kind.
    passes : int or None
        Radiance paths a pixel.
    error : float or None
        See `RenderContext.error`.
    baked : dict or None
        A `Bake`.

    Returns
    -------
    dict
    """
    report = {
        "seconds": seconds,
        "rays": rays,
        "variant": variants.activate(),
        "frames": plan.settings.frames,
        "radiance_passes": passes,
        "estimated": {
            "seconds": {
                "plan": plan.seconds,
                "measured": sum(seconds.values()) - seconds.get("plan", 0.0),
            },
            "stages": plan.stages,
            "field_error": {"plan": plan.error, "measured": error},
        },
    }
    return report if baked is None else report | {"bake": baked}
