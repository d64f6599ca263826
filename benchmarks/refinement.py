"""What `refine` gives each view: by weights and parts of the pupil, by frames and bits, and what wave optics allows."""

import math
from dataclasses import replace
from unittest import mock

import numpy as np
import scipy.fft

from holopath_addon import engine
from holopath_addon.engine.encoding import views
from holopath_addon.engine.encoding.options import eyebox_for
from holopath_addon.engine.waves.phase_fields import randomness_for
from holopath_addon.engine.waves.propagation import FreeSpace
from holopath_addon.workflow import pipeline

from .chart import looks
from .parts import joined
from .scenes import FOV, GREEN, Scenes

PIXELS = 128
TRUTH = 64  # paths a pixel
WEIGHTS = (0.98, 0.95, 0.9, 0.8, 0.6, 0.3, 0.0)  # of the whole pupil
PARTS = ((3, 4), (4, 8), (6, 16), (9, 24))  # halves and quarters of the pupil at each depth
FRAMES, BITS = (1, 3, 8, 24), (8, 6, 4, 1)
FINER, SIDE = 8, 512  # of the lens's disc in a pixel, and pixels of the picture that is out of focus
BLURS = (0.0, 0.5, 1, 2, 3, 5, 8, 12, 20)  # radii, pixels


def run(part=None, pixels=PIXELS, scenes=None):
    """Tables as text, of one part or of all; of so many scenes. Below the usual number of pixels with few choices."""
    hologram, few = hologram_of(pixels), 1 if pixels < PIXELS else None
    parts = {
        "weights": lambda: weights(hologram, scenes, WEIGHTS[:few], PARTS[:few]),
        "bits": lambda: bits(hologram, FRAMES[:few], BITS[:few]),
        "defocus": lambda: defocus(hologram),
    }
    return joined({name: parts[name] for name in ([part] if part else parts)})


def hologram_of(pixels):
    """A display whose volume is as large as it is."""
    size = pixels / PIXELS
    return engine.Hologram(pixels, pixels, 8e-6, (GREEN,), 2e-3 * size, 4.5e-3 * size)


def subjects():
    """Two that nothing was tuned for: five textured slats one behind another, and two planes under a lamp."""
    s = Scenes()
    slats = {
        f"slat_{n}": s.plane(
            depth, s.emissive(s.texture(128, 20 + n)), 0.05 * depth, 0.4 * depth, side * depth
        )
        for n, (side, depth) in enumerate(((-0.15, 0.45), (-0.05, 0.7), (0.06, 1.2), (0.14, 3.0)))
    }
    return {
        "slats": s.scene(wall=s.plane(6.0, s.emissive(s.texture(256, 31))), **slats),
        "lit planes": s.two_planes(s.diffuse),
    }


class Subject:
    """A scene, its truth, and many extra frames of it.

    Parameters
    ----------
    scene : mitsuba.Scene
    hologram : engine.Hologram
    """

    def __init__(self, scene, hologram):
        self._view = scene, engine.Camera(np.eye(4), FOV), hologram
        plan = engine.plan(*self._view)
        near, middle, far = pipeline.default_focus(plan, *self._view[1:])
        self._foci = near, middle, far
        self._truth = looks.truth_of(*self._view, self._foci, TRUTH)
        self._more = list(engine.extra_frames(*self._view, plan, lambda *_: None))

    def field(self, frames, **settings):
        """The complex field."""
        return engine.render(*self._view, engine.Settings(frames=frames, **settings))

    def many(self, field):
        """As a field, all that refinement goes towards."""
        return replace(field, data=np.concatenate([data for _, data in self._more]))

    def refined(self, field, kinds=None, **options):
        """The light of phases, by some `ViewKind` or those that so many frames have."""
        frames = len(field.data)
        options |= {"randomness": randomness_for(frames, eyebox_for(frames))}
        with mock.patch.object(
            views, "kinds_for", views.kinds_for if kinds is None else lambda eyebox: kinds
        ):
            return engine.encode(field, "refine", extra_frames=lambda _: self._more, **options).field()

    def row(self, label, light):
        """Mean and worst of the chart's eleven views, and the means of those through each part of the pupil."""
        pictures, border = (
            looks.seen(light, self._foci, self._truth["others"]),
            looks.border_of(light.hologram),
        )
        each = np.array(
            [engine.psnr(p, w, border) for p, w in zip(pictures, self._truth["pictures"], strict=True)]
        )
        each = each[: len(looks.HEADLINE)]
        return (
            f"    {label:28} {each.mean():6.2f} {each.min():6.2f}   whole {each[:5].mean():6.2f}  "
            f"halves {each[5:9].mean():6.2f}  quarters {each[9:].mean():6.2f}"
        )


