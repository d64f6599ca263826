"""Propagation of the fields on recording planes to the wave field at the SLM."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..hologram import AerialImage
from ..progress import Stages, named, parts, stage
from ..waves import arrays, despeckle, lens, libraries
from ..waves.panels import propagate_fields
from ..waves.phase_fields import pixel_transmission, recordable_fraction

if TYPE_CHECKING:
    from ..hologram import Hologram
    from ..light.path_tracer import PathsPerRay
    from ..plan import RecordingPlane
    from ..progress import Progress
    from ..tracing.grains import RadianceMap
    from ..tracing.recording import Recording
    from ..waves.arrays import Array

OWN_FRAMES = (
    0  # number of the phasors of a hologram's own frames; the next numbers are batches for despeckling
)


class Tracing:
    """Wave tracing of recording planes for sets of phasors, which have numbers, see `OWN_FRAMES`.

    Parameters
    ----------
    recording : Recording
    radiance : RadianceMap or PathsPerRay
    *sets : numpy.ndarray, complex64, shape (frames, rows, columns)
        Phasors of the hologram's own frames, and of others that share their rays.
    straight : float
        Fraction of the first set's light that goes straight on, see `straight_share`; 0 for the others, which are
        designed. Sets of another kernel or period share only the light of rays.
    """

    def __init__(
        self,
        recording: Recording,
        radiance: RadianceMap | PathsPerRay,
        *sets: np.ndarray,
        straight: float = 0.0,
    ) -> None:
        self._straight, self._recording, self._radiance, self._sets = straight, recording, radiance, sets
        joined = not straight and len({each.shape[1:] for each in sets}) == 1
        self._own = [np.concatenate(sets) if len(sets) > 1 else sets[0]] if joined else list(sets)
        self._latest = OWN_FRAMES, self._own

    def _phasors(self, number):
        """Phasors of a number, in a list of arrays that are traced one after another."""
        if number != self._latest[0]:
            own = number == OWN_FRAMES
            self._latest = number, self._own if own else [despeckle.batch_phasors(number - 1)]
        return self._latest[1]

    def frames(self, number: int) -> int:
        """Number of frames of a number's phasors."""
        return sum(map(len, self._phasors(number)))

    def recordable(self, number: int) -> np.ndarray:
        """Fraction of each phasor's energy that fields record: within the band, and by the paper's pixels."""
        sets = self._sets if number == OWN_FRAMES else self._phasors(number)
        with self._recording.clock("phase fields"):
            paper = self._recording.plan.settings.estimator == "paper"
            transmission = pixel_transmission() if paper else 1.0
            kept = [recordable_fraction(each) * transmission for each in sets]
        return np.repeat(kept, [len(each) for each in sets])

    def add(self, number: int, plane: RecordingPlane, out: Array, progress: Progress) -> None:
        """Add the wave field on a plane to `out`, which has a margin, shape (frames, wavelengths, y, x)."""
        first, count = 0, self.frames(number)
        for phasors in self._phasors(number):
            last = first + len(phasors)
            on_progress = named(stage(progress, first / count, last / count), "Wave tracing")
            straight = self._straight if number == OWN_FRAMES and not first else 0.0
            self._recording.record(
                plane, self._radiance, phasors, on_progress, out[first:last, ...], straight
            )
            first = last


