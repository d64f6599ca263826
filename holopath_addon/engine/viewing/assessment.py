"""Measures of what a viewer sees of a stored field: focus, eyebox, parallax, loss by phases, and path-traced truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ..mapping import border_pixels, squared
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

PATCHES = 3  # across and down; each has its own focus
MIN_COMPARED = 12  # pixels along a side: the window of SSIM
EDGE_TOLERANCE = 1e-6  # fraction of a pupil's radius that may lie beyond the light


def pupil_radius(field: WaveField) -> float:
    """Radius in meters of the largest pupil that every wavelength fills, within the stop."""
    return _band_radius(field) * field.hologram.optics.stop_circle[2]


def pupil_center(field: WaveField) -> tuple[float, float]:
    """Center of the pupil of `pupil_radius`, meters to the right and up of the axis."""
    x, y, _ = field.hologram.optics.stop_circle
    return x * _band_radius(field), y * _band_radius(field)


def _band_radius(field):
    """Radius in meters of the pupil that the whole band would fill in all wavelengths."""
    hologram = field.hologram
    return min(field.mapping.pupil_radius(hologram.max_slope(each)) for each in hologram.wavelengths)


def sharpness(images: np.ndarray) -> np.ndarray:
    """Mean squared gradient over squared brightness, for each patch of each image.

    Tenenbaum's measure of focus: the sharper, the larger (Krotkov, Int. J. Comput. Vision 1, 223 (1988)).

    Parameters
    ----------
    images : numpy.ndarray, shape (focus, y, x, channel)
        Intensities.

    Returns
    -------
    numpy.ndarray, shape (focus, `PATCHES`, `PATCHES`)
        Rows from the top, columns from the left; 0 in dark patches, and in all of an image with fewer pixels a side.
    """
    measures = np.zeros((len(images), PATCHES, PATCHES))
    if min(np.shape(images)[1:3]) < PATCHES:
        return measures
    # one by one: gradients take more memory than images
    for values, image in zip(measures, images, strict=True):
        gray = np.asarray(image, np.float64).mean(-1)
        down, across = np.gradient(gray)
        square = down**2 + across**2
        for row, rows in enumerate(np.array_split(np.arange(gray.shape[0]), PATCHES)):
            for column, columns in enumerate(np.array_split(np.arange(gray.shape[1]), PATCHES)):
                patch = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
                bright = gray[patch].mean() ** 2
                values[row, column] = square[patch].mean() / bright if bright > 0 else 0.0
    return measures


def pupils(field: WaveField, size: float, count: int) -> list[list[Pupil | None]]:
    """Grid of parts of the pupil, rows from the top; None where a part would reach beyond the light.

    Parameters
    ----------
    field : WaveField
    size : float
        Diameter of each part as a fraction of the whole pupil's, over 0 to 1.
    count : int
        Number of parts in a row and in a column.
    """
    radius = pupil_radius(field)
    reach, (right, up) = radius * (1 - size), pupil_center(field)
    offsets = np.linspace(-reach, reach, count) if count > 1 else np.zeros(1)
    return [
        [
            Pupil(float(x) + right, float(y) + up, 2 * size * radius)
            if math.hypot(x, y) <= reach * (1 + EDGE_TOLERANCE)
            else None
            for x in offsets
        ]
        for y in offsets[::-1]
    ]


def opening_fractions(field: WaveField, pupil: Pupil) -> np.ndarray:
    """Fraction of each wavelength's opening that a part of the pupil covers, shape (wavelength,)."""
    hologram, mapping = field.hologram, field.mapping
    radii = np.array([mapping.pupil_radius(hologram.max_slope(each)) for each in hologram.wavelengths])
    if hologram.optics.stopped:
        return np.array(
            [hologram.optics.fraction_within(pupil.x / r, pupil.y / r, pupil.diameter / 2 / r) for r in radii]
        )
    return _overlap(radii, pupil.diameter / 2, math.hypot(pupil.x, pupil.y)) / (math.pi * radii**2)


def _overlap(a, b, distance):
    """Area that disks of radii a and b, with their centers at a distance, have in common."""
    distance = np.clip(distance, abs(a - b), a + b)
    with np.errstate(invalid="ignore", divide="ignore"):
        sides = [
            np.clip((distance**2 + p**2 - q**2) / (2 * distance * p), -1, 1) for p, q in ((a, b), (b, a))
        ]
    angles = [np.nan_to_num(np.arccos(side)) for side in sides]  # not a number for equal, concentric disks
    kite = 0.5 * np.sqrt(
        np.maximum(
            (-distance + a + b) * (distance + a - b) * (distance - a + b) * (distance + a + b),
            0.0,
        )
    )
    area = a**2 * angles[0] + b**2 * angles[1] - kite
    return np.where(distance <= abs(a - b), math.pi * np.minimum(a, b) ** 2, area)


