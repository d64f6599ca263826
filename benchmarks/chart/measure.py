"""Measures records, one scene and method in a process: ``python -m benchmarks.chart.measure TASK``, a JSON file.

Seconds are those of the whole pipeline from the scene to the field or phases: planning, pictures, bakes, descents. Of
the plan baselines take no more than the range of depths in view, so that it is given to them and not counted. The
kernels are compiled beforehand, by a run with hardly any work; what takes under `SHORT` seconds runs twice, and the
shorter time counts.
"""

import ctypes
import functools
import gc
import hashlib
import importlib.util
import json
import re
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.scene import variants
from holopath_addon.engine.viewing.metrics import display_values
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

from ..parts import sentence_of
from . import looks, peers
from .figures import FLIP_MODULE, figures, of_eight_bits, psnr_of_headline
from .methods import M, methods, warmed
from .scenes import SCENES, built

SHORT = 3.0
EIGHT_BITS = ("psnr_8_bits", "psnr_worst_8_bits")  # None of what is no phases
OVER = "over "  # how the reason of a record begins that was given up after its limit
SHOWN = ("front", "back", "view-right")  # pictures that are kept for the close-ups
ROOT = Path(__file__).parents[2]
ENGINE = ROOT / "holopath_addon" / "engine"
OWN = Path(__file__).parent
SCENE_CODE = (
    *(OWN / f"{name}.py" for name in ("scenes", "portrait", "photograph")),
    OWN.parent / "scenes.py",
    ROOT / "holopath_addon" / "blender" / "demo.py",
    *sorted((ROOT / "holopath_addon" / "exchange" / "captures").glob("*.py")),
    ENGINE / "scene" / "captured" / "picture.py",
)
FIGURES_CODE = (OWN / "figures.py", OWN / "measure.py")
TRUTH_CODE = (
    OWN / "looks.py",
    ENGINE / "viewing/reference.py",
    ENGINE / "viewing/preview.py",
    ENGINE / "mapping.py",
    ENGINE / "baselines" / "focal_stack.py",  # whose planes others than those lie between
)


@dataclass(frozen=True)
class Task:
    """Records of one method and scene.

    Attributes
    ----------
    scene, method : str
        A method is also ``reference``: the truth alone.
    hologram : dict
        Of `engine.Hologram`.
    spp : int
        Paths a pixel of the reference.
    limit : float
        Seconds after which a record is given up, and those of more work with it.
    records : list of (str, int)
        Effort and frames, in order of work.
    folder : str
    slower : float
        How much slower this machine is than that in whose seconds efforts are limited.
    """

    scene: str
    method: str
    hologram: dict
    spp: int
    limit: float
    records: list
    folder: str
    slower: float = 1.0

    def encoding(self, method, effort):
        """`Method.encoding`, with its limit in this machine's seconds."""
        words = method.encoding(effort)
        if words and "seconds" in words:
            return words | {"seconds": words["seconds"] * self.slower}
        return words


def digest_of(*things):
    """Digest of files, which are `Path`, and of what JSON can write."""
    digest = hashlib.sha256()
    for thing in things:
        text = thing.read_bytes() if isinstance(thing, Path) else json.dumps(thing, sort_keys=True).encode()
        digest.update(len(text).to_bytes(8, "big") + text)
    return digest.hexdigest()[:16]


@functools.cache
def code_of(kind):
    """Digest of what decides what a kind of method does: the engine, and with baselines theirs."""
    files = sorted(
        path
        for path in ENGINE.rglob("*")
        if path.suffix in (".py", ".npy") and "baselines" not in path.parts  # phase maps, too
    )
    if kind in ("baseline", "peer"):
        files += sorted((ENGINE / "baselines").glob("*.py"))
    if kind == "peer":
        files.append(OWN / "peers.py")
    return digest_of(*files)


def record_path(task, effort, frames):
    """File of a record; its pictures lie beside it."""
    size = f"{task.hologram['width']}"
    name = "-".join((task.scene, size, task.method, effort, f"M{frames}"))
    return Path(task.folder) / "records" / (re.sub(r"[^\w.-]+", "_", name) + ".json")


