"""Estimates of a plan's seconds and memory, from the speeds that the probe measured."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from ..encoding import encoder
from ..encoding.options import JOINT_STEPS, eyebox_for
from ..encoding.views import MAX_DEPTHS, step_transforms, transforms
from ..memory import AT_ONCE, encoding_on_card, refocusing_on_card
from ..plan import CARD_STAGES, PHASES
from ..progress import OFTEN
from ..scene.variants import chunks_at_once, units_at_first, units_at_once
from ..tracing.grains import CHUNK_PATHS, UNIT_PATHS
from ..tracing.kernel_table import LEVELS
from ..tracing.wave_tracer import CHUNK_RAYS
from ..waves import despeckle
from ..waves.phase_fields import MAX_FRAMES, SETS
from ..waves.propagation import TEACHING_GUARD, grid_bytes, padded_shape, stack_bytes
from ..waves.target_images import MAX_TRANSFER_BYTES
from .noise import likely
from .planes import columns_of, mean_rays
from .probe import LEAST_SHARE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..plan import RecordingPlane
    from .machine import Slowness
    from .pilot_light import Light
    from .survey import Survey

CHUNK_BYTES = 256 << 20  # Mitsuba and the kernels' working memory
# of an occupied cell: twenty-two sums of 8 bytes, tables of its filter, and the means made of them
CELL_BYTES = 448
SURFACES = 2  # occupied slabs of a pixel column, roughly
ATLAS_TEXELS = 40  # a pixel of the view, roughly; not all are baked
MOST_TEXELS = 1 << 25
TEXEL_BYTES = 48  # with what making them takes

# Of the time that the probe's rays and paths take, over ten scenes (docs/measurements.md): probes look far apart. And
# of a path's that a ray takes to see a texture alone.
RAY, CHAIN, PATH, TEXTURE = 0.35, 1.0, 0.95, 0.2

# Seconds on the machine that `machine.Slowness` compares with. What programs take there:
SUM = 2.0e-9, 0.15e-9  # of a ray, and of each of its frames and wavelengths
SHARE = 1.2e-6  # of a column of the radiance map, whose grains look at their neighbors
# What one core takes, to write programs down above all:
LAUNCH = 0.05, 0.06  # each time that rays are launched, and paths
TRACING = 0.04  # to begin with rays
TABLES = 0.01, 0.045  # of kernel tables and regions, and of each plane's
COMPILED = 0.05  # that the pilot's programs took to compile at least, where those of the rendering do, too
# of rays, and times the pilot's; of what grains share, and times the pilot's of paths
COMPILING = 0.1, 1.5, 0.6, 1.6
LOOK, CHARTS, ROW = 0.3, 1.6, 1.1e-6  # of baking: to begin, of meshes with charts, and of each triangle
# The same of what was baked before, and of each texel of all.
LOAD, LOAD_ROW, LOAD_TEXEL = 0.1, 0.7e-6, 0.04e-6
FOUND = 0.12  # to see what is wanted of it
CHARTED = 2000  # triangles from which on charts take their whole time
# What transforms take:
MOVE = 0.022e-6  # of a pixel's way to another plane, of each frame and wavelength
COPY = 0.85e-9  # of a byte that comes from a card's memory to the processor's
# of encodings, a pixel of each frame and wavelength: `sgd` to its end, and transforms of the padded grid with what is
# around them, those of a step of all frames together and of looks at all views
SGD, TRANSFORM, LOOKED = 0.7e-6, 8e-9, 5e-9

# Groups of texels that are baked: of each diffuse pixel of the view, of each triangle (of dense meshes), and for what
# mirrors and glass show; samples of each, and for the light between surfaces; what one takes of a path that ends at the
# first surface that lamps light; and such paths that tell how much is left to trace.
GROUPS_PIXEL, GROUPS_TRIANGLE, GROUPS_SEEN = 1.4, 1.5, 400e3
GROUP, BETWEEN, SAMPLE, PILOT = 22, 5.5e6, 1.1, 1e6


def baking(
    survey: Survey, columns: int, few: tuple[int, int], baked: float | None, triangles: int
) -> dict[str, float]:
    """Seconds of the radiance cache and of the few paths and rays for textures that are left with it, by stage.

    `baked` is the share of the view whose light was baked before and is loaded, None where none of the scene was.
    """
    hologram, seen, light, slowness = survey.hologram, survey.seen, survey.light, survey.slowness
    charted = min(1.0, triangles / CHARTED)
    groups = hologram.width * hologram.height * seen.diffuse * GROUPS_PIXEL + triangles * GROUPS_TRIANGLE
    samples = (1 - (baked or 0)) * GROUP * (groups + (GROUPS_SEEN if seen.specular > LEAST_SHARE else 0))
    if baked is None:
        bake, samples = LOOK + CHARTS * charted + ROW * triangles, samples + BETWEEN
    else:
        bake = FOUND
    looks = replace(light, paths_per_second=light.short_per_second)
    return {
        "bake": slowness.core * bake + SAMPLE * samples / light.short_per_second,
        "radiance": map_seconds(looks, columns, *few, slowness) + PILOT / light.short_per_second,
    }


def loading(texels: int, triangles: int, slowness: Slowness) -> float:
    """Seconds to load what was baked before: a texture of so many texels."""
    return slowness.core * (LOAD + LOAD_ROW * triangles + LOAD_TEXEL * texels)


def map_seconds(light: Light, columns: int, passes: int, textures: int, slowness: Slowness) -> float:
    """Seconds of the radiance map: of its paths, of rays that see textures alone, and of what grains share."""
    share = slowness.programs * SHARE * columns * _shares(light)
    return path_seconds(light, columns * (passes + TEXTURE * textures), slowness) + share


def _shares(light):
    """Whether anything is in view that shares light, which what shines itself does not."""
    return light.shining < 1 - LEAST_SHARE


def path_seconds(light: Light, paths: float, slowness: Slowness) -> float:
    """Seconds of radiance paths."""
    traced = PATH * paths / light.paths_per_second
    return traced + slowness.core * LAUNCH[1] * launches(
        traced, paths / UNIT_PATHS, most=CHUNK_PATHS // UNIT_PATHS
    )


def launches(seconds: float, units: float, first: float = 1.0, most: int = 1) -> float:
    """Times that work is launched whose programs take so many seconds, in so many units: `first` ones at first, and
    `most` times `units_at_once` at most.

    `progress.Pace` doubles the units of a launch until it takes one to two times `OFTEN`.
    """
    units = max(units, 1.0)
    together = min(max(1.4 * OFTEN * units / max(seconds, 1e-9), 1.0), most * units_at_once(), units)
    return units / together + max(0.0, math.log2(together / min(first, units)))


def _wave_launches(survey, planes, seconds):
    """Launches of rays from all planes; see `wave_tracer.trace_blocks`."""
    pixels, _, _ = _numbers(survey)
    rays, count = pixels * sum(mean_rays(planes, survey.chains.branches)), len(planes)
    if survey.settings.radiance == "ray" or survey.settings.estimator == "paper":
        return max(rays / CHUNK_RAYS, count)  # drawn at random, so that no blocks are joined
    return count * launches(seconds / count, rays / count / CHUNK_RAYS, units_at_first())


def stages(
    survey: Survey,
    planes: Sequence[RecordingPlane],
    margin: int,
    traversals: int,
    baking: dict[str, float] | None,
) -> dict[str, float]:
    """Estimated seconds of each stage of a render, by the names that its report gives them; see `machine.slowness`.

    Without those in which programs are compiled: see `compiled`.

    Parameters
    ----------
    survey : Survey
    planes : tuple of RecordingPlane
    margin : int
        Pixels of the radiance map beyond each edge of the hologram.
    traversals : int
        Times that rays are traced: for all wavelengths together or for each.
    baking : dict or None
        Seconds of the stages of the radiance cache, where there is one.
    """
    settings, seen, light, slowness = survey.settings, survey.seen, survey.light, survey.slowness
    pixels, frames, colours = _numbers(survey)
    plain, chained = mean_rays(planes, survey.chains.branches)
    own = slowness.programs * (SUM[0] + SUM[1] * frames * colours)
    rays = plain * (RAY / seen.rays_per_second + own)
    rays += chained * (CHAIN / seen.chains_per_second + own)
    written = slowness.core * (TRACING + LAUNCH[0] * _wave_launches(survey, planes, pixels * rays))
    out = {
        "kernel tables": slowness.core * (TABLES[0] + TABLES[1] * len(planes)),
        "wave tracing": traversals * (written + pixels * rays),
        "propagation": slowness.transforms * pixels * frames * colours * MOVE * len(planes)
        + slowness.copies * COPY * 8 * pixels * frames * colours,
    }
    if settings.radiance == "ray":
        paths = pixels * (plain + chained) * settings.paths
        out["wave tracing"] += traversals * PATH * paths / light.paths_per_second
    elif baking is None:
        taken = likely(settings, light)
        out["radiance"] = traversals * map_seconds(light, columns_of(survey, margin), *taken, slowness)
    else:
        out |= baking
    if settings.despeckle:
        many = despeckle.BATCHES * SETS[-1]
        out["despeckle"] = (
            pixels * (plain + chained) * despeckle.BATCHES * RAY / seen.rays_per_second
            + slowness.programs * pixels * many * colours * (plain + chained) * SUM[1]
            + slowness.transforms * pixels * colours * (many * 1e-6 + frames * settings.despeckle * 25e-9)
        )
    return out


def compiled(survey: Survey, taken: dict[str, float]) -> dict[str, float]:
    """`stages` with what compiling adds to them, where the pilot's own programs had to be compiled, too."""
    seen, light, slowness = survey.seen, survey.light, survey.slowness
    if light.compiling <= slowness.core * COMPILED:
        return taken
    rays = slowness.core * COMPILING[0] + COMPILING[1] * seen.compiling
    paths = slowness.core * COMPILING[2] * _shares(light) + COMPILING[3] * light.compiling
    more = {"wave tracing": rays, "radiance": paths}
    return taken | {name: taken.get(name, 0.0) + seconds for name, seconds in more.items()}


