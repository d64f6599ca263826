"""Selection of the meshes of a scene that are joined for speed.

At each launch of rays Dr.Jit iterates over all shapes in memory, even those of other scenes: 0.2 ms for each on a slow
core, however few the rays are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

# Number of suitable meshes up to which none are joined: they cost 10 ms a launch.
MANY_MESHES = 64
# Maximum triangles of a joined mesh: larger ones have no charts for baked light (`light.unwrapping`).
MAX_TRIANGLES = 20_000
# Maximum extent of meshes that are joined, relative to the scene's: if a part of a mesh is too large for texels, such
# as a plain up to the horizon, all of the mesh's light is traced.
MAX_EXTENT = 0.25

# Number of instances from which a plan reports their cost.
MANY_INSTANCES = 100


def instances_cost(count: int) -> float:
    """Time of a launch for `count` instances in seconds, on a slow core: fitted to 100 to 1000 of four meshes."""
    return 1.8e-3 * count + 2.5e-5 * count**2


def groups(
    kinds: Sequence[Hashable | None], triangles: Sequence[int], bounds: np.ndarray
) -> list[tuple[int, ...]]:
    """Find the meshes that are joined.

    The result depends on their order, triangles and sizes only: while things move in an animation, a joined mesh keeps
    its triangles, and baked light its charts.

    Parameters
    ----------
    kinds : sequence of hashable or None
        Kind of each mesh: meshes of one kind may be joined; None for one that may not.
    triangles : sequence of int
        Triangles of each mesh.
    bounds : numpy.ndarray, shape (mesh, 2, 3)
        Lower and upper corner of each mesh's bounding box.

    Returns
    -------
    list of tuple of int
        Numbers of meshes that are joined, two or more in each group, in ascending order.
    """
    if sum(kind is not None for kind in kinds) <= MANY_MESHES:
        return []
    lower, upper = bounds[:, 0], bounds[:, 1]
    largest = MAX_EXTENT * np.linalg.norm(upper.max(0) - lower.min(0))
    small = np.linalg.norm(upper - lower, axis=1) <= largest
    result, latest, filled = [], {}, {}
    for number, (kind, count) in enumerate(zip(kinds, triangles, strict=True)):
        if kind is None or count > MAX_TRIANGLES or not small[number]:
            continue
        if kind not in latest or filled[kind] + count > MAX_TRIANGLES:
            latest[kind], filled[kind] = [], 0
            result.append(latest[kind])
        latest[kind].append(number)
        filled[kind] += count
    return [tuple(group) for group in result if len(group) > 1]


def joined_name(names: Sequence[str]) -> str:
    """Name of a mesh joined from meshes with these names; empty if they have none."""
    return f"{names[0]} and {len(names) - 1} more" if names[0] else ""
