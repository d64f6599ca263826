"""What a viewer gets of a stored field: focus, eyebox, parallax, loss by phases; and how near path tracing it is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..optics import Pupil
from ..waves.lens import behind_lens
from .metrics import psnr
from .reconstruction import to_rgb
from .reference import reference

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mitsuba as mi

    from ..encoding.phase_hologram import PhaseHologram
    from ..progress import Progress
    from ..wavefield import WaveField
    from .reconstruction import Refocuser

PATCHES = 3  # across and down, each of which has a focus of its own
SMALLEST = 12  # pixels a side that are compared at least, as many as the window of SSIM takes
WITHIN = 1e-6  # of a pupil's radius that may lie beyond the light


def pupil_radius(field: WaveField) -> float:
    """Radius in meters of the pupil that all wavelengths fill, within the stop."""
    return _edge(field) * field.hologram.optics.opening[2]


def middle(field: WaveField) -> tuple[float, float]:
    """Of that pupil, meters to the right and up."""
    x, y, _ = field.hologram.optics.opening
    return x * _edge(field), y * _edge(field)


def _edge(field):
    """Radius in meters of the pupil that the whole band would fill in all wavelengths."""
    hologram = field.hologram
    return min(field.mapping.pupil_radius(hologram.max_slope(each)) for each in hologram.wavelengths)


def sharpness(images: np.ndarray) -> np.ndarray:
    """Mean squared gradient over squared brightness, of patches of pictures.

    That measure of focus of Tenenbaum grows with all that is sharp (Krotkov, Int. J. Comput. Vision 1, 223 (1988)).

    Parameters
    ----------
    images : numpy.ndarray, shape (focus, y, x, channel)

    Returns
    -------
    numpy.ndarray, shape (focus, `PATCHES`, `PATCHES`)
        From the top and the left; 0 where it is dark.
    """
    found = np.zeros((len(images), PATCHES, PATCHES))
    for values, image in zip(
        found, images, strict=True
    ):  # one by one: gradients take more memory than pictures
        gray = np.asarray(image, np.float64).mean(-1)
        down, across = np.gradient(gray)
        square = down**2 + across**2
        for row, rows in enumerate(np.array_split(np.arange(gray.shape[0]), PATCHES)):
            for column, columns in enumerate(np.array_split(np.arange(gray.shape[1]), PATCHES)):
                patch = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
                bright = gray[patch].mean() ** 2
                values[row, column] = square[patch].mean() / bright if bright > 0 else 0.0
    return found


def pupils(field: WaveField, share: float, count: int) -> list[list[Pupil | None]]:
    """Parts of the pupil on a grid, rows from the top; None where one would reach beyond the light.

    Parameters
    ----------
    field : WaveField
    share : float
        Of the whole pupil's diameter, over 0 to 1.
    count : int
        In a row and in a column.
    """
    radius = pupil_radius(field)
    reach, (right, up) = radius * (1 - share), middle(field)
    at = np.linspace(-reach, reach, count) if count > 1 else np.zeros(1)
    return [
        [
            Pupil(float(x) + right, float(y) + up, 2 * share * radius)
            if math.hypot(x, y) <= reach * (1 + WITHIN)
            else None
            for x in at
        ]
        for y in at[::-1]
    ]


def shares(field: WaveField, pupil: Pupil) -> np.ndarray:
    """Of each wavelength's opening, how much a part of the pupil is."""
    hologram, mapping = field.hologram, field.mapping
    radii = np.array([mapping.pupil_radius(hologram.max_slope(each)) for each in hologram.wavelengths])
    if hologram.optics.stopped:
        return np.array(
            [hologram.optics.share(pupil.x / r, pupil.y / r, pupil.diameter / 2 / r) for r in radii]
        )
    return _overlap(radii, pupil.diameter / 2, math.hypot(pupil.x, pupil.y)) / (math.pi * radii**2)


def _overlap(a, b, apart):
    """Area that discs of radii a and b have in common, whose centers are so far apart."""
    apart = np.clip(apart, abs(a - b), a + b)
    with np.errstate(invalid="ignore", divide="ignore"):
        sides = [np.clip((apart**2 + p**2 - q**2) / (2 * apart * p), -1, 1) for p, q in ((a, b), (b, a))]
    angles = [
        np.nan_to_num(np.arccos(side)) for side in sides
    ]  # of equal discs on each other there is no axis
    kite = 0.5 * np.sqrt(
        np.maximum((-apart + a + b) * (apart + a - b) * (apart - a + b) * (apart + a + b), 0.0)
    )
    area = a**2 * angles[0] + b**2 * angles[1] - kite
    return np.where(apart <= abs(a - b), math.pi * np.minimum(a, b) ** 2, area)


