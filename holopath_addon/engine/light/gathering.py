"""Filling the radiance cache: light from surface to surface, then what is in view, by final gathering."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy import ndimage

from ..progress import paced
from ..scene.buffers import loaded
from ..scene.variants import threads, units_at_once
from .atlas import BLOCK
from .path_tracer import PathTracer
from .radiance_cache import NUMBERS, SUMS, zeros

if TYPE_CHECKING:
    from ..progress import PartProgress
    from .camera_view import BakeRequest
    from .groups import Groups
    from .radiance_cache import RadianceCache

SOURCE_SAMPLES = 4  # of each group, for each bounce
REST = 0.03  # of the texels may stay noisier than wished
ROUND = 16  # samples of a texel between two looks at the noise
SETTLED = 1e-3  # of all light: bounces that add less are left out
SMOOTH_OVER = 0.15  # of the harmonic mean distance to other surfaces: light from them varies little over that
BLOCK_LANES = 1 << 14  # that one thread takes at once: with their samples half a second
STRIDES = (1, 2, 4, 8, 16)  # groups of texels


class Gathered(NamedTuple):
    """What final gathering did.

    Attributes
    ----------
    samples : int
        Taken in all.
    noise, error : float or None
        Standard error reached by all but a share REST of the groups, and its root mean square over the light.
    """

    samples: int
    noise: float | None
    error: float | None


def solve(request: BakeRequest, cache: RadianceCache, progress: PartProgress) -> None:
    """Light on groups of texels, one bounce more at a time: the source that final gathering looks up.

    Parameters
    ----------
    request : BakeRequest
    cache : RadianceCache
    progress : callable
        ``progress(done)``, may raise.
    """
    groups, max_depth = cache.coarse, request.settings.max_depth
    sampling = _Sampling(request, cache, groups)
    # one for the view alone, whose rays now and then meet what no probe met
    bounces, before = max(max_depth - 2, 1) if len(groups) and max_depth > 1 else 0, 0.0
    for bounce in range(bounces):
        sums = sampling.sums(
            np.arange(len(groups)),
            SOURCE_SAMPLES,
            np.zeros(len(groups)),
            request.settings.seed + bounce,
            lambda done, bounce=bounce: progress((bounce + done) / bounces),
        )
        named = by_name(sums)
        source = np.column_stack([named["direct"] + named["indirect"], named["count"]])
        cache.source = loaded(mi.Float, source.ravel())
        total = source[:, :3].sum(dtype=float)
        if abs(total - before) <= SETTLED * total:
            break
        before = total
    progress(1.0)


class _Sampling:
    """Takes samples of groups of texels, of paths with an optional `limit`, see `PathTracer`."""

    def __init__(self, request, cache, groups, limit=math.inf):
        self._scene, self._cache, self._groups = request.scene, cache, groups
        self._tracer = PathTracer(request.settings.max_depth, limit, cache)
        self._pool = loaded(mi.UInt32, groups.pool)

    def sums(self, which, samples, done, seed, progress):
        """Sums over samples of some of the groups, [group, NUMBERS]; see `RadianceCache.sample`.

        `done`, a number each, tells how many they have had before.
        """
        sums, groups = np.empty((len(which), NUMBERS), np.float32), self._groups
        size = self._cache.lanes
        unit = dr.opaque(mi.UInt32, size)
        few = min(size, BLOCK_LANES * threads())
        for units in paced(range(math.ceil(len(which) / few)), size // few * units_at_once()):
            part = slice(units.start * few, min(units.stop * few, len(which)))
            lanes = (groups.starts[which[part]], groups.counts[which[part]], done[part])
            starts, counts, before = (loaded(mi.UInt32, values) for values in lanes)
            lane = dr.arange(mi.UInt32, part.stop - part.start) + dr.opaque(mi.UInt32, part.start)
            own = dr.opaque(mi.UInt32, seed * 9973 & 0xFFFFFFFF) + lane // unit * unit
            what = self._scene, self._tracer, self._pool, starts, counts, samples, before, own, lane % unit
            found = self._cache.sample(*what)
            dr.eval(found)
            for k, values in enumerate(found):
                sums[part, k] = np.array(values)
            progress(part.stop / len(which))
        return sums


def by_name(sums: np.ndarray) -> np.ndarray:
    """Sums of groups, [group, NUMBERS], as SUMS names them."""
    return sums.view(SUMS)[:, 0]


def gather(
    request: BakeRequest, cache: RadianceCache, groups: Groups, limit: float, progress: PartProgress
) -> Gathered:
    """Bake texels until their noise is low: final gathering, which looks up the source.

    Parameters
    ----------
    request : BakeRequest
        Its noise, relative to a group's mean, is aimed at, with no more samples of a group than it allows.
    cache : RadianceCache
    groups : Groups
        Of texels that are not baked yet.
    limit : float
        See `PathTracer`.
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    Gathered
    """
    if not len(groups):
        return Gathered(0, 0.0, 0.0)
    before = dr.width(cache.fine) // 4
    cache.add(groups, np.zeros((len(groups), 4)))
    fine = cache.fine
    cache.fine = zeros(dr.width(fine))  # rays look up the source alone, whatever is baked already
    sampling, most = _Sampling(request, cache, groups, limit), request.most
    sums = np.zeros((len(groups), NUMBERS), np.float32)
    filter = _Filter(cache, groups, before)
    left, taken, done = np.arange(len(groups)), 0, 0
    while True:
        # few groups take several rounds at once
        rounds = int(np.clip(cache.lanes // len(left), 1, max(1, (most - done) // ROUND)))
        found = sampling.sums(
            np.tile(left, rounds),
            ROUND,
            np.repeat(done + ROUND * np.arange(rounds), len(left)),
            request.settings.seed + 100 + done,
            lambda part, done=done, rounds=rounds: progress((done + ROUND * rounds * part) / most),
        )
        sums[left] += found.reshape(rounds, len(left), -1).sum(0)
        taken, done = taken + ROUND * rounds * len(left), done + ROUND * rounds
        values, variance = filter.smoothed(by_name(sums))
        reached = _noise(cache.atlas, groups.leaders, values, variance)
        left = left[reached[left] > request.noise]
        if len(left) <= REST * len(groups) or done >= most:
            break
    known = (by_name(sums)["count"] > 0).astype(np.float32)
    new = loaded(mi.Float, np.column_stack([values, known]).ravel())
    dr.scatter(fine, new, dr.arange(mi.UInt32, 4 * len(groups)) + 4 * before)
    cache.fine = fine
    light = values.mean(1)
    bright = np.minimum(light, np.percentile(light, 95))  # lamps' surroundings must not hide the rest
    error = math.sqrt((bright * reached**2).sum() / max(bright.sum(), 1e-30))
    return Gathered(taken, float(np.quantile(reached, 1 - REST)), error)


class _Filter:
    """Averages light that came by way of other surfaces over the distance in which it hardly varies.

    That is where distance / R + sqrt(1 - n.n') stays small, with R the harmonic mean distance to them and n, n' the
    normals (Ward, Rubinstein and Clear 1988, "A ray tracing solution for diffuse interreflection", equation 5). An
    à-trous filter (Dammertz et al. 2010) with such neighbours; shadows of lamps stay as they are.

    Parameters
    ----------
    cache : RadianceCache
    groups : Groups
        Neighbours are as many of them apart as texels elsewhere.
    first : int
        The groups' first slot.
    """

    def __init__(self, cache, groups, first):
        self._atlas, self._slots, self._first = cache.atlas, cache.slots, first
        self._texels = loaded(mi.UInt32, groups.leaders)
        self._sides = mi.Int(np.broadcast_to(groups.sides, len(groups)))
        surface, front = self._atlas.place(self._texels, mi.Point2f(0.5))
        si = surface.compute_surface_interaction(mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1)))
        normal = dr.select(front, si.n, -si.n)
        self._place = _flat(*si.p, 0.0)
        self._normal = _flat(*normal, 0.0)

    def smoothed(self, sums):
        """Mean R [texel, 3], and variance of its mean channel [texel]."""
        count = np.maximum(sums["count"], 1)
        direct, indirect = (sums[kind] / count[:, None] for kind in ("direct", "indirect"))
        # samples are spread evenly: the halves differ less than their variance says
        noise = [
            (2 * half / count - mean.mean(1)) ** 2
            for half, mean in zip(sums["halves"].T, (direct, indirect), strict=True)
        ]
        light = loaded(mi.Float, np.column_stack([indirect, noise[1]]).ravel())
        self._radius = loaded(mi.Float, SMOOTH_OVER / np.maximum(sums["inverse"] / count, 1e-9))
        weight = loaded(mi.Float, sums["count"])
        for stride in STRIDES:
            light = self._step(light, weight, stride)
        light = np.array(light).reshape(-1, 4)
        return direct + light[:, :3], noise[0] + light[:, 3]

    def _step(self, light, weight, stride):
        radius = self._radius
        number = dr.arange(mi.UInt32, dr.width(self._texels))
        place, normal = (_vector(table, number) for table in (self._place, self._normal))
        width, size = self._atlas.width, self._atlas.size
        column, line = mi.Int(self._texels % width), mi.Int(self._texels // width)
        total, variance, share = mi.Color3f(0), mi.Float(0), mi.Float(0)
        for over in (-1, 0, 1):
            for down in (-1, 0, 1):
                x, y = column + over * stride * self._sides, line + down * stride * self._sides
                inside = (x >= 0) & (x < width) & (y >= 0) & (y < size // width)
                slot = dr.gather(mi.UInt32, self._slots, 2 * mi.UInt32(y * width + x), inside)
                inside &= slot >= self._first
                at = slot - self._first
                there = _vector(self._place, at, inside)
                facing = _vector(self._normal, at, inside)
                reach = dr.minimum(radius, dr.gather(mi.Float, self._radius, at, inside))
                turn = dr.safe_sqrt(1 - dr.dot(facing, normal))
                near = dr.norm(there - place) <= reach * (1 - turn / SMOOTH_OVER)
                inside &= near | (over == down == 0)
                value = dr.gather(mi.Vector4f, light, at, inside)
                w = dr.gather(mi.Float, weight, at, inside) / (1 << abs(over) + abs(down))
                total += w * mi.Color3f(value.x, value.y, value.z)
                variance += dr.square(w) * value.w
                share += w
        share = dr.maximum(share, 1e-15)
        return _flat(*(total / share), variance / dr.square(share))


def _flat(*values):
    """Four numbers side by side for each lane."""
    flat = dr.ravel(mi.Vector4f(*values))
    dr.eval(flat)
    return flat


def _vector(flat, index, active=True):
    """The first three of the `_flat` numbers of a lane."""
    # pyrefly: ignore[missing-attribute]  # Dr.Jit's stubs have no swizzles
    return dr.gather(mi.Vector4f, flat, index, active).xyz


def _noise(atlas, texels, values, variance):
    """Standard error of the block that each texel lies in, relative to its mean: a texel alone does not know it.

    Errors are seen in amplitudes: below the median M of the view's light L, relative to sqrt(L M).
    """
    across, down = atlas.width // BLOCK, atlas.size // atlas.width // BLOCK
    block = texels // atlas.width // BLOCK * across + texels % atlas.width // BLOCK
    sums = [np.bincount(block, v, across * down) for v in (variance, values.mean(1), np.ones(len(texels)))]
    # with the blocks around: one that came out dark by chance would seem less noisy than it is
    variance, mean, count = (ndimage.uniform_filter(v.reshape(down, across), 3).ravel()[block] for v in sums)
    variance, mean = (np.maximum(v / count, 0) for v in (variance, mean))
    return np.sqrt(variance / np.maximum(mean * np.maximum(mean, np.median(mean)), 1e-30))