def record_digest(task, method, effort, frames):
    """Of all that decides a record."""
    settings, encoding = asdict(method.settings(effort, frames)), task.encoding(method, effort)
    return digest_of(
        code_of(method.kind),
        *((Path(pipeline.__file__), encoding) if encoding else ()),
        *SCENE_CODE,
        *TRUTH_CODE,
        *FIGURES_CODE,
        importlib.util.find_spec(FLIP_MODULE) is not None,
        task.hologram,
        task.spp,
        task.limit,
        settings,
    )


def kept(task, effort, frames):
    """An earlier record that is still true; None where there is none."""
    path = record_path(task, effort, frames)
    with suppress(OSError, ValueError, KeyError):
        record = json.loads(path.read_text())
        method = methods(engine.Hologram(**task.hologram))[task.method]
        if record["digest"] == record_digest(task, method, effort, frames):
            return record
    return None


def is_fault(record):
    """Whether a record failed; one that was given up after its limit did not."""
    return "failed" in record and not record["failed"].startswith(OVER)


def is_done(task):
    """Whether there is nothing to measure: a record that failed is tried again."""
    if task.method == "reference":
        return task.scene not in SCENES or truth_path(task).exists()
    records = [kept(task, *record) for record in task.records]
    return all(record and not is_fault(record) for record in records)


def truth_path(task):
    """File of a scene's truth."""
    digest = digest_of(*SCENE_CODE, *TRUTH_CODE, task.scene, task.hologram, task.spp)
    name = f"{task.scene}-{task.hologram['width']}-{digest}.npz"
    return Path(task.folder) / "references" / name


def truth_for(task, scene, camera, hologram):
    """The truth of a task's scene, kept on disk; None for scenes that are only timed."""
    if task.scene not in SCENES:
        return None
    path = truth_path(task)
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        start = time.perf_counter()
        truth = looks.truth_of(
            scene, camera, hologram, SCENES[task.scene].foci, task.spp, lambda done, what: None
        )
        part = path.with_suffix(".part.npz")
        np.savez(part, **truth, seconds=time.perf_counter() - start)
        part.replace(path)
    with np.load(path) as file:
        return dict(file)


def _tell(line):
    print(line, file=sys.stderr, flush=True)


def run(task, tell=_tell):
    """Measure a task's records that are not kept, and write each as soon as it is there.

    Parameters
    ----------
    task : Task
    tell : callable
        ``tell(line)`` for each.
    """
    variants.activate()
    hologram = engine.Hologram(**task.hologram)
    scene, camera = built(task.scene, hologram.width)
    truth = truth_for(task, scene, camera, hologram)
    if task.method == "reference":
        return
    method = methods(hologram)[task.method]
    gave_up = []  # frames of records that were; what comes after them is more work
    for effort, frames in task.records:
        if (earlier := kept(task, effort, frames)) and not is_fault(earlier):
            continue
        if any(fewer <= frames for fewer in gave_up):
            result = {"failed": f"{OVER}{task.limit:g} s"}
        else:
            result = _measured(task, method, effort, frames, scene, camera, hologram, truth)
        if result.get("failed", "").startswith(OVER):
            gave_up.append(frames)
        record = {
            "method": task.method,
            "kind": method.kind,
            "scene": task.scene,
            "frames": frames,
            "effort": effort,
            "pixels": hologram.width,
            **result,
            "settings": asdict(method.settings(effort, frames)),
            "digest": record_digest(task, method, effort, frames),
        }
        path = record_path(task, effort, frames)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record, indent=1))
        tell(line_of(record))


def line_of(record):
    """A record in a line."""
    name = f"{record['scene']}: {record['method']}, {record['effort']}, M = {record['frames']}: "
    if "failed" in record:
        return name + record["failed"]
    figures = f"{record['seconds']:.2f} s, {record['peak_bytes'] / 1e9:.2f} GB"
    if record["psnr"] is not None:
        figures += f", {record['psnr']:.2f} dB, at worst {record['psnr_worst']:.2f}"
    return name + figures


