"""A still in parts, which are kept in a hidden folder beside its own until it is there."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

from .. import output, stills
from ..engine import files
from ..engine.progress import stage
from ..engine.rendering.division import DividedRender, steps_of
from .claims import FOLDER
from .units import Unit

if TYPE_CHECKING:
    from ..engine import Hologram, Settings
    from ..engine.progress import Progress
    from ..stills import Still

JOINED = "joined"  # name of the last unit
JOINING = 0.1  # of which this much is to bring the field together


class StillParts:
    """The units of a still.

    Parameters
    ----------
    out : path
        Its output folder.
    count : int
        See `DividedRender`.
    hologram : engine.Hologram
    settings : engine.Settings
    job : str
        Digest of the job, as of the still's.
    encode : str
        As of the still's.
    still : callable
        ``still()`` exports the scene, and returns the `Still` and the seconds that it took.
    joined : callable
        ``joined(report)`` of the still, where this process joins it.

    Attributes
    ----------
    folder : pathlib.Path
        Of the parts.
    names : list of str
        Of the units that this process has made; it grows.
    """

    def __init__(
        self,
        out: Path,
        count: int,
        hologram: Hologram,
        settings: Settings,
        job: str,
        encode: str,
        still: Callable[[], tuple[Still, float]],
        joined: Callable[[dict], None],
    ) -> None:
        self.folder = out.parent / f".{out.name}.parts"
        self.names: list[str] = []
        self._out, self._count, self._job, self._encode, self._still = out, count, job, encode, still
        self._joined = joined
        self._steps = steps_of(hologram, settings, count)

    @property
    def units(self) -> dict[str, Unit]:
        """By name, in an order in which they can be made; the last one alone, where the still is there."""
        steps = {} if self.made() else self._steps

        def needless(name):
            return partial(DividedRender.needless, self.folder, name, self._job)

        found = [
            Unit(
                name,
                partial(self._make, name),
                partial(self._made, name),
                needs,
                needless(name),
            )
            for name, needs in steps.items()
        ]
        found.append(Unit(JOINED, self._join, self.made, tuple(steps)))
        return {unit.name: unit for unit in found}

    def made(self) -> bool:
        """Whether the still is there."""
        return stills.made(self._out, self._job, self._encode)

    def clear(self) -> None:
        """Clear the parts away, unless the still is not there yet, or others are at work on it."""
        if self.made() and not (self.folder / FOLDER).exists():
            shutil.rmtree(self.folder, ignore_errors=True)

    @cached_property
    def _work(self) -> tuple[DividedRender, Still, float]:
        still, seconds = self._still()
        what = still.scene, still.camera, still.hologram, still.settings
        return DividedRender(*what, self.folder, self._count, still.store, self._job), still, seconds

    def _made(self, name):
        return DividedRender.done(self.folder, name, self._job) or self.made()

    def _make(self, name, progress):
        progress(0.0, "Exporting the scene")
        render, _, _ = self._work
        render.make(name, progress)
        self.names.append(name)

    def _join(self, progress: Progress) -> None:
        progress(0.0, "Exporting the scene")
        render, still, seconds = self._work
        field = render.joined(stage(progress, 0.0, JOINING))
        files.sweep(self._out)
        with output.output_folder(self._out) as part:
            told = stage(progress, JOINING, 1.0)
            _, report = stills.write(part, still, told, seconds, field, stoppable=False)
        self.names.append(JOINED)
        self._joined(report)
