"""Baking for one view: what of the cache is there already, what has to be baked, and what was done."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .atlas import Atlas, Triangles, lay_out, number_of, unfit
from .bake_store import Stored
from .errors import InvalidInput
from .fingerprint import scene_digest
from .gathering import gather, solve
from .lobes import DIFFUSE, TRANSLUCENT, surfaces_of
from .radiance_cache import Groups, RadianceCache, View, inseparable

if TYPE_CHECKING:
    import mitsuba as mi

    from .bake_store import BakeStore
    from .camera import Camera
    from .chains import FirstHits, SpecularChains
    from .hologram import Hologram, Settings
    from .planner import Plan
    from .progress import Progress

MISSING = 0.02  # of the view: less is traced, where the camera has moved
NOISIER = 1.1  # than asked for: what is stored will do
COARSE = 0.05  # of the view may have texels of over two pixels


@dataclass(frozen=True)
class Bake:
    """What baking did.

    Attributes
    ----------
    reused : {'all', 'part', 'charts', 'nothing'}
        Of what was stored: the light, some of it, or only where texels lie.
    texels, groups : int
        In view, and the groups of them that share samples.
    samples : int
        Taken now, for the view.
    noise, error : float or None
        Relative standard error of what was baked now: of the noisiest groups but for a few, and its root mean square
        over the light.
    coarser : float
        How many times the texels are larger than pixels, to bound memory.
    dense : int
        Triangles too small or too many for charts.
    traced : tuple of str
        Shapes whose diffuse light is not cached.
    bytes : int
        Of the stored file, 0 where nothing is stored.
    seconds : dict
        Of each stage.
    note : str
        What was wrong with a stored bake, or why there is none; empty if nothing.
    """

    reused: str
    texels: int
    groups: int
    samples: int
    noise: float | None
    error: float | None
    coarser: float
    dense: int
    traced: tuple
    bytes: int
    seconds: dict
    note: str


def is_baked(scene: mi.Scene, settings: Settings, noise: float, most: int, store: BakeStore) -> bool:
    """Whether a store has the light of a scene, as good as asked for and for some view."""
    if not store.files():  # to sort a million triangles takes a second
        return False
    stored, _ = store.load(_triangles(scene))
    return stored is not None and _serves(stored, _digest(scene, settings), noise, most)


def _serves(stored, digest, noise, most):
    return stored.digest == digest and stored.noise <= NOISIER * noise and stored.most >= most


def _triangles(scene):
    return Triangles(scene, lambda shape: bool(shape.bsdf().flags() & DIFFUSE))


def _digest(scene, settings):
    return f"{scene_digest(scene)} {settings.max_depth}"


def bake(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    plan: Plan,
    optics: FirstHits | SpecularChains,
    settings: Settings,
    store: BakeStore | None = None,
    progress: Progress | None = None,
    anew: bool = False,
) -> tuple[RadianceCache, Bake]:
    """The radiance cache of what a camera sees, taken from a store as far as it is there.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    plan : Plan
    optics : FirstHits or SpecularChains
    settings : Settings
    store : BakeStore, optional
    progress : callable, optional
        ``progress(done, message)``, may raise.
    anew : bool
        Bake whatever is in the store, which gets the new light in its place.

    Returns
    -------
    RadianceCache, Bake
    """
    progress = progress or (lambda done, message: None)
    clock, noise, most = _Clock(), plan.texel_noise, plan.texel_samples
    progress(0.0, "Looking for baked light")
    triangles, digest = _triangles(scene), _digest(scene, settings)
    triangles.leave_out(inseparable(triangles))
    view = View(scene, camera, hologram, plan.near, optics, settings.seed)
    seen = View(scene, camera, hologram, plan.near, optics, settings.seed, margin=1.0)
    clock("look")
    surfaces = surfaces_of(scene)
    translucent = any(surface.bsdf().flags() & TRANSLUCENT for surface in surfaces)
    cache, missing, charted, stored, note = None, 1.0, False, None, ""

    def looked_at(cache):
        missing, lost, coarse = seen.coverage(cache)
        cache.complete &= lost == 0  # sides that no probe met when the texture was laid out
        return missing, lost + coarse

    if store and not anew:
        stored, note = store.load(triangles)
    if stored is not None and _serves(stored, digest, noise, most):
        noise, most = min(noise, stored.noise), max(most, stored.most)
        triangles.leave_out({mesh.shape for mesh in triangles.meshes if mesh.first not in stored.laid})
        cache = stored.cache(triangles, len(triangles.meshes) == len(surfaces), translucent)
        if cache is not None:
            missing, lacking = looked_at(cache)
            if lacking > COARSE:
                cache = None
    clock("load")
    fresh = cache is None
    if cache is None:
        texel, sides = view.reach(triangles)
        triangles.leave_out(unfit(triangles, texel, sides))
        charted = stored is not None and stored.layout.serves(triangles, texel, sides)
        if charted:
            layout = stored.layout
        else:
            layout = lay_out(triangles, texel, sides, lambda done: progress(0.1 * done, "Unwrapping"))
        cache = RadianceCache(Atlas(triangles, layout), len(triangles.meshes) == len(surfaces), translucent)
        missing, _ = looked_at(cache)
        clock("unwrap")
        solve(
            scene,
            cache,
            settings.max_depth,
            settings.seed,
            lambda done: progress(0.1 + 0.3 * done, "Baking light between surfaces"),
        )
        clock("solve")
    texels, side = view.seen(cache.atlas)
    samples, reached, error = 0, None, None
    new = ~cache.baked(texels)
    if (fresh or missing > MISSING) and new.any():
        samples, reached, error = gather(
            scene,
            cache,
            Groups.of(cache.atlas, texels[new], side[new]),
            settings.max_depth,
            plan.radiance_limit or math.inf,  # a view in the dark says nothing of others
            noise,
            most,
            settings.seed,
            lambda done: progress(0.4 + 0.6 * done, "Baking light in view"),
        )
    progress(1.0, "Baking light in view")
    clock("gather")
    size = 0
    if store:
        if fresh or samples:
            try:
                store.save(triangles, Stored.of(cache, digest, noise, most))
            except InvalidInput as fault:  # the light is good all the same
                note = str(fault)
        size = store.size(triangles)
    clock("store")
    cached = {mesh.shape for mesh in triangles.meshes}
    names = [s.id() for s in surfaces if s.bsdf().flags() & DIFFUSE and number_of(s) not in cached]
    return cache, Bake(
        ("charts" if charted else "nothing") if fresh else "part" if samples else "all",
        len(texels),
        sum(map(len, cache.groups)),
        samples,
        reached,
        error,
        cache.atlas.layout.coarser,
        cache.atlas.layout.dense,
        tuple(sorted(names)),
        size,
        clock.seconds,
        note,
    )


class _Clock:
    """Seconds since the last call, by stage."""

    def __init__(self):
        self.seconds, self._before = {}, time.perf_counter()

    def __call__(self, stage):
        now = time.perf_counter()
        self.seconds[stage], self._before = now - self._before, now
