"""A render in parts that many processes make in one folder, and the field that they join to.

What a part computes depends neither on how many there are nor on who makes it: the field is that of `render` to the
last bit, on processors of one kind. Radiance maps divide by pixels, see `map_parts`. Rays divide by recording planes
and tiles of them, so that none is traced twice. The ways between planes and to the SLM divide by wavelengths and
multiplexed frames, which know nothing of each other. What all share is prepared once: the plan, baked light, maps that
look it up, and the energy of phase fields.
"""

from __future__ import annotations

import json
import secrets
from concurrent.futures import ThreadPoolExecutor
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
from .map_parts import ASKED, TOLD, MapParts, map_steps, save_maps, told_step
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
        Parts that radiance maps and rays divide into, and most that the ways to the SLM do.

    Raises
    ------
    InvalidInput
        Where the method does not divide.
    """
    if settings.method in BASELINES:
        raise InvalidInput(f"The method {settings.method} does not divide into parts: leave out --divide.")
    if not 1 <= count <= MOST_PARTS:
        raise InvalidInput(f"A hologram divides into 1 to {MOST_PARTS} parts, not {count}.")
    settings = planner.resolved(settings)
    maps = map_steps(count, PREPARED) if _mapped(settings) else {}
    traced = [f"{TRACED}-{n + 1}-of-{count}" for n in range(count)]
    ways = _ways(hologram, settings, count)
    gathered = [f"{GATHERED}-{n + 1}-of-{len(ways)}-of-{count}" for n in range(len(ways))]
    lit = ([PREPARED, *maps][-1],)
    return {PREPARED: (), **maps} | dict.fromkeys(traced, lit) | dict.fromkeys(gathered, tuple(traced))


def _mapped(settings):
    """Whether there are radiance maps."""
    return settings.radiance != "ray"


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
        variants.activate_for(scene)
        self.job = job
        self.scene, self.camera, self.hologram = scene, camera, hologram
        self.settings, self.folder, self.count = planner.resolved(settings), Path(folder), count
        self.steps = steps_of(hologram, settings, count)
        # of light that all need, not only the maps, all need the same
        self.store = store if store and _mapped(self.settings) else BakeStore(self.folder / "baked")
        self._light: dict[int, RadianceMap | PathsPerRay] = {}
        # Tells preparations apart: what was measured for one plan may have made another one, with other parts.
        self._mark = ""
        self._clock = Clock()
        self._last: tuple[int, np.ndarray | None] = -1, None

    @staticmethod
    def done(folder: Path, name: str, job: str) -> bool:
        """Whether the result of a step is there, of the same preparation as all others, or it is `needless`."""
        report = _report(folder, name, job)
        return report is not None or DividedRender.needless(folder, name, job)

    @staticmethod
    def needless(folder: Path, name: str, job: str) -> bool:
        """Whether a step is not to be made: a question that is not asked, as enough is known without it."""
        kind, _, rest = name.partition("-")
        if kind not in (ASKED, TOLD):
            return False
        number, count = int(rest.split("-")[0]), int(rest.split("-")[-1])
        for earlier in range(number - 1, -1, -1):
            report = _report(folder, told_step(earlier, count) if earlier else PREPARED, job)
            if report is not None:
                return report["maps"] is not None
        return False

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
        kind, *numbers = name.split("-")
        if kind == PREPARED:
            self._mark = secrets.token_hex(8)
        else:
            self._renew()
        with whole_folder(self.folder / name, lambda folder: None) as part:
            self._clock.seconds = {}
            if kind == PREPARED:
                report = self._prepare(part, progress)
            elif kind == ASKED:
                self._maps.ask(int(numbers[0]), int(numbers[1]) - 1, part, progress)
                report = {}
            elif kind == TOLD:
                report = {"maps": self._maps.tell(int(numbers[0]), part, progress)}
            elif kind == TRACED:
                report = self._trace(int(numbers[0]) - 1, part, progress)
            else:
                ways = _ways(self.hologram, self.settings, self.count)
                report = self._gather(ways[int(numbers[0]) - 1], part, progress)
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
            if self.needless(self.folder, name, self.job):
                continue
            report = self._report(name)
            seconds, rays = added(seconds, report["seconds"]), added(rays, report.get("rays", {}))
            for way, k, start, stop in report.get("ways", ()):
                field[start:stop, k] = np.load(self.folder / name / f"{way}_{FIELD}", allow_pickle=False)
            progress((number + 1) / len(self.steps), "Joining")
        plan, maps = prepared["plan"], self._lit[1]
        rays = added(maps["rays"], rays)
        report = report_of(
            plan, settings.frames, seconds, rays, maps["passes"], maps["error"], prepared["bake"]
        )
        return WaveField(field, hologram, self.camera, plan.near, plan.to_dict(), report)

    def _renew(self):
        """Go by the preparation that is there: what was read of one that it has replaced goes."""
        report = _report(self.folder, PREPARED, self.job)
        if report is None:
            raise InvalidInput(
                f"{self.folder / PREPARED} is of another hologram: give the same command again."
            )
        if report["mark"] != self._mark:
            self._mark = report["mark"]
            self._light.clear()
            self._last = -1, None
            for name in ("_prepared", "_planned", "_index", "_maps", "_lit"):
                self.__dict__.pop(name, None)

    def _report(self, name):
        """The report of a step that is done.

        Raises
        ------
        InvalidInput
            Where another process has prepared all anew meanwhile.
        """
        report = _report(self.folder, name, self.job)
        if report is None or report["mark"] != self._mark:
            raise InvalidInput(
                f"{self.folder / name} is of another preparation of this hologram: give the same command again."
            )
        return report

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

        own = planned.phasors
        with self._clock("phase fields"):
            kept = [kept_energy(phasors_numbered(n, own), settings.estimator) for n in self._sets]
        prepared = {
            "scene": scene_digest(self.scene),
            "plan": plan.to_dict(),
            "kept_energy": kept,
            "bake": None if planned.baked is None else asdict(planned.baked),
        }
        (folder / INDEX).write_text(_json(prepared))
        return {"maps": self._undivided(planned, folder, stage(progress, BAKING, 1.0))}

    def _undivided(self, planned, folder, progress):
        """Of the radiance maps, where they do not divide: of baked light, which is looked up quickly; else None."""
        if not _mapped(self.settings):
            return {"error": None, "passes": None, "rays": {}}
        if not planned.plan.cached:
            return None

        def measured():
            for group, told in zip(planned.groups, parts(progress, len(planned.groups)), strict=True):
                with planned.recording(group) as recording:
                    radiance = recording.radiance(named(told, "Radiance"))
                yield radiance

        return save_maps(planned, measured(), folder)

    @cached_property
    def _maps(self) -> MapParts:
        return MapParts(self._planned, self.count, lambda name: self._made(name))

    def _made(self, name):
        """The folder of a step that is done."""
        self._report(name)
        return self.folder / name

    @cached_property
    def _lit(self) -> tuple[Path, dict[str, Any]]:
        """Where the radiance maps are, and what is told of them."""
        for name in self.steps:
            report = _report(self.folder, name, self.job)
            if report is not None and report.get("maps") is not None:
                return self._made(name), report["maps"]
        raise InvalidInput(f"{self.folder} has no radiance: give the same command again.")

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
        if not _mapped(self.settings):  # else the light is in the maps
            planned.bake(self.store, lambda done, message: None)
        return planned

    def _radiance(self, number, recording):
        """Where the rays of a group of wavelengths have their light from."""
        from ..tracing.stored_map import load_map

        if number not in self._light:
            self._light[number] = (
                load_map(self._lit[0] / f"map_{number}")
                if _mapped(self.settings)
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
                    straight = planned.straight if phasors == OWN else 0.0
                    for block, pixels, values in recording.trace(*what, lambda done: None, straight):
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
        divisible = _mapped(self.settings) and self.settings.estimator != "paper"
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
            with planned.recording(wavelengths) as recording:
                hologram = replace(recording.hologram, wavelengths=(wavelengths[colour],))
                stored = _Stored(self, group, colour, hologram, slice(start, stop))
                field = at_slm(recording, stored, self.hologram, parts(progress, len(ways))[number])
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
                folder = self._made(name)
                found += [(folder / VALUES, row) for row in json.loads((folder / INDEX).read_text())]
        return found

    def stored(
        self, group: int, phasors: int, plane: RecordingPlane, chosen: slice, colour: int
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """What was traced of a plane, of some frames and one wavelength of the group: which of the frames, pixels and
        values, as `wave_tracer.trace_blocks` has them. Nothing else is read, for the folder may be on a network.
        """
        wanted = [group, phasors, self._prepared["plan"].planes.index(plane)]
        colours = len(self._planned.groups[group])
        for file, (*place, start, stop, count, offset) in self._index:
            first, last = max(start, chosen.start), min(stop, chosen.stop)
            if place != wanted or first >= last:
                continue
            with open(file, "rb") as stream:
                stream.seek(offset)
                pixels = np.fromfile(stream, "<u4", count)
                values = np.empty((last - first, 1, count), np.complex64)
                for number, frame in enumerate(range(first, last)):
                    row = (frame - start) * colours + colour
                    stream.seek(offset + pixels.nbytes + row * values[0].nbytes)
                    values[number] = np.fromfile(stream, "<c8", count)
            yield slice(first, last), pixels, values


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

        chosen, whole = self._chosen(number), self._divided._planned.hologram
        what = self._group, number, plane, chosen, self._colour
        with ThreadPoolExecutor(variants.threads()) as executor:
            for frames, pixels, values in self._divided.stored(*what):
                own = slice(frames.start - chosen.start, frames.stop - chosen.start)
                add_pixels(out[own], whole, pixels, values, executor)
                progress(0.5, "Joining waves")


def _report(folder, name, job):
    """The report of a step of a job's preparation that is there; None where it is not done."""
    report, prepared = _read(folder / name), _read(folder / PREPARED)
    if report.get("job") == prepared.get("job") == job and report["mark"] == prepared["mark"]:
        return report
    return None


def _read(folder):
    try:
        return json.loads((folder / REPORT).read_text())
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