def at_slm(recording: Recording, tracing: Tracing, display: Hologram, progress: Progress) -> np.ndarray:
    """Wave field at the SLM; waves are arrays of the plan's library on the way there.

    Parameters
    ----------
    recording : Recording
    tracing : Tracing
        Tracing of this recording.
    display : Hologram
        Hologram whose pixels the field is for; rays may have been traced on another grid, see `mapping`.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    numpy.ndarray, complex64, shape (frames, wavelengths, y, x)
        Field of the picture, without the pixels beyond its edges.
    """
    hologram, steps = recording.hologram, recording.plan.settings.despeckle
    behind_lens = isinstance(hologram, AerialImage)
    stages = Stages(progress, "fields, despeckled" if steps else "fields")
    field = _in_scene(recording, tracing, OWN_FRAMES, stages["tracing"])
    if steps:
        _despeckle(recording, tracing, field, stages["despeckling"])
    out, pixels = field, None if behind_lens or display.plain else display
    if pixels is not None:
        out = arrays.empty((*field.shape[:2], display.height, display.width), "complex64", field)
    frames = field.shape[0]
    with recording.clock("propagation"):
        for k, m, wave in propagate_fields(field, hologram, -recording.plan.z_gathered, display=pixels):
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
    """Fields at the SLM, from those on the plane of an `AerialImage` with pixels of their wavelengths."""
    out = arrays.empty((*field.shape[:2], display.height, display.width), "complex64", field)
    for k, wavelength in enumerate(wavelengths):
        transform = lens.behind_lens(display, wavelength)
        assert transform is not None
        for frame in range(field.shape[0]):
            out[frame, k, ...] = transform.adjoint(field[frame, k, ...])
    return out


def _in_scene(recording, tracing, number, progress):
    """Wave field at `Plan.z_gathered` of everything before and behind it.

    Its scale makes a plane of radiance L refocus to intensity L. Between planes the carrier is left out, so that the
    parts of a surface that two planes record add up at every wavelength.
    """
    hologram, planes = recording.hologram, recording.plan.planes
    shape = tracing.frames(number), len(hologram.wavelengths), *recording.canvas
    on = libraries.empty_array(recording.plan.library)
    field, z = arrays.zeros(shape, "complex64", on), planes[0].z
    for index, (plane, part) in enumerate(zip(planes, parts(progress, len(planes)), strict=True)):
        on_propagation = named(part, "Between planes")
        if plane.sees == "images":
            # added to the field of the surfaces that show them
            images = arrays.zeros(shape, "complex64", on)
            tracing.add(number, plane, images, part)
            with recording.clock("propagation"):
                for k, m, wave in propagate_fields(images, hologram, z - plane.z, carried=False):
                    on_propagation(1.0)
                    field[m, k, ...] += wave
            continue
        if index:
            # the wave from behind passes the silhouette where the surfaces of this slab begin
            clear = arrays.like(np.sqrt(1 - recording.silhouette(plane)), on)
            with recording.clock("propagation"):
                for k, m, wave in propagate_fields(field, hologram, plane.low - z, carried=False):
                    on_propagation(0.0)
                    field[m, k, ...] = wave * clear
                for k, m, wave in propagate_fields(field, hologram, plane.z - plane.low, carried=False):
                    on_propagation(0.0)
                    field[m, k, ...] = wave
        z = plane.z
        tracing.add(number, plane, field, part)
    field *= arrays.like(np.float32(1 / np.sqrt(tracing.recordable(number))).reshape(-1, 1, 1, 1), on)
    return field


def _despeckle(recording, tracing, field, progress):
    """Despeckle the field on the plane nearest to the viewer, in place, by batches of frames of the same paths."""
    hologram, plan, settings = recording.hologram, recording.plan, recording.plan.settings
    low, high = (z - plan.z_gathered for z in (plan.z_low, plan.z_high))
    targets = [
        despeckle.targets(field.shape[-2:], hologram.pitch, wavelength, low, high, settings.seed, field)
        for wavelength in hologram.wavelengths
    ]
    stages = Stages(progress, "despeckling")
    for batch, part in enumerate(parts(stages["frames"], despeckle.BATCHES)):
        frames = _in_scene(recording, tracing, OWN_FRAMES + 1 + batch, part)
        with recording.clock("despeckle"):
            for k, target in enumerate(targets):
                target.add(frames[:, k, ...])
    with recording.clock("despeckle"):
        for k, (target, part) in enumerate(zip(targets, parts(stages["steps"], len(targets)), strict=True)):
            field[:, k, ...] = despeckle.despeckle(
                field[:, k, ...], target, settings.despeckle, settings.seed, named(part, "Despeckling")
            )
