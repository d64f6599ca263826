"""Encoding of fields as phases: `encode`, and one class for each of its methods."""

from __future__ import annotations

import math
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import numpy as np

from ..errors import Cancelled, cancelled
from ..memory import on_card
from ..progress import SHARES, named
from ..progress import stage as part_of
from ..settings.former_names import accepts_former_names
from ..waves import arrays
from ..waves.supervision import FramePool
from . import descent
from .axis import on_axis
from .channel import Channel
from .options import EncodingOptions, is_smooth
from .phase_hologram import PhaseHologram
from .views import step_transforms

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import ArrayLike

    from ..progress import Progress
    from ..wavefield import WaveField
    from ..waves.arrays import Array
    from ..waves.display_model import DisplayModel
    from ..waves.modulator import Levels

MAX_BYTES = 4 << 30  # of arrays that a stage works on: frames that do not fit are optimized in groups
BYTES = {"sgd": 40, "together": 44, "views": 24}  # for each pixel of a frame
DARK = 1e-6  # fraction of the brightest wavelength's amplitude, up to which a wavelength stays dark
# Deadlines as fractions of the given seconds: of the first stage, of extra frames while a wavelength has none, and of
# extra frames otherwise.
FIRST_STAGE_END, NO_FRAMES_END = 0.1, 0.6
EXTRA_FRAMES_END = SHARES["refine"]["extra frames"]
MIN_STEPS = 10  # steps of all frames together, at which evaluating all views pays off
# Extra frames that are added at once within given seconds. Eight steps towards four of them show more than four steps
# towards 24 (docs/measurements.md, Eight frames for the whole pupil).
FRAMES_AT_ONCE = 4


@accepts_former_names
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
    has_stop: bool = True,
    start: str | PhaseHologram = "arg",
    randomness: float | None = None,
    eyebox: float | None = None,
    extra_frames: Callable[[Progress], Iterable[tuple[list[int], Array]]] | None = None,
    seconds: float | None = None,
    tolerance: float = 1e-3,
    max_steps: int | None = None,
    seed: int = 0,
) -> PhaseHologram:
    """Encode a complex field as phases whose light matches it within the SLM's recordable cone.

    Parameters
    ----------
    field : WaveField
        The field to encode. Its data may be an array of another library than NumPy, as for `propagate`: that library
        then computes, and the phases are an array of it.
    method : str
        One of `ENCODINGS`. ``dpac``: double phase (Hsueh and Sawchuk, Appl. Opt. 17, 3874 (1978); Maimone et al., ACM
        TOG 36(4), 85 (2017)). ``sgd``: Adam on the phases, each frame by itself against its complex field (paper
        section 5). ``joint``: then all frames together, so that their mean intensity is the field's at depths all over
        the volume and through parts of the pupil. ``refine``: the same towards the mean intensity of `extra_frames`.
        ``auto``: `joint` if there are several frames, or one whose phases are smooth; it starts with their
        `randomness_for` if they are few or the eyebox is 0. Else `sgd`. If the seconds are too few for any extra
        frames, `refine` is `joint`.
    progress : callable, optional
        ``progress(done, message)`` with the PSNR so far, may raise `Cancelled`. The attribute `kept` of the `Cancelled`
        that `encode` then raises is the hologram so far.
    bits : int, optional
        Bits of a coarse SLM: phases are optimized on its 2^bits even levels. Default: any phase.
    levels : sequence of array_like or Levels, optional
        Measured phases of the SLM's levels instead, one set for each wavelength, radians, in any order and modulo 2 pi;
        `Levels` with a correction of its pixels, or a response that varies across them.
    display : sequence of DisplayModel, optional
        Effect of the display on light, one model for each wavelength, which descents compensate for. Default: an ideal
        display.
    supervision : str
        Target of `sgd`, one of `SUPERVISIONS`: the complex field, or amplitudes only as in prior work.
    compared_planes : int
        Number of planes on which amplitudes are compared, spread over the volume; a complex field needs only one.
    has_stop : bool
        Whether the display has a stop in its Fourier plane, outside of which light is unconstrained.
    start : str or PhaseHologram
        Start of the optimization: one of `STARTS`, the field's own phases or double phase; or an earlier hologram, such
        as that of an animation's previous frame.
    randomness : float, optional
        Randomness of the start of all frames together, instead of the field's phases and the optimization of each
        frame by itself: phases of a random map times this, 0 uniform and 1 random. At the SLM they lie around those of
        `even_double_phase`; behind a lens they are those of the image, around `spread_waves`. Fewer frames need less
        random phases (paper section 4.1; Yoo et al., Opt. Lett. 46, 4769 (2021)): `waves.phase_fields.randomness_for`.
    eyebox : float, optional
        Weight of views through parts of the pupil besides the whole, for all frames together, from 0, none, to 1.
        Default: `eyebox_for` the frames.
    extra_frames : callable, optional
        For `refine`: ``extra_frames(progress)`` yields fields of extra frames of the same light, batch by batch, with
        the indices of their wavelengths; shape (frame, these wavelengths, y, x). See `engine.extra_frames`.
    seconds : float, optional
        Time limit for all stages; all frames together take as many steps as fit, up to `max_steps`. Default: none.
    tolerance : float
        Relative decrease of the loss in a step, below which `sgd` ends.
    max_steps : int, optional
        Maximum number of steps of each stage and wavelength, without those in which `sgd` brings phases to few levels.
        Default: 1000 for `sgd`; for all frames together as many as the seconds allow, or else 100 for `joint` and 400
        for `refine`; for three to seven frames at most 100, unless the eyebox is larger than the default.
    seed : int
        Seed of the order of views, of the parts of the pupil, and of the random map.

    Returns
    -------
    PhaseHologram
        `report` has the steps, seconds and PSNR of each stage; `advice`, if there is any, is a sentence.

    Raises
    ------
    InvalidInput
        If the method is unknown, options do not fit, or the field is not finite.
    Cancelled

    Examples
    --------
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> hologram = engine.Hologram(32, 32, 8e-6, (516.5e-9,))
    >>> field = engine.WaveField(np.ones((1, 1, 32, 32), np.complex64), hologram, engine.Camera(np.eye(4), 0.5), 0.5)
    >>> phases = engine.encode(field, "dpac")
    >>> phases.data.shape, phases.method  # frame, wavelength, y, x
    ((1, 1, 32, 32), 'dpac')
    """
    options = EncodingOptions(
        method, bits, levels, display, supervision, compared_planes, has_stop, start, randomness, eyebox, extra_frames,
        seconds, tolerance, max_steps, seed,
    ).resolve(field)  # fmt: skip
    with FramePool() as pool:
        encoder = METHODS[options.method](field, options, progress or (lambda done, message: None), pool)
        return encoder.run()


