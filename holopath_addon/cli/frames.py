"""The frames of an animation as units of work, and before them the light that they have alike."""

import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

from .. import engine
from ..engine.progress import Stages
from ..engine.rendering.job_light import DECIDED, JobLight
from ..farm.units import Unit
from ..farm.worker import wait_until
from ..workflow import output, stills
from ..workflow.request import Request
from .sources import BlenderSource

LIGHT = "light"  # name of the unit, and of its folder
LIGHT_TOLD = "Light: "  # begins what is said while it is made


class AnimationFrames:
    """The units of an animation.

    Parameters
    ----------
    out : path
        Output folder of all.
    numbers : sequence of int
        Frames that are asked for.
    source : BlenderSource
    job : str
        Digest of the job.
    method : str
        That is asked for.
    encode : str
        As `Encoding.method` of all requests.
    store : engine.BakeStore or None
        As of all requests.
    request : callable
        ``request()`` exports the scene in its current frame.
    finished : callable
        ``finished(folder, report)`` of each frame that this process makes.
    say : callable
        ``say(text)`` of what was there before.
    in_turn : bool
        Whether the phases of a frame begin with those of the frame before, which is then made first.

    Attributes
    ----------
    names : list of str
        Of the frames that this process has made; it grows.
    """

    def __init__(
        self,
        out: Path,
        numbers: Sequence[int],
        source: BlenderSource,
        job: str,
        method: str,
        encode: str,
        store: engine.BakeStore | None,
        request: Callable[[], Request],
        finished: Callable[[Path, dict], None],
        say: Callable[[str], None],
        in_turn: bool = False,
    ) -> None:
        self.names: list[str] = []
        self._source, self._job, self._encode, self._request = source, job, encode, request
        self._finished, self._say = finished, say
        self._light = JobLight(out / LIGHT, job, store) if method in DECIDED else None
        self._folders = {number: output.frame_folder(out, number) for number in numbers}
        self._before = dict(zip(list(numbers)[1:], numbers, strict=False)) if in_turn else {}

    @cached_property
    def units(self) -> dict[str, Unit]:
        """By name, in order."""
        needs = () if self._light is None else (LIGHT,)
        found = [
            Unit(
                folder.name,
                partial(self._make, number),
                partial(self._made, folder),
                (*needs, *(self._folders[n].name for n in [self._before.get(number)] if n is not None)),
            )
            for number, folder in self._folders.items()
        ]
        if self._light is not None:
            found.insert(0, Unit(LIGHT, self._make_light, self._lit, prepares=True))
        return {unit.name: unit for unit in found}

    def _made(self, folder):
        return stills.is_complete(folder, self._job, self._encode)

    def _make(self, number, progress):
        folder = self._folders[number]

        def at(done, message):
            progress(min(done, 0.999), f"Frame {number}: {message}")

        with _naming(number):
            began = time.perf_counter()
            at(0.0, "Exporting the scene")
            self._source.go_to(number)
            request = self._alike(self._request(), at)
            if number in self._before:
                before = self._folders[self._before[number]] / "hologram"
                request = replace(request, encoding=replace(request.encoding, previous=before))
            spent = time.perf_counter() - began
            result, report = stills.update(
                folder,
                request,
                Stages(at, "still")["still"],
                spent,
                lambda text: self._say(f"{folder.name}: {text}"),
            )
        if result is not None:
            self.names.append(folder.name)
            self._finished(folder, report)

    def _alike(self, request, progress):
        """A frame's request with the light that all have; settings may be animated, though."""
        if self._light is None or request.settings.method not in DECIDED:
            return request
        wait_until(self._light.done, self._light.folder, progress)
        method = self._light.method if request.settings.method == "auto" else None
        return replace(request, store=self._light.store, method=method)

    def _make_light(self, progress):
        assert self._light is not None

        def look(number):
            self._source.go_to(number)
            return self._request()

        self._light.make(
            self._source.frames, look, lambda done, message: progress(done, f"{LIGHT_TOLD}{message}")
        )

    def _lit(self):
        """Whether no frame waits for the light."""
        assert self._light is not None
        return self._light.done() or all(map(self._made, self._folders.values()))


@contextmanager
def _naming(number):
    """Errors of bad input name the frame."""
    try:
        yield
    except engine.InvalidInput as error:
        raise engine.InvalidInput(f"Frame {number}: {error}") from error
