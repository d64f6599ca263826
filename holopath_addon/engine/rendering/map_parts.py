"""A radiance map in parts: questions that many processes ask some pixels each, and the answers brought together."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..progress import named, parts, stage
from ..tracing.questions import MOST_QUESTIONS, Question
from .planned import added

if TYPE_CHECKING:
    from ..progress import Progress
    from ..tracing.grains import RadianceMap
    from ..tracing.measurement import Measurement
    from .planned import PlannedRender

ASKED, TOLD = "asked", "told"  # steps
QUESTIONS = "questions.json"
CELLS = "cells"
JOINING = 0.6  # of the progress of bringing answers together


def map_steps(count: int, need: str) -> dict[str, tuple[str, ...]]:
    """The steps of a map: names, in an order in which they can be made, and of each what has to be done before.

    Parameters
    ----------
    count : int
        Parts that the pixels divide into.
    need : str
        What has to be done before all.
    """
    found = {}
    for number in range(1, MOST_QUESTIONS + 1):
        asked = [f"{ASKED}-{number}-{part + 1}-of-{count}" for part in range(count)]
        found |= dict.fromkeys(asked, (need,))
        need = told_step(number, count)
        found[need] = tuple(asked)
    return found


def told_step(number: int, count: int) -> str:
    """Name of the step in which the answers to a question, from 1 on, are brought together."""
    return f"{TOLD}-{number}-of-{count}"


class MapParts:
    """The radiance maps of a planned render, of each group of wavelengths one.

    Parameters
    ----------
    planned : PlannedRender
    count : int
        Parts that the pixels divide into.
    folder_of : callable
        ``folder_of(name)`` of a step that is done.
    """

    def __init__(self, planned: PlannedRender, count: int, folder_of: Callable[[str], Path]) -> None:
        self._planned, self._count, self._folder = planned, count, folder_of
        self._measurements: tuple[int, list[Measurement | None]] = 0, []

    def ask(self, number: int, part: int, folder: Path, progress: Progress) -> None:
        """Ask a part of the pixels, and write what they told.

        Parameters
        ----------
        number : int
            Of the question, from 1 on.
        part : int
            From 0 on.
        folder : pathlib.Path
            That is there.
        progress : callable
            ``progress(done, message)``, may raise.
        """
        from ..tracing.measurement import sparse
        from ..tracing.stored_map import save_totals

        planned = self._planned
        told = parts(progress, len(planned.groups))
        for place, measurement in enumerate(self._asking(number)):
            if measurement is None:
                continue
            first, last = (end * measurement.chunks // self._count for end in (part, part + 1))
            totals = measurement.nothing()
            with planned.recording(planned.groups[place]), planned.clock("radiance"):
                measurement.ask(range(first, last), totals, named(told[place], "Radiance"))
            (folder / str(place)).mkdir()
            save_totals(sparse(totals), folder / str(place))

    def tell(self, number: int, folder: Path, progress: Progress) -> dict[str, Any] | None:
        """Bring together what all pixels told, and write what follows: the next question, or the maps.

        Parameters
        ----------
        number, folder, progress :
            As of `ask`.

        Returns
        -------
        dict or None
            Of the maps, see `report_of`; None where there is another question.
        """
        from ..tracing.stored_map import save_totals

        planned, found = self._planned, []
        told = parts(stage(progress, 0.0, JOINING), len(planned.groups))
        for place, group in enumerate(planned.groups):
            with planned.recording(group) as recording, planned.clock("radiance"):
                measurement = recording.measurement()
                for earlier in range(1, number):
                    self._include(measurement, earlier, place)
                    measurement.question = self._question(earlier, place)
                    if measurement.question is None:
                        break
                if measurement.question is not None:
                    cells = self._include(measurement, number, place)
                    if number == 1:
                        (folder / f"{CELLS}_{place}").mkdir()
                        save_totals(cells, folder / f"{CELLS}_{place}")
            found.append(measurement)
            told[place](1.0, "Joining radiance")
        questions = [each.question and asdict(each.question) for each in found]
        (folder / QUESTIONS).write_text(json.dumps(questions))
        if any(questions):
            return None
        with planned.clock("radiance"):
            return save_maps(planned, (each.radiance_map() for each in found), folder)

    def _include(self, measurement, number, place):
        """Bring in the answers to a question; they are returned."""
        from ..tracing.measurement import sparse
        from ..tracing.stored_map import load_totals

        names = (f"{ASKED}-{number}-{part + 1}-of-{self._count}" for part in range(self._count))
        totals = measurement.joined(load_totals(self._folder(name) / str(place)) for name in names)
        measurement.include(totals)
        measurement.decide()
        return sparse(totals) if number == 1 else {}

    def _asking(self, number):
        """A measurement of each group that has this question, kept; None of those that know all."""
        if self._measurements[0] != number:
            self._measurements = number, [self._knowing(number, place) for place in self._places]
        return self._measurements[1]

    @property
    def _places(self):
        return range(len(self._planned.groups))

    def _knowing(self, number, place):
        from ..tracing.stored_map import load_totals

        with self._planned.recording(self._planned.groups[place]) as recording:
            measurement = recording.measurement()
        if number > 1:
            question = self._question(number - 1, place)
            if question is None:
                return None
            cells = self._folder(told_step(1, self._count)) / f"{CELLS}_{place}"
            measurement.include(measurement.joined([load_totals(cells)]))
            measurement.question = question
        return measurement

    def _question(self, number, place):
        """What is asked after a question of which all is told."""
        file = self._folder(told_step(number, self._count)) / QUESTIONS
        values = json.loads(file.read_text())[place]
        return values and Question(**values)


def save_maps(planned: PlannedRender, maps: Iterable[RadianceMap], folder: Path) -> dict[str, Any]:
    """Write the radiance maps of a planned render's groups.

    Parameters
    ----------
    planned : PlannedRender
    maps : iterable of RadianceMap
    folder : pathlib.Path

    Returns
    -------
    dict
        `error`, `passes` and `rays` of all, as `report_of` has them.
    """
    from ..tracing.stored_map import save_map

    errors, passes, rays = [], None, {}
    for number, (group, radiance) in enumerate(zip(planned.groups, maps, strict=True)):
        (folder / f"map_{number}").mkdir()
        save_map(radiance, folder / f"map_{number}")
        with planned.recording(group) as recording:
            recording.count(radiance)
            errors.append(recording.error)
            passes, rays = recording.passes, added(rays, recording.rays_traced)
    return {"error": planned.error(errors), "passes": passes, "rays": rays}
