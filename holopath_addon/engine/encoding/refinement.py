"""Which references are worth rendering, and the pictures that they make."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..pupil import Pupil
from ..waves.pictures import Pictures, Vantage
from .frame_mean import FrameMean

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..progress import PartProgress
    from ..wavefield import WaveField
    from ..waves.supervision import Frames

HALF = 0.5  # radius of a part of the pupil, of the whole's
RING = 8  # such parts around the axis, besides the one on it
DEPTH = 0.8  # between two depths, of the depth of focus 2 wavelength / slope^2
MOST_DEPTHS = 15


def chosen_pictures(
    field: WaveField,
    *,
    phases: np.ndarray,
    gains: list[float],
    colours: list[int],
    volume: tuple[float, float],
    references: Callable[[float, Pupil | None], np.ndarray],
    count: int,
    progress: PartProgress,
    threads: Frames,
) -> dict[int, Pictures]:
    """References over the volume and the pupil: first a few, then where the hologram is worst.

    Parameters
    ----------
    field : WaveField
    phases : numpy.ndarray, float32, shape (frame, wavelength, y, x)
        As they are before the stage.
    gains : list of float
        Of each wavelength; set to what the references' brightness asks for.
    colours : list of int
        Wavelengths to care for, at least one.
    volume : (float, float)
        Distances from the SLM between which the scene lies, metres.
    references : callable
        ``references(focus, pupil)``, array [y, x, wavelength].
    count : int
        Of references; fewer where the volume has not as many views.
    progress : callable
        ``progress(done)``, may raise.
    threads : Frames

    Returns
    -------
    dict of int to Pictures
        By wavelength; each vantage lets through what its pupil does.
    """
    hologram, mapping = field.hologram, field.mapping
    radii = [mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths]
    radius = float(np.mean([radii[colour] for colour in colours]))
    slope = hologram.widest_slope
    focal_depth = DEPTH * 2 * max(hologram.wavelengths) / slope**2
    first, last = volume
    depths = np.linspace(first, last, min(MOST_DEPTHS, 2 + math.ceil((last - first) / focal_depth)))
    views = [(i / (len(depths) - 1), part) for i in range(len(depths)) for part in _parts()]
    count = min(count, len(views))
    images, errors, vantages_of = {}, {}, {}

    def render(number):
        share, part = views[number]
        distance = volume[0] + share * (volume[1] - volume[0])
        pupil = None if part is None else Pupil(radius * part[0], radius * part[1], 2 * HALF * radius)
        images[number] = np.asarray(references(float(mapping.z_to_depth(distance)), pupil), np.float32)
        if not np.isfinite(images[number]).all():
            raise InvalidInput("A reference holds values that are not finite: look for faults in the scene.")
        vantages_of[number] = [
            Vantage(distance, None if pupil is None else _share_of(pupil, r)) for r in radii
        ]
        progress(len(images) / count)

    first = _first(views)[:count]
    for number in first:
        render(number)
    pictures = {colour: _pictures(field, colour, images, vantages_of) for colour in colours}
    for colour in colours:
        light = np.exp(np.complex64(1j) * phases[:, colour])
        mean = FrameMean(pictures[colour], 1.0, threads)
        seen = [mean.look(light, n) for n in range(len(first))]
        bright = sum(float(image.sum(dtype=float)) for image in seen)
        gains[colour] = math.sqrt(float(pictures[colour].wanted.sum(dtype=float)) / bright) if bright else 0.0
        for number, image, wanted in zip(first, seen, pictures[colour].wanted, strict=True):
            error = np.square(gains[colour] ** 2 * image - wanted).sum(dtype=float)
            errors[number] = errors.get(number, 0.0) + error / max(np.square(wanted).sum(dtype=float), 1e-30)
    while len(images) < count:
        render(_worst(views, images, errors))
    return {colour: _pictures(field, colour, images, vantages_of) for colour in colours}


def _parts():
    """The whole pupil, and halves of it: centre x and y in units of its radius."""
    angles = 2 * math.pi * np.arange(RING) / RING
    return [None, (0.0, 0.0), *((HALF * math.cos(a), HALF * math.sin(a)) for a in angles)]


def _first(views):
    """Numbers of a coarse set: the whole pupil at every depth, and in the middle every second part on the ring."""
    depths = sorted({share for share, _ in views})
    middle = depths[len(depths) // 2]
    wanted = [(middle, None), *((depth, None) for depth in depths), *((middle, p) for p in _parts()[2::2])]
    return [views.index(view) for view in dict.fromkeys(wanted)]


def _worst(views, images, errors):
    """The view that is farthest from those there are, as errors there measure distance."""
    best, worst = -1.0, None
    for number, view in enumerate(views):
        if number not in images:
            near = min(images, key=lambda other: _apart(view, views[other]))
            like = min(errors, key=lambda other: _apart(view, views[other]))
            score = errors[like] * _apart(view, views[near])
            if score > best:
                best, worst = score, number
    return worst


def _apart(view, other):
    """How different two views are: a smaller pupil has a longer depth of focus."""
    (depth, part), (depth_other, part_other) = view, other
    wide, wide_other = (1.0 if p is None else HALF for p in (part, part_other))
    x, y = part or (0.0, 0.0)
    x_other, y_other = part_other or (0.0, 0.0)
    along = 5 * (wide * wide_other) * (depth - depth_other)
    return math.hypot(along, x - x_other, y - y_other, 2 * (wide - wide_other))


def _share_of(pupil, radius):
    """A pupil in cycles a pixel: the edge of the recordable cone is at 0.5; y points down."""
    return 0.5 * pupil.x / radius, -0.5 * pupil.y / radius, 0.25 * pupil.diameter / radius


def _pictures(field, colour, images, vantages_of):
    """Pictures in one wavelength: a part of the pupil passes its share of the light."""
    hologram = field.hologram
    pictures = Pictures(
        field.data.shape[-2:],
        hologram.pitch,
        hologram.wavelengths[colour],
        [vantages_of[n][colour] for n in images],
    )
    for place, number in enumerate(images):
        pictures.wanted[place] = pictures.share(place) * images[number][..., colour]
    return pictures
