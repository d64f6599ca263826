"""What the pilot's rays saw, and what follows from it by NumPy alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..tracing.regions import DEPTHS, Sightings

if TYPE_CHECKING:
    from collections.abc import Sequence

# of the view: less sky may be cracks between triangles, fewer mirrors are not worth their cost
LEAST_SHARE = 1e-4


@dataclass(frozen=True, kw_only=True)
class Probe:
    """What a few rays saw.

    Attributes
    ----------
    vergence : numpy.ndarray
        Inverse world depths of what was hit, 1/m; through mirrors and lenses of the image, which may be negative.
    shown : numpy.ndarray of bool
        Which of them are images.
    sky : bool
        Whether rays that hit nothing meet an environment.
    specular : float
        Share of rays that meet surfaces with a δ lobe.
    nearly : float
        Share of rays that meet rough surfaces with a narrow lobe.
    diffuse : float
        Share of rays that meet surfaces, no mirrors, that scatter diffusely.
    turn, sharpest : float
        Turn of the view across the pupil in widths of the sharp glossy lobes in view, and of the sharpest; 0 without
        gloss.
    gloss : numpy.ndarray
        Inverse depths of the glossy surfaces in view, 1/m.
    places : Places
        What each ray saw.
    coherent : bool
        Whether rays are faster in packets, as they are where triangles are large.
    rays_per_second : float
        Of their program, on this machine.
    chains_per_second : float
        The same of rays that are followed over mirrors and through clear surfaces.
    compiling : float
        Seconds that the programs of rays and chains took to compile.
    bent : bool
        Whether images lie elsewhere than at the optical path length, as in curved mirrors and through glass.
    images : numpy.ndarray
        Inverse depths of such images, 1/m.
    splits : int
        Hits at which chains divide.
    cut : float
        Share of the light from white surroundings that chains would show beyond the hits that are followed.
    """

    vergence: np.ndarray
    sky: bool
    specular: float
    nearly: float
    diffuse: float
    turn: float
    sharpest: float
    gloss: np.ndarray
    places: Places
    coherent: bool
    rays_per_second: float
    chains_per_second: float
    compiling: float
    shown: np.ndarray
    bent: bool = False
    images: np.ndarray = field(default_factory=lambda: np.empty(0))
    splits: int = 0
    cut: float = 0.0

    @property
    def binned(self) -> float:
        """Share of the occupied cells of the radiance map that have all pupil bins."""
        return min(1.0, max(0.01, len(self.gloss) / max(len(self.vergence), 1) + self.specular))

    def vergence_range(self, limits: Sequence[float]) -> tuple[float, float]:
        """Smallest and largest inverse depth in view, 1/m.

        Caustics spread a few images over all depths, behind the viewer too: of images a hundredth of the view at
        either end, and what is beyond the limits, is left to the nearest depth inside.
        """
        if not len(self.vergence):
            return 0.0, 0.0
        images, ends = self.vergence[self.shown], self.vergence[~self.shown]
        if len(images):
            some = min(0.5, 0.01 * len(self.vergence) / len(images))
            ends = np.append(ends, np.clip(np.quantile(images, (some, 1 - some)), *limits))
        low = min(ends.min(), 0.0) if self.sky else ends.min()
        return float(low), float(ends.max())


@dataclass(frozen=True, kw_only=True)
class Places:
    """What rays saw, from anywhere.

    Attributes
    ----------
    column, row : numpy.ndarray
        Where rays cross the far end of the volume, pixels.
    slope_x, slope_y : numpy.ndarray
        To the right and up.
    z : numpy.ndarray
        Depth of what is seen, metres from the SLM; NaN where there is nothing.
    first : numpy.ndarray
        Depth of the first surface.
    chains : numpy.ndarray of bool
        Whether it is seen through mirrors or clear surfaces.
    z_far, pitch : float
        Metres.
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
        """Column and row, from the first pixel's edge, where rays cross planes at distances from the SLM in metres."""
        walk = (plane - self.z_far) / self.pitch
        return self.column + self.slope_x * walk + 0.5, self.row - self.slope_y * walk + 0.5

    def sightings(
        self, plane: float, limit: float, size: tuple[int, int], cell: int, where: np.ndarray, images: bool
    ) -> Sightings:
        """The `Sightings` from the tiles, `cell` pixels wide, of a plane of such a width and height, at a distance from
        the SLM, at the places `where`, with `images` in mirrors or without.
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
    """Edges of near things, as seen along the axis.

    Attributes
    ----------
    front, behind : numpy.ndarray
        Depths of what is in front and of the surface behind, metres from the SLM.
    seen : numpy.ndarray
        Depth of what is seen there: of the surface behind, or of the image that it shows.
    images : numpy.ndarray of bool
        Whether it shows one.
    length : float
        Of each piece, pixels.
    """

    front: np.ndarray
    behind: np.ndarray
    seen: np.ndarray
    images: np.ndarray
    length: float

    @classmethod
    def between(
        cls, first: np.ndarray, seen: np.ndarray, images: np.ndarray, least: float, length: float
    ) -> Edges:
        """Edges where depths of neighbours differ by more than `least`, and more than the surfaces beside them go on.

        Parameters
        ----------
        first, seen : numpy.ndarray, shape (rows, columns)
            Depths of first surfaces and of what they show, metres from the SLM.
        images : numpy.ndarray of bool, shape (rows, columns)
        least : float
            Metres.
        length : float
            Pixels from one place to the next.
        """
        found = []
        for depth, *what in ((first, seen, images), (first.T, seen.T, images.T)):
            steps = np.diff(depth, axis=1)
            goes_on = 2 * np.maximum(abs(np.roll(steps, 1, 1)), abs(np.roll(steps, -1, 1)))
            row, column = np.nonzero(abs(steps) > least + goes_on)
            nearer = column + (steps[row, column] > 0)
            behind = row, 2 * column + 1 - nearer
            found.append([depth[row, nearer], depth[behind], *(values[behind] for values in what)])
        front, behind, seen, images = (np.concatenate(values) for values in zip(*found, strict=True))
        return cls(front, behind, seen, images, length)
