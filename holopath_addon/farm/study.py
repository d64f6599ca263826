"""Studies: renders of all combinations of scenes, seeds, views and settings in a TOML file, and their table.

Each run is a still's output folder in ``runs/``, identified by a digest of its options. The table is made from the
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

# Options of a run, by their names of `holopath render`.
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
MOVES, TURNS = ("right", "up", "forward"), ("turn_left", "turn_up")  # that a view varies
MAX_NAME = 60  # characters of the readable part of a folder's name
FIGURES = (
    "psnr_db",
    "phases_psnr_db",
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
        The scene as in the study's file.
    options : dict of str to str, int, float or bool
        Options of `holopath render` by name.
    variables : tuple of str
        Names of the options that differ between runs.
    view : int or None
        Number of the camera's position.
    """

    scene: str
    options: dict
    variables: tuple = ()
    view: int | None = None

    @property
    def digest(self) -> str:
        """Digest of the scene's name and all options."""
        options = {name: str(value) for name, value in self.options.items() if value is not False}
        return blake2b(json.dumps([self.scene, sorted(options.items())]).encode(), digest_size=5).hexdigest()

    def folder(self, out: Path) -> Path:
        """Output folder of the run below that of the study: an existing one with its digest, or a new one."""
        existing = sorted((out / "runs").glob(f"*-{self.digest}"))
        if existing:
            return existing[0]
        words = [Path(self.scene.removeprefix("demo:")).stem]
        words += [] if self.view is None else [f"view{self.view}"]
        words += [f"{name}-{self.options[name]}" for name in self.variables if name in self.options]
        readable = re.sub(r"[^A-Za-z0-9.]+", "-", "-".join(words))[:MAX_NAME].strip("-.")
        return out / "runs" / f"{readable}-{self.digest}"

    def row(self) -> dict:
        """Columns of the table that are known before the run."""
        options = {name: " ".join(v) if isinstance(v, tuple) else v for name, v in self.options.items()}
        return {"scene": self.scene, "view": self.view, **options}


@dataclass(frozen=True)
class Study:
    """A study's file.

    Attributes
    ----------
    path : Path
    text : str
        Contents of the file.
    runs : tuple of Run
        All different runs, grouped by scene.
    """

    path: Path
    text: str = field(repr=False)
    runs: tuple = ()

    def scene(self, run: Run) -> str:
        """Scene of a run for the command line: paths are relative to the study's file."""
        return run.scene if run.scene.startswith("demo:") else str(self.path.parent / run.scene)


def read(path: Path | str) -> Study:
    """Read a study's file.

    Raises
    ------
    InvalidInput
        If the file cannot be read or is wrong.
    """
    path = Path(path)
    try:
        text = path.read_text("utf-8")
        parts = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidInput(
            f"The study {path} cannot be read ({reason}). Give a TOML file, see docs/study.md."
        ) from None
    try:
        return Study(path, text, tuple(_runs(parts)))
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def _runs(parts):
    """All combinations; scenes vary last, as opening one takes time."""
    _check_names(parts, PARTS, "part")
    scenes = _list(parts.get("scenes"), "scenes")
    if not all(isinstance(scene, str) for scene in scenes):
        raise InvalidInput("Expected scenes as files or demo:NAME, in quotes.")
    grid = {name: _list(values, f"{name} in [grid]") for name, values in _table(parts, "grid").items()}
    rows = parts.get("list", [{}])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InvalidInput("Expected list as tables of settings. Start each by [[list]].")
    common = _table(parts, "settings")
    axes = [set(grid), set().union(*rows), {"seed"} if "seeds" in parts else set()]
    views = list(_views(_table(parts, "views"))) if "views" in parts else [(None, {})]
    axes.append(set(views[0][1]))
    for one, other in itertools.combinations(axes, 2):
        for name in sorted(one & other):
            raise InvalidInput(
                f"{name} is given twice. Keep it in one of seeds, [views], [grid] and [[list]]."
            )
    for names in (common, grid, *rows):
        _check_names(names, NAMES, "setting")
    seeds = _list(parts["seeds"], "seeds") if "seeds" in parts else [None]
    runs = {}
    for scene, (view, place), row, seed, values in itertools.product(
        scenes, views, rows, seeds, itertools.product(*grid.values())
    ):
        options = {**common, **row, **dict(zip(grid, values, strict=True)), **place}
        options |= {} if seed is None else {"seed": seed}
        options = {name: _word(name, value) for name, value in options.items()}
        run = Run(scene, options, (*row, *grid, *(["seed"] if len(seeds) > 1 else [])), view)
        runs.setdefault(run.digest, run)
    return runs.values()


