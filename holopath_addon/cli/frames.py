"""Units of work of an animation: its frames, and before them their common light."""

import argparse
import time
from collections.abc import Callable
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
from . import options
from .sources import BlenderSource

LIGHT = "light"  # name of the unit, and of its folder
LIGHT_PREFIX = "Light: "  # of the messages of its progress, which Blender's window reads


class AnimationFrames:
    """Units of an animation.

    Parameters
    ----------
    args : argparse.Namespace
        See `cli.parse`.
    out : path
        Output folder of the animation.
    source : BlenderSource
    job : str
        Digest of the job.
    request : callable
        ``request()`` gives the `Request` of the scene in its current frame.
    on_finish : callable
        ``on_finish(folder, report)`` is called after each frame that this process makes.
    say : callable
        ``say(text)`` receives remarks on frames that were there.

    Attributes
    ----------
    names : list of str
        Names of the frames that this process has made so far.
    """

    def __init__(
        self,
        args: argparse.Namespace,
        out: Path,
        source: BlenderSource,
        job: str,
        request: Callable[[], Request],
        on_finish: Callable[[Path, dict], None],
        say: Callable[[str], None],
    ) -> None:
        self.names: list[str] = []
        self._source, self._job, self._encode, self._request = source, job, args.encode, request
        self._on_finish, self._say = on_finish, say
        method = options.settings_of(args, source.settings).method
        self._light = JobLight(out / LIGHT, job, args.store) if method in DECIDED else None
        numbers = list(args.frame_range or source.frames)
        self._folders = {number: output.frame_folder(out, number) for number in numbers}
        # a frame whose phases start from those of the previous one is made after it
        in_turn = args.encode_start == "before"
        self._previous = dict(zip(numbers[1:], numbers, strict=False)) if in_turn else {}

    @cached_property
    def units(self) -> dict[str, Unit]:
        """The units by name, in order."""
        needs = () if self._light is None else (LIGHT,)
        units = [
            Unit(
                folder.name,
                partial(self._make, number),
                partial(self._is_complete, number),
                (*needs, *(self._folders[n].name for n in [self._previous.get(number)] if n is not None)),
            )
            for number, folder in self._folders.items()
        ]
        if self._light is not None:
            units.insert(0, Unit(LIGHT, self._make_light, self._is_lit, prepares=True))
        return {unit.name: unit for unit in units}

    def _is_complete(self, number):
        previous = self._previous.get(number)
        before = None if previous is None else self._folders[previous]
        return stills.is_complete(self._folders[number], self._job, self._encode, before)

    def _make(self, number, progress):
        folder = self._folders[number]

        def frame_progress(done, message):
            progress(min(done, 0.999), f"Frame {number}: {message}")

        with _naming(number):
            start = time.perf_counter()
            frame_progress(0.0, "Exporting the scene")
            self._source.go_to(number)
            request = self._with_common_light(self._request(), frame_progress)
            if number in self._previous:
                previous = engine.PhaseHologram.load(self._folders[self._previous[number]] / "hologram")
                request = replace(request, encoding=replace(request.encoding, previous=previous))
            seconds = time.perf_counter() - start
            result, report = stills.update(
                folder,
                request,
                Stages(frame_progress, "still")["still"],
                seconds,
                lambda text: self._say(f"{folder.name}: {text}"),
            )
        if result is not None:
            self.names.append(folder.name)
            self._on_finish(folder, report)

    def _with_common_light(self, request, progress):
        """A frame's request with the light of all frames, unless the frame's animated settings exclude it."""
        if self._light is None or request.settings.method not in DECIDED:
            return request
        wait_until(self._light.done, self._light.folder, progress)
        method = self._light.method if request.settings.method == "auto" else None
        return replace(request, store=self._light.store, method=method)

    def _make_light(self, progress):
        assert self._light is not None

        def request_at(number):
            self._source.go_to(number)
            return self._request()

        self._light.make(
            self._source.frames, request_at, lambda done, message: progress(done, f"{LIGHT_PREFIX}{message}")
        )

    def _is_lit(self):
        """Whether the light is there, or no frame needs it any more."""
        assert self._light is not None
        return self._light.done() or all(map(self._is_complete, self._folders))


@contextmanager
def _naming(number):
    """Name the frame in errors of bad input in the block."""
    try:
        yield
    except engine.InvalidInput as error:
        raise engine.InvalidInput(f"Frame {number}: {error}") from error
