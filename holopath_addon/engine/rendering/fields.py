"""From what recording planes record to the wave field at the SLM."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..hologram import AerialImage
from ..pixels import Raster, beyond
from ..progress import Stages, named, parts, stage
from ..waves import arrays, despeckle, lens, libraries
from ..waves.phase_fields import pixel_transmission, recordable_fraction
from ..waves.propagation import carrier, commensurate, padded_shape, propagate_stack, transfer_function

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..hologram import Hologram
    from ..light.path_tracer import PathsPerRay
    from ..plan import RecordingPlane
    from ..progress import Progress
    from ..tracing.grains import RadianceMap
    from ..tracing.recording import Recording
    from ..waves.arrays import Array

OWN = 0  # number of the phasors that a hologram has; the next ones are of the batches that speckle is taken out by


class Tracing:
    """What recording planes record, traced when it is asked for: frames by sets of phasors, see `OWN`.

    Parameters
    ----------
    recording : Recording
    radiance : RadianceMap or PathsPerRay
    *sets : numpy.ndarray, complex64, shape (frames, rows, columns)
        Phasors of the hologram's own frames, and of others that share their rays.
    straight : float
        Of the first set's light, see `straight_share`; of the others, designed ones, it is 0. Sets of another kernel
        or another period share the light of rays alone.
    """

    def __init__(
        self,
        recording: Recording,
        radiance: RadianceMap | PathsPerRay,
        *sets: np.ndarray,
        straight: float = 0.0,
    ) -> None:
        self._straight, self._recording, self._radiance, self._sets = straight, recording, radiance, sets
        together = not straight and len({each.shape[1:] for each in sets}) == 1
        self._own = [np.concatenate(sets) if len(sets) > 1 else sets[0]] if together else list(sets)
        self._last = OWN, self._own

    def _phasors(self, number):
        """Those that share their rays, a list."""
        if number != self._last[0]:
            own = number == OWN
            self._last = number, self._own if own else [despeckle.batch_phasors(number - 1)]
        return self._last[1]

    def frames(self, number: int) -> int:
        """Frames of the set of phasors with a number."""
        return sum(map(len, self._phasors(number)))

    def recordable(self, number: int) -> np.ndarray:
        """The energy of each of its phasors that a field keeps: what is in the band, and passes the paper's pixels."""
        sets = self._sets if number == OWN else self._phasors(number)
        with self._recording.clock("phase fields"):
            paper = self._recording.plan.settings.estimator == "paper"
            passed = pixel_transmission() if paper else 1.0
            kept = [recordable_fraction(each) * passed for each in sets]
        return np.repeat(kept, [len(each) for each in sets])

    def add(self, number: int, plane: RecordingPlane, out: Array, progress: Progress) -> None:
        """Add the wave field on a plane to `out`, which has a margin, shape (frames, wavelengths, y, x)."""
        first, count = 0, self.frames(number)
        for phasors in self._phasors(number):
            last = first + len(phasors)
            told = named(stage(progress, first / count, last / count), "Wave tracing")
            straight = self._straight if number == OWN and not first else 0.0
            self._recording.record(plane, self._radiance, phasors, told, out[first:last, ...], straight)
            first = last


def at_slm(recording: Recording, tracing: Tracing, display: Hologram, progress: Progress) -> np.ndarray:
    """The wave field at the SLM. Waves are those of the plan's library until they are there.

    Parameters
    ----------
    recording : Recording
        For silhouettes, the plan and where planes lie.
    tracing : Tracing
        Of the recording.
    display : Hologram
        Whose pixels are wanted; rays may have been traced on another grid, see `mapping`.
    progress : callable
        ``progress(done, message)``, may raise.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, wavelengths, y, x)
        Of the picture, without what was traced beside it.
    """
    hologram, steps = recording.hologram, recording.plan.settings.despeckle
    behind_lens = isinstance(hologram, AerialImage)
    stages = Stages(progress, "fields, despeckled" if steps else "fields")
    field = _in_scene(recording, tracing, OWN, stages["tracing"])
    if steps:
        _despeckle(recording, tracing, field, stages["despeckling"])
    out, pixels = field, None if behind_lens or display.plain else display
    if pixels is not None:
        out = arrays.empty((*field.shape[:2], display.height, display.width), "complex64", field)
    frames = field.shape[0]
    with recording.clock("propagation"):
        for k, m, wave in _moved(field, hologram, -recording.plan.z_gathered, display=pixels):
            out[m, k, ...] = wave
            step = (k * frames + m + 1) / (frames * len(hologram.wavelengths))
            stages["to the SLM"](step, "To the SLM")
        if out is not field:
            return arrays.on_processor(out)
        edge = recording.beyond + recording.plan.beside
        field = field[..., edge : field.shape[-2] - edge, edge : field.shape[-1] - edge]
        return arrays.on_processor(
            _through_lens(field, hologram.wavelengths, display) if behind_lens else field
        )


