"""Which stages an encoding has, and what passes between them."""

from __future__ import annotations

import math
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import Cancelled, InvalidInput, cancelled
from ..hologram import AerialImage
from ..memory import on_card
from ..pixels import axes, coarsest
from ..progress import SHARES
from ..progress import stage as part_of
from ..scene.variants import threads
from ..settings import ENCODINGS
from ..waves import arrays
from ..waves.lens import behind_lens, spread_waves
from ..waves.modulator import Levels, wrapped
from ..waves.phase_fields import DESIGNED_STARTS, FEW_FRAMES, aimed_waves, random_phasors, randomness_for
from ..waves.propagation import filtered
from ..waves.supervision import Frames
from . import descent
from .axis import on_axis
from .double_phase import clipping_level, double_phase, even_double_phase, half_band, transmission
from .phase_hologram import PhaseHologram
from .phases import FINE, WHOLE, Phases
from .shown_light import ShownLight
from .targets import AmplitudeTarget, ComplexTarget
from .views import Views, step_transforms

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import ArrayLike

    from ..progress import Progress
    from ..wavefield import WaveField
    from ..waves.arrays import Array
    from ..waves.display_model import DisplayModel

SUPERVISIONS = ("complex", "amplitude")
STARTS = ("arg", "dpac")
MOST_BYTES = 4 << 30  # of arrays that a stage works on: frames that do not fit are done after another
SMOOTH = 0.8  # correlation of a field's neighbors; of random phases that fill the band it is 0.2
MARGIN = 12  # pixels around a display's, into which its relay scatters light
DARK = 1e-6  # of the brightest colour's amplitude
BYTES = {"sgd": 40, "together": 44, "views": 24}  # of a pixel of a frame
MOST_STEPS = 1000
STEPS = {"joint": 100, "refine": 400}  # of each wavelength, where seconds do not say how many
SHARE = {name: SHARES[name]["single frames"] for name in ("joint", "refine")}
TRACED = SHARES["refine"]["extra frames"]  # of the seconds, too
# Shares of the seconds, where these are few: the first stage takes no more of them, and some frames are there by then.
FIRST, LATEST = 0.1, 0.6
LEAST_STEPS = 10  # of all frames together, for which looks at all views are worth their time


