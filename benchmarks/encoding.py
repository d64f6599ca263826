"""Phases from fields: what each method keeps of the pictures, and what it costs."""

import math
import multiprocessing
import re
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np
import scipy.fft

from holopath_addon import engine
from holopath_addon.engine.encoding import descent
from holopath_addon.engine.encoding.phases import Phases
from holopath_addon.engine.encoding.targets import ComplexTarget
from holopath_addon.engine.encoding.views import ViewedVolume, Views, ViewTargets, step_transforms
from holopath_addon.engine.scene import variants
from holopath_addon.engine.waves.modulator import gray_levels
from holopath_addon.engine.waves.phase_fields import phasors_of
from holopath_addon.engine.waves.supervision import FramePool
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

from .convergence import border
from .parts import drawn, joined
from .scenes import FOV, GREEN, Scenes

SIDE, PITCH = 256, 8e-6
FRAMES = (1, 8, 24)
ENCODINGS = {
    "dpac": {"method": "dpac"},
    "sgd": {"method": "sgd"},
    "sgd, amplitudes": {"method": "sgd", "supervision": "amplitude"},
    "sgd, amplitudes on 7 planes": {"method": "sgd", "supervision": "amplitude", "compared_planes": 7},
    "joint": {"method": "joint"},
}
ROUNDED = ("sgd", "joint")  # to 8 bits as well
TRUTH = 512  # paths a pixel
GIVEN = (0.5, 1, 2, 5, 10, 30)  # seconds that encodings are given
MARKS = (2, 5, 10, 20, 30, 60)  # seconds
VIEWS = ("0.5 m", "1 m", "2 m", "0.67 m", "1.33 m", "right", "left", "up", "down")
OURS, RANDOM = "our field", "random phases"
SIZES = ((24, (256, 256)), (8, (512, 512)), (8, (1080, 1920)))
LARGE, LARGE_FRAMES = (1080, 1920), 4


def run(folder, part=None, pixels=SIDE, scenes=None):
    """Tables as text, of one part or of all; the chart goes to ``folder/encoding.png``.

    Below the usual number of pixels all is in little: displays of `cost` and `large`, frames, seconds, steps.
    """
    variants.activate()
    little = pixels < SIDE
    shape = pixels, pixels
    parts = {
        "methods": lambda: methods(pixels, scenes, FRAMES[: 1 if little else None]),
        "refine": lambda: refine(folder, pixels, scenes),
        "seconds": lambda: seconds(pixels, scenes, GIVEN[: 2 if little else None]),
        "cost": lambda: cost(((FRAMES[0], shape),) if little else SIZES),
        "large": lambda: large(shape, max_steps=2) if little else large(),
    }
    return joined({name: parts[name] for name in ([part] if part else parts)})


@dataclass(frozen=True)
class Subject:
    """A scene, its display, and where pictures of it are taken."""

    scene: object
    camera: engine.Camera
    hologram: engine.Hologram
    focus: tuple = (0.5, 1.0, 2.0)


def planes(scene, side=SIDE):
    """A scene of planes from 0.5 m on, which gives a thin volume close to the SLM."""
    ends = (1e-3 * side / SIDE, 6e-3 * side / SIDE)
    return Subject(
        scene, engine.Camera(np.eye(4), FOV), engine.Hologram(side, side, PITCH, (GREEN,), *ends, near=0.5)
    )


def suzanne(side=SIDE):
    """The demo scene from Blender."""
    from holopath_addon.cli.sources import open_source

    loaded = open_source("demo:suzanne").load(side, side, None)
    hologram = engine.Hologram(side, side, PITCH, (GREEN,))
    return Subject(loaded.scene, loaded.camera, hologram, (0.5, 1.0, 4.0))