class _Encoder:
    """Parts that all methods share: wavelengths, progress, seconds, and the report."""

    def __init__(self, field, options, progress, pool):
        self._field, self._options, self._on_progress = field, options, progress
        self._last_progress = 0.0, "Encoding"
        self._start = time.perf_counter()
        self._phases = arrays.zeros(field.data.shape, "float32", field.data)
        self._channels = [
            Channel(field, color, self._phases[:, color, ...], options, pool, self._repeat_progress)
            for color in range(field.data.shape[1])
        ]
        dark = DARK * max(channel.scale for channel in self._channels)
        self._lit = [channel for channel in self._channels if channel.scale > dark]
        self._report = {
            "bits": options.bits,
            "measured_levels": options.levels is not None,
            "display_model": options.display is not None,
            "stages": [],
        }

    def _progress(self, done, message):
        self._last_progress = done, message
        self._on_progress(done, message)

    def _repeat_progress(self):
        """Report the same progress again, for a caller that may cancel."""
        self._on_progress(*self._last_progress)

    def _seconds_left(self, fraction=1.0):
        """Seconds until a fraction of those given has passed."""
        seconds = self._options.seconds
        return math.inf if seconds is None else self._start + fraction * seconds - time.perf_counter()

    def _check_clock(self, fraction):
        if self._seconds_left(fraction) < 0:
            raise _TimeUp

    @contextmanager
    def _stage(self, name, channel=None):
        """Dictionary of what a stage reports, with its seconds."""
        stage, start = {"stage": name}, time.perf_counter()
        if channel is not None:
            stage["wavelength_m"] = channel.wavelength
        self._report["stages"].append(stage)
        try:
            yield stage
        finally:
            stage["seconds"] = time.perf_counter() - start

    def _finish(self):
        for channel in self._channels:
            channel.finish()

    def _hologram(self):
        """Return the hologram of the phases so far."""
        field, method = self._field, self._options.method
        gains = tuple(channel.gain * channel.scale for channel in self._channels)
        return PhaseHologram(
            self._phases, field.hologram, field.camera, field.near, method, gains, self._report
        )


class _DoublePhase(_Encoder):
    """The method dpac."""

    def run(self):
        for number, channel in enumerate(self._lit):
            begin, end = (n / len(self._lit) for n in (number, number + 1))
            channel.set_double_phase(named(part_of(self._progress, begin, end), "Encoding"))
        self._finish()
        for channel in self._lit:  # not from the clipping level: stray light brightens the image, too
            channel.set_gain()
        advice = on_axis("dpac", self._options.bits, self._field.hologram)
        if advice:
            self._report["advice"] = f"{advice[0].upper()}{advice[1:]}."
        return self._hologram()