def even(field: WaveField, picture: np.ndarray, pupil: Pupil) -> np.ndarray:
    """A picture [y, x, wavelength] through a part of the pupil, all wavelengths as bright as their opening.

    Red fills a wider cone than blue, so that white is bluish through a part. A path-traced picture is a mean over what
    is open, and knows no such thing.
    """
    return picture / shares(field, pupil)


@dataclass(frozen=True)
class PathTraced:
    """Path-traced pictures of a field's view, in two halves of independent noise, see `reference`.

    Attributes
    ----------
    scene : mitsuba.Scene
        That the field is of.
    field : WaveField
    paths : int
        A pixel and wavelength.
    max_depth : int
        As `Settings.max_depth`.
    """

    scene: mi.Scene
    field: WaveField
    paths: int
    max_depth: int

    def __call__(self, focus: Sequence[float], pupil: Pupil | None, progress: Progress) -> np.ndarray:
        """Pictures at world depths, meters, through a part of the pupil: (focus, half, y, x, wavelength)."""
        field = self.field
        return reference(
            self.scene, field.camera, field.hologram, focus, pupil, self.paths, field.near, self.max_depth, progress,
            halves=True,
        )  # fmt: skip

    @property
    def border(self) -> int:
        """Pixels at each edge that lose light of the far end of the volume to the SLM's aperture."""
        hologram = self.field.hologram.picture
        depth = max(abs(hologram.depth_far), abs(hologram.depth_near))
        most = (min(hologram.width, hologram.height) - SMALLEST) // 2
        return max(0, min(math.ceil(hologram.widest_slope * depth / hologram.pitch_x), most))


def brightness(field: WaveField, picture: np.ndarray, whole: np.ndarray, pupil: Pupil) -> float:
    """Of a picture through a part of the pupil, over what its share of each wavelength's opening would let through.

    Parameters
    ----------
    field : WaveField
    picture, whole : numpy.ndarray, shape (y, x, wavelength)
        Through the part, and through all of the pupil.
    pupil : Pupil

    Returns
    -------
    float
        1 for an eyebox that is evenly bright.
    """
    expected = (whole.mean((0, 1)) * shares(field, pupil)).sum()
    return float(picture.mean((0, 1)).sum() / expected) if expected > 0 else 0.0


def slices(
    refocus: Refocuser, focus: float, seen: Sequence[Pupil], row: int, progress: Progress, apart: int = 1
) -> np.ndarray:
    """One row of the picture through pupils side by side: an epipolar slice, in which depth is a slope.

    Bolles, Baker and Marimont, Int. J. Comput. Vision 1, 7 (1987).

    Parameters
    ----------
    refocus : Refocuser
    focus : float
        World depth, meters.
    seen : sequence of Pupil
    row : int
        Of all pixels.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.
    apart : int
        As of `Refocuser`.

    Returns
    -------
    numpy.ndarray, shape (pupil, x, 3)
        Linear RGB.
    """
    pictures = refocus.through(focus, seen, progress, apart)
    return to_rgb(pictures[:, row // apart], refocus.field.hologram.wavelengths)


def efficiency(phase: PhaseHologram, progress: Progress) -> list[float]:
    """Share of the modulated light within the stop, or the recordable cone, for each wavelength; the rest goes astray.

    Modulated is the beam of the hologram's optics. Behind a lens it is what meets the grid of the picture.
    `progress` may raise `Cancelled`.
    """
    hologram, grid = phase.hologram, phase.hologram.in_air
    shape = grid.raster(hologram.wavelengths[0]).shape
    found, (frames, colors) = [], phase.data.shape[:2]
    for color, wavelength in enumerate(hologram.wavelengths):
        inside = total = 0.0
        band = hologram.optics.passes(shape, grid.pitch_at(wavelength))
        way = behind_lens(hologram, wavelength)
        illumination = phase.hologram.illumination(color)
        beam = 1 if illumination is None else illumination
        for number, frame in enumerate(phase.data[:, color]):
            progress((color * frames + number) / (colors * frames), "Diffraction efficiency")
            light = beam * np.exp(1j * frame.astype(np.float64))
            total += math.prod(shape) * (np.abs(light) ** 2).sum()
            power = np.abs(scipy.fft.fft2(light if way is None else way.there(light))) ** 2
            inside += power[band].sum()
        found.append(inside / total)
    return found


def loss(shown: np.ndarray, wanted: np.ndarray) -> list[float]:
    """PSNR in dB of pictures by phases against those by the field, both of shape (view, y, x, wavelength).

    NaN where the field is dark.
    """
    return [psnr(a, b) if b.any() else math.nan for a, b in zip(shown, wanted, strict=True)]
