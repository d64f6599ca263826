"""Slabs of depth, which divide a scene among recording planes.

They overlap: a surface that continues from one into the next fades out of the first as it fades into the second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

RAMP = 0.15  # half of the overlap of two slabs, fraction of the thinner one
DEPTH_BINS = 128  # resolution of depths for the boundaries of slabs


@dataclass(frozen=True)
class Slab:
    """Range of depths z between two ramps, meters from the SLM; infinite where there is no other slab.

    Attributes
    ----------
    far : (float, float)
        Ends of the ramp over which amplitudes rise from 0 to 1.
    near : (float, float)
        Ends of the ramp over which they fall to 0.
    """

    far: tuple[float, float] = (-math.inf, -math.inf)
    near: tuple[float, float] = (math.inf, math.inf)

    @property
    def bounded(self) -> bool:
        """Whether there is any other slab."""
        return math.isfinite(self.far[0]) or math.isfinite(self.near[0])

    def holds(self, z: ArrayLike) -> np.ndarray:
        """Whether surfaces at depths z contribute to the slab; false for NaN."""
        return (np.asarray(z) > self.far[0]) & (np.asarray(z) < self.near[1])


EVERYWHERE = Slab()


def overlapping(parts: Sequence[tuple[float, float]]) -> list[Slab]:
    """Slabs around depth ranges, which meet in the middle between two.

    Parameters
    ----------
    parts : sequence of (float, float)
        Ranges (low, high), from low to high, meters from the SLM.
    """
    ends = [parts[0][0], *(0.5 * (a[1] + b[0]) for a, b in pairwise(parts)), parts[-1][1]]
    ramps = [(-math.inf, -math.inf)]
    for before, end, after in zip(ends, ends[1:], ends[2:], strict=False):
        half = RAMP * min(end - before, after - end)
        ramps.append((end - half, end + half))
    ramps.append((math.inf, math.inf))
    return [Slab(far, near) for far, near in pairwise(ramps)]


def partitions(cost: np.ndarray, max_parts: int) -> list[list[tuple[int, int]]]:
    """Cut a row of bins into 1, 2, ... parts at the minimum total cost for each number of parts.

    Parameters
    ----------
    cost : numpy.ndarray, shape (bins, bins)
        Cost of one part from bin i to bin j.
    max_parts : int
        Largest number of parts.

    Returns
    -------
    list of list of (int, int)
        For each number of parts, the first and last bin of each part.
    """
    best, cuts = cost[0], []
    results = [[(0, len(cost) - 1)]]
    for _ in range(min(max_parts, len(cost)) - 1):
        options = best[:-1, None] + cost[1:]
        options[np.tril_indices_from(options)] = np.inf
        cuts.append(options.argmin(0))
        best = options.min(0)
        parts, end = [], len(cost) - 1
        for cut in cuts[::-1]:
            begin = int(cut[end]) + 1
            parts.append((begin, end))
            end = begin - 1
        results.append([(0, end), *parts[::-1]])
    return results


def depth_slabs(depths: np.ndarray, count: int) -> list[tuple[float, float]]:
    """Split depths into at most `count` slabs with the minimum sum of squared thicknesses.

    Parameters
    ----------
    depths : numpy.ndarray
        Depths of the visible surfaces, finite.
    count : int
        Maximum number of slabs.

    Returns
    -------
    list of (float, float)
        Lowest and highest depth in each slab, from low to high.
    """
    first, last, _ = binned(depths)
    cost = (last[None, :] - first[:, None]) ** 2
    return [(float(first[i]), float(last[j])) for i, j in partitions(cost, count)[-1]]


def binned(depths: np.ndarray, bins: int = DEPTH_BINS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sort depths into bins of equal width.

    Parameters
    ----------
    depths : numpy.ndarray
        Finite depths.
    bins : int
        Number of bins; empty ones are left out of the results.

    Returns
    -------
    first, last : numpy.ndarray
        Lowest and highest depth in each bin.
    number : numpy.ndarray of int
        Bin of each depth.
    """
    low, high = float(depths.min()), float(depths.max())
    number = np.minimum((depths - low) / max(high - low, 1e-12) * bins, bins - 1).astype(
        np.min_scalar_type(bins)
    )
    counts = np.bincount(number, minlength=bins)
    used = counts > 0
    begin = np.append(0, np.cumsum(counts[used])[:-1])
    ordered = depths[np.argsort(number, kind="stable")]  # fast for small integers
    first, last = (ends.reduceat(ordered, begin).astype(float) for ends in (np.minimum, np.maximum))
    return first, last, (np.cumsum(used) - 1)[number]