def methods(side=SIDE, count=None, frames=FRAMES):
    """Pictures of each method against the truth and against those of the complex field."""
    builders = {
        "two planes": lambda: planes(Scenes().two_planes(Scenes().emissive), side),
        "suzanne": lambda: suzanne(side),
    }
    lines = [
        "encoding methods: PSNR in dB at three focus depths against the truth, and the field's own pictures"
    ]
    for name in tuple(builders)[:count]:
        subject = builders[name]()
        focus, hologram = subject.focus, subject.hologram
        view, edge, truth = (subject.scene, subject.camera, hologram), border(hologram), None
        lines.append(f"  {name}: {side} x {side}, 8 µm, green, at {', '.join(f'{d:g}' for d in focus)} m")
        for kind in ("random", "designed"):
            for number in frames:
                settings = engine.Settings(frames=number, method="full", phase_field=kind)
                field = engine.render(*view, settings)
                if truth is None:
                    truth = engine.reference(*view, focus, spp=TRUTH, near=field.near)
                own = engine.reconstruct(field, focus)
                best = _psnrs(own, truth, edge)
                lines.append(f"    {kind}, M = {number:2d}: the complex field {_row(best)}")
                for label, phase, seconds in _encodings(field):
                    pictures = engine.reconstruct(phase.field(), focus)
                    values = _psnrs(pictures, truth, edge)
                    lines.append(
                        f"      {label:27} {_row(values)}  own {_row(_psnrs(pictures, own, edge))}  "
                        f"loss {np.mean(best) - np.mean(values):5.2f} dB  {seconds:6.2f} s"
                    )
    return "\n".join(lines)


def _encodings(field):
    """Name, hologram and seconds of each method, rounded ones after their own."""
    for label, options in ENCODINGS.items():
        start = time.perf_counter()
        phase = engine.encode(field, **options)
        seconds = time.perf_counter() - start
        yield label, phase, seconds
        if label in ROUNDED:
            data = (gray_levels(phase.data, 8) * (2 * math.pi / 256)).astype(np.float32)
            yield f"{label}, then 8 bits", replace(phase, data=data), seconds


def _psnrs(pictures, truth, edge):
    return [engine.psnr(p, t, edge) for p, t in zip(pictures, truth, strict=True)]


def _row(values):
    return " ".join(f"{v:5.2f}" for v in values)


class Watch:
    """Seconds since the start, without those that were `paused`."""

    def __init__(self):
        self._start = time.perf_counter()

    def __call__(self):
        return time.perf_counter() - self._start

    @contextmanager
    def paused(self):
        begun = time.perf_counter()
        yield
        self._start += time.perf_counter() - begun


class Curve:
    """PSNR of all views of phases under way, over the seconds; looking takes no time.

    Attributes
    ----------
    points : list of (float, list of float)
        Seconds and PSNR.
    ends : list of (float, list of float)
        The same at the end of each stage.
    """

    def __init__(self, look):
        self.points, self.ends = [], []
        self._look, self._watch, self._next = look, Watch(), 0.0

    def note(self, phases, end=False):
        """Look at the phases, if it is time or a stage's end."""
        seconds = self._watch()
        if not end and seconds < self._next:
            return
        with self._watch.paused():
            values = self._look(phases.values())
        self.points.append((seconds, values))
        self._next = seconds + max(0.5, 0.1 * seconds)
        if end:
            self.ends.append(self.points[-1])

    def watched(self, descend):
        """The same way down, looked at."""

        def way(phases, *others):
            *others, told, stage = others

            def noted(*state):
                self.note(phases)
                return told(*state)

            gain = descend(phases, *others, noted, stage)
            self.note(phases, end=True)
            return gain

        return way

    def at(self, seconds):
        """PSNR of all views by then; None before the first."""
        return next((values for when, values in reversed(self.points) if when <= seconds), None)