def _through_lens(field, wavelengths, display):
    """Fields on the plane of an `AerialImage`, on the pixels of their wavelengths, at the SLM of its display."""
    out = arrays.empty((*field.shape[:2], display.height, display.width), "complex64", field)
    for k, wavelength in enumerate(wavelengths):
        way = lens.behind_lens(display, wavelength)
        assert way is not None
        for frame in range(field.shape[0]):
            out[frame, k, ...] = way.adjoint(field[frame, k, ...])
    return out


def _in_scene(recording, tracing, number, progress):
    """The wave field at `Plan.z_gathered`, of all that lies before and behind it.

    Its scale makes a plane of radiance L refocus to intensity L. Between planes the carrier is left out, for then the
    shares of a surface that two planes record add up, whatever the wavelength.
    """
    hologram, planes = recording.hologram, recording.plan.planes
    shape = tracing.frames(number), len(hologram.wavelengths), *recording.canvas
    on = libraries.empty_array(recording.plan.library)
    field, z = arrays.zeros(shape, "complex64", on), planes[0].z
    for index, (plane, told) in enumerate(zip(planes, parts(progress, len(planes)), strict=True)):
        moving = named(told, "Between planes")
        if plane.sees == "images":
            # straight rays tell which of them are seen
            images = arrays.zeros(shape, "complex64", on)
            tracing.add(number, plane, images, told)
            with recording.clock("propagation"):
                for k, m, wave in _moved(images, hologram, z - plane.z, carried=False):
                    moving(1.0)
                    field[m, k, ...] += wave
            continue
        if index:
            # what lies behind passes the surfaces of this slab as a wave, there where they begin
            clear = arrays.like(np.sqrt(1 - recording.silhouette(plane)), on)
            with recording.clock("propagation"):
                for k, m, wave in _moved(field, hologram, plane.low - z, carried=False):
                    moving(0.0)
                    field[m, k, ...] = wave * clear
                for k, m, wave in _moved(field, hologram, plane.z - plane.low, carried=False):
                    moving(0.0)
                    field[m, k, ...] = wave
        z = plane.z
        tracing.add(number, plane, field, told)
    field *= arrays.like(np.float32(1 / np.sqrt(tracing.recordable(number))).reshape(-1, 1, 1, 1), on)
    return field


def _despeckle(recording, tracing, field, progress):
    """Take speckle out of the field on the plane nearest to the viewer, in place; the same paths, more frames."""
    hologram, plan, settings = recording.hologram, recording.plan, recording.plan.settings
    low, high = (z - plan.z_gathered for z in (plan.z_low, plan.z_high))
    targets = [
        despeckle.targets(field.shape[-2:], hologram.pitch, wavelength, low, high, settings.seed, field)
        for wavelength in hologram.wavelengths
    ]
    stages = Stages(progress, "despeckling")
    for batch, told in enumerate(parts(stages["frames"], despeckle.BATCHES)):
        many = _in_scene(recording, tracing, OWN + 1 + batch, told)
        with recording.clock("despeckle"):
            for k, target in enumerate(targets):
                target.add(many[:, k, ...])
    with recording.clock("despeckle"):
        for k, (target, told) in enumerate(zip(targets, parts(stages["steps"], len(targets)), strict=True)):
            field[:, k, ...] = despeckle.despeckle(
                field[:, k, ...], target, settings.despeckle, settings.seed, named(told, "Despeckling")
            )


def _moved(field, hologram, distance, carried=True, display=None) -> Iterator[tuple[int, int, np.ndarray]]:
    """Wavelength number, frame number and the field moved by a distance, with its carrier or without, of a stack.

    To a display that is where its pixels lie for the light of each wavelength.
    """
    shape, start = field.shape[-2:], distance
    for k, wavelength in enumerate(hologram.wavelengths):
        places, guard = None, 0
        if display is not None:
            distance = start + display.distance_at(wavelength)
            places = display.raster(wavelength).lines_on(Raster(shape, hologram.pitch))
            guard = beyond(places, shape)
        padded = padded_shape(shape, hologram.pitch, wavelength, distance, guard)
        padded = padded if places is None else commensurate(padded, places)
        transfer = transfer_function(padded, hologram.pitch, wavelength, distance, on=field)
        if carried:
            transfer = transfer * carrier(wavelength, distance)
        for m, wave in enumerate(propagate_stack(field[:, k, ...], transfer, places)):
            yield k, m, wave
