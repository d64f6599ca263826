"""Which meshes of a scene become one, for speed.

Each time that rays are launched, Dr.Jit goes through all shapes that there are, also those that no scene shows:
0.2 ms for each on a slow core, however few the rays are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

# Meshes that might be joined, up to which each stays one: together they cost 10 ms a launch.
MANY_MESHES = 64
# Triangles of a joined mesh: baked light has charts on meshes of no more (`light.unwrapping`).
MAX_TRIANGLES = 20_000
# Extent of a mesh that is joined, relative to the scene's: where texels cannot show a part of a mesh, such as a plain
# that reaches the horizon, all of the mesh's light is traced.
MAX_EXTENT = 0.25

# Instances, from which on a plan says what they cost.
MANY_INSTANCES = 100


def instances_cost(count: int) -> float:
    """Seconds that a launch of rays takes for instances, on a slow core: fitted to 100 to 1000 of four meshes."""
    return 1.8e-3 * count + 2.5e-5 * count**2


def groups(
    kinds: Sequence[Hashable | None], triangles: Sequence[int], bounds: np.ndarray
) -> list[tuple[int, ...]]:
    """Find the meshes that are joined.

    It follows from their order, their triangles and their size: where things move in an animation, a joined mesh keeps
    its triangles, and baked light its charts.

    Parameters
    ----------
    kinds : sequence of hashable or None
        Meshes of one kind may be joined; None for a mesh that stays one.
    triangles : sequence of int
        How many each has.
    bounds : numpy.ndarray, shape (mesh, 2, 3)
        Lower and upper corner of the box around each.

    Returns
    -------
    list of tuple of int
        Numbers of the meshes that become one, at least two, ascending.
    """
    if sum(kind is not None for kind in kinds) <= MANY_MESHES:
        return []
    lower, upper = bounds[:, 0], bounds[:, 1]
    largest = MAX_EXTENT * np.linalg.norm(upper.max(0) - lower.min(0))
    small = np.linalg.norm(upper - lower, axis=1) <= largest
    found, latest, filled = [], {}, {}
    for number, (kind, count) in enumerate(zip(kinds, triangles, strict=True)):
        if kind is None or count > MAX_TRIANGLES or not small[number]:
            continue
        if kind not in latest or filled[kind] + count > MAX_TRIANGLES:
            latest[kind], filled[kind] = [], 0
            found.append(latest[kind])
        latest[kind].append(number)
        filled[kind] += count
    return [tuple(group) for group in found if len(group) > 1]


def joined_name(names: Sequence[str]) -> str:
    """Name of a mesh that was joined of meshes with these names, empty where they have none."""
    return f"{names[0]} and {len(names) - 1} more" if names[0] else ""
