"""Light that all frames of a job have alike: how it is found, decided once, and what is baked of it, once.

Which way is faster is decided by measured times, and what is baked depends on which views were baked before. So both
are done once for all, for views of the scene's own range of frames, and kept in a folder that is not written again.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ..errors import InvalidInput
from ..files import overwrite_check, whole_folder
from ..light.bake_store import BakeStore, JobStore
from ..planning import planner
from ..progress import Clock, Progress, parts, stage
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
        """Decide and bake; that of another job is replaced, or kept where its first views are the same.

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
        views, before = spread(frames), self._record
        with whole_folder(self.folder, overwrite_check("HoloPath's light", RECORD, others=("*",))) as folder:
            progress(0.0, "Exporting the scene")
            first = [_told(look, frame) for frame in views[:2]]
            moves = len({told and told[0] for told in first}) > 1
            of = None if None in first else hashlib.sha256(json.dumps(first).encode()).hexdigest()
            if of is not None and of == before.get("of"):  # a file that was saved anew
                method = before["method"]
                for file in self.store.files():
                    shutil.copyfile(file, folder / file.name)
            else:
                method = _found(views, look, moves, JobStore(folder, self._own), progress)
            for file in BakeStore(folder).files():
                file.chmod(0o644)  # for other users that share the folder, too
            record = {"format": FORMAT, "job": self._job, "of": of, "method": method}
            (folder / RECORD).write_text(json.dumps(record) + "\n")


def spread(frames: Sequence[int]) -> list[int]:
    """A few frames from the first to the last one, of which views are looked at."""
    count = min(MOST_VIEWS, max(-(-len(frames) // EVERY), 2), len(frames))
    return [frames[round(n * (len(frames) - 1) / max(1, count - 1))] for n in range(count)]


def _told(look, frame):
    """JSON-able: a frame's scene, by its digest, and all else that decides its light; None where it is no view."""
    from ..scene.fingerprint import scene_digest

    try:
        view = look(frame)
    except InvalidInput:
        return None
    asked = view.camera.to_dict(), view.hologram.to_dict(), asdict(view.settings)
    return [scene_digest(view.scene), repr(asked)]


def _found(frames, look, moves, store, progress):
    """The method, decided in the first of the views that can be planned; light is baked into a store then."""
    from ..scene.fingerprint import scene_digest

    # Light of a scene that moves serves no other frame: what there is of the first one then must not decide.
    known = JobStore(store.folder, store, sealed=True) if moves else store
    method, digest, seen, errors = None, None, [], []
    for frame, at in zip(frames, parts(progress, len(frames)), strict=True):
        at(0.0, "Exporting the scene")
        try:
            view = look(frame)
            if method and scene_digest(view.scene) != digest:
                break
            settings = planner.resolved(replace(view.settings, method=method or view.settings.method))
            asked = view.camera.to_dict(), view.hologram, replace(settings, method="fast")
            if asked in seen:
                continue
            what = view.scene, view.camera, view.hologram, settings
            plan = planner.plan(*what, known, stage(at, 0.0, 0.0))
            method, digest = "fast" if plan.cached else "full", scene_digest(view.scene)
            if not plan.cached:
                store.clear()  # what it may have begun with
                break
            PlannedRender(*what[:3], plan, Clock()).bake(store, at)
            seen.append(asked)
        except InvalidInput as error:  # there may be nothing in view
            errors.append(InvalidInput(f"Frame {frame}: {error}"))
        if moves and method:
            break
    if method is None:
        raise errors[0]
    return method
