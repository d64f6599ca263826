"""A study: renders of all combinations of scenes, seeds, views and settings of a TOML file, and the table of them.

Each run is a still's output folder in ``runs/``, found again by a digest of what it is asked. The table is made of the
runs' reports, at any time.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import re
import tomllib
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from ..engine import InvalidInput
from ..engine.settings import DECLARED
from ..workflow import output
from . import ranges

# What a run may be asked, by the names of `holopath render`.
FLAGS = ("compare_reference", "rgbd", "run_scripts")
NAMES = (
    *DECLARED,
    *("display", "resolution", "pitch", "wavelengths", "depth_range", "depth_mapping", "near"),
    *(
        "camera",
        "move",
        "turn",
        "at_frame",
        "scene_name",
        "view_layer",
        "define",
        "focus",
        "pupil",
        "encode",
        "encode_seconds",
        "eyebox",
        "bits",
        "light_field",
        "quilt",
    ),
    *FLAGS,
)
PARTS = ("scenes", "seeds", "settings", "grid", "list", "views")
PLACE, TURN = ("right", "up", "forward"), ("turn_left", "turn_up")  # what a view varies
LONGEST = 60  # characters of a folder's readable name
FIGURES = (
    "psnr_db",
    "psnr_deviation_db",
    "psnr_of_diffracted_db",
    "psnr_ceiling_db",
    "ssim",
    "border_pixels",
)


@dataclass(frozen=True)
class Run:
    """One combination.

    Attributes
    ----------
    scene : str
        As the study has it.
    asked : dict of str to str, int, float or bool
        What `holopath render` is told, by name.
    varied : tuple of str
        Names of what differs between runs.
    view : int or None
        Number of the camera's place.
    """

    scene: str
    asked: dict
    varied: tuple = ()
    view: int | None = None

    @property
    def digest(self) -> str:
        """Of the scene's name and all that is asked."""
        asked = {name: str(value) for name, value in self.asked.items() if value is not False}
        return blake2b(json.dumps([self.scene, sorted(asked.items())]).encode(), digest_size=5).hexdigest()

    def folder(self, out: Path) -> Path:
        """Its output folder in that of the study; one that was called otherwise, as other settings varied, stays."""
        there = sorted((out / "runs").glob(f"*-{self.digest}"))
        if there:
            return there[0]
        words = [Path(self.scene.removeprefix("demo:")).stem]
        words += [] if self.view is None else [f"view{self.view}"]
        words += [f"{name}-{self.asked[name]}" for name in self.varied if name in self.asked]
        readable = re.sub(r"[^A-Za-z0-9.]+", "-", "-".join(words))[:LONGEST].strip("-.")
        return out / "runs" / f"{readable}-{self.digest}"

    def row(self) -> dict:
        """What is known of it before it is made."""
        asked = {name: " ".join(v) if isinstance(v, tuple) else v for name, v in self.asked.items()}
        return {"scene": self.scene, "view": self.view, **asked}


@dataclass(frozen=True)
class Study:
    """What a study's file asks for.

    Attributes
    ----------
    path : Path
    text : str
    runs : tuple of Run
        Without repetition, those of a scene one after another.
    """

    path: Path
    text: str = field(repr=False)
    runs: tuple = ()

    def scene(self, run: Run) -> str:
        """A run's scene as the command line takes it: paths are relative to the study's file."""
        return run.scene if run.scene.startswith("demo:") else str(self.path.parent / run.scene)


def read(path: Path | str) -> Study:
    """Read a study's file.

    Raises
    ------
    InvalidInput
        On what it must not say, in a sentence that names the file.
    """
    path = Path(path)
    try:
        text = path.read_text("utf-8")
        parts = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidInput(
            f"The study {path} cannot be read ({reason}): give a TOML file, see docs/study.md."
        ) from None
    try:
        return Study(path, text, tuple(_runs(parts)))
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def _runs(parts):
    """All combinations; scenes vary most slowly, as to open one takes time."""
    _known(parts, PARTS, "part")
    scenes = _list(parts.get("scenes"), "scenes")
    if not all(isinstance(scene, str) for scene in scenes):
        raise InvalidInput("scenes holds something other than names: give files and demo:NAME in quotes.")
    grid = {name: _list(values, f"{name} in [grid]") for name, values in _table(parts, "grid").items()}
    rows = parts.get("list", [{}])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InvalidInput("list is not a list of settings: begin each with [[list]].")
    common = _table(parts, "settings")
    axes = [set(grid), set().union(*rows), {"seed"} if "seeds" in parts else set()]
    views = list(_views(_table(parts, "views"))) if "views" in parts else [(None, {})]
    axes.append(set(views[0][1]))
    for one, other in itertools.combinations(axes, 2):
        for name in sorted(one & other):
            raise InvalidInput(
                f"{name} is given twice: leave it in one of seeds, [views], [grid] and [[list]]."
            )
    for names in (common, grid, *rows):
        _known(names, NAMES, "setting")
    seeds = _list(parts["seeds"], "seeds") if "seeds" in parts else [None]
    found = {}
    for scene, (view, place), row, seed, values in itertools.product(
        scenes, views, rows, seeds, itertools.product(*grid.values())
    ):
        asked = {**common, **row, **dict(zip(grid, values, strict=True)), **place}
        asked |= {} if seed is None else {"seed": seed}
        asked = {name: _word(name, value) for name, value in asked.items()}
        run = Run(scene, asked, (*row, *grid, *(["seed"] if len(seeds) > 1 else [])), view)
        found.setdefault(run.digest, run)
    return found.values()


