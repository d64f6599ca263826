"""Renewal of records of some numbers of frames in what is published, on any machine.

A chart takes hours, and machines differ by a factor of three. So a published scene can be renewed in part: this machine
measures again what that of the scene has measured, records of code that hardly changes, and its seconds are divided by
how much slower it is. An effort that is limited in seconds has as many times more of them here, for the same work.
"""

import statistics
from dataclasses import asdict, replace

from holopath_addon import engine

from . import archive, measure
from .methods import SHOWN, M, methods

INTERRUPTED = "interrupted"  # reason of what was not measured because somebody stopped the chart
# Of what is timed on both machines: renders, transforms and descents, some 30 s.
TIMED = {"rgbd": ("balanced", SHOWN), "rgbd-sgd": ("preview",)}


def tasks_of(chart, scene, names, frames, efforts=()):
    """Tasks of a scene that tell how fast this machine is, and those of records of some numbers of frames.

    Parameters
    ----------
    chart : run.Chart
    scene : str
    names : sequence of str
        Of methods.
    frames : sequence of int
    efforts : sequence of str
        Names of the efforts that are renewed; none for all.

    Returns
    -------
    (list of measure.Task, list of measure.Task)
    """
    known = methods(chart.hologram)
    timed = [chart.task(scene, name, [(e, M) for e in efforts]) for name, efforts in TIMED.items()]
    renewed = []
    for name in names:
        records = [
            (effort, m)
            for effort, m in chart.records(scene, known[name])
            if m in frames and (not efforts or effort in efforts)
        ]
        if records:
            renewed.append(chart.task(scene, name, records))
    return timed, renewed


def renew(chart, scenes, names, frames, efforts, do, made):
    """Measure records of some numbers of frames anew, and publish them among those of their scenes.

    Parameters
    ----------
    chart : run.Chart
    scenes, names : sequence of str
        Of scenes and methods.
    frames : sequence of int
    efforts : sequence of str
        See `tasks_of`.
    do : callable
        ``do(chart, tasks)`` measures tasks that are not done, and returns their records.
    made : callable
        ``made()`` is the `report.Made` of now.

    Returns
    -------
    list of str
        What failed, a sentence each; what was published of it stays.

    Raises
    ------
    InvalidInput
        If a scene is not published, or there is nothing to renew.
    """
    published, faults = archive.load(scenes, archive.FOLDER), []
    for scene in scenes:
        if scene not in published:
            raise engine.InvalidInput(
                f"The scene {scene} is not published in {archive.FOLDER}: measure all of it, without --frames."
            )
    if not any(tasks_of(chart, scene, names, frames, efforts)[1] for scene in scenes):
        raise engine.InvalidInput(
            "No record has such a scene, method, effort and number of frames: choose others for --frames or --efforts."
        )
    for scene in scenes:
        timed, renewed = tasks_of(chart, scene, names, frames, efforts)
        for task in timed:
            for record in task.records:
                measure.record_path(task, *record).unlink(missing_ok=True)
        reference = chart.task(scene, "reference", [])
        now = do(chart, [reference, *timed])
        if _is_interrupted(now):
            break
        slower = slower_than(published[scene]["records"], now)
        records = do(chart, [replace(task, limit=task.limit * slower, slower=slower) for task in renewed])
        faults += [measure.line_of(record) for record in records if measure.is_fault(record)]
        archive.save({scene: merged(published[scene], records, asdict(made()), slower)}, archive.FOLDER)
        if _is_interrupted(records):
            break
    return faults


def _is_interrupted(records):
    return any(record.get("failed") == INTERRUPTED for record in records)


def slower_than(before, now):
    """Median of the ratios of seconds, of records now and of those of the same key before."""
    seconds = {_key(record): record.get("seconds") for record in before}
    ratios = [r["seconds"] / seconds[_key(r)] for r in now if "failed" not in r and seconds.get(_key(r))]
    if not ratios:
        raise engine.InvalidInput(
            "No record was measured on both machines, so that seconds cannot be compared."
        )
    return statistics.median(ratios)


def merged(part, records, made, slower):
    """A part of the archive with `records` in place of those before, in its machine's seconds."""
    renewed = {}
    for record in records:
        if measure.is_fault(record):
            continue
        if "failed" in record:
            seconds = float(record["failed"].removeprefix(measure.OVER).split()[0])
            record = record | {"failed": f"{measure.OVER}{seconds / slower:g} s"}
        else:
            stages = {name: seconds / slower for name, seconds in record["stages"].items()}
            record = record | {"seconds": record["seconds"] / slower, "stages": stages}
        renewed[_key(record)] = record
    kept = [record for record in part["records"] if _key(record) not in renewed]
    keys = [list(key) for key in renewed]
    earlier = [
        run | {"records": [key for key in run["records"] if key not in keys]}
        for run in part.get("renewals", ())
    ]
    runs = [*earlier, made | {"slower": slower, "records": keys}]
    runs = [run for run in runs if run["records"]]
    return part | {"records": [*kept, *renewed.values()], "renewals": runs}


def _key(record):
    return record["method"], record["effort"], record["frames"]
