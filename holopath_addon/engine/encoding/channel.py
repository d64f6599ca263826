"""One wavelength of an encoding: its field, its phases, and the optics between the SLM and where light is compared."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from ..hologram import AerialImage
from ..pixels import axes, coarsest
from ..scene.variants import threads
from ..waves import arrays
from ..waves.lens import behind_lens, spread_waves
from ..waves.modulator import wrapped
from ..waves.phase_fields import aimed_waves, random_phasors
from ..waves.propagation import filtered
from .double_phase import (
    MIN_SPREAD,
    clipping_level,
    double_phase,
    even_double_phase,
    half_band,
    spread_for,
    transmission,
)
from .phase_hologram import PhaseHologram
from .phases import FINE, WHOLE, Phases
from .shown_light import ShownLight
from .targets import AmplitudeTarget, ComplexTarget
from .views import ViewedVolume, Views, ViewTargets

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ..progress import PartProgress
    from ..wavefield import WaveField
    from ..waves.arrays import Array
    from ..waves.supervision import FramePool
    from .options import EncodingOptions

MIN_LEVELS = 16  # from which a start that leaves room for bright places, and short steps from it, show more
MARGIN = 12  # pixels of guard band around a display's panel, into which its relay scatters light


class Channel:
    """One wavelength of a field while it is encoded.

    Light is compared at the SLM, or on the plane of the image behind the hologram's lens. Fields are scaled to a root
    mean square of 1 at the SLM over all frames.

    Parameters
    ----------
    field : WaveField
    color : int
        Index of the wavelength.
    phases : array, float32, shape (frame, y, x)
        Memory for the phases, radians.
    options : EncodingOptions
    pool : FramePool
        Threads for the frames.
    on_wait : callable
        Called several times a second during longer work; may raise `Cancelled`.

    Attributes
    ----------
    color : int
    wavelength : float
        Meters.
    name : str
        The wavelength in nanometers, for messages.
    scale : float
        Root mean square of the field.
    gain : float
        Amplitude of the light to send in, for the scaled field.
    """

    def __init__(
        self,
        field: WaveField,
        color: int,
        phases: Array,
        options: EncodingOptions,
        pool: FramePool,
        on_wait: Callable[[], object],
    ) -> None:
        self.phases, self.gain = phases, 0.0
        self._field, self.color, self._options = field, color, options
        self._pool, self._on_wait = pool, on_wait
        hologram, self._panel = field.hologram, field.data.shape[-2:]
        self.wavelength = hologram.wavelengths[color]
        self.name = f"{self.wavelength * 1e9:.4g} nm"
        self.scale = _root_mean_square(field.data[:, color, ...])
        self._levels = options.levels_at(color)
        self._margin, self._display = 0, None
        if options.display is not None:
            self._margin = MARGIN
            self._display = ShownLight(
                options.display[color], self._panel, hologram.pitch, MARGIN, field.data
            )
        beam = hologram.illumination(color)
        self._beam = beam if beam is None else arrays.like(beam, field.data)
        self._lens, self._grid = behind_lens(hologram, self.wavelength), hologram.in_air
        self._shape = tuple(n + 2 * self._margin for n in self._panel)  # of light
        if self._lens is not None:
            self._shape = self._grid.raster(hologram.wavelengths[0]).shape
        self._stop_mask = hologram.optics.stop_mask(self._shape, self._grid.pitch_at(self.wavelength))

    @property
    def randomness(self) -> float | None:
        """Randomness of the phases that descents start with; None for the field's own.

        Behind a lens phases are spread over the whole band, and a display of few levels has no smooth ones: both count
        as random. Those of an earlier hologram are no start of a randomness.
        """
        randomness = None if isinstance(self._options.start, PhaseHologram) else self._options.randomness
        return 1.0 if randomness is not None and self._is_rough else randomness

    @property
    def _is_rough(self):
        return self._lens is not None or (self._levels is not None and len(self._levels) < MIN_LEVELS)

    @property
    def coarse_levels(self):
        """`Levels` so far apart that descents must compensate for them; None without any."""
        levels = self._levels
        return levels if levels is not None and levels.widest_gap > FINE else None

    def fields(self, frames: int | slice) -> Array:
        """Scaled fields of some frames where light is compared; a copy."""
        return self.compared(self._field.data[frames, self.color, ...])

    def compared(self, fields: Array) -> Array:
        """Fields at the SLM, scaled, where light is compared, with the guard band."""
        return self._pad(self.propagate(fields * (1 / self.scale)))

    def propagate(self, fields: Array) -> Array:
        """Propagate fields from the SLM to where light is compared."""
        return fields if self._lens is None else self._lens.propagate(fields)

    def _pad(self, fields):
        """Add the guard band, dark."""
        if not self._margin:
            return fields
        padded = arrays.zeros((*fields.shape[:-2], *self._shape), fields.dtype, fields)
        padded[..., self._margin : -self._margin, self._margin : -self._margin] = fields
        return padded

    def set_gain(self) -> None:
        """Set the gain with which the light within the band has the energy of the field's."""
        band, xp = arrays.like(self._stop_mask, self.phases), arrays.namespace(self.phases)
        field_energy = light_energy = 0.0
        for frame in range(self.phases.shape[0]):
            self._on_wait()
            wave = arrays.fft2(self.fields(frame), workers=threads())
            field_energy += arrays.total(xp.abs(wave[band]) ** 2)
            phase = self.phases[frame, ...]
            if self._display is not None:
                light = self._display.light(phase)
            else:
                light = xp.exp(1j * arrays.as_type(phase, "complex64"))
            if self._beam is not None:
                light *= self._beam
            light = arrays.fft2(self.propagate(light), workers=threads())
            light_energy += arrays.total(xp.abs(light[band]) ** 2)
        self.gain = math.sqrt(field_energy / light_energy) if light_energy else 0.0

    def set_double_phase(self, on_progress: PartProgress) -> None:
        """Set the phases by double phase; all frames share a clipping level, as their mean intensity counts."""
        frames = self.phases.shape[0]
        keep = half_band(self._panel)
        if self._lens is None:
            keep &= self._stop_mask
        waves = arrays.empty((frames, *self._panel), "complex64", self._field.data)
        for frame in range(frames):
            wave = self._field.data[frame, self.color, ...] * (1 / self.scale)
            waves[frame, ...] = filtered(wave, arrays.mask(keep, wave))
            on_progress(0.7 * (frame + 1) / frames)
        waves = transmission(waves, self._beam)
        level = clipping_level(waves, self._beam) or 1
        for frame in range(frames):
            self.phases[frame, ...] = double_phase(waves[frame, ...] / level)
            on_progress(0.7 + 0.3 * (frame + 1) / frames)

    def set_start(self) -> None:
        """Set the phases that descents start with."""
        self._on_wait()
        data, start, phases = self._field.data, self._options.start, self.phases
        xp = arrays.namespace(data)
        if isinstance(start, PhaseHologram):
            phases[...] = arrays.like(start.data[:, self.color, ...], data)
        elif self._options.randomness is not None:
            self._set_random_start(MIN_SPREAD)
        elif self._display is not None:
            for frame in range(phases.shape[0]):
                angles = self._display.phases_for(self._pad(data[frame, self.color, ...]))
                phases[frame, ...] = xp.remainder(angles, 2 * math.pi)
        elif start == "dpac":
            self.set_double_phase(lambda done: self._on_wait())
        else:
            waves = transmission(data[:, self.color, ...], self._beam)
            phases[...] = xp.remainder(arrays.angle(waves), 2 * math.pi)
        if (
            self._options.randomness is not None
        ):  # frames are not optimized one by one, which sets it otherwise
            self.set_gain()

    def leave_room_for(self, targets: ViewTargets) -> None:
        """Set a start of given randomness anew, so that pixels can show what is bright in the target pictures."""
        options, margin = self._options, self._margin
        if options.randomness is None or self._is_rough or isinstance(options.start, PhaseHologram):
            return
        self._on_wait()
        whole = targets.views.kinds[0][1]
        middle = targets.intensities[whole[len(whole) // 2]]
        if margin:  # the display's guard band is dark
            middle = middle[margin:-margin, margin:-margin]
        self.gain = 0.0  # until it is that of these phases, if it is canceled meanwhile
        self._set_random_start(spread_for(arrays.namespace(middle).sqrt(middle)))
        self.set_gain()

    def _set_random_start(self, spread):
        frames, options = self.phases.shape[0], self._options
        rows, columns = self._grid.raster(self.wavelength).shape
        waves = random_phasors(frames, rows, columns, options.seed, options.randomness)
        if self._lens is None:
            waves *= self._aimed_waves()
        else:
            waves = self._lens.adjoint(waves * spread_waves(frames, (rows, columns)))
        waves = transmission(arrays.like(waves, self._field.data), self._beam)
        # around half a turn, as displays blur phases across the ends of a turn
        self.phases[...] = math.pi + arrays.angle(waves)
        if self._lens is None:  # behind a lens the corners of the Fourier plane are those of the image
            self.phases += arrays.like(even_double_phase(self._panel, spread), self._field.data)

    def _aimed_waves(self):
        """`aimed_waves` through the pupil that all wavelengths fill, within the stop."""
        hologram = self._field.hologram
        x, y, radius = hologram.optics.stop_circle
        sizes = [each / coarsest(hologram.pitch) for each in axes(hologram.pitch)]
        radius *= min(hologram.wavelengths) / self.wavelength
        scale = [radius * size for size in sizes]
        return aimed_waves(self.phases.shape[0], self._panel, scale, (-y * sizes[0], x * sizes[1]))

    def target(self, fields: Array) -> ComplexTarget | AmplitudeTarget:
        """Target of `sgd` for the `fields` of some frames."""
        options, optics = self._options, self._field.hologram.optics
        pitch = self._grid.pitch_at(self.wavelength)
        if options.supervision == "complex":
            return ComplexTarget(fields, options.has_stop, self._pool, optics, pitch)
        low, high = self._volume
        count = options.compared_planes
        distances = np.linspace(low, high, count) if count > 1 else [(low + high) / 2]
        return AmplitudeTarget(fields, pitch, self.wavelength, distances, self._pool, optics)

    def view_targets(self) -> ViewTargets:
        """Targets of all frames together, to which no frames are added yet."""
        hologram, grid, places = self._field.hologram, self._grid, None
        if isinstance(grid, AerialImage):
            # light beside the image is free
            if grid.raster(self.wavelength) != grid.raster():
                places = grid.met(self.wavelength)
        elif not grid.plain:
            lines = grid.picture.raster().lines_on(grid.raster(self.wavelength))
            places = [line._replace(first=line.first + self._margin) for line in lines]
        pitch, options = grid.pitch_at(self.wavelength), self._options
        volume = ViewedVolume(self._shape, pitch, self.wavelength, *self._volume, hologram.optics, places)
        frames = self.phases.shape[0]
        views = Views(volume, frames, options.seed, options.eyebox, self._on_wait, self.phases)
        return ViewTargets(views, self.phases)

    @property
    def _volume(self):
        """Distances of the scene's ends from the panel as this wavelength sees it."""
        plan, hologram = self._field.plan, self._field.hologram
        panel = hologram.distance_at(self.wavelength)
        low = plan.get("z_low", hologram.depth_far) - panel
        high = plan.get("z_high", hologram.depth_near) - panel
        return (low, high) if high > low else (low - 1e-6, low + 1e-6)

    @contextmanager
    def optimized(self, frames: slice) -> Iterator[Phases]:
        """`Phases` of some frames, which are written back however the block ends."""
        ends = WHOLE if self._levels is None else self._levels.ends
        values = self.phases[frames, ...]
        phases = Phases(values, self._pool, self._display, ends, self._beam, self._lens)
        try:
            yield phases
        finally:
            values[...] = phases.values()

    def finish(self) -> None:
        """Round the phases to the display's levels.

        Behind a lens, pixels beside the square that the image uses get a checkerboard, whose light misses the image.
        """
        phases = self.phases
        if self._lens is not None:
            board = np.float32(math.pi) * (np.indices(self._panel).sum(0) % 2).astype(np.float32)
            board = arrays.namespace(phases).broadcast_to(arrays.like(board, phases)[None, ...], phases.shape)
            used = (slice(None), *self._lens.used)
            kept = arrays.copied(phases[used])
            phases[...] = board
            phases[used] = kept
        if self._levels is not None:
            for frame in range(phases.shape[0]):
                phases[frame, ...] = wrapped(self._levels.nearest(phases[frame, ...])[0])


def _root_mean_square(fields):
    xp = arrays.namespace(fields)
    sizes = (arrays.as_type(xp.abs(fields[n, ...]), "float64") for n in range(fields.shape[0]))
    return math.sqrt(np.mean([float(xp.mean(size**2)) for size in sizes]))