def _views(asked):
    """Numbers of views, and what is asked for each: it stays the same where there are more of them."""
    _known(asked, ("count", "seed", "frames", *PLACE, *TURN), "part of [views]")
    count, seed = asked.get("count", 1), asked.get("seed", 0)
    if not (isinstance(count, int) and isinstance(seed, int) and count >= 1 and seed >= 0):
        raise InvalidInput("count and seed of [views] are not whole numbers: give for example count = 20.")
    frames = ranges.frames(str(asked["frames"])) if "frames" in asked else (None,)
    low, high = np.transpose([_range(asked, name) for name in (*PLACE, *TURN)])
    for view, (frame, _) in enumerate(itertools.product(frames, range(count))):
        place = [f"{x:.6g}" for x in np.random.default_rng([seed, view]).uniform(low, high)]
        given = {} if frame is None else {"at_frame": frame}
        given |= {"move": ",".join(place[:3])} if any(name in asked for name in PLACE) else {}
        given |= {"turn": ",".join(place[3:])} if any(name in asked for name in TURN) else {}
        yield view, given


def _range(asked, name):
    """Ends of a view's bound; a number is as far to either side."""
    ends = asked.get(name, 0.0)
    ends = ends if isinstance(ends, list) else [-ends, ends] if isinstance(ends, (int, float)) else []
    if len(ends) != 2 or not all(isinstance(end, (int, float)) and math.isfinite(end) for end in ends):
        raise InvalidInput(f"{name} of [views] is not a range: give its two ends, for example [-0.1, 0.1].")
    return ends


def _known(names, known, what):
    for name in names:
        if name not in known:
            raise InvalidInput(f"There is no {what} '{name}': choose of {', '.join(known)}.")


def _table(parts, name):
    table = parts.get(name, {})
    if not isinstance(table, dict):
        raise InvalidInput(f"{name} is not a table: write its names and values below [{name}].")
    return table


def _list(values, name):
    if not isinstance(values, list) or not values:
        raise InvalidInput(
            f"{name} is not a list of at least one: write for example {name.split()[0]} = [...]."
        )
    return values


def _word(name, value):
    """A setting's value as the command line takes it; a tuple is an option that is repeated."""
    if name in FLAGS:
        if not isinstance(value, bool):
            raise InvalidInput(f"{name} is neither true nor false, but {value}.")
        return value
    if isinstance(value, list) and not any(isinstance(part, (list, dict)) for part in value):
        return ("x" if name == "resolution" else ",").join(map(str, value))
    if isinstance(value, dict) and name == "define":
        return tuple(
            f"{key}={str(each).lower() if isinstance(each, bool) else each}" for key, each in value.items()
        )
    if isinstance(value, dict) and name == "fixed":
        return ",".join(f"{key}={each}" for key, each in value.items())
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise InvalidInput(f"{name} is {value}: give a number or a text, as on the command line.")
    return value


def check_free(out: Path) -> None:
    """Refuse an output folder that holds something other than a study's runs.

    Raises
    ------
    InvalidInput
    """
    if out.exists() and not out.is_dir():
        raise InvalidInput(f"The output {out} is a file: choose a folder with --out.")
    names = {path.name for path in out.iterdir()} if out.exists() else set()
    if names and "runs" not in names:
        raise InvalidInput(f"The output folder {out} holds no study: choose a new one with --out.")


# -- the table


def note_failure(out: Path, name: str, error: str) -> None:
    """Keep why a run failed, until it is made."""
    folder = out / "failed"
    output.write_pictures(folder, {f"{name}.txt": error.encode("utf-8")})


def failure(out: Path, name: str) -> str | None:
    """What `note_failure` kept of a run."""
    try:
        return _failure_file(out, name).read_text("utf-8")
    except OSError:
        return None


def forget_failure(out: Path, name: str) -> None:
    """The run is made, or to be tried again."""
    _failure_file(out, name).unlink(missing_ok=True)


def _failure_file(out, name):
    return out / "failed" / f"{name}.txt"


