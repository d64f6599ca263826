"""Radiance maps, and what is known of one before it is whole, on disk, for processes that share one."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import mitsuba as mi
import numpy as np

from ..scene.buffers import loaded
from .grain_grid import GrainGrid
from .grains import RadianceMap
from .regions import Sightings

NUMBERS = "passes", "textures", "colours", "error"
ROWS, NUMBERS_OF = "_rows.npy", "_numbers.npy"  # of totals


def save_map(radiance: RadianceMap, folder: Path) -> None:
    """Write a radiance map into a folder that is there.

    Of the cells only those that have a number are kept: most of a volume is empty.

    Parameters
    ----------
    radiance : RadianceMap
    folder : pathlib.Path
    """
    numbers = np.array(radiance.numbers)
    cells = np.flatnonzero(numbers)
    np.save(folder / "cells.npy", np.stack([cells.astype(np.uint32), numbers[cells]]))
    np.save(folder / "radiances.npy", np.array(radiance.radiances))
    for number, sightings in enumerate(radiance.sightings):
        np.save(folder / f"sightings_{number}.npy", np.stack([sightings.depth, sightings.chains]))
    grid = {each.name: getattr(radiance.grid, each.name) for each in fields(GrainGrid) if each.init}
    told = {name: getattr(radiance, name) for name in NUMBERS}
    images = [sightings.images for sightings in radiance.sightings]
    (folder / "map.json").write_text(json.dumps({"grid": grid, "images": images, **told}))


def load_map(folder: Path) -> RadianceMap:
    """Read what `save_map` wrote.

    Parameters
    ----------
    folder : pathlib.Path

    Returns
    -------
    RadianceMap
    """
    told = json.loads((folder / "map.json").read_text())
    grid = GrainGrid(**told["grid"])
    cells, values = np.load(folder / "cells.npy", allow_pickle=False)
    numbers = np.zeros(grid.columns * grid.rows * grid.slabs * grid.branches, np.uint32)
    numbers[cells] = values
    stored = [np.load(folder / f"sightings_{n}.npy", allow_pickle=False) for n in range(len(told["images"]))]
    return RadianceMap(
        grid,
        loaded(mi.UInt32, numbers),
        loaded(mi.Float, np.load(folder / "radiances.npy", allow_pickle=False)),
        sightings=tuple(
            Sightings(depth, chains > 0, images)
            for (depth, chains), images in zip(stored, told["images"], strict=True)
        ),
        **{name: told[name] for name in NUMBERS},
    )


def save_totals(totals: dict[str, tuple[np.ndarray, np.ndarray]], folder: Path) -> None:
    """Write what some pixels told into a folder that is there.

    Parameters
    ----------
    totals : dict
        As `measurement.sparse` has them.
    folder : pathlib.Path
    """
    for name, (rows, values) in totals.items():
        np.save(folder / f"{name}{ROWS}", rows)
        np.save(folder / f"{name}{NUMBERS_OF}", values)


def load_totals(folder: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Read what `save_totals` wrote.

    Parameters
    ----------
    folder : pathlib.Path
    """
    names = [file.name.removesuffix(ROWS) for file in folder.glob(f"*{ROWS}")]
    return {
        name: tuple(np.load(folder / f"{name}{end}", allow_pickle=False) for end in (ROWS, NUMBERS_OF))
        for name in names
    }
