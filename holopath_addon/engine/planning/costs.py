"""Estimates of a plan's seconds and bytes, from the speeds that the probe and `machine` measured.

Constants in seconds are for the reference machine of `machine.Slowness`, fitted to ten scenes on two cores from 24 to
26 November 2026 (docs/measurements.md, What plans foretell). Constants in bytes follow from the arrays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
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
from ..waves.propagation import OPTIMIZATION_GUARD, grid_bytes, padded_shape, stack_bytes
from ..waves.target_images import MAX_TRANSFER_BYTES, spread_viewpoints
from .noise import estimated_rays
from .planes import columns_of, mean_rays
from .probe import MIN_VIEW_FRACTION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..plan import RecordingPlane
    from .machine import Slowness
    from .pilot_light import Light
    from .survey import Survey

# Bytes
WORKING_BYTES = 256 << 20  # working memory of Mitsuba and of one launch of the kernels
CELL_BYTES = 448  # an occupied cell of the radiance map: 22 sums of 8 bytes, filter tables, and means
CELLS_PER_COLUMN = 2  # occupied slabs in a pixel column, typically
TEXELS_PER_PIXEL = 40  # texels of the atlas per pixel of the view, typically
MAX_ATLAS_TEXELS = 1 << 25
TEXEL_BYTES = 48  # a texel while it is baked

# Fractions of the time that the probe's rays, chains and paths take each: neighboring probe rays are far apart.
RAY_TIME_FRACTION = 0.35
CHAIN_TIME_FRACTION = 1.0
PATH_TIME_FRACTION = 0.95
TEXTURE_TIME_FRACTION = 0.2  # fraction of a path's time that a ray takes to see a texture alone

# Seconds of Dr.Jit's programs, see `Slowness.programs`
RAY_SUM_SECONDS = 2.0e-9  # for each ray
FRAME_SUM_SECONDS = 0.15e-9  # for each frame and wavelength of each ray
SHARING_SECONDS = 1.2e-6  # for each column of the radiance map, whose grains share light with their neighbors

# Seconds of one core, mostly Python that traces programs, see `Slowness.core`
RAY_LAUNCH_SECONDS, PATH_LAUNCH_SECONDS = 0.05, 0.06
TRACING_START_SECONDS = 0.04
TABLES_SECONDS, PLANE_TABLES_SECONDS = 0.01, 0.045  # kernel tables and regions: once, and for each plane
MIN_COMPILING_SECONDS = 0.05  # by the pilot; above, the programs of the render are compiled, too
RAY_COMPILING_SECONDS, SHARING_COMPILING_SECONDS = 0.1, 0.6
RAY_COMPILING_RATIO, PATH_COMPILING_RATIO = 1.5, 1.6  # times what the pilot's programs took to compile
BAKE_START_SECONDS, BAKE_CHARTS_SECONDS, BAKE_TRIANGLE_SECONDS = 0.3, 1.6, 1.1e-6
CHARTED_TRIANGLES = 2000  # triangles from which charts take all of `BAKE_CHARTS_SECONDS`
LOAD_START_SECONDS, LOAD_TRIANGLE_SECONDS, LOAD_TEXEL_SECONDS = 0.1, 0.7e-6, 0.04e-6
FIND_TEXELS_SECONDS = 0.12  # to find which texels of baked light the view lacks

# Seconds of Fourier transforms, see `Slowness.transforms`, for each pixel, frame and wavelength
PROPAGATION_SECONDS = 0.022e-6  # to another plane
# of encodings (docs/measurements.md, Seconds of encoding)
SGD_SECONDS = 0.7e-6  # all steps of `sgd`
STEP_TRANSFORM_SECONDS = 8e-9  # a transform of the padded grid, in a step of all frames together
VIEW_TRANSFORM_SECONDS = 5e-9  # a transform of the padded grid, for a view
DESPECKLE_FRAME_SECONDS, DESPECKLE_STEP_SECONDS = 1e-6, 25e-9  # a frame of the target; a step of a frame

COPY_SECONDS_PER_BYTE = 0.85e-9  # from a card's memory to the processor's, see `Slowness.copies`

# Work of baking: groups of texels, samples, and how long a sample takes
GROUPS_PER_PIXEL = 1.4  # for each diffuse pixel of the view
GROUPS_PER_TRIANGLE = 1.5  # of dense meshes
SPECULAR_GROUPS = 400e3  # seen by way of mirrors and glass
SAMPLES_PER_GROUP = 22
INDIRECT_SAMPLES = 5.5e6  # for the light between surfaces
SAMPLE_TIME_RATIO = (
    1.1  # a sample's time over that of a path which ends at the first surface that lamps light
)
FIRST_LOOK_PATHS = 1e6  # such paths, which measure how many more are needed once light is baked


def baking_seconds(
    survey: Survey, columns: int, rays: tuple[int, int], baked_fraction: float | None, triangles: int
) -> dict[str, float]:
    """Seconds of the radiance cache, and of the radiance map that is still needed with it, by stage.

    Parameters
    ----------
    survey : Survey
    columns : int
        Pixels of the radiance map.
    rays : (int, int)
        Radiance paths a pixel, and rays a pixel for textures.
    baked_fraction : float or None
        Fraction of the view whose light was baked before and is loaded; None where none of the scene was.
    triangles : int

    Returns
    -------
    dict of str to float
    """
    hologram, probe, light, slowness = survey.hologram, survey.probe, survey.light, survey.slowness
    charted = min(1.0, triangles / CHARTED_TRIANGLES)
    groups = (
        hologram.width * hologram.height * probe.diffuse * GROUPS_PER_PIXEL + triangles * GROUPS_PER_TRIANGLE
    )
    groups += SPECULAR_GROUPS if probe.specular > MIN_VIEW_FRACTION else 0
    samples = (1 - (baked_fraction or 0)) * SAMPLES_PER_GROUP * groups
    if baked_fraction is None:
        core = BAKE_START_SECONDS + BAKE_CHARTS_SECONDS * charted + BAKE_TRIANGLE_SECONDS * triangles
        samples += INDIRECT_SAMPLES
    else:
        core = FIND_TEXELS_SECONDS
    short = replace(light, paths_per_second=light.short_per_second)
    return {
        "bake": slowness.core * core + SAMPLE_TIME_RATIO * samples / light.short_per_second,
        "radiance": radiance_map_seconds(short, slowness, columns, *rays)
        + FIRST_LOOK_PATHS / light.short_per_second,
    }


def loading_seconds(texels: int, triangles: int, slowness: Slowness) -> float:
    """Seconds to load a texture of baked light."""
    return slowness.core * (
        LOAD_START_SECONDS + LOAD_TRIANGLE_SECONDS * triangles + LOAD_TEXEL_SECONDS * texels
    )


def radiance_map_seconds(
    light: Light, slowness: Slowness, columns: int, passes: int, texture_rays: int
) -> float:
    """Seconds of the radiance map: its paths, its rays for textures, and the sharing of light between grains.

    Parameters
    ----------
    light : Light
        With the speed of the paths.
    slowness : Slowness
    columns : int
        Pixels of the map.
    passes, texture_rays : int
        Paths, and rays for textures, of each of them.
    """
    sharing = slowness.programs * SHARING_SECONDS * columns * _shares_light(light)
    return path_seconds(light, slowness, columns * (passes + TEXTURE_TIME_FRACTION * texture_rays)) + sharing


def path_seconds(light: Light, slowness: Slowness, paths: float) -> float:
    """Seconds of radiance paths."""
    traced = PATH_TIME_FRACTION * paths / light.paths_per_second
    launches = launch_count(traced, paths / UNIT_PATHS, max_ratio=CHUNK_PATHS // UNIT_PATHS)
    return traced + slowness.core * PATH_LAUNCH_SECONDS * launches


def launch_count(seconds: float, units: float, first: float = 1.0, max_ratio: int = 1) -> float:
    """Number of launches for some units of work.

    `progress.Pace` doubles the units of a launch until it takes one to two times `OFTEN`.

    Parameters
    ----------
    seconds : float
        Seconds that all units take.
    units : float
    first : float
        Units of the first launch.
    max_ratio : int
        Maximum units of a launch over `units_at_once`.
    """
    units = max(units, 1.0)
    together = min(max(1.4 * OFTEN * units / max(seconds, 1e-9), 1.0), max_ratio * units_at_once(), units)
    return units / together + max(0.0, math.log2(together / min(first, units)))


def _shares_light(light):
    """Whether any grains share light: emitters do not."""
    return light.shining < 1 - MIN_VIEW_FRACTION


@dataclass(frozen=True, kw_only=True)
class CostModel:
    """Seconds and bytes of a planned render, and of the encodings of its field.

    Attributes
    ----------
    survey : Survey
        Its `slowness` may be that of the processor beside a card.
    planes : sequence of RecordingPlane
    margin : int
        Pixels of the radiance map beyond each edge of the hologram.
    slabs, bins : int
        Depth slabs of the radiance map, and its pupil bins along each axis.
    traversals : int
        Times that rays are traced: once for all wavelengths, or once for each.
    baking_seconds : dict of str to float or None
        Result of `baking_seconds`; None without a radiance cache.
    """

    survey: Survey
    planes: Sequence[RecordingPlane]
    margin: int
    slabs: int
    bins: int
    traversals: int
    baking_seconds: dict[str, float] | None

    @property
    def of_refine_batch(self) -> CostModel:
        """Costs of a render of as many frames as `refine` traces at once."""
        pixels, _, colors = self._counts
        frames = min(max(SETS[-1], AT_ONCE // (8 * pixels * colors)), MAX_FRAMES)
        settings = replace(self.survey.settings, frames=frames, despeckle=0)
        return replace(self, survey=replace(self.survey, settings=settings))

    def stage_seconds(self) -> dict[str, float]:
        """Estimate the seconds of each stage of a render, without compiling, by the stages' names in its report."""
        survey, planes = self.survey, self.planes
        settings, probe, light, slowness = survey.settings, survey.probe, survey.light, survey.slowness
        pixels, frames, colors = self._counts
        plain, chained = self._mean_rays
        sums = slowness.programs * (RAY_SUM_SECONDS + FRAME_SUM_SECONDS * frames * colors)
        rays = plain * (RAY_TIME_FRACTION / probe.rays_per_second + sums)
        rays += chained * (CHAIN_TIME_FRACTION / probe.chains_per_second + sums)
        start = TRACING_START_SECONDS + RAY_LAUNCH_SECONDS * self._wave_launches(pixels * rays)
        out = {
            "kernel tables": slowness.core * (TABLES_SECONDS + PLANE_TABLES_SECONDS * len(planes)),
            "wave tracing": self.traversals * (slowness.core * start + pixels * rays),
            "propagation": slowness.transforms * pixels * frames * colors * PROPAGATION_SECONDS * len(planes)
            + slowness.copies * COPY_SECONDS_PER_BYTE * 8 * pixels * frames * colors,
        }
        if settings.radiance == "ray":
            paths = pixels * (plain + chained) * settings.paths
            out["wave tracing"] += self.traversals * PATH_TIME_FRACTION * paths / light.paths_per_second
        elif self.baking_seconds is None:
            columns = columns_of(survey, self.margin)
            out["radiance"] = self.traversals * radiance_map_seconds(
                light, slowness, columns, *estimated_rays(settings, light)
            )
        else:
            out |= self.baking_seconds
        if settings.despeckle:
            targets = despeckle.BATCHES * SETS[-1]
            steps = targets * DESPECKLE_FRAME_SECONDS + frames * settings.despeckle * DESPECKLE_STEP_SECONDS
            out["despeckle"] = (
                pixels * (plain + chained) * despeckle.BATCHES * RAY_TIME_FRACTION / probe.rays_per_second
                + slowness.programs * pixels * targets * colors * (plain + chained) * FRAME_SUM_SECONDS
                + slowness.transforms * pixels * colors * steps
            )
        return out

    def with_compiling(self, stages: dict[str, float]) -> dict[str, float]:
        """Add compiling to `stage_seconds`, where the pilot's own programs had to be compiled, too."""
        probe, light, slowness = self.survey.probe, self.survey.light, self.survey.slowness
        if light.compiling <= slowness.core * MIN_COMPILING_SECONDS:
            return stages
        sharing = slowness.core * SHARING_COMPILING_SECONDS * _shares_light(light)
        compiling = {
            "wave tracing": slowness.core * RAY_COMPILING_SECONDS + RAY_COMPILING_RATIO * probe.compiling,
            "radiance": sharing + PATH_COMPILING_RATIO * light.compiling,
        }
        return stages | {name: stages.get(name, 0.0) + seconds for name, seconds in compiling.items()}

    def encoding_seconds(self, stages: dict[str, float]) -> dict[str, float]:
        """Estimate the seconds of the parts of encodings, by `PHASES`.

        `sgd` and `joint` are all their steps. `look` is of all views of a frame. For `refine`, `light` finds the
        radiance again, `rays` traces a batch of extra frames, `frame` adds one of them, and `step` is of all frames.

        Parameters
        ----------
        stages : dict of str to float
            `stage_seconds` of the render.
        """
        probe, slowness = self.survey.probe, self.survey.slowness
        pixels, frames, colors = self._counts
        plain, chained = self._mean_rays
        grids, eyebox = self._encoding_grids, eyebox_for(frames)
        views_of_grids = sum(grid * (1 + transforms(frames, eyebox) * depths) for grid, depths in grids)
        look = slowness.transforms * VIEW_TRANSFORM_SECONDS * views_of_grids
        rays = plain * RAY_TIME_FRACTION / probe.rays_per_second
        rays = pixels * (rays + chained * CHAIN_TIME_FRACTION / probe.chains_per_second)
        sums = slowness.programs * pixels * colors * (plain + chained) * FRAME_SUM_SECONDS
        propagation = slowness.transforms * pixels * colors * PROPAGATION_SECONDS * len(self.planes)
        copied = slowness.copies * COPY_SECONDS_PER_BYTE * 4 * pixels * frames * colors  # phases from a card
        sgd = slowness.transforms * pixels * frames * colors * SGD_SECONDS + copied
        padded = sum(grid for grid, _ in grids)
        step = slowness.transforms * frames * step_transforms(eyebox) * STEP_TRANSFORM_SECONDS * padded
        joint = sgd + 3 * frames * look + JOINT_STEPS["joint"] * step
        light = sum(stages.get(name, 0.0) for name in ("kernel tables", "radiance"))
        parts = sgd, joint, look, light, self.traversals * rays, sums + propagation, step
        return dict(zip(PHASES, parts, strict=True))

    def render_bytes(self) -> float:
        """Estimate the peak bytes of the arrays of a render."""
        settings = self.survey.settings
        pixels, frames, colors = self._counts
        moving = self._moving_bytes(max(frames, SETS[-1]) if settings.despeckle else frames)
        # sums of a launch; a card's are copied to the processor in one piece
        sums = min((chunks_at_once() - 1) * WORKING_BYTES // 2, 8 * pixels * frames * colors)
        return self._field_bytes() + self._light_bytes() + WORKING_BYTES + sums + moving

    def encoding_bytes(self) -> dict[str, float]:
        """Estimate the peak bytes of each encoding, with the field that it encodes."""
        return self._encoding_bytes(self.of_refine_batch.render_bytes(), encoder.MAX_BYTES)

    def card_bytes(self, chunk_bytes: int, free_bytes: float) -> dict[str, float]:
        """Estimate the peak bytes of a card's memory for each of `CARD_STAGES` and each encoding.

        Tracing keeps fields, light and tables, and the sums of a launch twice. Propagation moves one field at a time.
        Encodings work on batches of half of what is free.

        Parameters
        ----------
        chunk_bytes : int
            `Plan.chunk`.
        free_bytes : float
        """
        pixels, frames, colors = self._counts
        field = 8 * pixels * frames * colors
        batch = self.of_refine_batch._tracing_bytes(chunk_bytes)
        encodings = self._encoding_bytes(batch, min(encoder.MAX_BYTES, free_bytes / 2))
        stages = (
            self._tracing_bytes(chunk_bytes),
            self._field_bytes() + self._moving_bytes(1),
            refocusing_on_card(field, 4 * pixels * colors),
        )
        return dict(zip(CARD_STAGES, stages, strict=True)) | {
            name: max(needed, encoding_on_card(field)) for name, needed in encodings.items()
        }

    @property
    def _counts(self):
        """Numbers of pixels, frames and wavelengths."""
        hologram = self.survey.hologram
        return hologram.width * hologram.height, self.survey.settings.frames, len(hologram.wavelengths)

    @property
    def _mean_rays(self):
        """Mean rays a pixel: plain ones, and those that follow chains."""
        return mean_rays(self.planes, self.survey.chains.branches)

    @property
    def _encoding_grids(self):
        """Pixels of the padded grid on which phases are found, and number of depths of its views, by wavelength."""
        survey, grids = self.survey, []
        hologram, farthest = survey.hologram, max(abs(survey.z_low), abs(survey.z_high))
        size, volume = (hologram.height, hologram.width), survey.z_high - survey.z_low
        for wavelength in hologram.wavelengths:
            depths = 1 + math.ceil(volume * hologram.max_slope(wavelength) ** 2 / wavelength)
            padded = padded_shape(size, hologram.pitch, wavelength, farthest, OPTIMIZATION_GUARD)
            grids.append((math.prod(padded), min(MAX_DEPTHS, max(2, depths))))
        return grids

    def _wave_launches(self, seconds):
        """Number of launches of rays from all planes; see `wave_tracer.trace_blocks`."""
        settings, planes = self.survey.settings, len(self.planes)
        rays = self._counts[0] * sum(self._mean_rays)
        if settings.radiance == "ray" or settings.estimator == "paper":
            return max(rays / CHUNK_RAYS, planes)  # random numbers go by blocks, which are not joined
        return planes * launch_count(seconds / planes, rays / planes / CHUNK_RAYS, units_at_first())

    def _tracing_bytes(self, chunk_bytes):
        """Bytes of a card's memory for wave tracing."""
        pixels, frames, colors = self._counts
        working = WORKING_BYTES + 2 * min(chunks_at_once() * chunk_bytes, 8 * pixels * frames * colors)
        return self._field_bytes() + self._light_bytes() + working

    def _light_bytes(self):
        """Bytes of kernel tables, of the radiance map, and of baked light."""
        survey, (pixels, _, colors) = self.survey, self._counts
        tables = 0 if survey.settings.estimator == "paper" else LEVELS[1] * self.margin**2 * 8 * colors
        cells = CELLS_PER_COLUMN * (1 + (self.bins**2 - 1) * survey.probe.binned) * CELL_BYTES
        columns = 0 if survey.settings.radiance == "ray" else columns_of(survey, self.margin)
        radiance = columns * ((16 * self.slabs << survey.chains.splits) + cells)
        texels = (
            0
            if self.baking_seconds is None
            else min(pixels * TEXELS_PER_PIXEL, MAX_ATLAS_TEXELS) * TEXEL_BYTES
        )
        return tables + radiance + texels

    def _field_bytes(self):
        """Bytes of the fields on recording planes, and of despeckling."""
        settings, (pixels, frames, colors) = self.survey.settings, self._counts
        images = any(plane.sees == "images" for plane in self.planes)  # a field beside that of surfaces
        fields = pixels * frames * (colors * (1 + images) + 1) * 8
        if settings.despeckle:
            # a batch and its spectra, or of one color the fields, Adam's moments, spectra, waves and slopes
            fields += (
                pixels * 8 * max(SETS[-1] * (colors + 1), 7 * frames) + self._despeckling_targets_bytes()
            )
        return fields

    def _despeckling_targets_bytes(self):
        """Bytes of the target images of despeckling and of their transfer functions, of all wavelengths."""
        survey, hologram, needed = self.survey, self.survey.hologram, 0
        size, volume = (hologram.height, hologram.width), survey.z_high - survey.z_low
        for wavelength in hologram.wavelengths:
            images = len(spread_viewpoints(hologram.pitch, wavelength, 0.0, volume, seed=0))
            grid = math.prod(padded_shape(size, hologram.pitch, wavelength, volume))
            needed += images * 4 * math.prod(size) + min(MAX_TRANSFER_BYTES, 8 * grid * images)
        return needed

    def _moving_bytes(self, frames):
        """Bytes of the propagation of some frames to other planes and to the SLM."""
        hologram, farthest = self.survey.hologram, max(abs(self.survey.z_low), abs(self.survey.z_high))
        size = hologram.height, hologram.width
        grid = max(grid_bytes(size, hologram.pitch, w, farthest) for w in hologram.wavelengths)
        return stack_bytes(grid, frames)

    def _encoding_bytes(self, batch_bytes, max_array_bytes):
        """Bytes of each encoding, by name.

        `batch_bytes` is for tracing a batch of extra frames, and `max_array_bytes` bounds the arrays of a stage.
        """
        (pixels, frames, colors), grids = self._counts, self._encoding_grids
        own = (8 + 4) * frames * pixels * colors
        eyebox = eyebox_for(frames)
        targets = [4 * grid * transforms(frames, eyebox) * depths for grid, depths in grids]
        transfers = [min(MAX_TRANSFER_BYTES, 8 * grid * depths) for grid, depths in grids]
        kept = [sum(each) for each in zip(targets, transfers, strict=True)]
        steps = min(max_array_bytes, encoder.BYTES["together"] * frames * max(grid for grid, _ in grids))
        co_traced = SETS[-1] * 8 * pixels * colors
        co_traced = co_traced if co_traced <= AT_ONCE else 0  # see `phases.extra_frame_count`
        return {
            "dpac": own + 8 * frames * pixels,
            "sgd": own + min(max_array_bytes, encoder.BYTES["sgd"] * frames * pixels),
            "joint": own + max(kept) + steps,
            "refine": own + sum(kept) + max(steps, batch_bytes) + co_traced,
        }