def rows(study: Study, out: Path) -> list[dict]:
    """The table: a row for each run and focus distance, or for a run that is not there.

    Parameters
    ----------
    study : Study
    out : Path
        Its output folder.

    Returns
    -------
    list of dict
        Values by the name of their column: text, numbers or None.
    """
    found = []
    for run in study.runs:
        folder = run.folder(out)
        failed, report = failure(out, folder.name), output.read_report(folder)
        row = {"run": folder.name, **run.row()}
        if failed or not report:
            found.append({**row, "error": failed or "This run is not made yet."})
            continue
        made = _of_report(report)
        figures = {_number(each["focus_m"]): each for each in report.get("comparison") or ()}
        for focus in map(_number, report["focus_m"]):
            compared = figures.get(focus, {})  # none where the reference is black
            picture = folder / "reconstruction" / f"{output.picture_name(focus, output.pupil_of(report))}.exr"
            found.append(
                {
                    **row,
                    "error": None,
                    "focus_m": focus,
                    **{name: _number(compared.get(name)) for name in FIGURES},
                    "folder": folder.relative_to(out).as_posix(),
                    "picture": picture.relative_to(out).as_posix(),
                    **made,
                }
            )
    return found


def _of_report(report):
    """Columns of a run that do not depend on the focus; lengths in meters, as in the report."""
    hologram, plan = report["hologram"], report["plan"]
    foretold = report.get("foretold") or {}  # of baselines nothing is
    made: dict[str, Any] = {
        f"{name}_m" if DECLARED[name].unit else name: value
        for name, value in report["settings"].items()
        if name in DECLARED
    }
    for name, value in hologram.items():
        made[name if name in ("width", "height", "depth_mapping") else f"{name}_m"] = value
    made |= {
        "near_m": plan["near"],
        "rays_per_pixel": report["spp"],
        "variant": report["variant"],
        "planned_seconds": plan["seconds"],
        "measured_seconds": foretold.get("seconds", {}).get("measured"),
        "planned_memory_bytes": plan["memory_bytes"],
        "planned_field_error": plan["error"],
        "measured_field_error": foretold.get("field_error", {}).get("measured"),
    }
    made |= {f"planned_seconds_{_name(stage)}": value for stage, value in plan["stages"].items()}
    made |= {f"seconds_{_name(stage)}": value for stage, value in report["seconds"].items()}
    encoding = report.get("encoding", {})
    made["planned_seconds_encoding"] = encoding.get("plan", {}).get("seconds")
    for name, value in encoding.items():
        if isinstance(value, (str, int, float)):
            made[f"encoding_{_name(name)}"] = value
    made |= {f"version_{name}": value for name, value in report["versions"].items()}
    made["warnings"] = " ".join(report["warnings"]) or None
    return {name: _plain(value) for name, value in made.items()}


def _name(text):
    return text.replace(" ", "_")


def _plain(value):
    """A table holds no lists."""
    if isinstance(value, dict):
        return ",".join(f"{key}={each}" for key, each in value.items()) or None
    return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else value


def _number(value):
    return math.inf if value == "inf" else math.nan if value == "nan" else value


def write_table(study: Study, out: Path) -> bool:
    """Write ``table.csv`` and, where h5py is, ``table.h5``, each whole.

    Returns
    -------
    bool
        Whether h5py is there.

    Raises
    ------
    OSError
    """
    made = rows(study, out)
    columns = list(dict.fromkeys(name for row in made for name in row))
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, columns)
    table.writeheader()
    table.writerows(made)
    files = {"table.csv": text.getvalue().encode("utf-8")}
    hdf5 = _hdf5({name: [row.get(name) for row in made] for name in columns}, study.text)
    if hdf5 is not None:
        files["table.h5"] = hdf5
    output.write_pictures(out, files)
    return hdf5 is not None


def _hdf5(columns, text):
    """HDF5 file of the table, one compound data set ``table``, and of the study's ``study``; None without h5py."""
    try:
        import h5py
    except ImportError:
        return None
    typed = {name: _typed(values, h5py.string_dtype()) for name, values in columns.items()}
    count = len(next(iter(typed.values())))
    table = np.empty(count, [(name, values.dtype) for name, values in typed.items()])
    for name, values in typed.items():
        table[name] = values
    file = io.BytesIO()
    with h5py.File(file, "w") as stored:
        stored["table"] = table
        stored["study"] = text
    return file.getvalue()


def _typed(values, string):
    """A column as an array: whole numbers, numbers with NaN where there is none, or text."""
    numbers = [value for value in values if value is not None]
    if not all(isinstance(value, (int, float)) for value in numbers):
        return np.array(["" if value is None else str(value) for value in values], string)
    whole = len(numbers) == len(values) and all(isinstance(v, int) and abs(v) < 1 << 63 for v in values)
    return np.array([math.nan if v is None else v for v in values], np.int64 if whole else np.float64)
