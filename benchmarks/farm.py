"""Farms on paper: 1 to 1,024 workers, simulated from what this machine measures.

``python -m benchmarks farm`` measures small frames, a minute or two; ``farm full`` Full HD ones, in ten.
What was measured goes to out/bench/farm.json, with which ``farm again`` only simulates. ``farm check`` measures two
processes that share small frames, and says what the simulation foretells of them.
A worker is a machine as this one: units take as long as with all of its processors.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, replace
from pathlib import Path

from holopath_addon.engine import files
from holopath_addon.workflow import stills

from .farm_operations import Operations, rules
from .farm_simulation import Dask, Folder, Rules, Step, simulate

SMALL, FULL_HD = (256, 144), (1920, 1080)
WORKERS = tuple(2**n for n in range(11))
FRAMES = 250
# Assumed, not measured: shares of NFS, a small one and one as a cluster has.
SLOW, QUICK = Folder("1 Gbit/s", 0.125e9, 2_000), Folder("10 Gbit/s", 1.25e9, 20_000)
LOCAL = Folder("a disk", 1e9, 100_000)
MOST_BEFORE = 256  # workers; with more all look at all without end


# What this machine takes


def _words(scene, size, *more):
    return ["render", scene, "--resolution", "{}x{}".format(*size), "--focus", "1m", "--frames", "8", *more]


def measured(size, folder: Path) -> dict:
    """Seconds, bytes and file operations of all that a farm does with frames of a size, on this machine."""
    return {"size": size, "rules": asdict(rules()), **_film(size, folder), "dask": _dask()}


def _film(size, folder):
    """Seconds to open the scene; a frame's, its bytes, and the seconds that a process's first one takes besides."""
    words = _words("demo:suzanne", size, "--method", "full", "--out", str(folder / "film"))
    spent = _run([*words, "--frame-range", "2-3"])
    reports = [folder / "film" / f"frame_{number:04d}" / "report.json" for number in (2, 3)]
    first, second = (json.loads(path.read_text())["seconds"]["total"] for path in reports)
    frame = reports[1].parent
    written = sum(path.stat().st_size for path in frame.rglob("*") if path.is_file())
    with Operations(folder) as operations:
        stills.is_complete(frame, json.loads(reports[1].read_text())["job"], "none")
    done = operations.count
    return {"start": spent - first - second, "frame": [second, written, done, max(first - second, 0.0)]}


def _run(words):
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "holopath_addon", *words],
        check=True,
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )
    return time.perf_counter() - start


def _dask():
    """Seconds of Dask for a task: that nobody else has meanwhile, and until a worker has its next one."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        client.gather(client.map(_same, range(100), pure=False))
        start = time.perf_counter()
        client.gather(client.map(_same, range(1000), pure=False))
        each = (time.perf_counter() - start) / 1000
        start = time.perf_counter()
        for number in range(100):
            client.submit(_same, number, pure=False).result()
        return {"serial": each, "latency": (time.perf_counter() - start) / 100}


def _same(number):
    return number


def measure(kept: Path, size=SMALL) -> dict:
    """What `simulate` takes, of holograms of a size; kept in a file, too."""
    kept.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
        found = measured(size, Path(folder).absolute())
    with files.whole_file(kept) as part:
        part.write_text(json.dumps(found))
    return found


# As `rules` found it of the version before 26 November 2026, to compare with.
BEFORE = Rules(38, 28, 58, 96, 15, 32, 0, 9, 1, 10, 8, 3.2, crowd=0)


# What a farm would take


def film(found) -> list[Step]:
    """Units of an animation."""
    seconds, written, done, first = found["frame"]
    frame = Step("", "last frames", seconds, written, first, done)
    return [replace(frame, name=f"frame_{n:04d}") for n in range(FRAMES)]