def refine(folder, side=SIDE, count=None):
    """Seconds against PSNR of `refine`, from our field and from random phases."""
    build = Scenes()
    subjects = {
        "three planes": planes(build.three_planes(), side),
        "two planes under a lamp": planes(build.two_planes(build.diffuse), side),
    }
    lines = [
        f"refinement: {side} x {side}, M = 8, {len(VIEWS)} views; PSNR in dB, mean / worst, after seconds "
        "that count all from the scene on"
    ]
    curves = {}
    for name, subject in tuple(subjects.items())[:count]:
        look = _nine_views(subject)
        for start in (OURS, RANDOM):
            _start(subject, start, max_steps=1)  # compiles
        lines.append(f"  {name + ':':37}" + "".join(f"{f'{s} s':>15}" for s in MARKS))
        for start in (OURS, RANDOM):
            curve = curves[name, start] = Curve(look)
            with (
                mock.patch.object(descent, "adam", curve.watched(descent.adam)),
                mock.patch.object(descent, "together", curve.watched(descent.together)),
            ):
                phase = _start(subject, start)
            cells = [curve.at(s) for s in MARKS]
            lines.append(
                f"    {start:35}"
                + "".join(f"{f'{np.mean(c):.2f} / {min(c):.2f}' if c else '-':>15}" for c in cells)
            )
            lines.append(f"      {_stages(phase, curve)}")
        before, ours = (values for _, values in curves[name, OURS].ends)
        lines.append(f"    {'each view':24}" + "".join(f"{v:>8}" for v in VIEWS))
        for label, values in (
            ("our field, sgd only", before),
            ("our field, refined", ours),
            ("random phases, refined", curves[name, RANDOM].ends[-1][1]),
        ):
            lines.append(f"    {label:24}" + "".join(f"{v:8.2f}" for v in values))
        gains = np.subtract(ours, before)
        lines.append(
            f"    gains {gains.min():.2f} to {gains.max():.2f} dB, {(gains < 0).sum()} views got worse"
        )
    return drawn("\n".join(lines), lambda: _chart(curves, Path(folder) / "encoding.png"))


