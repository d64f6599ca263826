"""Filling of the radiance cache: light from surface to surface, then texels in view by final gathering."""

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

SOURCE_SAMPLES = 4  # samples of each group, for each bounce
NOISY_FRACTION = 0.03  # fraction of the groups that may stay noisier than the target
ROUND = 16  # samples of a texel between two estimates of the noise
MIN_BOUNCE = 1e-3  # fraction of all light: bounces that add less are left out
# Fraction of the harmonic mean distance to other surfaces over which light from them varies little.
SMOOTH_OVER = 0.15
BLOCK_LANES = 1 << 14  # groups that one thread samples at once: half a second
STRIDES = (1, 2, 4, 8, 16)  # of the filter, groups of texels


class Gathered(NamedTuple):
    """Result of final gathering.

    Attributes
    ----------
    samples : int
        All samples.
    noise, error : float or None
        Relative standard error of all groups but for the noisiest `NOISY_FRACTION`, and its root mean square over the
        light.
    """

    samples: int
    noise: float | None
    error: float | None


def solve(request: BakeRequest, cache: RadianceCache, progress: PartProgress) -> None:
    """Solve for the light on groups of texels bounce by bounce: the source that final gathering looks up.

    Parameters
    ----------
    request : BakeRequest
    cache : RadianceCache
    progress : callable
        ``progress(done)``, may raise.
    """
    groups, max_depth = cache.coarse, request.settings.max_depth
    sampling = _Sampling(request, cache, groups)
    # one bounce even for direct light: rays of the view now and then meet surfaces that no probe ray met
    bounces, before = max(max_depth - 2, 1) if len(groups) and max_depth > 1 else 0, 0.0
    for bounce in range(bounces):
        sums = sampling.sums(
            np.arange(len(groups)),
            SOURCE_SAMPLES,
            np.zeros(len(groups)),
            request.settings.seed + bounce,
            lambda done, bounce=bounce: progress((bounce + done) / bounces),
        )
        fields = by_name(sums)
        source = np.column_stack([fields["direct"] + fields["indirect"], fields["count"]])
        cache.source = loaded(mi.Float, source.ravel())
        total = source[:, :3].sum(dtype=float)
        if abs(total - before) <= MIN_BOUNCE * total:
            break
        before = total
    progress(1.0)