def table(found, counts) -> str:
    """A row for each number of workers."""
    steps, asked, dask = film(found), Rules(**found["rules"]), Dask(**found["dask"])
    lines = [
        "{} frames of {} x {}; seconds".format(len(steps), *found["size"]),
        f"on {SLOW.name} and on {QUICK.name}; efficiency and what limits are those on the first",
        f"  {'workers':>7s} {SLOW.name:>10s} {'speed-up':>8s} {'eff.':>5s} {'limit':22s} {'op/s':>6s} "
        f"{'MB/s':>5s} {'before':>10s} {QUICK.name:>10s} {'speed-up':>8s} {'limit':22s} {'Dask':>8s}",
    ]
    alone, knee = None, 0
    for workers in counts:
        slow, quick = (simulate(steps, workers, folder, asked, found["start"]) for folder in (SLOW, QUICK))
        alone = alone or (slow.seconds, quick.seconds)
        before = simulate(steps, workers, SLOW, BEFORE, found["start"]) if workers <= MOST_BEFORE else None
        handed = simulate(steps, workers, QUICK, asked, found["start"], dask)
        faster, quicker = alone[0] / slow.seconds, alone[1] / quick.seconds
        knee = workers if faster / workers >= 0.5 else knee
        lines.append(
            f"  {workers:7d} {slow.seconds:10.0f} {faster:8.1f} {faster / workers:5.0%} "
            f"{slow.limit:22s} "
            f"{slow.operations / slow.ended:6.0f} {slow.bytes / slow.seconds / 1e6:5.0f} "
            f"{f'{before.seconds:10.0f}' if before else '':>10s} {quick.seconds:10.0f} {quicker:8.1f} "
            f"{quick.limit:22s} {handed.seconds:8.0f}"
        )
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join([*lines, f"  up to {knee} workers are used by half or more"])


def check(kept: Path, size=SMALL, frames=6) -> str:
    """Processes with one processor each that share small work; and what is foretold of them."""
    processors = sorted(os.sched_getaffinity(0))[:2]
    os.sched_setaffinity(0, processors[:1])
    found, lines = measure(kept, size), []
    cache = ["--cache", str(kept.absolute().with_suffix(".cache"))]
    with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
        _run(
            [
                *_words("demo:suzanne", size, *cache, "--out", folder),
                "--method",
                "fast",
                "--frame-range",
                "1",
            ]
        )
    more = "--method", "fast", "--frame-range", f"1-{frames}", *cache
    for workers in (1, 2):
        with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
            words = _words("demo:suzanne", size, *more, "--out", f"{folder}/out")
            start = time.perf_counter()
            command = [sys.executable, "-m", "holopath_addon", *words]
            running = [
                subprocess.Popen(["taskset", "-c", str(n), *command, "--quiet"]) for n in processors[:workers]
            ]
            assert not any(process.wait() for process in running)
            seconds = time.perf_counter() - start
        foretold = simulate(
            film(found)[:frames], workers, LOCAL, Rules(**found["rules"]), found["start"]
        ).ended
        lines.append(
            f"{frames} frames, {workers} processes: {seconds:.1f} s, {foretold / seconds - 1:+.0%} foretold"
        )
    return "\n".join(lines)


def run(folder, what="small", pixels=SMALL[0], max_workers=WORKERS[-1], frames=6) -> str:
    """A table as text; `pixels` is the width of what is measured where that is small, frames are of check."""
    kept = Path(folder) / "farm.json"
    small = pixels, pixels * SMALL[1] // SMALL[0]
    if what == "check":
        return check(kept, small, frames)
    if what == "again":
        found = json.loads(kept.read_text())
    else:
        found = measure(kept, FULL_HD if what == "full" else small)
    seconds, written, *_ = found["frame"]
    shown = (
        f"start {found['start']:.1f} s, a frame {seconds:.1f} s and {written / 1e6:.0f} MB; {found['rules']}"
    )
    workers = [count for count in WORKERS if count <= max_workers]
    return f"{shown}\n\n{table(found, workers)}"
