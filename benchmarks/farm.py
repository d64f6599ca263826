"""Farms on paper: 1 to 1,024 workers, simulated from what this machine measures.

``python -m benchmarks farm`` measures a small hologram, a minute or two; ``farm full`` a Full HD one, in ten.
What was measured goes to out/bench/farm.json, with which ``farm again`` only simulates. ``farm check`` measures two
processes that share a small still, and says what the simulation foretells of them.
A worker is a machine as this one: units take as long as with all of its processors.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import asdict, replace
from pathlib import Path
from statistics import mean

from holopath_addon import cli, engine
from holopath_addon.command_line import render_command, sources
from holopath_addon.engine import files
from holopath_addon.engine.rendering.division import steps_of
from holopath_addon.engine.rendering.map_parts import ASKED, TOLD
from holopath_addon.farm.parts import JOINED, StillParts

from .farm_operations import Operations, rules
from .farm_simulation import Dask, Folder, Rules, Step, simulate

SMALL, FULL_HD, UHD = (256, 144), (1920, 1080), (3840, 2160)
COUNTS = (16, 2)  # parts of the stills that are measured: how much of a unit's time does not divide
WORKERS = tuple(2**n for n in range(11))
FRAMES = 250
MOST_PARTS = 128  # of a still: a Full HD radiance map has hardly more chunks
# Assumed, not measured: shares of NFS, a small one and one as a cluster has.
SLOW, QUICK = Folder("1 Gbit/s", 0.125e9, 2_000), Folder("10 Gbit/s", 1.25e9, 20_000)
LOCAL = Folder("a disk", 1e9, 100_000)
MOST_BEFORE = 256  # workers; with more all look at all without end


# What this machine takes


def _nothing(*_):
    pass


def _words(scene, size, *more):
    return ["render", scene, "--resolution", "{}x{}".format(*size), "--focus", "1m", "--frames", "8", *more]


def measured(size, folder: Path) -> dict:
    """Seconds, bytes and file operations of all that a farm does with holograms of a size, on this machine."""
    args = cli.parse(_words("demo:suzanne", size, "--method", "full", "--out", str(folder / "still")))
    still = render_command.still_of(args, sources.open_source(args.scene), "benchmark")
    asked = {"hologram": json.dumps(still.hologram.to_dict()), "settings": json.dumps(asdict(still.settings))}
    found = {"size": size, **asked, "units": _units(still, folder), "rules": asdict(rules())}
    return found | _film(size, folder, found["units"][-1][-1]) | {"dask": _dask()}


def _film(size, folder, done):
    """Seconds to open the scene; a frame's, its bytes, and the seconds that a process's first one takes besides."""
    words = _words("demo:suzanne", size, "--method", "full", "--out", str(folder / "film"))
    spent = _run([*words, "--frame-range", "2-3"])
    reports = [folder / "film" / f"frame_{number:04d}" / "report.json" for number in (2, 3)]
    first, second = (json.loads(path.read_text())["seconds"]["total"] for path in reports)
    written = sum(path.stat().st_size for path in reports[1].parent.rglob("*") if path.is_file())
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


def _units(still, folder):
    """Of a still in parts, of both `COUNTS`: name, seconds, bytes read and written, operations of `done`."""
    rows = []
    for count in COUNTS:
        parts = StillParts(
            folder / "still",
            count,
            still.hologram,
            still.settings,
            still.job,
            "none",
            lambda: (still, 0.0),
            _nothing,
        )
        for name, unit in parts.units.items():
            if unit.done() or (name == JOINED and count != COUNTS[-1]):
                continue
            start, read = time.perf_counter(), _read()
            unit.make(_nothing)
            seconds, read = time.perf_counter() - start, _read() - read
            target = folder / "still" if name == JOINED else parts.folder / name
            written = sum(path.stat().st_size for path in target.rglob("*") if path.is_file())
            with Operations(folder) as operations:
                unit.done()
            rows.append([count, name, seconds, read, written, operations.count])
            print(*rows[-1], file=sys.stderr, flush=True)
    return rows


def _read():
    """Bytes that this process has asked files for; a disk may read ahead of it by much more."""
    told = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return int(told["rchar"])


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
    frame = Step("", "last frames", seconds, 0.0, written, first, done=done)
    return [replace(frame, name=f"frame_{n:04d}") for n in range(FRAMES)]


def still(found, count, scale=1.0) -> list[Step]:
    """Units of a still in parts, by the engine's graph; `scale` is how many times as many pixels as measured it has."""
    hologram, settings = (json.loads(found[name]) for name in ("hologram", "settings"))
    needs = steps_of(engine.Hologram.from_dict(hologram), engine.Settings(**settings), count)
    needs = _asked(needs, {_kind(row[1]) for row in found["units"]})
    needs[JOINED] = tuple(needs)
    kinds = [_kind(name) for name in needs]
    costs = {kind: _cost(found["units"], kind, kinds.count(kind), scale) for kind in set(kinds)}
    return [
        Step(name, kind, needs=needs[name], **costs[kind]) for name, kind in zip(needs, kinds, strict=True)
    ]


