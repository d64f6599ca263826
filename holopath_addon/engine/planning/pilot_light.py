"""What radiance paths through a few grains tell of the light: statistics, by NumPy alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

LEAST_LIGHT = 0.005  # of the light: bounces that add less are left out
OUTLIERS = 0.01  # of the grains: a few at the edges of lamps' images would else decide
BRIGHT = 95  # percentile
DEPTHS_TRIED = (1, 2, 3, 4, 6)  # vertices of a path


@dataclass(frozen=True)
class Light:
    """What a few radiance paths found.

    Attributes
    ----------
    max_depth, lost : int, float
        Vertices of a path that are enough, and the share of the light that is lost with longer ones.
    shining : float
        Share of the paths that begin at what shines itself.
    noise, direct, texture : float
        Variance of one path relative to its grain's squared mean, weighted by brightness; of paths that end at the
        first surface that lamps light; and of the reflectance where a path begins.
    chroma : float
        Largest difference of the colour channels relative to their mean, weighted by brightness.
    bright : float
        Radiance of the bright parts of the view, the 95th percentile of what is lit.
    paths_per_second : float
        Of their program, on this machine.
    compiling : float
        Seconds that it took to compile.
    short_per_second : float
        Speed of paths that end at the first surface that lamps light, see `Pilot.with_short_paths`; infinite before.
    """

    max_depth: int
    shining: float
    lost: float = 0.0
    noise: float = 0.0
    direct: float = 0.0
    texture: float = 0.0
    chroma: float = 0.0
    bright: float = 0.0
    paths_per_second: float = math.inf
    compiling: float = 0.0
    short_per_second: float = math.inf


@dataclass(frozen=True)
class Paths:
    """Radiance paths of some grains.

    Attributes
    ----------
    light, direct : numpy.ndarray, shape (3, grains, paths)
        All that they find, and what they find up to the first surface that lamps light.
    by_vertices : list of numpy.ndarray, shape (grains, paths)
        Light of all channels, of paths with `DEPTHS_TRIED` vertices at most.
    reflectance : numpy.ndarray, shape (3, grains, paths)
        Where they begin.
    same : numpy.ndarray of bool, shape (grains, paths)
        Whether they see the cell that the grain's first path sees: others do not count.
    shining : float
        Share that begins at what shines itself.
    """

    light: np.ndarray
    direct: np.ndarray
    by_vertices: list[np.ndarray]
    reflectance: np.ndarray
    same: np.ndarray
    shining: float

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Of each grain."""
        return (values * self.same).sum(-1) / self.same.sum(1)

    def variance(self, values: np.ndarray) -> np.ndarray:
        """Of each grain, of one path."""
        apart = ((values - self.mean(values)[..., None]) ** 2 * self.same).sum(-1)
        return apart / np.maximum(self.same.sum(1) - 1, 1)


def light_of(paths: Paths, least: int, most: int, firefly: float) -> Light:
    """The `Light` that paths found, speeds apart.

    Parameters
    ----------
    paths : Paths
    least, most : int
        Vertices that a path has at least, and that these had.
    firefly : float
        Most that a path counts, in radiances of the bright parts of the view.

    Returns
    -------
    Light
    """
    whole, dark = paths.mean(paths.light.sum(0)), Light(least, paths.shining)
    if not (whole > 0).any():
        return dark
    # as the rendering's paths are limited
    limit = firefly * np.percentile(whole[whole > 0], BRIGHT) / 3
    limited = np.minimum(paths.light, limit)
    means, mean = paths.mean(limited), paths.mean(limited.sum(0))
    lit = (mean > 0) & (paths.same.sum(1) > 1)
    if not lit.any():
        return dark
    grains = _Lit(lit, mean, means)
    depth, lost = _vertices(paths, grains, whole, least, most)
    return Light(
        depth,
        paths.shining,
        lost,
        noise=grains.noise(paths.variance(limited), means),
        direct=grains.noise(paths.variance(np.minimum(paths.direct, limit)), means),
        texture=grains.noise(paths.variance(paths.reflectance), paths.mean(paths.reflectance)),
        chroma=grains.share(3 * np.ptp(means, axis=0)),
        bright=float(grains.bright) / 3,
    )


class _Lit:
    """Grains that are lit, weighted by brightness, in which lamps in view must not hide the rest."""

    def __init__(self, lit, mean, means):
        self._lit, self._mean = lit, mean[lit]
        self.bright = np.percentile(self._mean, BRIGHT)
        self._weight = np.minimum(self._mean, self.bright)
        self._weight /= self._weight.sum()
        self._weights = np.minimum(means[:, lit], self.bright / 3)

    def share(self, values):
        """Of the light of all channels that some has."""
        return float((self._weight * values[self._lit] / self._mean).sum())

    def noise(self, variance, means):
        """Relative variance, of each channel by itself."""
        relative = variance[:, self._lit] / np.maximum(means[:, self._lit], 1e-30) ** 2
        relative = np.minimum(relative, np.quantile(relative, 1 - OUTLIERS))
        return float((self._weights * relative).sum() / max(self._weights.sum(), 1e-30))


def _vertices(paths, grains, whole, least, most):
    """Vertices of a path that are enough, and the share of the light that is lost."""
    left = grains.share(whole)
    for fewer, light in zip(DEPTHS_TRIED, paths.by_vertices, strict=False):
        left -= grains.share(paths.mean(light))
        if least <= fewer < most and left < LEAST_LIGHT:
            return fewer, max(left, 0.0)
    return most, 0.0