class _SingleFrames(_Encoder):
    """The method sgd: each frame by itself."""

    frames_end = 1.0  # fraction of the work that is done after it

    def run(self):
        try:
            for channel in self._lit:
                channel.set_start()
            self._descend()
            self._finish()
        except (Exception, KeyboardInterrupt) as error:
            if not cancelled(error):
                raise
            raise self._stopped() from error
        return self._hologram()

    def _stopped(self):
        """`Cancelled` with the hologram so far: the phases of each wavelength's last step, or of the start."""
        self._on_progress = lambda done, message: None  # it has canceled already
        for channel in self._lit:
            if not channel.gain:
                channel.set_gain()
        self._finish()
        self._report["stopped"] = True
        stopped = Cancelled("Encoding was stopped.")
        stopped.kept = self._hologram()
        return stopped

    def _descend(self):
        self._optimize_single_frames()
        if self._options.supervision == "complex":
            self._advise_on_smooth_phases()

    def _optimize_single_frames(self):
        part = self.frames_end / max(1, len(self._lit))
        limit = FIRST_STAGE_END / self.frames_end if self.frames_end < 1 else 1.0
        rate = descent.WARM if isinstance(self._options.start, PhaseHologram) else descent.RATE
        for number, channel in enumerate(self._lit):
            # levels are left to the next stage, if there is one
            levels = channel.coarse_levels if self._options.method == "sgd" else None
            self._descend_frames(channel, (number * part, (number + 1) * part), limit, rate, levels)

    def _descend_frames(self, channel, progress_range, limit, rate, levels):
        """Optimize the frames of a wavelength one by one.

        They end at the latest when the fraction of the seconds that has passed is `limit` times their progress.
        """
        options, (begin, end) = self._options, progress_range
        white = _white(channel.fields(0))
        effort = descent.Effort(rate, levels, options.max_frame_steps, options.tolerance)
        groups = _groups(self._phases, math.prod(self._field.data.shape[-2:]) * BYTES["sgd"])
        part = (end - begin) / len(groups)
        for number, group in enumerate(groups):
            self._repeat_progress()
            target = channel.target(channel.fields(group))
            if not target.energy:
                continue
            first = begin + part * number

            def on_progress(done, loss, first=first):
                psnr = 10 * math.log10(white**2 / max(loss, 1e-30))
                self._progress(first + part * done, f"Phases, {channel.name}, {psnr:.1f} dB")
                self._check_clock(limit * (first + part))
                return psnr

            with (
                self._stage("sgd", channel) as stage,
                channel.optimized(group) as phases,
                suppress(_TimeUp),
            ):
                descent.adam(phases, target, effort, on_progress, stage)
        channel.set_gain()

    def _advise_on_smooth_phases(self):
        """Advise amplitude supervision, which shows a field of smooth phases better."""
        data = self._field.data
        is_flat = self._field.hologram.in_air is self._field.hologram
        waves = (
            data[number, ...]
            if is_flat
            else arrays.namespace(data).stack(
                [each.propagate(data[number, color, ...]) for color, each in enumerate(self._channels)]
            )
            for number in range(data.shape[0])
        )
        if is_smooth(waves):
            self._report["advice"] = (
                "The field's phases are smooth, and its complex target leaves a phase-only hologram little freedom. "
                "Use amplitude supervision, by `holopath encode DIR --method sgd --supervision amplitude "
                "--compared-planes 7`, or in Python supervision='amplitude', compared_planes=7."
            )