def weights(hologram, count=None, weights=WEIGHTS, numbers=PARTS, frames=8):
    """Weights of the whole pupil and of parts of it, and how many parts."""
    lines = [
        f"weights over views: M = {frames}; PSNR in dB, mean and worst of eleven views, and of each kind"
    ]
    whole, *some = views.kinds_for(1.0)
    for name, scene in tuple(subjects().items())[:count]:
        subject = Subject(scene, hologram)
        field = subject.field(frames)
        lines += [
            f"  {name}",
            subject.row("complex field", field),
            subject.row("mean of many frames", subject.many(field)),
        ]
        for weight in weights:
            kinds = (replace(whole, weight=weight), *(replace(k, weight=(1 - weight) / 2) for k in some))
            lines.append(subject.row(f"weight {weight:g}", subject.refined(field, kinds)))
        for pair in numbers:
            kinds = (whole, *(replace(k, each=n) for k, n in zip(some, pair, strict=True)))
            label = "{} halves, {} quarters".format(*pair)
            lines.append(subject.row(label, subject.refined(field, kinds)))
    return "\n".join(lines)


def bits(hologram, numbers=FRAMES, levels=BITS):
    """Few frames, and displays of few bits."""
    lines = ["frames and bits: PSNR in dB, mean and worst of eleven views, and of each kind"]
    subject = Subject(subjects()["lit planes"], hologram)
    for frames in numbers:
        field = subject.field(frames)
        lines += [
            f"  M = {frames}",
            subject.row("complex field", field),
            subject.row("despeckled", subject.field(frames, despeckle=200)),
            subject.row("auto without extra frames", engine.encode(field).field()),
            subject.row("refined", subject.refined(field)),
            *(subject.row(f"refined, {n} bits", subject.refined(field, bits=n)) for n in levels),
            subject.row("auto without more, 1 bit", engine.encode(field, bits=1).field()),
        ]
    return "\n".join(lines)


def defocus(hologram):
    """A hard-edged texture out of focus: incoherent wave optics against the disc of a lens without diffraction."""
    texture = sum(
        np.kron(np.random.default_rng(b).random((SIDE // b,) * 2), np.ones((b, b))) for b in (16, 8, 4)
    )
    spectrum = scipy.fft.fft2(np.clip(0.5 + 2 * (texture / 3 - 0.5), 0.02, 1))
    slope, space = hologram.max_slope(GREEN), FreeSpace((SIDE, SIDE), hologram.pitch, GREEN)
    in_focus = _spread(space(0.0))
    lines = [
        "out of focus: PSNR in dB against the lens's picture, of wave optics and of that picture * |h|^2 in focus"
    ]
    for radius in BLURS:
        lens = spectrum * _disc(radius)
        images = (spectrum * _spread(space(radius * hologram.pitch / slope)), lens * in_focus, lens)
        waves, blurred, wanted = (np.maximum(scipy.fft.ifft2(i).real, 0)[..., None] for i in images)
        both = (engine.psnr(image, wanted, 32) for image in (waves, blurred))
        lines.append("  {:4.1f} pixels  {:6.1f} {:6.1f}".format(radius, *both))
    return "\n".join(lines)


def _spread(transfer):
    """Of intensities, of a wave's."""
    spread = np.abs(scipy.fft.ifft2(transfer)) ** 2
    return scipy.fft.fft2(spread / spread.sum())


def _disc(radius):
    """Transfer function of a disc, of pixels that average over it."""
    if not radius:
        return 1.0
    reach = math.ceil(radius) + 1
    places = (np.arange(-reach * FINER, reach * FINER + FINER) + 0.5) / FINER - 0.5
    inside = np.hypot(places[:, None], places) <= radius
    count = 2 * reach + 1
    disc = np.zeros((SIDE, SIDE))
    disc[:count, :count] = inside.reshape(count, FINER, count, FINER).sum((1, 3))
    return scipy.fft.fft2(np.roll(disc / disc.sum(), (-reach, -reach), (0, 1)))
