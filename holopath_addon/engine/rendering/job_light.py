"""Light that all frames of a job have alike: how it is found, decided once, and what is baked of it, once.

Which way is faster is decided by measured times, and what is baked depends on which views were baked before. So both
are done once for all, for views of the scene's own range of frames, and kept in a folder that is not written again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ..errors import InvalidInput
from ..files import earlier, whole_folder
from ..light.bake_store import BakeStore, JobStore
from ..planning import planner
from ..progress import Clock, Progress, parts
from ..scene import variants
from .planned import PlannedRender

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..settings import Settings

RECORD = "light.json"
FORMAT = "HoloPath light"
DECIDED = ("auto", "fast")  # methods whose frames would differ by who makes them, and after which others
MOST_VIEWS = 8
EVERY = 8  # frames, of which one is looked at, as far as that gives no more views


class View(Protocol):
    """What is seen in a frame."""

    @property
    def scene(self) -> mi.Scene: ...
    @property
    def camera(self) -> Camera: ...
    @property
    def hologram(self) -> Hologram: ...
    @property
    def settings(self) -> Settings: ...


class JobLight:
    """A job's light in its folder.

    Parameters
    ----------
    folder : path
    job : str
        Digest of the job.
    store : BakeStore or None
        The user's own: what it holds is not baked again, and what is baked goes there, too.

    Attributes
    ----------
    store : JobStore
        The light that was baked, to be read alone.
    """

    def __init__(self, folder: Path | str, job: str, store: BakeStore | None) -> None:
        self.folder, self._job, self._own = Path(folder), job, store
        self.store = JobStore(self.folder, store, sealed=True)

    def done(self) -> bool:
        """Whether it is there."""
        return self._record.get("job") == self._job

    @cached_property
    def method(self) -> str:
        """How light is found in every frame, 'full' or 'fast'; once it is `done`."""
        return self._record["method"]

    @property
    def _record(self):
        try:
            return json.loads((self.folder / RECORD).read_text())
        except (OSError, ValueError):
            return {}

    def make(self, frames: Sequence[int], look: Callable[[int], View], progress: Progress) -> None:
        """Decide and bake; that of another job is replaced.

        Parameters
        ----------
        frames : sequence of int
            Numbers of the scene's own frames, whichever are rendered.
        look : callable
            ``look(frame)`` gives its `View`.
        progress : callable
            ``progress(done, message)``, may raise `Cancelled`.

        Raises
        ------
        InvalidInput
            If none of the views can be planned.
        BackendUnavailable, Cancelled, OSError
        """
        variants.activate()
        with whole_folder(self.folder, earlier("HoloPath's light", RECORD)) as folder:
            store, nothing = JobStore(folder, self._own), JobStore(folder, self._own, sealed=True)
            method = _found(spread(frames), look, store, nothing, progress)
            if method != "fast":
                store.clear()
            for file in BakeStore(folder).files():
                file.chmod(0o644)  # for other users that share the folder, too
            record = {"format": FORMAT, "job": self._job, "method": method}
            (folder / RECORD).write_text(json.dumps(record) + "\n")


def spread(frames: Sequence[int]) -> list[int]:
    """A few frames from the first to the last one, of which views are looked at."""
    count = min(MOST_VIEWS, max(-(-len(frames) // EVERY), 2), len(frames))
    return [frames[round(n * (len(frames) - 1) / max(1, count - 1))] for n in range(count)]


def _found(frames, look, store, nothing, progress):
    """The method, decided in the first of the views that can be planned; light is baked into a store then.

    Light of a scene that moves serves no other frame, so that `nothing` is there for the decision, whatever the store
    has of the first one.
    """
    from ..scene.fingerprint import scene_digest

    progress(0.0, "Exporting the scene")
    moves = len({_digest(look, frame) for frame in frames[:2]}) > 1
    method, digest, seen, errors = None, None, [], []
    for frame, at in zip(frames, parts(progress, len(frames)), strict=True):
        if moves and method:
            break
        at(0.0, "Exporting the scene")
        try:
            view = look(frame)
            if method and scene_digest(view.scene) != digest:
                break
            settings = planner.resolved(replace(view.settings, method=method or view.settings.method))
            known = view.camera.to_dict(), view.hologram, replace(settings, method="fast")
            if known in seen:
                continue
            what = view.scene, view.camera, view.hologram, settings
            at(0.0, "Planning")
            plan = planner.plan(*what, nothing if moves else store)
            method, digest = "fast" if plan.cached else "full", scene_digest(view.scene)
            if not plan.cached:
                break
            PlannedRender(*what, plan, Clock()).bake(store, at)
            seen.append(known)
        except InvalidInput as error:  # in view there may be nothing
            errors.append(InvalidInput(f"Frame {frame}: {error}"))
    if method is None:
        raise errors[0]
    return method


def _digest(look, frame):
    """Of the scene in a frame; None where it cannot be exported."""
    from ..scene.fingerprint import scene_digest

    try:
        return scene_digest(look(frame).scene)
    except InvalidInput:
        return None