def phases(
    survey: Survey, planes: Sequence[RecordingPlane], traversals: int, taken: dict[str, float]
) -> dict[str, float]:
    """Seconds of what encodings of a field are made of, by `PHASES`; see `stages`, which gave `taken`.

    `sgd` and `joint` to their ends; a `look` at all views of a frame; for `refine` the `light` that is found again, the
    `rays` of each batch of more frames and each `frame`; and each `step` of all frames together.
    """
    seen, slowness = survey.seen, survey.slowness
    pixels, frames, colours = _numbers(survey)
    plain, chained = mean_rays(planes, survey.chains.branches)
    grids = _grids(survey)
    padded, eyebox = sum(grid for grid, _ in grids), eyebox_for(frames)
    look = (
        slowness.transforms
        * LOOKED
        * sum(grid * (1 + transforms(frames, eyebox) * depths) for grid, depths in grids)
    )
    rays = pixels * (plain * RAY / seen.rays_per_second + chained * CHAIN / seen.chains_per_second)
    sums = slowness.programs * pixels * colours * (plain + chained) * SUM[1]
    moved = slowness.transforms * pixels * colours * MOVE * len(planes)
    copied = slowness.copies * COPY * 4 * pixels * frames * colours  # phases that a card has found
    sgd = slowness.transforms * pixels * frames * colours * SGD + copied
    step = slowness.transforms * frames * step_transforms(eyebox) * TRANSFORM * padded
    joint = sgd + 3 * frames * look + JOINT_STEPS["joint"] * step
    light = sum(taken.get(name, 0.0) for name in ("kernel tables", "radiance"))
    each = sgd, joint, look, light, traversals * rays, sums + moved, step
    return dict(zip(PHASES, each, strict=True))