def _kind(name):
    """Units are alike but for the number of the part; questions of the radiance map are not."""
    words = name.split("-")
    return "-".join(words[:2]) if words[0] in (ASKED, TOLD) else words[0]


def _asked(needs, known):
    """Steps of a still but for questions that were not asked; who needs these needs what they need."""

    def those(names):
        for name in names:
            yield from [name] if _kind(name) in known else those(needs[name])

    return {name: tuple(dict.fromkeys(those(each))) for name, each in needs.items() if _kind(name) in known}


def _cost(rows, kind, number, scale):
    """Of one of so many units of a kind: a part that each has, and one that divides; what the first one has besides."""
    by_count = defaultdict(list)
    for count, name, *figures in rows:
        if _kind(name) == kind:
            by_count[count].append(figures)
    alike = [units[1:] or units for units in by_count.values()]
    numbers, found = [len(units) for units in by_count.values()], []
    for column in range(4):
        many, few = (mean(unit[column] for unit in alike[n]) for n in (0, -1))
        divides = (
            (few - many) / (1 / numbers[-1] - 1 / numbers[0])
            if numbers[0] > numbers[-1]
            else many * numbers[0]
        )
        divides = min(max(divides, 0.0), few * numbers[-1])
        found.append(max(few - divides / numbers[-1], 0.0) + scale * divides / number)
    first = next(iter(by_count.values()))[0]
    besides = [max(first[n] - mean(unit[n] for unit in alike[0]), 0.0) for n in range(2)]
    return {
        "seconds": found[0],
        "read": found[1],
        "written": found[2],
        "done": found[3],
        "first_seconds": besides[0],
        "first_read": scale * besides[1],
    }


def table(name, steps_by_workers, found) -> str:
    """Rows by workers."""
    asked, dask = Rules(**found["rules"]), Dask(**found["dask"])
    lines = [
        f"{name}; seconds, on {SLOW.name} and on {QUICK.name}; efficiency and what limits are those on the first",
        f"  {'workers':>7s} {'units':>5s} {SLOW.name:>10s} {'speed-up':>8s} {'eff.':>5s} {'limit':22s} {'op/s':>6s} "
        f"{'MB/s':>5s} {'before':>10s} {QUICK.name:>10s} {'speed-up':>8s} {'limit':22s} {'Dask':>8s}",
    ]
    alone, knee = None, 0
    for workers, steps in steps_by_workers:
        slow, quick = (simulate(steps, workers, folder, asked, found["start"]) for folder in (SLOW, QUICK))
        alone = alone or (slow.seconds, quick.seconds)
        before = simulate(steps, workers, SLOW, BEFORE, found["start"]) if workers <= MOST_BEFORE else None
        handed = simulate(steps, workers, QUICK, asked, found["start"], dask)
        faster, quicker = alone[0] / slow.seconds, alone[1] / quick.seconds
        knee = workers if faster / workers >= 0.5 else knee
        lines.append(
            f"  {workers:7d} {len(steps):5d} {slow.seconds:10.0f} {faster:8.1f} {faster / workers:5.0%} "
            f"{slow.limit:22s} "
            f"{slow.operations / slow.ended:6.0f} {slow.bytes / slow.seconds / 1e6:5.0f} "
            f"{f'{before.seconds:10.0f}' if before else '':>10s} {quick.seconds:10.0f} {quicker:8.1f} "
            f"{quick.limit:22s} {handed.seconds:8.0f}"
        )
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join([*lines, f"  up to {knee} workers are used by half or more"])


