"""Light that all frames of a job share: its method is decided once, and it is baked once.

Measured times decide the method, and what is baked depends on the views that were baked before. Both are done once for
all frames, for views of the scene's own frame range, and kept in a folder that is not written again.
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
from .render_context import RenderContext

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..settings import Settings

RECORD = "light.json"
FORMAT = "HoloPath light"
DECIDED = ("auto", "fast")  # methods whose frames would depend on the machine, and on the frames before
MAX_VIEWS, FRAMES_PER_VIEW = 8, 8  # views of a job, and frames for each view up to that number


class View(Protocol):
    """View of a frame."""

    @property
    def scene(self) -> mi.Scene:
        """Mitsuba's scene."""
        ...

    @property
    def camera(self) -> Camera:
        """Camera of the frame."""
        ...

    @property
    def hologram(self) -> Hologram:
        """Display."""
        ...

    @property
    def settings(self) -> Settings:
        """Settings as requested."""
        ...


class JobLight:
    """Light of a job in its folder.

    Parameters
    ----------
    folder : path
    job : str
        Digest of the job.
    store : BakeStore or None
        The user's own store: its light is not baked again, and new light is copied there.

    Attributes
    ----------
    store : JobStore
        The baked light, read-only.
    """

    def __init__(self, folder: Path | str, job: str, store: BakeStore | None) -> None:
        self.folder, self._job, self._own = Path(folder), job, store
        self.store = JobStore(self.folder, store, sealed=True)

    def done(self) -> bool:
        """Whether the light of this job is in the folder."""
        return self._record.get("job") == self._job

    @cached_property
    def method(self) -> str:
        """Method of light of every frame, 'full' or 'fast'; once `done`."""
        return self._record["method"]

    @property
    def _record(self):
        try:
            return json.loads((self.folder / RECORD).read_text())
        except (OSError, ValueError):
            return {}

    def make(self, frames: Sequence[int], look: Callable[[int], View], progress: Progress) -> None:
        """Decide and bake; light of another job is replaced, or kept where its first views are the same.

        Parameters
        ----------
        frames : sequence of int
            All of the scene's own frames, not only those that are rendered.
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
            first = [_inputs(look, frame) for frame in views[:2]]
            moves = len({inputs and inputs[0] for inputs in first}) > 1
            of = None if None in first else hashlib.sha256(json.dumps(first).encode()).hexdigest()
            if of is not None and of == before.get("of"):  # a file that was saved anew
                method = before["method"]
                for file in self.store.files():
                    shutil.copyfile(file, folder / file.name)
            else:
                method = _decided(views, look, moves, JobStore(folder, self._own), progress)
            for file in BakeStore(folder).files():
                file.chmod(0o644)  # for other users that share the folder, too
            record = {"format": FORMAT, "job": self._job, "of": of, "method": method}
            (folder / RECORD).write_text(json.dumps(record) + "\n")


def spread(frames: Sequence[int]) -> list[int]:
    """A few frames from the first to the last one, whose views decide."""
    count = min(MAX_VIEWS, max(-(-len(frames) // FRAMES_PER_VIEW), 2), len(frames))
    return [frames[round(n * (len(frames) - 1) / max(1, count - 1))] for n in range(count)]


def _inputs(look, frame):
    """Digest of a frame's scene, and everything else that affects its light, for JSON; None without a view."""
    from ..scene.fingerprint import scene_digest

    try:
        view = look(frame)
    except InvalidInput:
        return None
    request = view.camera.to_dict(), view.hologram.to_dict(), asdict(view.settings)
    return [scene_digest(view.scene), repr(request)]


def _decided(frames, look, moves, store, progress):
    """Method that the first view decides which can be planned; the light of all views is baked into a store."""
    from ..scene.fingerprint import scene_digest

    # Light of a moving scene serves one frame only, so that light of the first frame must not decide.
    known = JobStore(store.folder, store, sealed=True) if moves else store
    method, digest, baked, errors = None, None, [], []
    for frame, part in zip(frames, parts(progress, len(frames)), strict=True):
        part(0.0, "Exporting the scene")
        try:
            view = look(frame)
            if method and scene_digest(view.scene) != digest:
                break
            settings = planner.resolved(replace(view.settings, method=method or view.settings.method))
            request = view.camera.to_dict(), view.hologram, replace(settings, method="fast")
            if request in baked:
                continue
            plan = planner.plan(
                view.scene, view.camera, view.hologram, settings, known, stage(part, 0.0, 0.0)
            )
            method, digest = "fast" if plan.cached else "full", scene_digest(view.scene)
            if not plan.cached:
                store.clear()  # of light that it began with
                break
            RenderContext(view.scene, view.camera, view.hologram, plan, Clock()).bake(store, part)
            baked.append(request)
        except InvalidInput as error:  # as where nothing is in view
            errors.append(InvalidInput(f"Frame {frame}: {error}"))
        if moves and method:
            break
    if method is None:
        raise errors[0]
    return method
