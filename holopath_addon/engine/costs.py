"""Estimates of a plan's seconds and memory, from the speeds that the probe measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from . import despeckle
from .kernel_table import LEVELS
from .phase_fields import SETS

if TYPE_CHECKING:
    from .hologram import Hologram, Settings
    from .probing import Light, Probe

CHUNK_BYTES = 256 << 20  # Mitsuba and the kernels' working memory
CELL_BYTES = (
    416  # of an occupied cell: eighteen sums of 8 bytes, tables of its filter, and the means made of them
)
SURFACES = 2  # occupied slabs of a pixel column, roughly
ATLAS_TEXELS = 40  # a pixel of the view, roughly; not all are baked
MOST_TEXELS = 1 << 25
TEXEL_BYTES = 48  # with what making them takes

# Of the time that the probe's rays and paths take, alone in their kernels; over ten scenes (docs/measurements.md).
RAY, CHAIN, PATH = 0.6, 0.85, 0.85

# Seconds on the machine that `machine.slowness` compares with.
SUM = 2.0e-9, 0.3e-9  # of a ray, and of each of its frames and wavelengths
TRACING, PATHS = 0.05, 0.08  # to begin with rays, and with paths
TABLES = 0.02, 0.04  # of kernel tables and regions, and of each plane's
SHARE = 1.2e-6  # of a column of the radiance map, whose grains look at their neighbors
COMPILED = 0.05  # that the pilot's programs took to compile at least, where those of the rendering do, too
COMPILING = (
    (0.1, 1.5),
    (0.6, 1.6),
)  # of rays and of paths: all that is alike in all scenes, and times the pilot's
MOVE = 0.024e-6  # of a pixel's way to another plane, of each frame and wavelength
LOOK, CHARTS, ROW = 0.5, 1.0, 1.1e-6  # of baking: to begin, of meshes with charts, and of each triangle
LOAD, LOAD_ROWS, LOAD_ROW = 0.1, 0.3, 0.7e-6  # the same of what was baked before
CHARTED = 2000  # triangles from which on charts take their whole time
SAMPLE = 0.15e-6  # of a sample of a texel, besides its ray's

# Samples of baked light: of each pixel of the view, of each triangle (of dense meshes), and for the light between
# surfaces; and what one takes of a path, which has every bounce.
BAKED_PIXEL, BAKED_TRIANGLE, BETWEEN, BOUNCE = 64, 30, 12e6, 0.25


@dataclass(frozen=True)
class Work:
    """What a plan has to do.

    Attributes
    ----------
    columns : int
        Pixels of the radiance map.
    plain, chained : float
        Rays a pixel of the hologram, and those that mirrors or clear surfaces are in view of, branches included.
    passes : int
        Radiance paths of a column that will be taken, roughly.
    texture : dict or None
        Seconds of the stages of the radiance cache, where there is one.
    traversals : int
        Times that rays are traced: for all wavelengths together or for each.
    planes : int
        Recording planes.
    images : bool
        Whether some of these record images only, which are brought to the others.
    """

    columns: int
    plain: float
    chained: float
    passes: int
    texture: dict[str, float] | None
    traversals: int
    planes: int
    images: bool


def baking(
    hologram: Hologram, light: Light, columns: int, passes: int, baked: bool, triangles: int, slowness: float
) -> dict[str, float]:
    """Seconds of the radiance cache and of the few paths that are left with it, by stage."""
    charted = min(1.0, triangles / CHARTED)
    if baked:
        bake = slowness * (LOAD + LOAD_ROWS * charted + LOAD_ROW * triangles)
    else:
        samples = hologram.width * hologram.height * BAKED_PIXEL + triangles * BAKED_TRIANGLE
        bake = slowness * (LOOK + CHARTS * charted + ROW * triangles + SAMPLE * samples)
        bake += BOUNCE * (samples + BETWEEN) / light.paths_per_second
    return {"bake": bake, "radiance": map_seconds(light, columns, passes, slowness)}


def map_seconds(light: Light, columns: int, passes: int, slowness: float) -> float:
    """Seconds of the radiance map: of its paths, and of what grains share."""
    return path_seconds(light, columns * passes, slowness) + slowness * SHARE * columns


def path_seconds(light: Light, paths: float, slowness: float) -> float:
    """Seconds of radiance paths."""
    return slowness * PATHS + PATH * paths / light.paths_per_second


def stages(
    hologram: Hologram, settings: Settings, seen: Probe, light: Light, work: Work, slowness: float
) -> dict[str, float]:
    """Estimated seconds of each stage of a render, by the names that its report gives them; see `machine.slowness`."""
    pixels, frames, colours = hologram.width * hologram.height, settings.frames, len(hologram.wavelengths)
    own = slowness * (SUM[0] + SUM[1] * frames * colours)
    rays = work.plain * (RAY / seen.rays_per_second + own)
    rays += work.chained * (CHAIN / seen.chains_per_second + own)
    out = {
        "kernel tables": slowness * (TABLES[0] + TABLES[1] * work.planes),
        "wave tracing": work.traversals * (slowness * TRACING + pixels * rays),
        "propagation": slowness * pixels * frames * colours * MOVE * work.planes,
    }
    if settings.radiance == "ray":
        paths = pixels * (work.plain + work.chained) * settings.paths
        out["wave tracing"] += work.traversals * path_seconds(light, paths, slowness)
    elif work.texture is None:
        out["radiance"] = work.traversals * map_seconds(light, work.columns, work.passes, slowness)
    else:
        out |= work.texture
    if light.compiling > slowness * COMPILED:
        pilots = ("wave tracing", seen.compiling, COMPILING[0]), ("radiance", light.compiling, COMPILING[1])
        for stage, seconds, (same, times) in pilots:
            out[stage] = out.get(stage, 0.0) + slowness * same + times * seconds
    if settings.despeckle:
        many = despeckle.BATCHES * SETS[-1]
        out["despeckle"] = (
            pixels * (work.plain + work.chained) * despeckle.BATCHES * RAY / seen.rays_per_second
            + slowness * pixels * many * colours * ((work.plain + work.chained) * 0.3e-9 + 1e-6)
            + slowness * pixels * frames * colours * settings.despeckle * 25e-9
        )
    return out


def memory(
    hologram: Hologram,
    settings: Settings,
    work: Work,
    margin: int,
    slabs: int,
    bins: int,
    binned: float,
    splits: int,
) -> float:
    """Estimated bytes of the arrays at most.

    `binned` is the share of the occupied cells that have all pupil bins.
    """
    pixels, frames, colours = hologram.width * hologram.height, settings.frames, len(hologram.wavelengths)
    fields = pixels * frames * (colours * (1 + work.images) + 1) * 8
    if settings.despeckle:
        # a batch and its spectra, or the fields, Adam's memory, spectra, waves and slopes of a colour
        fields += pixels * 8 * max(SETS[-1] * (colours + 1), 7 * frames) + pixels * colours * 40 * 4
    tables = LEVELS[1] * margin**2 * 8 * colours
    radiance = work.columns * ((16 * slabs << splits) + SURFACES * (1 + (bins**2 - 1) * binned) * CELL_BYTES)
    texels = 0 if work.texture is None else min(pixels * ATLAS_TEXELS, MOST_TEXELS) * TEXEL_BYTES
    return fields + tables + radiance + texels + CHUNK_BYTES