def _views(table):
    """Numbers and options of views; more views or frames do not change those that there are."""
    _check_names(table, ("count", "seed", "frames", *MOVES, *TURNS), "part of [views]")
    count, seed = table.get("count", 1), table.get("seed", 0)
    if not (isinstance(count, int) and isinstance(seed, int) and count >= 1 and seed >= 0):
        raise InvalidInput("Expected count and seed of [views] as whole numbers, such as count = 20.")
    frames = ranges.frames(str(table["frames"])) if "frames" in table else (None,)
    low, high = np.transpose([_range(table, name) for name in (*MOVES, *TURNS)])
    for view, (number, frame) in enumerate(itertools.product(range(count), frames)):
        own = [seed, number] if frame is None else [seed, number, frame & 0xFFFFFFFF]
        place = [f"{x:.6g}" for x in np.random.default_rng(own).uniform(low, high)]
        options = {} if frame is None else {"at_frame": frame}
        options |= {"move": ",".join(place[:3])} if any(name in table for name in MOVES) else {}
        options |= {"turn": ",".join(place[3:])} if any(name in table for name in TURNS) else {}
        yield view, options


def _range(table, name):
    """Ends of a view's range; a number stands for a symmetric range."""
    ends = table.get(name, 0.0)
    ends = ends if isinstance(ends, list) else [-ends, ends] if isinstance(ends, (int, float)) else []
    if len(ends) != 2 or not all(isinstance(end, (int, float)) and math.isfinite(end) for end in ends):
        raise InvalidInput(f"Expected {name} of [views] as a range, such as [-0.1, 0.1].")
    return ends


def _check_names(names, known, kind):
    for name in names:
        if name not in known:
            raise InvalidInput(f"Expected a {kind} among {', '.join(known)}, got '{name}'.")


def _table(parts, name):
    table = parts.get(name, {})
    if not isinstance(table, dict):
        raise InvalidInput(f"Expected {name} as a table. Write its names and values below [{name}].")
    return table


def _list(values, name):
    if not isinstance(values, list) or not values:
        raise InvalidInput(f"Expected {name} as a list of one or more. Write {name.split()[0]} = [...].")
    return values


def _word(name, value):
    """Value of a setting for the command line; a tuple is a repeated option."""
    if name in FLAGS:
        if not isinstance(value, bool):
            raise InvalidInput(f"Expected {name} to be true or false, got {value}.")
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
        raise InvalidInput(f"Expected {name} as a number or a text, as on the command line, got {value}.")
    return value


def check_free(out: Path) -> None:
    """Refuse an output folder with contents other than a study's runs.

    Raises
    ------
    InvalidInput
    """
    if out.exists() and not out.is_dir():
        raise InvalidInput(f"The output {out} is a file. Choose a folder by --out.")
    names = {path.name for path in out.iterdir()} if out.exists() else set()
    if names and "runs" not in names:
        raise InvalidInput(f"The output folder {out} does not hold a study. Choose a new one by --out.")


# -- the table


def note_failure(out: Path, name: str, error: str) -> None:
    """Store the error of a run, until it is made."""
    folder = out / "failed"
    output.write_pictures(folder, {f"{name}.txt": error.encode("utf-8")})


def failure(out: Path, name: str) -> str | None:
    """Error of a run that `note_failure` stored; None without one."""
    try:
        return _failure_file(out, name).read_text("utf-8")
    except OSError:
        return None


def forget_failure(out: Path, name: str) -> None:
    """Delete the error of a run that is made, or tried again."""
    _failure_file(out, name).unlink(missing_ok=True)


def _failure_file(out, name):
    return out / "failed" / f"{name}.txt"


def rows(study: Study, out: Path, job: str | None = None) -> list[dict]:
    """Make the table: a row for each run and focus distance, or for a missing run.

    Parameters
    ----------
    study : Study
    out : Path
        Its output folder.
    job : str, optional
        Digest of its job: a run of another one, as of an earlier scene, is missing. Default: any.

    Returns
    -------
    list of dict
        Values by name of the column: text, numbers or None.
    """
    table = []
    for run in study.runs:
        folder = run.folder(out)
        error, report = failure(out, folder.name), output.read_report(folder)
        row = {"run": folder.name, **run.row()}
        if error or not report or job not in (None, report.get("job")):
            missing = "made yet" if not report else "checked yet: its scene or HoloPath may have changed"
            table.append({**row, "error": error or f"This run is not {missing}."})
            continue
        columns = _columns_of(report)
        figures = {_number(each["focus_m"]): each for each in report.get("comparison") or ()}
        for focus in map(_number, report["focus_m"]):
            values = figures.get(focus, {})  # none where the reference is black
            picture = folder / "reconstruction" / f"{output.picture_name(focus, output.pupil_of(report))}.exr"
            table.append(
                {
                    **row,
                    "error": None,
                    "focus_m": focus,
                    **{name: _number(values.get(name)) for name in FIGURES},
                    "folder": folder.relative_to(out).as_posix(),
                    "picture": picture.relative_to(out).as_posix(),
                    **columns,
                }
            )
    return table


