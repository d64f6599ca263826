"""Statistics of the light that radiance paths find through a few grains, by NumPy alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# Bounces are left out that add less than this fraction of the light, and without which the field has less than this
# relative error: what is dark may be lit by them alone.
MIN_LIGHT_FRACTION, MAX_LOST_ERROR = 0.005, 0.02
MAX_CHROMA = 3.0  # of light of one channel alone
OUTLIER_FRACTION = 0.01  # of the grains: else a few at the edges of emitters' images would decide
BRIGHT_PERCENTILE = 95
VERTEX_COUNTS = (1, 2, 3, 4, 6)  # maximum vertices of a path, in the order tried


@dataclass(frozen=True)
class Light:
    """Statistics of a few radiance paths.

    Attributes
    ----------
    max_depth : int
        Vertices of a path that suffice.
    shining : float
        Fraction of the paths that begin on an emitter.
    lost : float
        Fraction of the light that longer paths would add.
    lost_error : float
        Relative error of the field without that light.
    noise, direct, texture : float
        Variance relative to the squared mean of the grain, weighted by brightness: of one path, of one that ends at the
        first surface that lamps light, and of the reflectance where a path begins.
    chroma : float
        Maximum difference of the color channels relative to their mean, of any grain: a mean over the view would hide
        small colored things.
    bright : float
        Radiance of the bright parts of the view, the 95th percentile of what is lit.
    paths_per_second : float
        Speed of the program on this machine.
    compiling : float
        Seconds that it took to compile.
    short_per_second : float
        Speed of paths that end at the first surface that lamps light, see `Pilot.with_short_paths`; infinite before.
    """

    max_depth: int
    shining: float
    lost: float = 0.0
    lost_error: float = 0.0
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
        All radiance of each path, and that up to the first surface that lamps light.
    by_vertices : list of numpy.ndarray, shape (grains, paths)
        Light of all channels that each of `VERTEX_COUNTS` adds.
    reflectance : numpy.ndarray, shape (3, grains, paths)
        Reflectance where paths begin.
    same : numpy.ndarray of bool, shape (grains, paths)
        Whether they meet the cell that the grain's first path meets; others do not count.
    shining : float
        Fraction that begins on an emitter.
    """

    light: np.ndarray
    direct: np.ndarray
    by_vertices: list[np.ndarray]
    reflectance: np.ndarray
    same: np.ndarray
    shining: float

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean over the paths of each grain."""
        return (values * self.same).sum(-1) / self.same.sum(1)

    def variance(self, values: np.ndarray) -> np.ndarray:
        """Variance of one path of each grain."""
        squares = ((values - self.mean(values)[..., None]) ** 2 * self.same).sum(-1)
        return squares / np.maximum(self.same.sum(1) - 1, 1)


def light_of(paths: Paths, min_vertices: int, max_vertices: int, firefly_limit: float) -> Light:
    """Statistics of paths as `Light`, without speeds.

    Parameters
    ----------
    paths : Paths
    min_vertices, max_vertices : int
        Vertices that a path has at least, and that these had at most.
    firefly_limit : float
        Maximum that a path counts, in radiances of the bright parts of the view.

    Returns
    -------
    Light
    """
    # the pilot may miss what is small: where it finds no light nothing is left out
    colors = paths.mean(paths.light)
    whole, dark = colors.sum(0), Light(max_vertices, paths.shining, chroma=MAX_CHROMA)
    if not (whole > 0).any():
        return dark
    # as paths of the render are limited
    limit = firefly_limit * np.percentile(whole[whole > 0], BRIGHT_PERCENTILE) / 3
    limited = np.minimum(paths.light, limit)
    means, mean = paths.mean(limited), paths.mean(limited.sum(0))
    lit = (mean > 0) & (paths.same.sum(1) > 1)
    if not lit.any():
        return dark
    grains = _LitGrains(lit, mean, means)
    depth, lost, lost_error = _vertices(paths, grains, whole, min_vertices, max_vertices)
    return Light(
        depth,
        paths.shining,
        lost,
        lost_error,
        noise=grains.noise(paths.variance(limited), means),
        direct=grains.noise(paths.variance(np.minimum(paths.direct, limit)), means),
        texture=grains.noise(paths.variance(paths.reflectance), paths.mean(paths.reflectance)),
        chroma=float((3 * np.ptp(colors, axis=0)[lit] / whole[lit]).max()),
        bright=float(grains.bright) / 3,
    )


class _LitGrains:
    """Lit grains, weighted by brightness up to a limit, so that lamps in view do not hide the rest."""

    def __init__(self, lit, mean, means):
        self._lit, self._mean = lit, mean[lit]
        self.bright = np.percentile(self._mean, BRIGHT_PERCENTILE)
        self._weight = np.minimum(self._mean, self.bright)
        self._weight /= self._weight.sum()
        self._weights = np.minimum(means[:, lit], self.bright / 3)

    def fraction(self, values):
        """Fraction of the light of all channels, weighted mean."""
        return float((self._weight * values[self._lit] / self._mean).sum())

    def amplitude_error(self, lost, whole):
        """Relative error of the field where a part of each grain's light is lost.

        With weights w by brightness and the lost fraction l of each grain, e^2 = sum w (1 - sqrt(1 - l))^2.
        """
        fraction = np.clip(lost[self._lit] / np.maximum(whole[self._lit], 1e-30), 0, 1)
        return float(np.sqrt((self._weight * (1 - np.sqrt(1 - fraction)) ** 2).sum()))

    def noise(self, variance, means):
        """Relative variance, of each channel by itself."""
        relative = variance[:, self._lit] / np.maximum(means[:, self._lit], 1e-30) ** 2
        relative = np.minimum(relative, np.quantile(relative, 1 - OUTLIER_FRACTION))
        return float((self._weights * relative).sum() / max(self._weights.sum(), 1e-30))


def _vertices(paths, grains, whole, min_vertices, max_vertices):
    """Vertices of a path that suffice, the fraction of the light that is lost with them, and the field's error."""
    left = whole
    for count, light in zip(VERTEX_COUNTS, paths.by_vertices, strict=False):
        left = left - paths.mean(light)
        lost, error = grains.fraction(left), grains.amplitude_error(left, whole)
        if min_vertices <= count < max_vertices and lost < MIN_LIGHT_FRACTION and error < MAX_LOST_ERROR:
            return count, max(lost, 0.0), error
    return max_vertices, 0.0, 0.0