def phases_memory(survey: Survey, batch_bytes: float, most: float = encoder.MAX_BYTES) -> dict[str, float]:
    """Bytes that encodings of a field take at most, with it, by name; see `phases`.

    `batch_bytes` are those of a render of as many frames as `refine` traces at once, see `refine_batch`, and `most`
    those of the arrays that a stage works on.
    """
    pixels, frames, colours = _numbers(survey)
    grids = _grids(survey)
    own = (8 + 4) * frames * pixels * colours
    targets = [4 * grid * transforms(frames, eyebox_for(frames)) * depths for grid, depths in grids]
    transfers = [min(MAX_TRANSFER_BYTES, 8 * grid * depths) for grid, depths in grids]
    kept = [sum(each) for each in zip(targets, transfers, strict=True)]
    grid = max(grid for grid, _ in grids)
    steps = min(most, encoder.BYTES["together"] * frames * grid)
    along = SETS[-1] * 8 * pixels * colours
    along = along if along <= AT_ONCE else 0  # see `phases.frames_along`
    return {
        "dpac": own + 8 * frames * pixels,
        "sgd": own + min(most, encoder.BYTES["sgd"] * frames * pixels),
        "joint": own + max(kept) + steps,
        "refine": own + sum(kept) + max(steps, batch_bytes) + along,
    }


