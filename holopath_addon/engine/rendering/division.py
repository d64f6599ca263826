"""A render in parts that many processes make in one folder, and the field that they join to.

What a part computes depends neither on how many there are nor on who makes it: the field is that of `render` to the
last bit, on processors of one kind. Rays divide by recording planes and tiles of them, so that none is traced twice.
The ways between planes and to the SLM divide by wavelengths and multiplexed frames, which know nothing of each other.
What all share is prepared once: the plan, baked light, radiance maps and the energy of phase fields.
"""

from __future__ import annotations

import json
import secrets
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InvalidInput
from ..files import whole_folder
from ..light.bake_store import BakeStore
from ..plan import Plan
from ..planning import planner
from ..progress import Clock, Progress, named, parts, stage
from ..scene import variants
from ..settings import BASELINES, Settings
from ..wavefield import WaveField
from ..waves import despeckle
from ..waves.phase_fields import SETS
from .fields import OWN, at_slm, kept_energy, phasors_numbered
from .planned import PlannedRender, added, report_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..light.path_tracer import PathsPerRay
    from ..plan import RecordingPlane
    from ..tracing.grains import RadianceMap

PREPARED, TRACED, GATHERED = "prepared", "traced", "gathered"  # steps
REPORT, INDEX, VALUES, FIELD = "report.json", "index.json", "values.bin", "field.npy"
MOST_PARTS = 4096
PLANNING, BAKING = 0.1, 0.5  # how much of the preparation is done then


def steps_of(hologram: Hologram, settings: Settings, count: int) -> dict[str, tuple[str, ...]]:
    """The parts of a render: names, in an order in which they can be made, and of each what has to be done before.

    Parameters
    ----------
    hologram : Hologram
    settings : Settings
    count : int
        Parts that the rays divide into, and most that the ways to the SLM do.

    Raises
    ------
    InvalidInput
        Where the method does not divide.
    """
    if settings.method in BASELINES:
        raise InvalidInput(f"The method {settings.method} does not divide into parts: leave out --divide.")
    if not 1 <= count <= MOST_PARTS:
        raise InvalidInput(f"A hologram divides into 1 to {MOST_PARTS} parts, not {count}.")
    traced = [f"{TRACED}-{n + 1}-of-{count}" for n in range(count)]
    ways = _ways(hologram, planner.resolved(settings), count)
    gathered = [f"{GATHERED}-{n + 1}-of-{len(ways)}-of-{count}" for n in range(len(ways))]
    return {PREPARED: ()} | dict.fromkeys(traced, (PREPARED,)) | dict.fromkeys(gathered, (PREPARED, *traced))


