"""Results of the pilot's rays, and what NumPy derives from them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..tracing.regions import DEPTHS, Sightings

if TYPE_CHECKING:
    from collections.abc import Sequence

# Fraction of the view: less sky may be cracks between triangles, and fewer mirrors are not worth their cost.
MIN_VIEW_FRACTION = 1e-4


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Results of a few rays.

    Attributes
    ----------
    vergence : numpy.ndarray
        Inverse world depths of hits, 1/m; through mirrors and lenses those of images, which may be negative.
    is_image : numpy.ndarray of bool
        Whether each of them is of an image.
    sky : bool
        Whether rays that hit nothing meet an environment.
    specular : float
        Fraction of rays that meet surfaces with a δ lobe.
    nearly_specular : float
        Fraction of rays that meet rough surfaces with a narrow lobe.
    diffuse : float
        Fraction of rays that meet surfaces which scatter diffusely, and are no mirrors.
    turn, sharpest : float
        Turn of the view across the pupil in widths of the sharp glossy lobes in view, and of the sharpest; 0 without
        gloss.
    gloss : numpy.ndarray
        Inverse depths of the glossy surfaces in view, 1/m.
    places : Places
        Where each ray went, and the depths that it met.
    coherent : bool
        Whether rays are faster in packets, as they are where triangles are large.
    rays_per_second, chains_per_second : float
        Speeds of the programs on this machine: of rays to the first surface, and of rays that are followed over mirrors
        and through clear surfaces.
    compiling : float
        Seconds that these programs took to compile.
    bent : bool
        Whether images lie elsewhere than at the optical path length, as in curved mirrors and through glass.
    images : numpy.ndarray
        Inverse depths of such images, 1/m.
    splits : int
        Hits at which chains divide.
    cut : float
        Fraction of the light from white surroundings that chains would show beyond the hits that are followed.
    """

    vergence: np.ndarray
    sky: bool
    specular: float
    nearly_specular: float
    diffuse: float
    turn: float
    sharpest: float
    gloss: np.ndarray
    places: Places
    coherent: bool
    rays_per_second: float
    chains_per_second: float
    compiling: float
    is_image: np.ndarray
    bent: bool = False
    images: np.ndarray = field(default_factory=lambda: np.empty(0))
    splits: int = 0
    cut: float = 0.0

    @property
    def binned(self) -> float:
        """Fraction of the occupied cells of the radiance map that have all pupil bins; at least 0.01."""
        return min(1.0, max(0.01, len(self.gloss) / max(len(self.vergence), 1) + self.specular))

    def vergence_range(self, limits: Sequence[float]) -> tuple[float, float]:
        """Minimum and maximum inverse depth in view, 1/m.

        Caustics spread a few images over all depths, behind the viewer too. Images within a hundredth of the view at
        either end, and those beyond the limits, are moved to the nearest depth inside.

        Parameters
        ----------
        limits : (float, float)
            Minimum and maximum inverse depth of images, 1/m.
        """
        if not len(self.vergence):
            return 0.0, 0.0
        images, ends = self.vergence[self.is_image], self.vergence[~self.is_image]
        if len(images):
            fraction = min(0.5, 0.01 * len(self.vergence) / len(images))
            ends = np.append(ends, np.clip(np.quantile(images, (fraction, 1 - fraction)), *limits))
        low = min(ends.min(), 0.0) if self.sky else ends.min()
        return float(low), float(ends.max())


@dataclass(frozen=True, kw_only=True)
class Places:
    """Paths of the probe's rays, and the depths that they met.

    Attributes
    ----------
    column, row : numpy.ndarray
        Where rays cross the far end of the volume, pixels.
    slope_x, slope_y : numpy.ndarray
        To the right and up.
    z : numpy.ndarray
        Depth of what is visible, meters from the SLM; NaN where nothing is.
    first : numpy.ndarray
        Depth of the first surface.
    chains : numpy.ndarray of bool
        Whether it is visible through mirrors or clear surfaces.
    z_far, pitch : float
        Far end of the volume, and pixel pitch, meters.
    """

    column: np.ndarray
    row: np.ndarray
    slope_x: np.ndarray
    slope_y: np.ndarray
    z: np.ndarray
    first: np.ndarray
    chains: np.ndarray
    z_far: float
    pitch: float

    def on_plane(self, plane: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Column and row, from the first pixel's edge, where rays cross planes at distances from the SLM in meters."""
        walk = (plane - self.z_far) / self.pitch
        return self.column + self.slope_x * walk + 0.5, self.row - self.slope_y * walk + 0.5

    def sightings(
        self, plane: float, limit: float, size: tuple[int, int], cell: int, where: np.ndarray, images: bool
    ) -> Sightings:
        """`Sightings` from the tiles of a plane.

        Parameters
        ----------
        plane : float
            Distance of the plane from the SLM, meters.
        limit : float
            Maximum distance of a surface from the plane, meters.
        size : (int, int)
            Width and height of the plane, pixels.
        cell : int
            Side of a tile, pixels.
        where : numpy.ndarray of bool
            Places that count for depths.
        images : bool
            Whether the plane records images.

        Returns
        -------
        Sightings
        """
        column, row = (np.floor(at / cell).astype(int) for at in self.on_plane(plane))
        columns, rows = (-(-n // cell) for n in size)
        on_plane = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        inside, tiles = on_plane & where, row * columns + column
        part = np.minimum(np.abs(self.z[inside] - plane) / limit, 1.0)
        depth, chains = np.zeros(rows * columns, np.uint32), np.zeros(rows * columns, bool)
        np.maximum.at(depth, tiles[inside], 1 + (part * (DEPTHS - 1)).astype(np.uint32))
        chains[tiles[on_plane & self.chains]] = True
        return Sightings(depth.reshape(rows, columns), chains.reshape(rows, columns), images)


@dataclass(frozen=True)
class Edges:
    """Edges of near things in a view along the axis.

    Attributes
    ----------
    front, behind : numpy.ndarray
        Depths of the surface in front and of the surface behind, meters from the SLM.
    visible : numpy.ndarray
        Depth of what is visible behind: of the surface, or of the image that it shows.
    images : numpy.ndarray of bool
        Whether it shows one.
    length : float
        Length of each piece of an edge, pixels.
    """

    front: np.ndarray
    behind: np.ndarray
    visible: np.ndarray
    images: np.ndarray
    length: float

    @classmethod
    def between(
        cls, first: np.ndarray, visible: np.ndarray, images: np.ndarray, min_step: float, length: float
    ) -> Edges:
        """Edges where depth steps between neighbors exceed `min_step`, and twice the steps on either side.

        Parameters
        ----------
        first, visible : numpy.ndarray, shape (rows, columns)
            Depths of first surfaces and of what they show, meters from the SLM.
        images : numpy.ndarray of bool, shape (rows, columns)
            Whether they show images.
        min_step : float
            Meters.
        length : float
            Pixels between neighbors.

        Returns
        -------
        Edges
        """
        found = []
        for depth, *others in ((first, visible, images), (first.T, visible.T, images.T)):
            steps = np.diff(depth, axis=1)
            slope = 2 * np.maximum(abs(np.roll(steps, 1, 1)), abs(np.roll(steps, -1, 1)))
            row, column = np.nonzero(abs(steps) > min_step + slope)
            nearer = column + (steps[row, column] > 0)
            behind = row, 2 * column + 1 - nearer
            found.append([depth[row, nearer], depth[behind], *(values[behind] for values in others)])
        front, behind, visible, images = (np.concatenate(values) for values in zip(*found, strict=True))
        return cls(front, behind, visible, images, length)