def balance_colors(field: WaveField, image: np.ndarray, pupil: Pupil) -> np.ndarray:
    """Divide an image through a part of the pupil by the fraction of the opening that each wavelength has there.

    Red fills a wider cone than blue, so that white turns bluish through a part. A path-traced image is a mean over the
    opening and needs no such correction.

    Parameters
    ----------
    field : WaveField
    image : numpy.ndarray, shape (y, x, wavelength)
        Intensities.
    pupil : Pupil
        The part that the image was seen through.
    """
    return image / opening_fractions(field, pupil)


@dataclass(frozen=True)
class PathTraced:
    """Path-traced images of a field's view, in two halves of independent noise, see `reference`.

    Attributes
    ----------
    scene : mitsuba.Scene
        Scene of the field.
    field : WaveField
    paths : int
        Number of paths for each pixel and wavelength.
    max_depth : int
        As `Settings.max_depth`.
    """

    scene: mi.Scene
    field: WaveField
    paths: int
    max_depth: int

    def __call__(self, focus: Sequence[float], pupil: Pupil | None, progress: Progress) -> np.ndarray:
        """Images at some depths through a part of the pupil; parameters and result as of `reference`."""
        field = self.field
        return reference(
            self.scene, field.camera, field.hologram, focus, pupil, self.paths, field.near, self.max_depth, progress,
            halves=True,
        )  # fmt: skip

    @property
    def border(self) -> int:
        """Number of pixels at each edge that lose light to the SLM's aperture, at the deepest end of the volume."""
        camera, hologram = squared(self.field.camera, self.field.hologram)
        pixels = border_pixels(hologram, camera, self.field.near)
        limit = (min(hologram.width, hologram.height) - MIN_COMPARED) // 2
        return max(0, min(pixels, limit))


def brightness(field: WaveField, image: np.ndarray, whole: np.ndarray, pupil: Pupil) -> float:
    """Brightness through a part of the pupil, relative to an eyebox that is evenly bright.

    Parameters
    ----------
    field : WaveField
    image, whole : numpy.ndarray, shape (y, x, wavelength)
        Intensities through the part, and through all of the pupil.
    pupil : Pupil
        The part.

    Returns
    -------
    float
        1 for an even eyebox; 0 where the whole is dark.
    """
    expected = (whole.mean((0, 1)) * opening_fractions(field, pupil)).sum()
    return float(image.mean((0, 1)).sum() / expected) if expected > 0 else 0.0


def epipolar_slices(
    refocus: Refocuser, focus: float, pupils: Sequence[Pupil], row: int, progress: Progress, apart: int = 1
) -> np.ndarray:
    """One row of the image through each of several pupils side by side: depth shows as slope.

    Bolles, Baker and Marimont, Int. J. Comput. Vision 1, 7 (1987).

    Parameters
    ----------
    refocus : Refocuser
    focus : float
        World depth, meters.
    pupils : sequence of Pupil
        From the left to the right.
    row : int
        Row of the full image.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.
    apart : int
        Distance in pixels between those that are computed, see `Refocuser`.

    Returns
    -------
    numpy.ndarray, shape (pupil, x, 3)
        Linear RGB.
    """
    images = refocus.through(focus, pupils, progress, apart)
    return to_rgb(images[:, row // apart], refocus.field.hologram.wavelengths)


def efficiency(phase: PhaseHologram, progress: Progress) -> list[float]:
    """Diffraction efficiency for each wavelength: fraction of the modulated light within the stop or recordable cone.

    Parameters
    ----------
    phase : PhaseHologram
        Modulates the beam of its optics. Behind a lens the light that meets the grid of the picture counts.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.
    """
    hologram, grid = phase.hologram, phase.hologram.in_air
    shape = grid.raster(hologram.wavelengths[0]).shape
    fractions, (frames, colors) = [], phase.data.shape[:2]
    for color, wavelength in enumerate(hologram.wavelengths):
        inside = total = 0.0
        band = hologram.optics.stop_mask(shape, grid.pitch_at(wavelength))
        lens = behind_lens(hologram, wavelength)
        illumination = phase.hologram.illumination(color)
        beam = 1 if illumination is None else illumination
        for number, frame in enumerate(phase.data[:, color]):
            progress((color * frames + number) / (colors * frames), "Diffraction efficiency")
            light = beam * np.exp(1j * frame.astype(np.float64))
            total += math.prod(shape) * (np.abs(light) ** 2).sum()
            power = np.abs(scipy.fft.fft2(light if lens is None else lens.propagate(light))) ** 2
            inside += power[band].sum()
        fractions.append(inside / total)
    return fractions


def loss(images: np.ndarray, targets: np.ndarray) -> list[float]:
    """PSNR in dB of each image by phases against that by the field; NaN where the latter is dark.

    Parameters
    ----------
    images, targets : numpy.ndarray, shape (view, y, x, wavelength)
        Intensities by the phases, and by the field.
    """
    return [psnr(a, b) if b.any() else math.nan for a, b in zip(images, targets, strict=True)]