def _ways(hologram, settings, count):
    """Wavelength, and first and last frame, of fields that move together: those of each part.

    Speckle is taken out of all frames of a wavelength together.
    """
    frames, colours = settings.frames, len(hologram.wavelengths)
    together = frames if settings.despeckle else 1
    ways = [(k, m, m + together) for k in range(colours) for m in range(0, frames, together)]
    count = min(count, len(ways))
    ends = [number * len(ways) // count for number in range(count + 1)]
    return [_united(ways[first:last]) for first, last in zip(ends, ends[1:], strict=False)]


class DividedRender:
    """A render whose parts are made one by one, by this process or others.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
    folder : path
        Where parts are kept: one for each scene and settings.
    count : int
        Parts that the rays divide into, and most that the ways to the SLM do.
    store : BakeStore, optional
        Where baked light is kept. Default: in the folder.
    job : str
        Digest of all that decides the field: parts of another one do not count.

    Raises
    ------
    InvalidInput
        See `steps_of`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        camera: Camera,
        hologram: Hologram,
        settings: Settings,
        folder: Path | str,
        count: int,
        store: BakeStore | None = None,
        job: str = "",
    ) -> None:
        variants.activate()
        self.job = job
        self.scene, self.camera, self.hologram = scene, camera, hologram
        self.settings, self.folder, self.count = planner.resolved(settings), Path(folder), count
        self.steps = steps_of(hologram, settings, count)
        # of light that all need, not only the maps, all need the same
        self.store = store if store and self._mapped else BakeStore(self.folder / "baked")
        self._light: dict[int, RadianceMap | PathsPerRay] = {}
        # Tells preparations apart: what was measured for one plan may have made another one, with other parts.
        self._mark = ""
        self._clock = Clock()
        self._last: tuple[int, np.ndarray | None] = -1, None

    @staticmethod
    def done(folder: Path, name: str, job: str) -> bool:
        """Whether the result of a step is there, of the same preparation as all others; it appears whole."""
        report, prepared = _report(folder, name), _report(folder, PREPARED)
        return report.get("job") == prepared.get("job") == job and report["mark"] == prepared["mark"]

    def make(self, name: str, progress: Progress) -> None:
        """Do a step whose needs are done.

        Parameters
        ----------
        name : str
        progress : callable
            ``progress(done, message)``, may raise `Cancelled`.

        Raises
        ------
        InvalidInput, BackendUnavailable, Cancelled, OSError
        """
        kind, _, number = name.partition("-")
        if kind == PREPARED:
            self._mark = secrets.token_hex(8)
        else:
            self._renew()
        with whole_folder(self.folder / name, lambda folder: None) as part:
            self._clock.seconds = {}
            if kind == PREPARED:
                report = self._prepare(part, progress)
            elif kind == TRACED:
                report = self._trace(int(number.split("-")[0]) - 1, part, progress)
            else:
                ways = _ways(self.hologram, self.settings, self.count)
                report = self._gather(ways[int(number.split("-")[0]) - 1], part, progress)
            (part / REPORT).write_text(
                _json({"job": self.job, "mark": self._mark, "seconds": self._clock.seconds, **report})
            )

    def joined(self, progress: Progress) -> WaveField:
        """The wave field, once all steps are done.

        Parameters
        ----------
        progress : callable
            ``progress(done, message)``, may raise `Cancelled`.

        Returns
        -------
        WaveField
        """
        self._renew()
        hologram, settings, prepared = self.hologram, self.settings, self._prepared
        shape = settings.frames, len(hologram.wavelengths), hologram.height, hologram.width
        field, seconds, rays = np.empty(shape, np.complex64), {}, {}
        for number, name in enumerate(self.steps):
            report = self._report(name)
            seconds, rays = added(seconds, report["seconds"]), added(rays, report.get("rays", {}))
            for way, k, start, stop in report.get("ways", ()):
                field[start:stop, k] = np.load(self.folder / name / f"{way}_{FIELD}", allow_pickle=False)
            progress((number + 1) / len(self.steps), "Joining")
        plan = prepared["plan"]
        told = prepared["passes"], prepared["error"], prepared["bake"]
        report = report_of(plan, settings.frames, seconds, rays, *told)
        return WaveField(field, hologram, self.camera, plan.near, plan.to_dict(), report)

    def _renew(self):
        """Go by the preparation that is there: what was read of one that it has replaced goes."""
        mark = _report(self.folder, PREPARED)["mark"]
        if mark != self._mark:
            self._mark = mark
            self._light.clear()
            self._last = -1, None
            for name in ("_prepared", "_planned", "_index"):
                self.__dict__.pop(name, None)

    def _report(self, name):
        """The report of a step that is done.

        Raises
        ------
        InvalidInput
            Where another process has prepared all anew meanwhile.
        """
        report = _report(self.folder, name)
        if report.get("mark") != self._mark:
            raise InvalidInput(
                f"{self.folder / name} is of another preparation of this hologram: give the same command again."
            )
        return report

    @property
    def _mapped(self) -> bool:
        """Whether there are radiance maps."""
        return self.settings.radiance != "ray"

    @property
    def _sets(self) -> range:
        """Numbers of the sets of phasors whose waves are traced."""
        return range(OWN + 1 + (despeckle.BATCHES if self.settings.despeckle else 0))

    def _phasors(self, number):
        if number != self._last[0]:
            self._last = number, phasors_numbered(number, self._planned.phasors)
        return self._last[1]

    # What all share

    def _prepare(self, folder, progress):
        hologram, settings = self.hologram, self.settings
        progress(0.0, "Planning")
        with self._clock("plan"):
            plan = planner.plan(self.scene, self.camera, hologram, settings, self.store)
        planned = PlannedRender(self.scene, self.camera, hologram, settings, plan, self._clock)
        planned.bake(self.store, stage(progress, PLANNING, BAKING))
        from ..scene.fingerprint import scene_digest
        from ..tracing.stored_map import save_map

        errors, passes, rays = [], None, {}
        at = parts(stage(progress, BAKING if plan.cached else PLANNING, 1.0), len(planned.groups))
        for number, (group, told) in enumerate(zip(planned.groups, at, strict=True)):
            with planned.recording(group) as recording:
                radiance = recording.radiance(named(told, "Radiance"))
                if self._mapped:
                    (folder / f"map_{number}").mkdir()
                    save_map(radiance, folder / f"map_{number}")
            errors.append(recording.error)
            passes, rays = recording.passes, added(rays, recording.rays_traced)
        own = planned.phasors
        with self._clock("phase fields"):
            kept = [kept_energy(phasors_numbered(n, own), settings.estimator) for n in self._sets]
        prepared = {
            "scene": scene_digest(self.scene),
            "plan": plan.to_dict(),
            "kept_energy": kept,
            "error": planned.error(errors),
            "passes": passes,
            "bake": None if planned.baked is None else asdict(planned.baked),
        }
        (folder / INDEX).write_text(_json(prepared))
        return {"rays": rays}

    @cached_property
    def _prepared(self) -> dict[str, Any]:
        """What the preparation found.

        Raises
        ------
        InvalidInput
            If it was of another scene than this process has.
        """
        from ..scene.fingerprint import scene_digest

        prepared = json.loads((self.folder / PREPARED / INDEX).read_text())
        if prepared["scene"] != scene_digest(self.scene):
            raise InvalidInput(
                "This machine reads another scene than the one that began this hologram: give all the same files "
                "and the same versions of Blender and HoloPath."
            )
        return prepared | {"plan": Plan.from_dict(prepared["plan"])}

    @cached_property
    def _planned(self) -> PlannedRender:
        what = self.scene, self.camera, self.hologram, self.settings, self._prepared["plan"], self._clock
        planned = PlannedRender(*what)
        if not self._mapped:  # else the light is in the maps
            planned.bake(self.store, lambda done, message: None)
        return planned

    def _radiance(self, number, recording):
        """Where the rays of a group of wavelengths have their light from."""
        from ..tracing.stored_map import load_map

        if number not in self._light:
            self._light[number] = (
                load_map(self.folder / PREPARED / f"map_{number}")
                if self._mapped
                else recording.radiance(lambda done: None)
            )
        return self._light[number]

    # Rays

    def _trace(self, number, folder, progress):
        planned, rows, offset = self._planned, [], 0
        work, done, rays = self._work(number), 0, {}
        whole = sum(block.work for blocks in work.values() for block in blocks)
        with open(folder / VALUES, "wb") as stream:
            for place, blocks in work.items():
                group, phasors, plane = place
                with planned.recording(planned.groups[group]) as recording:
                    radiance, recording.rays_traced = self._radiance(group, recording), {}
                    what = planned.plan.planes[plane], radiance, self._phasors(phasors), blocks
                    for block, pixels, values in recording.trace(*what, lambda done: None):
                        rows.append([*place, block.start, block.stop, block.count, offset])
                        stream.write(pixels.astype("<u4").tobytes())
                        stream.write(values.astype("<c8").tobytes())
                        offset += pixels.nbytes + values.nbytes
                        done += block.work
                        progress(done / whole, "Wave tracing")
                    rays = added(rays, recording.rays_traced)
        (folder / INDEX).write_text(json.dumps(rows))
        return {"rays": rays}

    def _work(self, number):
        """One part of all blocks, by group of wavelengths, set of phasors and plane; the parts are alike in rays."""
        planned, found, blocks = self._planned, {}, []
        # where the pixels of a block draw random numbers together, it stays whole
        divisible = self._mapped and self.settings.estimator != "paper"
        for group, wavelengths in enumerate(planned.groups):
            with planned.recording(wavelengths) as recording:
                radiance = self._radiance(group, recording)
                for phasors in self._sets:
                    for plane, recorded in enumerate(planned.plan.planes):
                        traced = recording.blocks(recorded, radiance, self.frames(phasors))
                        blocks += [((group, phasors, plane), block) for block in traced]
        share, start = sum(block.work for _, block in blocks) / self.count, 0
        for place, block in blocks:
            ends = [(end * share - start) / block.work for end in (number, number + 1)]
            low, high = (min(max(end if divisible else round(end), 0.0), 1.0) for end in ends)
            part = block.cut(low, high)
            if part.count:
                found.setdefault(place, []).append(part)
            start += block.work
        return found

    # Ways to the SLM

    def _gather(self, ways, folder, progress):
        planned, rows = self._planned, []
        for number, (k, start, stop) in enumerate(ways):
            group, wavelengths = next(
                (n, g) for n, g in enumerate(planned.groups) if self.hologram.wavelengths[k] in g
            )
            colour = wavelengths.index(self.hologram.wavelengths[k])
            hologram = replace(self.hologram, wavelengths=(wavelengths[colour],))
            stored = _Stored(self, group, colour, hologram, slice(start, stop))
            with planned.recording(wavelengths) as recording:
                field = at_slm(recording, stored, parts(progress, len(ways))[number])
            np.save(folder / f"{number}_{FIELD}", field[:, 0])
            rows.append([number, k, start, stop])
        return {"ways": rows}

    def frames(self, number: int) -> int:
        """Frames of a set of phasors, see `fields.OWN`."""
        return self.settings.frames if number == OWN else SETS[-1]

    def kept_energy(self, number: int) -> float:
        """Of a set of phasors, see `fields.kept_energy`."""
        return self._prepared["kept_energy"][number]

    @cached_property
    def _index(self) -> list[tuple[Path, list[int]]]:
        """What was traced, once all is: the file of values, and a row of `_trace` for each block."""
        found = []
        for name in self.steps:
            if name.startswith(TRACED):
                self._report(name)
                folder = self.folder / name
                found += [(folder / VALUES, row) for row in json.loads((folder / INDEX).read_text())]
        return found

    def stored(
        self, group: int, phasors: int, plane: RecordingPlane
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Frames, pixels and values of what was traced of a plane, as `wave_tracer.trace_blocks` has them; mapped."""
        wanted = [group, phasors, self._prepared["plan"].planes.index(plane)]
        colours = len(self._planned.groups[group])
        for file, (*place, start, stop, count, offset) in self._index:
            if place == wanted:
                pixels = np.memmap(file, "<u4", "r", offset, (count,))
                shape = stop - start, colours, count
                yield slice(start, stop), pixels, np.memmap(file, "<c8", "r", offset + pixels.nbytes, shape)


class _Stored:
    """`Recorded` of some frames of one wavelength, from disk."""

    def __init__(self, divided, group, colour, hologram, frames):
        self.hologram = hologram
        self._divided, self._group, self._colour, self._own = divided, group, colour, frames

    def _chosen(self, number):
        return self._own if number == OWN else slice(0, self._divided.frames(number))

    def frames(self, number):
        chosen = self._chosen(number)
        return chosen.stop - chosen.start

    def recordable(self, number):
        return self._divided.kept_energy(number)

    def add(self, number, plane, out, progress):
        from ..tracing.wave_tracer import add_pixels

        chosen, whole = self._chosen(number), self._divided.hologram
        for frames, pixels, values in self._divided.stored(self._group, number, plane):
            start, stop = max(frames.start, chosen.start), min(frames.stop, chosen.stop)
            if start < stop:
                mine = values[start - frames.start : stop - frames.start, self._colour : self._colour + 1]
                add_pixels(out[start - chosen.start : stop - chosen.start], whole, pixels, mine)
            progress(0.5, "Joining waves")


def _report(folder, name):
    """The report of a step; empty where it is not done."""
    try:
        return json.loads((folder / name / REPORT).read_text())
    except FileNotFoundError:
        return {}


def _united(ways):
    """Ways of one wavelength whose frames follow each other, as one."""
    found = []
    for k, start, stop in ways:
        if found and found[-1][0] == k and found[-1][2] == start:
            found[-1] = k, found[-1][1], stop
        else:
            found.append((k, start, stop))
    return found


def _json(values):
    """JSON; infinite numbers as Python writes them."""
    return json.dumps(values, default=lambda number: number.item())