def _nine_views(subject):
    """PSNR of phases in nine views, as a function of them: five focus depths, and four half pupils at 1 m."""
    view = subject.scene, subject.camera, subject.hologram
    near, edge = subject.hologram.near, border(subject.hologram)
    depths = [0.5, 1.0, 2.0, 2 / 3, 4 / 3]
    blank = engine.WaveField(np.zeros((1, 1, 1, 1), np.complex64), subject.hologram, subject.camera, near)
    half = blank.mapping.pupil_radius(subject.hologram.max_slope(GREEN)) / 2
    pupils = [engine.Pupil(half * x, half * y, 2 * half) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    truth = [*engine.reference(*view, depths, spp=TRUTH, near=near)]
    truth += [engine.reference(*view, [1.0], pupil, spp=TRUTH, near=near)[0] for pupil in pupils]

    def look(phases):
        focused = engine.Refocuser(replace(blank, data=np.exp(np.complex64(1j) * phases)[:, None]))
        pictures = [*focused(depths)] + [focused([1.0], pupil)[0] for pupil in pupils]
        return _psnrs(pictures, truth, edge)

    return look


def _start(subject, start, **options):
    """Encode with `refine`: from our field, or from random phases that know no more than where the volume lies."""
    view = subject.scene, subject.camera, subject.hologram
    settings = engine.Settings(frames=8)
    plan = engine.plan(*view, settings)
    if start == OURS:
        field = engine.render(*view, settings, plan)
    else:
        shape = settings.frames, 1, subject.hologram.height, subject.hologram.width
        phases = np.random.default_rng(0).uniform(0, 2 * math.pi, shape).astype(np.float32)
        light = np.exp(np.complex64(1j) * phases)
        field = engine.WaveField(light, subject.hologram, subject.camera, plan.near, plan.to_dict())

    return pipeline.encode(field, Encoding("refine"), lambda *_: None, subject.scene, settings, **options)


def _stages(phase, curve):
    """What the stages of an encoding took."""
    sgd, many, refinement = phase.report["stages"]
    (first, _), (last, _) = curve.ends
    return (
        f"{sgd['steps']} steps of sgd until {first:.1f} s, {many['frames']} frames more in "
        f"{many['seconds']:.1f} s, {refinement['steps']} steps until {last:.1f} s"
    )


def _chart(curves, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(name for name, _ in curves))
    size = (6 * len(names), 4.5)
    figure, axes = plt.subplots(1, len(names), figsize=size, layout="constrained", squeeze=False)
    for axis, name in zip(axes.flat, names, strict=True):
        for start, color in ((OURS, "tab:green"), (RANDOM, "tab:gray")):
            seconds, values = zip(*curves[name, start].points, strict=True)
            seconds, values = [*seconds, MARKS[-1]], [*values, values[-1]]
            axis.plot(seconds, [np.mean(v) for v in values], color=color, label=f"{start}, mean")
            axis.plot(seconds, [min(v) for v in values], ":", color=color, label=f"{start}, worst")
        axis.set(title=name, xlabel="seconds", ylabel="PSNR over nine views, dB", xlim=(0, MARKS[-1]))
        axis.grid(alpha=0.3)
        axis.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def seconds(side=SIDE, count=None, given=GIVEN, frames=8):
    """What phases show that were found in so many seconds: what `auto` chooses, and `joint` in the same time."""
    build = Scenes()
    builders = {
        "three planes": lambda: planes(build.three_planes(), side),
        "two planes under a lamp": lambda: planes(build.two_planes(build.diffuse), side),
        "suzanne": lambda: suzanne(side),
    }
    lines = [f"seconds of encoding: {side} x {side}, M = {frames}, nine views, PSNR in dB, mean / worst"]
    for name in tuple(builders)[:count]:
        subject, settings = builders[name](), engine.Settings(frames=frames)
        view = subject.scene, subject.camera, subject.hologram
        field = engine.render(*view, settings)
        look = _views_of(subject, field)
        lines.append(f"  {name}: the complex field {_mean_and_worst(look(field))}")
        limits = [{"seconds": limit} for limit in given] + [{}]
        for method, options in [
            ("sgd", {}),
            ("joint", {}),
            ("refine", {}),
            *(("auto", limit) for limit in limits),
        ] + [("joint", limit) for limit in limits[:-1]]:
            plan = engine.plan(*view, settings)
            extra_frames = engine.extra_frame_count(plan, subject.hologram, method, options.get("seconds"))
            field = engine.render(*view, settings, plan, extra_frames=extra_frames)
            start = time.perf_counter()
            phase = pipeline.encode(
                field, Encoding(method, **options), lambda *_: None, subject.scene, settings
            )
            taken, stages = time.perf_counter() - start, phase.report["stages"]
            more = sum(stage.get("frames", 0) for stage in stages)
            lines.append(
                f"    {method:6}{options.get('seconds', '-'):>5} s: {_mean_and_worst(look(phase.field()))}  "
                f"{taken:6.1f} s, {phase.method}, {more} extra frames, {stages[-1]['steps']} steps"
            )
    return "\n".join(lines)


def _views_of(subject, field):
    """PSNR of fields in five depths and four half pupils, as a function of them."""
    near, far = (1 / subject.focus[n] for n in (0, -1))
    depths = [1 / d for d in np.linspace(near, far, 5)]
    half = field.mapping.pupil_radius(subject.hologram.max_slope(GREEN)) / 2
    pupils = [engine.Pupil(half * x, half * y, 2 * half) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    looks = [(depth, None) for depth in depths] + [(depths[2], pupil) for pupil in pupils]
    view, edge = (subject.scene, subject.camera, subject.hologram), border(subject.hologram)
    truth = [
        engine.reference(*view, [depth], pupil, spp=TRUTH, near=field.near, halves=True)[0]
        for depth, pupil in looks
    ]

    def look(light):
        focused = engine.Refocuser(light)
        return [engine.psnr(focused([d], p)[0], t, edge) for (d, p), t in zip(looks, truth, strict=True)]

    return look


def _mean_and_worst(values):
    return f"{np.mean(values):5.2f} / {min(values):5.2f}"


def cost(sizes=SIZES):
    """A step of each optimization against its FFTs alone, in the same threads."""
    lines = ["cost of a step in ms: with its FFTs alone; medians"]
    for frames, shape in sizes:
        rng = np.random.default_rng(0)
        parts = rng.normal(size=(2, frames, *shape)).astype(np.float32)
        fields = parts[0] + 1j * parts[1]
        views = Views(ViewedVolume(shape, PITCH, GREEN, -2e-3, 3e-3), frames, 0)
        targets = ViewTargets(views)
        with FramePool() as pool:
            targets.add(fields)
            phases = Phases(np.angle(fields), pool)
            target = ComplexTarget(fields, True, pool)
            seen = descent.ViewLosses(phases.light, targets, 1.0)
            chosen = [
                (number, kind.weight / kind.looks)
                for kind, numbers in views.kinds
                for number in numbers[: kind.looks]
            ]
            even = np.ones(frames, np.complex64)

            def sgd(phases=phases, target=target):
                _, back, factors = target.gradient(phases.light)
                phases.descend(back, factors, 0.01)

            def joint(phases=phases, seen=seen, chosen=chosen, even=even):
                phases.descend(seen.gradient(phases.light, chosen), even, 0.01)

            text = []
            for name, step, count, grid in (
                ("sgd", sgd, 2, shape),
                ("joint", joint, round(step_transforms(1.0)), views.padded),
            ):
                whole, alone = _medians(step, _ffts(np.ones((frames, *grid), np.complex64), count, pool))
                text.append(f"{name} {whole:7.1f} ({count} FFTs {alone:7.1f}, ratio {whole / alone:.2f})")
        lines.append(f"  M = {frames:2d}, {shape[1]:4d} x {shape[0]:4d}: {'   '.join(text)}")
    return "\n".join(lines)


def _ffts(waves, count, pool):
    """Nothing but FFTs, there and back, of each frame."""

    def one(n):
        wave = waves[n]
        for _ in range(count // 2):
            wave = scipy.fft.ifft2(scipy.fft.fft2(wave, overwrite_x=True), overwrite_x=True)

    return lambda: pool.each(one, len(waves))


def _medians(*works, most_seconds=12.0):
    """Milliseconds of each, taken in turns so that both see the same machine."""
    for work in works:
        work()
    times, start = [[] for _ in works], time.perf_counter()
    while len(times[0]) < 5 or (len(times[0]) < 31 and time.perf_counter() - start < most_seconds):
        for work, taken in zip(works, times, strict=True):
            begun = time.perf_counter()
            work()
            taken.append(time.perf_counter() - begun)
    return [1e3 * float(np.median(taken)) for taken in times]


def large(shape=LARGE, frames=LARGE_FRAMES, max_steps=1000):
    """Seconds and memory of `joint` on a large display in three colors, and what follows for M = 24."""
    seconds, stages, peak, idle = _alone(shape, frames, max_steps)
    *_, smaller, _ = _alone(shape, frames // 2, 1)
    slope = (peak - smaller) / (frames - frames // 2)
    steps = ", ".join(f"{s['stage']} {s['steps']} steps in {s['seconds']:.0f} s" for s in stages)
    return "\n".join(
        [
            f"large hologram: joint, {shape[1]} x {shape[0]}, three colors, M = {frames}",
            f"  {seconds:.0f} s, peak {peak:.2f} GiB ({idle:.2f} before): {steps}",
            f"  M = 24: {seconds * 24 / frames:.0f} s, at most {peak + slope * (24 - frames):.1f} GiB",
        ]
    )


def _alone(shape, frames, max_steps):
    """What `_encode_large` returns in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_encode_large, shape, frames, max_steps).result()


def _encode_large(shape, frames, max_steps):
    """Seconds, stages, and GiB at most and before the encoding."""
    height, width = shape
    far, near = engine.DISPLAYS["pluto-2"].depth_range
    hologram = engine.Hologram(width, height, PITCH, depth_far=far, depth_near=near)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    smooth = (0.6 + 0.4 * np.cos(3 * x) * np.cos(2 * y)).astype(np.float32)
    waves = np.empty((frames, len(hologram.wavelengths), height, width), np.complex64)
    for m, phasor in enumerate(phasors_of("designed", frames, height, width, 0)):
        rows, columns = (np.arange(n) % period for n, period in zip(shape, phasor.shape, strict=True))
        waves[m] = smooth * phasor[np.ix_(rows, columns)]
    field = engine.WaveField(waves, hologram, engine.Camera(np.eye(4), FOV), 0.5)
    idle, start = _peak(), time.perf_counter()
    phase = engine.encode(field, "joint", max_steps=max_steps)
    return time.perf_counter() - start, [dict(s) for s in phase.report["stages"]], _peak(), idle


def _peak():
    """GiB at most so far; `resource.getrusage` would count those of the process that started this one."""
    status = Path("/proc/self/status").read_text()
    return int(re.findall(r"VmHWM:\s*(\d+) kB", status)[0]) / 2**20