class _Sampling:
    """Sampling of groups of texels, by paths with an optional `limit`, see `PathTracer`."""

    def __init__(self, request, cache, groups, limit=math.inf):
        self._scene, self._cache, self._groups = request.scene, cache, groups
        self._tracer = PathTracer(request.settings.max_depth, limit, cache)
        self._pool = loaded(mi.UInt32, groups.pool)

    def sums(self, which, samples, done, seed, progress):
        """Sums over samples of some groups, [group, NUMBERS], that had `done` before; see `RadianceCache.sample`."""
        sums, groups = np.empty((len(which), NUMBERS), np.float32), self._groups
        size = self._cache.lanes
        unit = dr.opaque(mi.UInt32, size)
        block = min(size, BLOCK_LANES * threads())
        for units in paced(range(math.ceil(len(which) / block)), size // block * units_at_once()):
            part = slice(units.start * block, min(units.stop * block, len(which)))
            lanes = (groups.starts[which[part]], groups.counts[which[part]], done[part])
            starts, counts, before = (loaded(mi.UInt32, values) for values in lanes)
            lane = dr.arange(mi.UInt32, part.stop - part.start) + dr.opaque(mi.UInt32, part.start)
            own = dr.opaque(mi.UInt32, seed * 9973 & 0xFFFFFFFF) + lane // unit * unit
            sampled = self._cache.sample(
                self._scene, self._tracer, self._pool, starts, counts, samples, before, own, lane % unit
            )
            dr.eval(sampled)
            for k, values in enumerate(sampled):
                sums[part, k] = np.array(values)
            progress(part.stop / len(which))
        return sums


def by_name(sums: np.ndarray) -> np.ndarray:
    """View sums of groups, [group, NUMBERS], with the names of SUMS."""
    return sums.view(SUMS)[:, 0]


def gather(
    request: BakeRequest, cache: RadianceCache, groups: Groups, limit: float, progress: PartProgress
) -> Gathered:
    """Bake texels until their noise is low: final gathering, which looks up the source.

    Parameters
    ----------
    request : BakeRequest
        Has the target noise of a group and its maximum samples.
    cache : RadianceCache
        The groups are added to it.
    groups : Groups
        Groups of texels that are not baked yet.
    limit : float
        Maximum radiance of a path, see `PathTracer`.
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
    sampling, max_samples = _Sampling(request, cache, groups, limit), request.max_samples
    sums = np.zeros((len(groups), NUMBERS), np.float32)
    filter = _Filter(cache, groups, before)
    left, total, done = np.arange(len(groups)), 0, 0
    while True:
        # few groups take several rounds at once
        rounds = int(np.clip(cache.lanes // len(left), 1, max(1, (max_samples - done) // ROUND)))
        new = sampling.sums(
            np.tile(left, rounds),
            ROUND,
            np.repeat(done + ROUND * np.arange(rounds), len(left)),
            request.settings.seed + 100 + done,
            lambda part, done=done, rounds=rounds: progress((done + ROUND * rounds * part) / max_samples),
        )
        sums[left] += new.reshape(rounds, len(left), -1).sum(0)
        total, done = total + ROUND * rounds * len(left), done + ROUND * rounds
        values, variance = filter.smooth(by_name(sums))
        noise = _noise(cache.atlas, groups.leaders, values, variance)
        left = left[noise[left] > request.noise]
        if len(left) <= NOISY_FRACTION * len(groups) or done >= max_samples:
            break
    known = (by_name(sums)["count"] > 0).astype(np.float32)
    baked = loaded(mi.Float, np.column_stack([values, known]).ravel())
    dr.scatter(fine, baked, dr.arange(mi.UInt32, 4 * len(groups)) + 4 * before)
    cache.fine = fine
    light = values.mean(1)
    bright = np.minimum(light, np.percentile(light, 95))  # surroundings of lights must not hide the rest
    error = math.sqrt((bright * noise**2).sum() / max(bright.sum(), 1e-30))
    return Gathered(total, float(np.quantile(noise, 1 - NOISY_FRACTION)), error)


class _Filter:
    """À-trous filter (Dammertz et al. 2010) of light that comes by way of other surfaces; shadows stay sharp.

    It averages where such light hardly varies: where distance / R + sqrt(1 - n.n') is small, with R the harmonic mean
    distance to other surfaces and n, n' the normals (Ward, Rubinstein and Clear 1988, "A ray tracing solution for
    diffuse interreflection", equation 5).

    Parameters
    ----------
    cache : RadianceCache
    groups : Groups
        Groups to filter, with strides in units of their squares.
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

    def smooth(self, sums):
        """Mean R [texel, 3], and variance of its mean channel [texel]."""
        count = np.maximum(sums["count"], 1)
        direct, indirect = (sums[kind] / count[:, None] for kind in ("direct", "indirect"))
        # from the halves, as samples are spread evenly and the variance would overestimate the noise
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
        total, variance, weights = mi.Color3f(0), mi.Float(0), mi.Float(0)
        for over in (-1, 0, 1):
            for down in (-1, 0, 1):
                x, y = column + over * stride * self._sides, line + down * stride * self._sides
                inside = (x >= 0) & (x < width) & (y >= 0) & (y < size // width)
                slot = dr.gather(mi.UInt32, self._slots, 2 * mi.UInt32(y * width + x), inside)
                inside &= slot >= self._first
                at = slot - self._first
                its_place = _vector(self._place, at, inside)
                its_normal = _vector(self._normal, at, inside)
                reach = dr.minimum(radius, dr.gather(mi.Float, self._radius, at, inside))
                turn = dr.safe_sqrt(1 - dr.dot(its_normal, normal))
                near = dr.norm(its_place - place) <= reach * (1 - turn / SMOOTH_OVER)
                inside &= near | (over == down == 0)
                value = dr.gather(mi.Vector4f, light, at, inside)
                w = dr.gather(mi.Float, weight, at, inside) / (1 << abs(over) + abs(down))
                total += w * mi.Color3f(value.x, value.y, value.z)
                variance += dr.square(w) * value.w
                weights += w
        weights = dr.maximum(weights, 1e-15)
        return _flat(*(total / weights), variance / dr.square(weights))


def _flat(*values):
    """Table of four numbers for each lane."""
    flat = dr.ravel(mi.Vector4f(*values))
    dr.eval(flat)
    return flat


def _vector(flat, index, active=True):
    """First three numbers of a lane in a table."""
    # pyrefly: ignore[missing-attribute]  # Dr.Jit's stubs have no swizzles
    return dr.gather(mi.Vector4f, flat, index, active).xyz


def _noise(atlas, texels, values, variance):
    """Standard error of the block around each texel, relative to its mean; one texel is not enough to estimate it.

    Errors show in amplitudes: below the median M of the view's light L, relative to sqrt(L M).
    """
    across, down = atlas.width // BLOCK, atlas.size // atlas.width // BLOCK
    block = texels // atlas.width // BLOCK * across + texels % atlas.width // BLOCK
    sums = [np.bincount(block, v, across * down) for v in (variance, values.mean(1), np.ones(len(texels)))]
    # with the blocks around: one that is dark by chance would seem less noisy than it is
    variance, mean, count = (ndimage.uniform_filter(v.reshape(down, across), 3).ravel()[block] for v in sums)
    variance, mean = (np.maximum(v / count, 0) for v in (variance, mean))
    return np.sqrt(variance / np.maximum(mean * np.maximum(mean, np.median(mean)), 1e-30))
