"""Groups of texels that share their samples."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from typing import TYPE_CHECKING

import numpy as np

from .atlas import NONE

if TYPE_CHECKING:
    from .atlas import Atlas


@dataclass(frozen=True)
class Groups:
    """Groups of texels that share their samples: those in a square that belong to one triangle, or to tiny ones.

    Attributes
    ----------
    pool : numpy.ndarray of uint32
        Texels, group by group.
    starts, counts : numpy.ndarray of uint32
        Start of each group in the pool, and its number of texels.
    sides : numpy.ndarray of uint32 or int
        Side of each group's square, texels.
    """

    pool: np.ndarray
    starts: np.ndarray
    counts: np.ndarray
    sides: np.ndarray | int = 1

    @classmethod
    def of(cls, atlas: Atlas, texels: np.ndarray, side: np.ndarray | int) -> Groups:
        """Group texels in squares of `side` texels, a number or one for each texel."""
        line, column = texels // atlas.width, texels % atlas.width
        square = (line // side * side).astype(np.int64) * atlas.width + column // side * side
        row = atlas.rows[texels].astype(np.int64)
        row[atlas.points[row]] = 0
        key = square * (atlas.triangles.count + 1) + row
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.diff(key[order], prepend=-1))
        counts = np.diff(starts, append=len(order))
        sides = np.broadcast_to(side, texels.shape)[order][starts]
        return cls(*(values.astype(np.uint32) for values in (texels[order], starts, counts, sides)))

    @classmethod
    def all_of(cls, atlas: Atlas, side: int) -> Groups:
        """Group all texels of an atlas in squares of a side; faster than `of`, as most squares need no sorting."""
        width, height = atlas.layout.size
        numbers = np.arange(atlas.size, dtype=np.uint32).reshape(height, width)
        rows = atlas.rows.reshape(height, width)
        margin = (0, -height % side), (0, -width % side)
        numbers, rows = (np.pad(v, margin, constant_values=NONE) for v in (numbers, rows))
        shape = rows.shape[0] // side, side, rows.shape[1] // side, side
        numbers, rows = (v.reshape(shape).swapaxes(1, 2).reshape(-1, side * side) for v in (numbers, rows))
        first = rows.min(1)
        whole = first == rows.max(1)
        mixed = numbers[~whole][rows[~whole] != NONE]
        rest = cls.of(atlas, mixed.astype(np.int64), side)
        pool = numbers[whole & (first != NONE)]
        starts = side * side * np.arange(len(pool) + 1)
        return cls(
            np.concatenate([pool.ravel(), rest.pool]),
            np.concatenate([starts[:-1], starts[-1] + rest.starts]).astype(np.uint32),
            np.concatenate([np.full(len(pool), side * side), rest.counts]).astype(np.uint32),
        )

    def __len__(self) -> int:
        return len(self.starts)

    def digest(self) -> str:
        """Digest of the texels in each group."""
        return blake2b(self.pool.tobytes() + self.counts.tobytes(), digest_size=16).hexdigest()

    @property
    def leaders(self) -> np.ndarray:
        """First texel of each group."""
        return self.pool[self.starts]

    @property
    def numbers(self) -> np.ndarray:
        """Number of the group of each texel in the pool."""
        return np.repeat(np.arange(len(self), dtype=np.uint32), self.counts)
