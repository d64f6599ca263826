"""Published records: a JSON file for each scene, from all of which docs/chart.md is written.

The whole chart takes longer than one sitting on a slow machine. Methods are compared at equal seconds within a scene,
so each scene is measured whole on one machine, which its file names. Records that were renewed on another one
(`renewal`) are in its seconds.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

FOLDER = Path("docs/chart")
TRIANGLES = "triangles"  # name of the part with scenes of many triangles, which are only timed
DIGITS = 6  # significant digits of a figure
UNPUBLISHED = ("settings", "digest")  # of a record: what decides whether it is measured again


def part_of(scene):
    """Name of the part in which records of a scene are."""
    return TRIANGLES if scene.startswith("hills ") else scene


def parts_of(records, made, references) -> dict[str, dict[str, Any]]:
    """Split records by scene.

    Parameters
    ----------
    records : list of dict
        With those that ``failed``.
    made : report.Made
        The run that measured them.
    references : dict of str to dict
        PSNR that the reference allows, by scene.

    Returns
    -------
    dict of str to dict
        By part: ``made``, ``reference`` (None of scenes that are only timed) and ``records``; ``renewals``, if records
        were measured anew later, see `renewal`.
    """
    parts = {}
    for record in records:
        scene = record["scene"]
        part = {"made": asdict(made), "reference": references.get(scene), "records": []}
        parts.setdefault(part_of(scene), part)["records"].append(record)
    return parts


def save(parts, folder):
    """Write parts, each to a file of its name in a folder; parts of other scenes stay."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    for name, part in parts.items():
        records = [{k: _short(v) for k, v in r.items() if k not in UNPUBLISHED} for r in part["records"]]
        head = {own: _short(value) for own, value in part.items() if own != "records"}
        head = json.dumps(head)[1:-1]
        lines = ",\n".join(json.dumps(record, separators=(",", ":")) for record in records)
        (Path(folder) / f"{name}.json").write_text(f'{{{head},\n"records": [\n{lines}\n]}}\n', "utf-8")


def load(names, folder) -> dict[str, dict[str, Any]]:
    """Read the parts of these names that are in a folder, in their order."""
    files = {name: Path(folder) / f"{name}.json" for name in names}
    return {name: json.loads(file.read_text("utf-8")) for name, file in files.items() if file.exists()}


def _short(value):
    if isinstance(value, dict):
        return {name: _short(own) for name, own in value.items()}
    if isinstance(value, list):
        return [_short(own) for own in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
