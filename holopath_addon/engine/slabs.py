"""Slabs of depth that recording planes share a scene in.

They overlap: a surface that goes on from one into the next fades out of the one as it fades into the other.
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

RAMP = 0.15  # of the thinner of two slabs: how far their overlap reaches to either side of the boundary
DEPTH_BINS = 128  # that slabs are fitted to


@dataclass(frozen=True)
class Slab:
    """Depths z between two ramps, meters from the SLM; infinite where there is no other slab.

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
        """Whether surfaces at depths z have a share in the slab; not NaN."""
        return (np.asarray(z) > self.far[0]) & (np.asarray(z) < self.near[1])


EVERYWHERE = Slab()


def overlapping(parts: Sequence[tuple[float, float]]) -> list[Slab]:
    """Slabs around depth ranges, (low, high) each, from low to high: they meet in the middle between two."""
    ends = [parts[0][0], *(0.5 * (a[1] + b[0]) for a, b in pairwise(parts)), parts[-1][1]]
    ramps = [(-math.inf, -math.inf)]
    for before, end, after in zip(ends, ends[1:], ends[2:], strict=False):
        half = RAMP * min(end - before, after - end)
        ramps.append((end - half, end + half))
    ramps.append((math.inf, math.inf))
    return [Slab(far, near) for far, near in pairwise(ramps)]


def partitions(cost: np.ndarray, most: int) -> list[list[tuple[int, int]]]:
    """Cut a row of bins into 1, 2, ... up to `most` parts, so that each number of parts costs the least.

    Parameters
    ----------
    cost : numpy.ndarray, shape (bins, bins)
        Of one part from bin i to bin j.
    most : int

    Returns
    -------
    list of list of (int, int)
        First and last bin of each part.
    """
    best, cuts = cost[0], []
    found = [[(0, len(cost) - 1)]]
    for _ in range(min(most, len(cost)) - 1):
        options = best[:-1, None] + cost[1:]
        options[np.tril_indices_from(options)] = np.inf
        cuts.append(options.argmin(0))
        best = options.min(0)
        parts, end = [], len(cost) - 1
        for cut in cuts[::-1]:
            begin = int(cut[end]) + 1
            parts.append((begin, end))
            end = begin - 1
        found.append([(0, end), *parts[::-1]])
    return found


def depth_slabs(depths: np.ndarray, count: int) -> list[tuple[float, float]]:
    """Split depths into at most `count` slabs of the least sum of squared thicknesses.

    Parameters
    ----------
    depths : numpy.ndarray
    count : int

    Returns
    -------
    list of (float, float)
        Lowest and highest depth in each slab, from low to high.
    """
    first, last, _ = binned(depths)
    cost = (last[None, :] - first[:, None]) ** 2
    return [(float(first[i]), float(last[j])) for i, j in partitions(cost, count)[-1]]


def binned(depths: np.ndarray, bins: int = DEPTH_BINS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest and highest depth in each bin that holds any, and the bin of each depth."""
    low, high = float(depths.min()), float(depths.max())
    number = np.minimum((depths - low) / max(high - low, 1e-12) * bins, bins - 1).astype(
        np.min_scalar_type(bins)
    )
    counts = np.bincount(number, minlength=bins)
    used = counts > 0
    begin = np.append(0, np.cumsum(counts[used])[:-1])
    ordered = depths[np.argsort(number, kind="stable")]  # of small integers, which is fast
    first, last = (ends.reduceat(ordered, begin).astype(float) for ends in (np.minimum, np.maximum))
    return first, last, (np.cumsum(used) - 1)[number]