def _measured(task, method, effort, frames, scene, camera, hologram, truth):
    settings, encoding = method.settings(effort, frames), task.encoding(method, effort)
    view, limit, clock = (scene, camera, hologram), task.limit, Stages(task.limit)
    try:
        warm = _rendered(method, *view, warmed(settings), encoding, Stages(limit))
        if encoding:
            _encode(method, warm, encoding | {"max_steps": 1}, Stages(limit), scene, settings)
        free()
        seconds, field = _timed(method, *view, settings, encoding, clock)
        peak = peak_bytes()
        if seconds < SHORT:
            again, field = _timed(method, *view, settings, encoding, Stages(limit))
            seconds = min(seconds, again)
        result = {"seconds": seconds, "peak_bytes": peak, "stages": clock.seconds, "psnr": None}
        if truth is None:
            return result
        foci = SCENES[task.scene].foci
        pictures = looks.seen(field, foci, truth["others"])
        result |= figures(pictures, truth, hologram) | dict.fromkeys(EIGHT_BITS)
        if method.phases or encoding:
            levels = looks.seen(of_eight_bits(field), foci, truth["others"], len(looks.HEADLINE))
            result |= dict(zip(EIGHT_BITS, psnr_of_headline(levels, truth, hologram), strict=True))
        if frames == M:
            path = record_path(task, effort, frames).with_suffix(".npz")
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(path, **displayed(pictures, truth, looks.border_of(hologram)))
    except engine.Cancelled:
        return {"failed": f"{OVER}{limit:g} s"}
    except Exception as error:  # one method's fault is no other's
        return {"failed": sentence_of(error)}
    return result


def _timed(method, scene, camera, hologram, settings, encoding, clock):
    """Seconds, and the field; the baselines' plan, of which they take the depths in view alone, is not counted."""
    plan = engine.plan(scene, camera, hologram, settings) if method.kind in ("baseline", "peer") else None
    start = time.perf_counter()
    field = _rendered(method, scene, camera, hologram, settings, encoding, clock, plan)
    if encoding:
        field = _encode(method, field, encoding, clock, scene, settings).field()
    return time.perf_counter() - start, field


def _encode(method, field, encoding, clock, scene, settings):
    """Phases; those of other methods take nothing more of the scene."""
    scene = scene if method.kind == "ours" else None
    own = {name: value for name, value in encoding.items() if name not in ("method", "seconds")}
    asked = Encoding(encoding["method"], encoding.get("seconds"))
    return pipeline.encode(field, asked, clock, scene, settings, **own)


def _rendered(method, scene, camera, hologram, settings, encoding, clock, plan=None):
    """The field, with the extra frames that the encoding needs."""
    clock.start()
    extra_frames = 0
    if encoding:
        plan = plan or engine.plan(scene, camera, hologram, settings)
        extra_frames = engine.extra_frame_count(plan, hologram, **encoding)
    if method.kind == "peer":
        return peers.render(method.name, scene, camera, hologram, settings, plan, clock)
    return engine.render(scene, camera, hologram, settings, plan, clock, extra_frames=extra_frames)


class Stages:
    """A progress callback that sums seconds by message, until the next one, and cancels after `limit` seconds."""

    def __init__(self, limit):
        self.seconds, self._limit, self._stage = {}, limit, "Planning"
        self.start()

    def start(self):
        """Begin to count."""
        self._start = self._last = time.perf_counter()

    def __call__(self, done, message):
        message = message.split(",")[0]  # what is told of how far it came is no other stage
        now = time.perf_counter()
        if now - self._start > self._limit:
            raise engine.Cancelled("It takes too long.")
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._last
        self._last, self._stage = now, message


def displayed(pictures, truth, border):
    """Pictures for the close-ups, 8 bits, by name; as bright as the reference."""
    inner = slice(border, -border or None)
    out = {}
    for name in SHOWN:
        number = looks.HEADLINE.index(name)
        mean = truth["pictures"][number].mean(0)
        _, wanted, scale = display_values(pictures[number], mean, border)
        root = np.sqrt(mean[inner, inner])
        white = np.percentile(root, 95)
        values = np.sqrt(np.maximum(scale * pictures[number][inner, inner], 0)) / white
        out[name] = np.clip(255 * values, 0, 255).astype(np.uint8)
    return out


def free():
    """Give memory of earlier work back, and begin to look for the peak anew."""
    import drjit

    gc.collect()
    drjit.flush_malloc_cache()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_bytes():
    """Most memory that this process has had since `free`; where the system does not tell that, since its start."""
    with suppress(OSError, IndexError):
        return int(re.findall(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())[0]) << 10
    import resource

    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most << 10


if __name__ == "__main__":
    file = Path(sys.argv[1])
    try:
        run(Task(**json.loads(file.read_text())))
    except Exception as error:
        file.with_suffix(".why").write_text(sentence_of(error))
        raise