class _Joint(_SingleFrames):
    """The method joint: all frames together, towards their own mean intensity."""

    frames_end = joint_begin = SHARES["joint"]["single frames"]

    def _descend(self):
        if self._options.randomness is None:
            self._optimize_single_frames()
        for number, channel in enumerate(self._lit):
            self._optimize_jointly(channel, channel.view_targets(), number)

    def _optimize_jointly(self, channel, targets, number):
        """Optimize the phases of a wavelength towards targets; wavelengths share the seconds left.

        Its own frames are added to the targets, but not to those of extra frames if phases have a randomness of their
        own: fields of few frames are smooth then, and their images interfere. Nothing is done if no light can be seen.
        If the time is too short, the frames are optimized one by one.
        """
        if not channel.gain:
            return
        begin, end = (self._joint_progress(number + n) for n in (0, 1))
        if not self._is_worthwhile(targets.views, number):
            if self._seconds_left() > 0:
                self._descend_frames(channel, (begin, end), 1.0, descent.WARM, channel.coarse_levels)
            return
        self._progress(begin, "Views of the field")
        options, (frames, *_) = self._options, self._field.data.shape
        if options.randomness is None or not targets.frames:
            for group in _groups(self._phases, math.prod(targets.views.padded) * BYTES["views"]):
                targets.add(channel.fields(group))
        self._correct_targets(targets)
        channel.leave_room_for(targets)
        rate, max_steps = descent.max_step(channel.randomness), options.max_joint_steps(frames)
        groups = _groups(self._phases, math.prod(targets.views.padded) * BYTES["together"])
        stages_left, gains = len(groups) * (len(self._lit) - number), []
        shown = "All frames" if frames > 1 else "The frame"
        for place, group in enumerate(groups):

            def on_progress(done, psnr, place=place):
                at = self._joint_progress(number + (place + done) / len(groups))
                self._progress(at, f"{shown}, {channel.name}, {psnr:.1f} dB")

            with self._stage(options.method, channel) as stage, channel.optimized(group) as phases:
                seconds = options.seconds and self._seconds_left() / (stages_left - place)
                effort = descent.Effort(
                    rate, channel.coarse_levels, max_steps, seed=options.seed, seconds=seconds
                )
                gains.append(descent.together(phases, targets, channel.gain, effort, on_progress, stage))
        channel.gain = float(np.mean(gains))

    def _correct_targets(self, targets):
        """Correct the targets for what the field lacks; the field's own need none."""

    def _joint_progress(self, count):
        """Fraction of the whole that is done after so many wavelengths."""
        return self.joint_begin + (1 - self.joint_begin) * count / len(self._lit)

    def _is_worthwhile(self, views, number):
        """Whether the seconds are enough for all frames together in the wavelengths left.

        A step of single frames takes two FFTs of a frame.
        """
        options = self._options
        stages = [stage for stage in self._report["stages"] if stage.get("steps")]
        if options.seconds is None or options.randomness is not None or not stages:
            return True  # with a given randomness single frames cannot be optimized instead
        first = stages[number % len(stages)]
        padded, pixels = math.prod(views.padded), math.prod(views.volume.shape)
        transform = first["seconds"] / first["steps"] / 2 * padded / pixels
        # all views are evaluated as targets, at the start and at the end
        needed = (3 * views.transforms + MIN_STEPS * step_transforms(options.eyebox)) * transform
        return needed < self._seconds_left() / (len(self._lit) - number)


class _Refine(_Joint):
    """The method refine: all frames together, towards the mean intensity of extra frames, and mostly of its own."""

    frames_end = SHARES["refine"]["single frames"]
    joint_begin = EXTRA_FRAMES_END

    def _descend(self):
        if self._options.randomness is None:
            self._optimize_single_frames()
        targets = self._targets_of_extra_frames() if self._lit else []
        for number, channel in enumerate(self._lit):
            self._optimize_jointly(channel, targets.pop(channel.color), number)

    def _targets_of_extra_frames(self):
        """Targets of the extra frames that the seconds allow, by the index of the wavelength."""
        channels = {channel.color: channel for channel in self._lit}
        counts = dict.fromkeys(channels, 0)
        targets = {color: channel.view_targets() for color, channel in channels.items()}
        progress = part_of(self._progress, self.frames_end, self.joint_begin)

        def check_clock():
            self._check_clock(EXTRA_FRAMES_END if min(counts.values()) else NO_FRAMES_END)

        def on_progress(done, message):
            progress(done, message)
            check_clock()

        with self._stage("extra frames") as stage, suppress(_TimeUp):
            for colors, fields in self._options.extra_frames(on_progress):
                count = fields.shape[0]
                at_once = max(1, count) if self._options.seconds is None else FRAMES_AT_ONCE
                for first in range(0, count, at_once):
                    group = fields[first : first + at_once, ...]
                    for place, color in enumerate(colors):
                        if color in channels:
                            counts[color] += group.shape[0]
                            waves = arrays.like(group[:, place, ...], self._field.data)
                            targets[color].add(channels[color].compared(waves))
                    check_clock()
        stage["frames"] = min(counts.values())
        return targets

    def _correct_targets(self, targets):
        targets.unvignette()
        if self._field.hologram.optics.stopped:
            targets.sharpen()


METHODS = {"dpac": _DoublePhase, "sgd": _SingleFrames, "joint": _Joint, "refine": _Refine}


class _TimeUp(Exception):
    """The seconds of a stage are over."""


def _white(wave):
    """Amplitude that counts as white, see `metrics.display_values`."""
    amplitude = np.abs(arrays.on_processor(wave))
    return float(np.percentile(amplitude, 95)) or float(amplitude.max()) or 1.0


def _groups(phases, bytes_each):
    """Slices of frames that fit into memory, about equal; into half of a graphics card's free memory."""
    frames, card = phases.shape[0], on_card(phases)
    max_bytes = min(MAX_BYTES, card[1] // 2) if card else MAX_BYTES
    count = math.ceil(frames / max(1, max_bytes // bytes_each))
    ends = [round(i * frames / count) for i in range(count + 1)]
    return [slice(a, b) for a, b in zip(ends, ends[1:], strict=False)]