def _columns_of(report):
    """Columns of a run that do not depend on the focus; lengths in meters, as in the report."""
    hologram, plan = report["hologram"], report["plan"]
    estimates = report.get("estimated") or {}  # baselines have none
    columns: dict[str, Any] = {
        f"{name}_m" if DECLARED[name].unit else name: value
        for name, value in report["settings"].items()
        if name in DECLARED
    }
    for name, value in hologram.items():
        columns[name if name in ("width", "height", "depth_mapping") else f"{name}_m"] = value
    columns |= {
        "near_m": plan["near"],
        "rays_per_pixel": report["spp"],
        "variant": report["variant"],
        "planned_seconds": plan["seconds"],
        "measured_seconds": estimates.get("seconds", {}).get("measured"),
        "planned_memory_bytes": plan["memory_bytes"],
        "planned_field_error": plan["error"],
        "measured_field_error": estimates.get("field_error", {}).get("measured"),
    }
    columns |= {f"planned_seconds_{_name(stage)}": value for stage, value in plan["stages"].items()}
    columns |= {f"seconds_{_name(stage)}": value for stage, value in report["seconds"].items()}
    encoding = report.get("encoding", {})
    columns["planned_seconds_encoding"] = encoding.get("plan", {}).get("seconds")
    for name, value in encoding.items():
        if isinstance(value, (str, int, float)):
            columns[f"encoding_{_name(name)}"] = value
    columns |= {f"version_{name}": value for name, value in report["versions"].items()}
    columns["warnings"] = " ".join(report["warnings"]) or None
    return {name: _plain(value) for name, value in columns.items()}


def _name(text):
    return text.replace(" ", "_")


def _plain(value):
    """A value for the table, with lists and dictionaries as text."""
    if isinstance(value, dict):
        return ",".join(f"{key}={each}" for key, each in value.items()) or None
    return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else value


def _number(value):
    return math.inf if value == "inf" else math.nan if value == "nan" else value


def write_table(study: Study, out: Path, job: str | None = None) -> bool:
    """Write ``table.csv`` and, if h5py is installed, ``table.h5``, each complete or not at all.

    Parameters
    ----------
    study, out, job
        See `rows`.

    Returns
    -------
    bool
        Whether h5py is installed.

    Raises
    ------
    OSError
    """
    table_rows = rows(study, out, job)
    columns = list(dict.fromkeys(name for row in table_rows for name in row))
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, columns)
    table.writeheader()
    table.writerows(table_rows)
    files = {"table.csv": text.getvalue().encode("utf-8")}
    hdf5 = _hdf5({name: [row.get(name) for row in table_rows] for name in columns}, study.text)
    if hdf5 is not None:
        files["table.h5"] = hdf5
    output.write_pictures(out, files)
    return hdf5 is not None


def _hdf5(columns, text):
    """HDF5 file with the table as a compound data set ``table``, and the study's text; None without h5py."""
    try:
        import h5py
    except ImportError:
        return None
    arrays = {name: _array(values, h5py.string_dtype()) for name, values in columns.items()}
    count = len(next(iter(arrays.values())))
    table = np.empty(count, [(name, values.dtype) for name, values in arrays.items()])
    for name, values in arrays.items():
        table[name] = values
    file = io.BytesIO()
    with h5py.File(file, "w") as root:
        root["table"] = table
        root["study"] = text
    return file.getvalue()


def _array(values, string):
    """A column as an array of integers, of floats with NaN for None, or of text."""
    numbers = [value for value in values if value is not None]
    if not all(isinstance(value, (int, float)) for value in numbers):
        return np.array(["" if value is None else str(value) for value in values], string)
    whole = len(numbers) == len(values) and all(isinstance(v, int) and abs(v) < 1 << 63 for v in values)
    return np.array([math.nan if v is None else v for v in values], np.int64 if whole else np.float64)