def refine_batch(survey: Survey) -> Survey:
    """Survey of a render of as many frames as `refine` traces at once."""
    pixels, _, colours = _numbers(survey)
    frames = min(max(SETS[-1], AT_ONCE // (8 * pixels * colours)), MAX_FRAMES)
    return replace(survey, settings=replace(survey.settings, frames=frames, despeckle=0))


def _grids(survey):
    """Pixels of the padded grid on which phases are found, and depths at which they are looked at, by wavelength."""
    hologram, farthest = survey.hologram, max(abs(survey.z_low), abs(survey.z_high))
    size, volume, grids = (hologram.height, hologram.width), survey.z_high - survey.z_low, []
    for wavelength in hologram.wavelengths:
        depths = 1 + math.ceil(volume * hologram.max_slope(wavelength) ** 2 / wavelength)
        padded = padded_shape(size, hologram.pitch, wavelength, farthest, TEACHING_GUARD)
        grids.append((math.prod(padded), min(MAX_DEPTHS, max(2, depths))))
    return grids


def memory(
    survey: Survey, planes: Sequence[RecordingPlane], margin: int, slabs: int, bins: int, cached: bool
) -> float:
    """Estimated bytes of the arrays at most, with so many slabs and bins of the radiance map; see `stages`."""
    settings = survey.settings
    pixels, frames, colours = _numbers(survey)
    moving = _moving(survey, max(frames, SETS[-1]) if settings.despeckle else frames)
    # sums of a launch; a card's are brought to the processor in one piece
    sums = min((chunks_at_once() - 1) * CHUNK_BYTES // 2, 8 * pixels * frames * colours)
    lighting = _lighting(survey, margin, slabs, bins, cached)
    return _fields(survey, planes) + lighting + CHUNK_BYTES + sums + moving


def card_memory(
    survey: Survey,
    planes: Sequence[RecordingPlane],
    margin: int,
    slabs: int,
    bins: int,
    cached: bool,
    chunk: int,
    free: float,
) -> dict[str, float]:
    """Estimated bytes of a card's memory that each stage takes at most, where waves are computed there.

    Stages are `CARD_STAGES` and the encodings. Tracing has the light and the tables beside the fields, and sums of a
    launch with a copy; propagation one field on its way. See `memory`; `chunk` is the plan's, and encodings work on
    half of what is free at once.
    """
    pixels, frames, colours = _numbers(survey)

    def traced(survey):
        sums = 8 * pixels * survey.settings.frames * colours
        working = CHUNK_BYTES + 2 * min(chunks_at_once() * chunk, sums)
        return _fields(survey, planes) + _lighting(survey, margin, slabs, bins, cached) + working

    field = 8 * pixels * frames * colours
    render = traced(survey), _fields(survey, planes) + _moving(survey, 1)
    views = refocusing_on_card(field, 4 * pixels * colours)
    batches = phases_memory(survey, traced(refine_batch(survey)), min(encoder.MAX_BYTES, free / 2))
    encodings = {name: max(needed, encoding_on_card(field)) for name, needed in batches.items()}
    return dict(zip(CARD_STAGES, (*render, views), strict=True)) | encodings


def _lighting(survey, margin, slabs, bins, cached):
    """Bytes of kernel tables, of the radiance map, and of baked light."""
    settings, (pixels, _, colours) = survey.settings, _numbers(survey)
    tables = 0 if settings.estimator == "paper" else LEVELS[1] * margin**2 * 8 * colours
    surfaces = SURFACES * (1 + (bins**2 - 1) * survey.seen.binned) * CELL_BYTES
    cells = 0 if settings.radiance == "ray" else columns_of(survey, margin)
    radiance = cells * ((16 * slabs << survey.chains.splits) + surfaces)
    texels = min(pixels * ATLAS_TEXELS, MOST_TEXELS) * TEXEL_BYTES if cached else 0
    return tables + radiance + texels


def _fields(survey, planes):
    """Bytes of the fields on recording planes, and of what takes speckle out of them."""
    settings, (pixels, frames, colours) = survey.settings, _numbers(survey)
    images = any(plane.sees == "images" for plane in planes)  # which are brought to the others
    fields = pixels * frames * (colours * (1 + images) + 1) * 8
    if settings.despeckle:
        # a batch and its spectra, or the fields, Adam's memory, spectra, waves and slopes of a colour
        fields += pixels * 8 * max(SETS[-1] * (colours + 1), 7 * frames) + pixels * colours * 40 * 4
    return fields


def _moving(survey, frames):
    """Bytes of so many frames on their way to other planes and to the SLM."""
    hologram, farthest = survey.hologram, max(abs(survey.z_low), abs(survey.z_high))
    size = hologram.height, hologram.width
    grid = max(grid_bytes(size, hologram.pitch, w, farthest) for w in hologram.wavelengths)
    return stack_bytes(grid, frames)


def _numbers(survey):
    """Of pixels, frames and wavelengths."""
    hologram = survey.hologram
    return hologram.width * hologram.height, survey.settings.frames, len(hologram.wavelengths)