def encode(
    field: WaveField,
    method: str = "auto",
    progress: Progress | None = None,
    *,
    bits: int | None = None,
    levels: Sequence[ArrayLike | Levels] | None = None,
    display: Sequence[DisplayModel] | None = None,
    supervision: str = "complex",
    compared_planes: int = 1,
    aperture: bool = True,
    start: str | PhaseHologram = "arg",
    randomness: float | None = None,
    eyebox: float | None = None,
    many: Callable[[Progress], Iterable[tuple[list[int], Array]]] | None = None,
    seconds: float | None = None,
    tolerance: float = 1e-3,
    max_steps: int | None = None,
    seed: int = 0,
) -> PhaseHologram:
    """Phases whose light, within the SLM's recordable cone, is that of a complex field.

    Parameters
    ----------
    field : WaveField
        Its data may be of another library than NumPy, as for `propagate`: then it is that which encodes, and phases are
        of it.
    method : str
        One of `ENCODINGS`. ``dpac``: double phase (Hsueh and Sawchuk, Appl. Opt. 17, 3874 (1978); Maimone et al., ACM
        TOG 36(4), 85 (2017)). ``sgd``: Adam on the phases, each frame for itself against its complex field (paper
        section 5). ``joint``: then all frames together, so that their mean intensity is the field's at depths and
        through parts of the pupil all over the volume. ``refine``: instead, so that it is that of `many` frames.
        ``auto``: `joint` where there are several frames, which begins with their `randomness_for` where they are few,
        else `sgd`. Where its seconds are too few for any more frames, `refine` is `joint`.
    progress : callable, optional
        ``progress(done, message)`` with the PSNR so far, may raise `Cancelled`; what is done by then is in the
        attribute `kept` of the `Cancelled` that this raises.
    bits : int, optional
        Of an SLM so coarse that it matters: phases are the best of its 2^bits levels. Default: not rounded.
    levels : sequence of array_like or Levels, optional
        Instead, the phases in radians that the SLM really has at each wavelength, measured; in any order, of any turn.
        With a correction of its pixels, or a response that varies over them: `Levels`.
    display : sequence of DisplayModel, optional
        What the display makes of phases at each wavelength: the descents make up for what is not ideal. Default: light
        of phases alone.
    supervision : str
        Of `sgd`, one of `SUPERVISIONS`: the complex field, or amplitudes only as in prior work.
    compared_planes : int
        On which amplitudes are compared, spread over the volume; a complex field on one has all there is.
    aperture : bool
        Whether the display has a stop in its Fourier plane, beyond which light is free.
    start : str or PhaseHologram
        Of the optimisation: one of `STARTS`, the field's own phases or double phase; or an earlier hologram, such as
        that of the frame before in an animation.
    randomness : float, optional
        Of all frames together: the descent begins with phases `randomness` times those of a random map, rather than
        with those of the field, and each frame for itself is left out. At the SLM they lie around those of
        `even_double_phase`; behind a lens they are those of the picture, around `spread_waves`. With 0 the map is
        even, and with 1 random. The fewer the frames, the less random they had best be (paper section 4.1; Yoo
        et al., Opt. Lett. 46, 4769 (2021)): `waves.phase_fields.randomness_for`.
    eyebox : float, optional
        Of all frames together: weight of what parts of the pupil see besides the whole, from 0, none, to 1. Default:
        `eyebox_for` the frames.
    many : callable, optional
        For `refine`: ``many(progress)`` gives fields of many more frames of the same light, batch by batch, with the
        numbers of the wavelengths that they are of; shape (frame, those wavelengths, y, x). See `many_frames`.
    seconds : float, optional
        That all of it may take: what there is by then is what it gives, and all frames together take as many steps as
        fit. Default: to the end.
    tolerance : float
        `sgd` ends when its loss falls by less than this share a step.
    max_steps : int, optional
        Of each stage and wavelength, but for those in which `sgd` brings phases to few levels. Default: 1000 of `sgd`;
        of all frames together as the seconds say, or else 100 of `joint` and 400 of `refine`.
    seed : int
        Of the order and the parts of the pupil in which views are looked at, and of the random map.

    Returns
    -------
    PhaseHologram
        `report` says steps, seconds and PSNR of each stage; `advice`, if there is any, is a sentence.

    Raises
    ------
    InvalidInput
        If there is no such method, options do not fit, or the field is not finite.
    Cancelled
    """
    eyebox = eyebox_for(field.data.shape[0]) if eyebox is None else eyebox
    free, few = randomness is None and start == "arg", randomness_for(field.data.shape[0], eyebox)
    if method == "auto":
        method = "joint" if field.data.shape[0] > 1 else "sgd"
        if method == "joint" and free:
            randomness = few
    elif method in ("joint", "refine") and free and field.hologram.in_air is not field.hologram:
        randomness = (
            few  # fields of few frames are smooth: such a picture's light meets the middle of the SLM alone
        )
    together = max_steps or (MOST_STEPS if seconds else STEPS.get(method, MOST_STEPS))
    effort = descent.Effort(tolerance, MOST_STEPS if max_steps is None else max_steps, seed)
    asked = _Asked(
        method,
        bits,
        levels,
        display,
        supervision,
        compared_planes,
        aperture,
        start,
        randomness,
        eyebox,
        many,
        seconds,
        effort,
        together,
    )
    asked.check(field)
    with Frames() as threads:
        work = _Work(field, asked, progress or (lambda done, message: None), threads)
        if method == "dpac":
            work.double_phase()
            advice = on_axis(method, bits, field.hologram)
            work.report |= {"advice": f"{advice[0].upper()}{advice[1:]}."} if advice else {}
            return work.hologram()
        try:
            work.begin()
            if randomness is None:
                for colour in work.colours:
                    work.sgd(colour)
            if method == "joint":
                work.joint()
            elif method == "refine" and work.colours:
                work.refine()
            elif supervision == "complex":
                work.advise_smooth()
            work.round()
        except (Exception, KeyboardInterrupt) as error:
            if not cancelled(error):
                raise
            stopped = Cancelled("Encoding was stopped.")
            stopped.kept = work.stopped()
            raise stopped from error
        return work.hologram()


