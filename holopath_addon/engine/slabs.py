"""Slabs of depth: which recording plane records which depths.

`Slab`s of neighboring planes overlap. In the overlap their weights add up to 1, so that a surface that continues across
it fades from one into the other.
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

RAMP_FRACTION = 0.15  # half-width of the overlap of two slabs, fraction of the thinner one's thickness
DEPTH_BINS = 128  # default number of bins of `bin_depths`


@dataclass(frozen=True)
class Slab:
    """Interval of depths z with soft ends, meters from the SLM. An end without a neighbor is infinite.

    Attributes
    ----------
    far : (float, float)
        Start and end of the ramp, at the smaller z, over which the weight rises from 0 to 1 by a smoothstep.
    near : (float, float)
        Start and end of the ramp, at the larger z, over which it falls from 1 to 0.
    """

    far: tuple[float, float] = (-math.inf, -math.inf)
    near: tuple[float, float] = (math.inf, math.inf)

    @property
    def bounded(self) -> bool:
        """Whether an end is finite; false for `EVERYWHERE`."""
        return math.isfinite(self.far[0]) or math.isfinite(self.near[0])

    def holds(self, z: ArrayLike) -> np.ndarray:
        """Whether depths z are in the slab, ramps included; false for NaN."""
        return (np.asarray(z) > self.far[0]) & (np.asarray(z) < self.near[1])


EVERYWHERE = Slab()


def overlapping_slabs(ranges: Sequence[tuple[float, float]]) -> list[Slab]:
    """Build a slab for each depth range.

    Neighbors meet halfway between their ranges, and overlap there by `RAMP_FRACTION` of the thinner one to either side.
    The first and last slab have no outer end.

    Parameters
    ----------
    ranges : sequence of (float, float)
        Low and high end of each range, meters from the SLM. Not empty, ascending.

    Returns
    -------
    list of Slab
        In the same order.
    """
    ends = [ranges[0][0], *(0.5 * (a[1] + b[0]) for a, b in pairwise(ranges)), ranges[-1][1]]
    ramps = [(-math.inf, -math.inf)]
    for before, end, after in zip(ends, ends[1:], ends[2:], strict=False):
        half = RAMP_FRACTION * min(end - before, after - end)
        ramps.append((end - half, end + half))
    ramps.append((math.inf, math.inf))
    return [Slab(far, near) for far, near in pairwise(ramps)]


def partitions(cost: np.ndarray, max_parts: int) -> list[list[tuple[int, int]]]:
    """Cut a row of bins into 1, 2, ... parts at the minimum total cost for each number of parts.

    Parameters
    ----------
    cost : numpy.ndarray, shape (bins, bins)
        Cost of one part of bins i to j, both included; entries below the diagonal are ignored.
    max_parts : int
        Maximum number of parts; there are no more than bins.

    Returns
    -------
    list of list of (int, int)
        Item k - 1 has k parts, each as its first and last bin.
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


def split_depths(depths: np.ndarray, count: int) -> list[tuple[float, float]]:
    """Split depths into at most `count` ranges with the minimum sum of squared thicknesses.

    Parameters
    ----------
    depths : numpy.ndarray, shape (n,)
        Finite depths, at least one, in any unit.
    count : int
        Maximum number of ranges.

    Returns
    -------
    list of (float, float)
        Lowest and highest depth in each range, ascending; fewer than `count` where depths fill fewer bins.
    """
    first, last, _ = bin_depths(depths)
    cost = (last[None, :] - first[:, None]) ** 2
    return [(float(first[i]), float(last[j])) for i, j in partitions(cost, count)[-1]]


def bin_depths(depths: np.ndarray, bins: int = DEPTH_BINS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group depths into bins of equal width, and drop the empty ones.

    Parameters
    ----------
    depths : numpy.ndarray, shape (n,)
        Finite depths, at least one.
    bins : int
        Number of bins, empty ones included.

    Returns
    -------
    first, last : numpy.ndarray of float64, shape (used,)
        Lowest and highest depth in each bin that is not empty.
    index : numpy.ndarray of int, shape (n,)
        Index of each depth's bin among those.
    """
    low, high = float(depths.min()), float(depths.max())
    index = np.minimum((depths - low) / max(high - low, 1e-12) * bins, bins - 1).astype(
        np.min_scalar_type(bins)
    )
    counts = np.bincount(index, minlength=bins)
    used = counts > 0
    begin = np.append(0, np.cumsum(counts[used])[:-1])
    ordered = depths[np.argsort(index, kind="stable")]  # a radix sort, as these integers are small
    first, last = (extreme.reduceat(ordered, begin).astype(float) for extreme in (np.minimum, np.maximum))
    return first, last, (np.cumsum(used) - 1)[index]