def best(found, workers, scale) -> list[Step]:
    """A still in the number of parts that is the best for so many workers."""
    rules = Rules(**found["rules"])
    counts = sorted({max(1, min(MOST_PARTS, round(workers * each))) for each in (0.25, 1, 2)})
    stills = [still(found, count, scale) for count in counts]
    return min(stills, key=lambda steps: simulate(steps, workers, SLOW, rules, found["start"]).seconds)


def check(kept: Path, size=SMALL, count=8, frames=6) -> str:
    """Processes with one processor each that share small work; and what is foretold of them."""
    processors = sorted(os.sched_getaffinity(0))[:2]
    os.sched_setaffinity(0, processors[:1])
    found, lines = measure(kept, size), []
    jobs = {
        f"a still in {count} parts": (["--method", "full", "--divide", str(count)], still(found, count)),
        f"{frames} frames": (["--method", "fast", "--frame-range", f"1-{frames}"], film(found)[:frames]),
    }
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
    for name, (more, steps) in jobs.items():
        for workers in (1, 2):
            with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
                words = _words("demo:suzanne", size, *more, "--out", f"{folder}/out", *cache)
                start = time.perf_counter()
                command = [sys.executable, "-m", "holopath_addon", *words]
                running = [
                    subprocess.Popen(["taskset", "-c", str(n), *command, "--quiet"])
                    for n in processors[:workers]
                ]
                assert not any(process.wait() for process in running)
                seconds = time.perf_counter() - start
            foretold = simulate(steps, workers, LOCAL, Rules(**found["rules"]), found["start"]).ended
            lines.append(
                f"{name}, {workers} processes: {seconds:.1f} s, {foretold / seconds - 1:+.0%} foretold"
            )
    return "\n".join(lines)


def run(folder, what="small", pixels=SMALL[0], max_workers=WORKERS[-1], parts=8, frames=6) -> str:
    """Tables as text; `pixels` is the width of what is measured where that is small, parts and frames are of check."""
    kept = Path(folder) / "farm.json"
    small = pixels, pixels * SMALL[1] // SMALL[0]
    if what == "check":
        return check(kept, small, parts, frames)
    if what == "again":
        found = json.loads(kept.read_text())
    else:
        found = measure(kept, FULL_HD if what == "full" else small)
    workers = [count for count in WORKERS if count <= max_workers]
    size, pixels = "{} x {}".format(*found["size"]), found["size"][0] * found["size"][1]
    larger = UHD[0] * UHD[1] / pixels
    seconds, written, *_ = found["frame"]
    shown = (
        f"start {found['start']:.1f} s, a frame {seconds:.1f} s and {written / 1e6:.0f} MB; {found['rules']}"
    )
    return "\n\n".join(
        [
            shown,
            table(f"{FRAMES} frames of {size}", ((w, film(found)) for w in workers), found),
            table(f"A still of {size}", ((w, best(found, w, 1.0)) for w in workers), found),
            table(
                "A still of 3840 x 2160, scaled by its pixels",
                ((w, best(found, w, larger)) for w in workers),
                found,
            ),
        ]
    )