def eyebox_for(frames: int) -> float:
    """Weight of parts of the pupil that so many frames can carry, see `encode`.

    With three frames parts of the pupil gain nothing from any weight, and the whole loses 2 dB (docs/theory.md).
    """
    return float(np.clip((frames - FEW_FRAMES) / (DESIGNED_STARTS - FEW_FRAMES), 0, 1)) ** 2


@dataclass(frozen=True)
class _Asked:
    """What `encode` is asked for."""

    method: str
    bits: int | None
    levels: Sequence[ArrayLike | Levels] | None
    display: Sequence[DisplayModel] | None
    supervision: str
    planes: int
    aperture: bool
    start: str | PhaseHologram
    randomness: float | None
    eyebox: float
    many: Callable[[Progress], Iterable[tuple[list[int], Array]]] | None
    seconds: float | None
    effort: descent.Effort  # of `sgd`
    together: int  # steps of all frames together, most

    def levels_of(self, count):
        """`Levels` of each wavelength; None where any phase is one.

        Raises
        ------
        InvalidInput
        """
        if self.levels is None:
            return [None if self.bits is None else Levels.even(self.bits)] * count
        if len(self.levels) != count:
            raise InvalidInput(
                f"There are levels of {len(self.levels)} wavelengths for {count}: give as many."
            )
        return [each if isinstance(each, Levels) else Levels(each) for each in self.levels]

    def check(self, field):
        """Whether options are known, and fit each other and the field."""
        for value, known, name in (
            (self.method, ENCODINGS, "encoding"),
            (self.supervision, SUPERVISIONS, "supervision"),
            (self.start if isinstance(self.start, str) else STARTS[0], STARTS, "start of an encoding"),
        ):
            if value not in known:
                raise InvalidInput(f"There is no {name} '{value}': choose one of {', '.join(known)}.")
        if self.bits is not None and not 1 <= self.bits <= 16:
            raise InvalidInput(f"An SLM has 1 to 16 bits, not {self.bits}.")
        if self.bits is not None and self.levels is not None:
            raise InvalidInput("Levels that were measured have a number of their own: leave out the bits.")
        if self.display is not None and len(self.display) != field.data.shape[1]:
            raise InvalidInput(
                f"There are display models of {len(self.display)} wavelengths for {field.data.shape[1]}: give as many."
            )
        if self.display is not None and self.method == "dpac":
            raise InvalidInput(
                "Double phase knows no display model: choose sgd or joint, or leave out the model."
            )
        if self.display is not None and not field.hologram.flat_bench:
            raise InvalidInput(
                "A display that was fitted has a beam and a stop of its own, and no lens behind it: leave out it or "
                "the hologram's optics."
            )
        for each in self.levels or ():
            for name in ("correction", "variation"):
                values = getattr(each, name, None)
                if values is not None and self.display is not None:
                    raise InvalidInput(f"A display model knows no {name} of the levels: leave out either.")
                if values is not None and values.shape != field.data.shape[-2:]:
                    raise InvalidInput(
                        f"The {name} of the levels has {_pixels(values)}, the field {_pixels(field.data)}: give one of "
                        "its size."
                    )
        if not 1 <= self.planes <= 64:
            raise InvalidInput(f"Amplitudes are compared on 1 to 64 planes, not {self.planes}.")
        if self.seconds is not None and not 0 < self.seconds < math.inf:
            raise InvalidInput(f"The seconds of an encoding must be more than 0, not {self.seconds}.")
        if not 0 <= self.effort.tolerance < 1 or self.effort.max_steps < 1:
            raise InvalidInput(
                "The tolerance of an encoding is a share from 0 to 1, and it has at least one step."
            )
        if not self.aperture and (self.method != "sgd" or self.supervision != "complex"):
            raise InvalidInput(
                "Without a stop in the Fourier plane only sgd with complex supervision encodes: choose it, or leave "
                "the aperture."
            )
        if not self.aperture and field.hologram.optics.stopped:
            raise InvalidInput(
                "The optics have a stop, and without the aperture there is none: leave out either of them."
            )
        if self.method == "refine" and self.many is None:
            raise InvalidInput(
                "The encoding refine needs the scene, for many more frames of it: give it to `holopath render --encode "
                "refine`, or choose joint."
            )
        for name, value in (("randomness", self.randomness), ("eyebox", self.eyebox)):
            if value is not None and not 0 <= value <= 1:
                raise InvalidInput(f"The {name} of an encoding is from 0 to 1, not {value}.")
        if self.randomness is not None and self.method not in ("joint", "refine"):
            raise InvalidInput(
                f"The encoding {self.method} begins with the field's phases: leave out the randomness, or choose joint "
                "or refine."
            )
        if not isinstance(self.start, (str, PhaseHologram)):
            raise InvalidInput("An encoding starts with a PhaseHologram, 'arg' or 'dpac'.")
        if isinstance(self.start, PhaseHologram) and self.start.data.shape != field.data.shape:
            raise InvalidInput(
                f"The hologram to start with has {_size(self.start.data)}, the field {_size(field.data)}: start with "
                "another."
            )
        xp = arrays.namespace(field.data)
        for frame in range(field.data.shape[0]):
            if not xp.all(xp.isfinite(field.data[frame, ...])):
                raise InvalidInput("The wave field holds values that are not finite: render it again.")


def _size(data):
    frames, colours = data.shape[:2]
    return f"{frames} frames and {colours} wavelengths of {_pixels(data)}"


def _pixels(data):
    rows, columns = data.shape[-2:]
    return f"{columns} x {rows} pixels"


class _TimeUp(Exception):
    """A stage has taken the seconds that it had."""


class _Work:
    """Phases of all wavelengths under way."""

    def __init__(self, field, asked, progress, threads):
        self.field, self._asked, self._tell, self._threads = field, asked, progress, threads
        self._told = 0.0, "Encoding"
        self._begun = time.perf_counter()
        self._xp = arrays.namespace(field.data)
        self.phases = arrays.zeros(field.data.shape, "float32", field.data)
        self._frames, count, *_ = field.data.shape
        # fields are taken as if their root mean square were 1; what is next to nothing stays dark
        self._scales = [_root_mean_square(field.data[:, colour, ...]) for colour in range(count)]
        self.colours = [colour for colour in range(count) if self._scales[colour] > DARK * max(self._scales)]
        self.gains = [0.0] * count
        self._levels = asked.levels_of(count)
        # those for which the descents have to care
        self._coarse = [
            ring if ring is not None and ring.widest_gap > FINE else None for ring in self._levels
        ]
        hologram, shape = field.hologram, field.data.shape[-2:]
        self._margin = 0 if asked.display is None else MARGIN
        self._shape = tuple(n + 2 * self._margin for n in shape)  # of light
        self._displays = [
            None
            if asked.display is None
            else ShownLight(asked.display[colour], shape, hologram.pitch, MARGIN, field.data)
            for colour in range(count)
        ]
        beams = [hologram.illumination(colour) for colour in range(count)]
        self._beams = [beam if beam is None else arrays.like(beam, field.data) for beam in beams]
        self._ways = [behind_lens(hologram, wavelength) for wavelength in hologram.wavelengths]
        self._grid = hologram.in_air
        if self._ways[0] is not None:
            self._shape = self._grid.raster(hologram.wavelengths[0]).shape
        self._passes = [
            hologram.optics.passes(self._shape, self._grid.pitch_at(w)) for w in hologram.wavelengths
        ]
        self.report = {
            "bits": asked.bits,
            "measured_levels": asked.levels is not None,
            "display_model": asked.display is not None,
            "stages": [],
        }

    def _progress(self, done, message):
        self._told = done, message
        self._tell(done, message)

    def _heard(self):
        """Tell the same again, to whom may want to cancel."""
        self._tell(*self._told)

    def hologram(self):
        """What has been done."""
        field = self.field
        gains = tuple(gain * scale for gain, scale in zip(self.gains, self._scales, strict=True))
        return PhaseHologram(
            self.phases, field.hologram, field.camera, field.near, self._asked.method, gains, self.report
        )

    def advise_smooth(self):
        """Say which supervision shows a field of smooth phases better.

        A complex field whose phases are flat in its picture leaves phases alone no freedom. Flat ones have a narrow
        spectrum, so that neighbors are alike: the correlation of neighbors is that of the field on any plane, as
        propagation keeps the power spectrum (Wiener and Khinchin).
        """
        energy = alike = 0.0
        for number in range(self._frames):
            frame = self.field.data[number, ...]
            if self._ways[0] is not None:
                waves = (self._seen(frame[colour, ...], colour) for colour in range(frame.shape[0]))
                frame = self._xp.stack(list(waves))
            energy += arrays.product(frame, frame).real
            alike += abs(arrays.product(frame[..., :-1, :], frame[..., 1:, :]))
            alike += abs(arrays.product(frame[..., :-1], frame[..., 1:]))
        if alike > 2 * SMOOTH * energy > 0:
            self.report["advice"] = (
                "The field's phases are smooth, of which phases alone show little: amplitude supervision shows more, "
                "by `holopath encode DIR --method sgd --supervision amplitude --compared-planes 7`, or in Python "
                "supervision='amplitude', compared_planes=7."
            )

    def stopped(self):
        """What there is of it: the phases of each wavelength's last step, or of the start."""
        self._tell = lambda done, message: None  # who canceled is heard already
        for colour in self.colours:
            self.gains[colour] = self.gains[colour] or self._gain(colour)
        self.round()
        self.report["stopped"] = True
        return self.hologram()

    def double_phase(self):
        """The method dpac."""
        count = len(self._levels)
        for colour in self.colours:
            self._double_phase(
                colour, lambda done, colour=colour: self._progress((colour + done) / count, "Encoding")
            )
        self.round()
        for colour in self.colours:  # not the level: what goes astray lights the picture too
            self.gains[colour] = self._gain(colour)

    def _double_phase(self, colour, on_progress):
        """Double phase of one wavelength; its level is one for all frames, as their mean intensity counts."""
        frames, _, *shape = self.field.data.shape
        waves = arrays.empty((frames, *shape), "complex64", self.field.data)
        for frame in range(frames):
            waves[frame, ...] = self._checkered(frame, colour)
            on_progress(0.7 * (frame + 1) / frames)
        waves = self._at_pixels(waves, colour)
        level = clipping_level(waves, self._beams[colour]) or 1
        for frame in range(frames):
            self.phases[frame, colour, ...] = double_phase(waves[frame, ...] / level)
            on_progress(0.7 + 0.3 * (frame + 1) / frames)

    def begin(self):
        """Phases to start with."""
        data, start, randomness = self.field.data, self._asked.start, self._asked.randomness
        for colour in self.colours:
            self._heard()
            display = self._displays[colour]
            phases = self.phases[:, colour, ...]
            if isinstance(start, PhaseHologram):
                phases[...] = arrays.like(start.data[:, colour, ...], data)
            elif randomness is not None:
                way, grid = self._ways[colour], self._grid.raster(self.field.hologram.wavelengths[colour])
                rows, columns = grid.shape
                begun = random_phasors(self._frames, rows, columns, self._asked.effort.seed, randomness)
                if way is None:
                    begun *= self._aimed(colour)
                else:
                    begun = way.back(begun * spread_waves(self._frames, grid.shape))
                begun = arrays.like(begun, data)
                # amid a turn, for displays blur phases over its ends
                phases[...] = math.pi + arrays.angle(self._at_pixels(begun, colour))
                if way is None:  # behind a lens corners of the Fourier plane are corners of the picture
                    phases += arrays.like(even_double_phase(data.shape[-2:]), data)
            elif display is not None:
                for frame in range(self._frames):
                    found = display.phases_for(self._wide(data[frame, colour, ...]))
                    phases[frame, ...] = self._xp.remainder(found, 2 * math.pi)
            elif start == "dpac":
                self._double_phase(colour, lambda done: self._heard())
            else:
                waves = self._at_pixels(data[:, colour, ...], colour)
                phases[...] = self._xp.remainder(arrays.angle(waves), 2 * math.pi)
            if randomness is not None:  # nothing comes before all frames together
                self.gains[colour] = self._gain(colour)

    def _aimed(self, colour):
        """`aimed_waves` of a wavelength through the pupil that all wavelengths fill, within the stop."""
        hologram = self.field.hologram
        x, y, radius = hologram.optics.opening
        sizes = [each / coarsest(hologram.pitch) for each in axes(hologram.pitch)]
        radius *= min(hologram.wavelengths) / hologram.wavelengths[colour]
        scale = [radius * size for size in sizes]
        return aimed_waves(self._frames, self.field.data.shape[-2:], scale, (-y * sizes[0], x * sizes[1]))

    def sgd(self, colour, on=None):
        """Each frame for itself; `on` goes on with it, from one share of the progress to another until it is over."""
        field, asked = self.field, self._asked
        white, name = _white(self._fields(0, colour)), self._named(colour)
        groups = _groups(self.phases, math.prod(field.data.shape[-2:]) * BYTES["sgd"])
        whole = SHARE.get(asked.method, 1.0)
        place, share = self.colours.index(colour), whole / len(self.colours)
        begin, end = on or (place * share, (place + 1) * share)
        part, limit = (end - begin) / len(groups), FIRST / whole if whole < 1 and not on else 1
        rate = descent.WARM if on or isinstance(asked.start, PhaseHologram) else descent.RATE
        levels = self._coarse[colour] if on or asked.method == "sgd" else None  # else the next stage's
        for number, group in enumerate(groups):
            self._heard()
            target = self._target(self._fields(group, colour), colour)
            if not target.energy:
                continue
            begun = begin + part * number

            def told(done, loss, begun=begun):
                psnr = 10 * math.log10(white**2 / max(loss, 1e-30))
                self._progress(begun + part * done, f"Phases, {name}, {psnr:.1f} dB")
                self._check_clock(limit * (begun + part))
                return psnr

            with (
                self._stage("sgd", colour) as stage,
                self._phases(group, colour) as phases,
                suppress(_TimeUp),
            ):
                descent.adam(phases, target, rate, levels, asked.effort, told, stage)
        self.gains[colour] = self._gain(colour)

    def _target(self, fields, colour):
        """What `sgd` compares the light of some frames with."""
        hologram, asked = self.field.hologram, self._asked
        wavelength = hologram.wavelengths[colour]
        pitch = self._grid.pitch_at(wavelength)
        if asked.supervision == "complex":
            return ComplexTarget(fields, asked.aperture, self._threads, hologram.optics, pitch)
        distances = _spread(*self._volume(colour), asked.planes)
        return AmplitudeTarget(fields, pitch, wavelength, distances, self._threads, hologram.optics)

    def joint(self):
        """All frames together, towards their own mean."""
        for number, colour in enumerate(self.colours):
            self._towards(self._views(colour), colour, SHARE["joint"], number)

    def refine(self):
        """All frames together, towards the mean of them and many more."""
        begun, counts = SHARE["refine"], dict.fromkeys(self.colours, 0)
        wanted = {colour: self._views(colour) for colour in self.colours}
        tell = part_of(self._progress, begun, TRACED)

        def told(done, message):
            tell(done, message)
            self._check_clock(TRACED if min(counts.values()) else LATEST)

        with self._stage("many frames", None) as stage, suppress(_TimeUp):
            for numbers, fields in self._asked.many(told):
                for place, colour in enumerate(numbers):
                    if colour in wanted:
                        counts[colour] += fields.shape[0]
                        waves = arrays.like(fields[:, place, ...], self.field.data)
                        seen = self._seen(waves * (1 / self._scales[colour]), colour)
                        wanted[colour].add(self._wide(seen))
                        del seen
                self._check_clock(TRACED if min(counts.values()) else LATEST)
        stage["frames"] = min(counts.values())
        for number, colour in enumerate(self.colours):
            self._towards(wanted.pop(colour), colour, TRACED, number)

    def _views(self, colour):
        """What all frames together go towards in one wavelength, before frames are counted."""
        hologram, seed = self.field.hologram, self._asked.effort.seed
        volume, frames = self._volume(colour), self._frames
        wavelength = hologram.wavelengths[colour]
        grid, places = self._grid, None
        space = self._shape, grid.pitch_at(wavelength), wavelength, *volume
        if isinstance(grid, AerialImage):
            # what lies beside the picture is free
            places = None if grid.raster(wavelength) == grid.raster() else grid.met(wavelength)
        elif not grid.plain:
            lines = grid.picture.raster().lines_on(grid.raster(wavelength))
            places = [line._replace(first=line.first + self._margin) for line in lines]
        return Views(
            *space, frames, seed, self._asked.eyebox, hologram.optics, places, self._heard, self.phases
        )

    def _worth(self, views, number):
        """Whether there is time for all frames together in one wavelength; a step of `sgd` is two FFTs of a frame."""
        stages = [each for each in self.report["stages"] if each.get("steps")]
        if self._asked.seconds is None or self._asked.randomness is not None or not stages:
            return True  # with a given randomness `sgd` has nothing to go on with
        first = stages[number % len(stages)]
        transform = first["seconds"] / first["steps"] / 2 * math.prod(views.padded) / math.prod(views.shape)
        # each is looked at when it is wanted, in the beginning and in the end
        least = (3 * views.transforms + LEAST_STEPS * step_transforms(self._asked.eyebox)) * transform
        return least < self._left(1) / (len(self.colours) - number)

    def _towards(self, views, colour, begun, number):
        """Bring phases of one wavelength to views, of which its own frames are some; wavelengths share the time left.

        Its own frames do not count beside more of others where phases have a randomness of their own: fields of few
        frames are smooth then, and show their interference. Nothing is done where nothing of it can be seen. Where the
        time is too short, each frame goes on for itself.
        """
        if not self.gains[colour]:
            return
        if not self._worth(views, number):
            if self._left(1) > 0:
                self.sgd(colour, [self._at(begun, number + n) for n in (0, 1)])
            return
        self._progress(self._at(begun, number), "Views of the field")
        if self._asked.randomness is None or views.frames <= self._frames:
            for group in _groups(self.phases, math.prod(views.padded) * BYTES["views"]):
                views.add(self._fields(group, colour))
        method, name, gains = self._asked.method, self._named(colour), []
        if method == "refine":
            views.unvignette()
            if self.field.hologram.optics.stopped:
                views.sharpen()
        effort = replace(self._asked.effort, max_steps=self._asked.together)
        longest = descent.LONGEST if self._asked.randomness is None else descent.LONGEST_SMOOTH
        groups = _groups(self.phases, math.prod(views.padded) * BYTES["together"])
        left = len(groups) * (len(self.colours) - number)
        for place, group in enumerate(groups):

            def told(done, psnr, place=place):
                at = self._at(begun, number + (place + done) / len(groups))
                self._progress(at, f"All frames, {name}, {psnr:.1f} dB")

            with self._stage(method, colour) as stage, self._phases(group, colour) as phases:
                seconds = None if self._asked.seconds is None else self._left(1) / (left - place)
                what = phases, views, self.gains[colour], longest, self._coarse[colour], effort, seconds
                gains.append(descent.together(*what, told, stage))
        self.gains[colour] = float(np.mean(gains))

    def _named(self, colour):
        """The wavelength in words."""
        return f"{self.field.hologram.wavelengths[colour] * 1e9:.4g} nm"

    def _at(self, begun, number):
        """How much is done of the whole after so many wavelengths, where all frames together begin at `begun`."""
        return begun + (1 - begun) * number / len(self.colours)

    def _left(self, share):
        """Seconds until a share of them is over."""
        seconds = self._asked.seconds
        return math.inf if seconds is None else self._begun + share * seconds - time.perf_counter()

    def _check_clock(self, share):
        if self._left(share) < 0:
            raise _TimeUp

    def _fields(self, which, colour):
        """Complex fields of some frames where light is compared, of root mean square 1 at the SLM over all; a copy."""
        fields = self.field.data[which, colour, ...] * (1 / self._scales[colour])
        return self._wide(self._seen(fields, colour))

    def _seen(self, fields, colour):
        """Fields of the SLM where light is compared: there, or on the plane of the picture behind its lens."""
        way = self._ways[colour]
        return fields if way is None else way.there(fields)

    def _checkered(self, which, colour):
        """Complex fields of some frames at the SLM, of what every second pixel of it can show."""
        keep = half_band(self.field.data.shape[-2:])
        if self._ways[colour] is None:
            keep &= self._passes[colour]
        fields = self.field.data[which, colour, ...] * (1 / self._scales[colour])
        return filtered(fields, arrays.mask(keep, fields))

    def _wide(self, fields):
        """With dark around them as wide as the display's margin."""
        if not self._margin:
            return fields
        wide = arrays.zeros((*fields.shape[:-2], *self._shape), fields.dtype, fields)
        wide[..., self._margin : -self._margin, self._margin : -self._margin] = fields
        return wide

    def _at_pixels(self, waves, colour):
        """What pixels have to let through so that the beam becomes waves; where it is faint, less."""
        return transmission(waves, self._beams[colour])

    def _volume(self, colour):
        """Distances between which the scene lies, from the panel as a wavelength has it."""
        plan, hologram = self.field.plan, self.field.hologram
        own = hologram.distance_at(hologram.wavelengths[colour])
        ends = plan.get("z_low", hologram.depth_far) - own, plan.get("z_high", hologram.depth_near) - own
        return ends if ends[1] > ends[0] else (ends[0] - 1e-6, ends[0] + 1e-6)

    def _gain(self, colour):
        """Amplitude with which the light in the band is as much as the field's."""
        band, xp = arrays.like(self._passes[colour], self.phases), self._xp
        wanted = shown = 0.0
        for frame in range(self._frames):
            self._heard()
            wave = arrays.fft2(self._fields(frame, colour), workers=threads())
            wanted += arrays.total(xp.abs(wave[band]) ** 2)
            display, phase = self._displays[colour], self.phases[frame, colour, ...]
            light = display.light(phase) if display else xp.exp(1j * arrays.as_type(phase, "complex64"))
            if self._beams[colour] is not None:
                light *= self._beams[colour]
            light = arrays.fft2(self._seen(light, colour), workers=threads())
            shown += arrays.total(xp.abs(light[band]) ** 2)
        return math.sqrt(wanted / shown) if shown else 0.0

    def round(self):
        """Bring phases to the display's levels.

        Behind a lens pixels beside the picture's square get a checkerboard, whose light passes beside the picture.
        """
        for colour, way in enumerate(self._ways):
            if way is not None:
                phases = self.phases[:, colour, ...]
                board = np.float32(math.pi) * (np.indices(phases.shape[-2:]).sum(0) % 2).astype(np.float32)
                board = self._xp.broadcast_to(arrays.like(board, phases)[None, ...], phases.shape)
                used = (slice(None), *way.used)
                kept = arrays.copied(phases[used])
                phases[...] = board
                phases[used] = kept
        for colour, levels in enumerate(self._levels):
            if levels is not None:
                for frame in range(self._frames):
                    phases = self.phases[frame, colour, ...]
                    phases[...] = wrapped(levels.nearest(phases)[0])

    @contextmanager
    def _phases(self, group, colour):
        """`Phases` of some frames in one wavelength, which are put back however the work ends."""
        levels = self._levels[colour]
        ends = WHOLE if levels is None else levels.ends
        display, beam = self._displays[colour], self._beams[colour]
        begun = self.phases[group, colour, ...]
        phases = Phases(begun, self._threads, display, ends, beam, self._ways[colour])
        try:
            yield phases
        finally:
            begun[...] = phases.values()

    @contextmanager
    def _stage(self, name, colour):
        """What a stage reports, with its seconds."""
        stage, begun = {"stage": name}, time.perf_counter()
        if colour is not None:
            stage["wavelength_m"] = self.field.hologram.wavelengths[colour]
        self.report["stages"].append(stage)
        try:
            yield stage
        finally:
            stage["seconds"] = time.perf_counter() - begun


def _root_mean_square(fields):
    xp = arrays.namespace(fields)
    sizes = (arrays.as_type(xp.abs(fields[n, ...]), "float64") for n in range(fields.shape[0]))
    return math.sqrt(np.mean([float(xp.mean(size**2)) for size in sizes]))


def _white(wave):
    """Amplitude that counts as white, see `metrics.display_values`."""
    amplitude = np.abs(arrays.on_processor(wave))
    return float(np.percentile(amplitude, 95)) or float(amplitude.max()) or 1.0


def _spread(low, high, count):
    """Distances over a volume; one is in its middle."""
    return np.linspace(low, high, count) if count > 1 else [(low + high) / 2]


def _groups(phases, bytes_each):
    """Slices of frames that fit into memory, about equal; into half of what is free where phases lie on a card."""
    frames, card = phases.shape[0], on_card(phases)
    most = min(MOST_BYTES, card[1] // 2) if card else MOST_BYTES
    count = math.ceil(frames / max(1, most // bytes_each))
    ends = [round(i * frames / count) for i in range(count + 1)]
    return [slice(a, b) for a, b in zip(ends, ends[1:], strict=False)]
