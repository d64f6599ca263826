"""Baking for one view: what of the cache is there already, what has to be baked, and what was done."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..errors import InvalidInput
from ..scene.fingerprint import scene_digest
from ..scene.lobes import DIFFUSE, TRANSLUCENT, surfaces_of
from .atlas import Atlas, Triangles, lay_out, number_of, unfit
from .bake_store import Found, Stored
from .gathering import gather, solve
from .radiance_cache import Groups, RadianceCache, View, inseparable

if TYPE_CHECKING:
    from collections.abc import Callable

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..plan import Plan
    from ..progress import Progress
    from ..scene.specular_chains import FirstHits, SpecularChains
    from ..settings import Settings
    from .bake_store import BakeStore

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


def find(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    near: float,
    optics: FirstHits | SpecularChains,
    settings: Settings,
    noise: float,
    most: int,
    store: BakeStore | None,
    triangles: Triangles | None = None,
) -> Found:
    """Look for light in a store, as good as asked for.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    near : float
        World depth of the volume's near end, metres.
    optics : FirstHits or SpecularChains
    settings : Settings
    noise, most : float, int
        Relative standard error of texels that is wanted, and most samples of one.
    store : BakeStore or None
    triangles : Triangles, optional
        Of the scene.

    Returns
    -------
    Found
    """
    triangles, digest = triangles or _triangles(scene), _digest(scene, settings)
    triangles.leave_out(inseparable(triangles))
    view = View(scene, camera, hologram, near, optics, settings.seed)
    seen = View(scene, camera, hologram, near, optics, settings.seed, margin=1.0)
    surfaces = surfaces_of(scene)
    translucent = any(surface.bsdf().flags() & TRANSLUCENT for surface in surfaces)
    cache, missing = None, 1.0
    stored, note = store.load(triangles) if store else (None, "")
    if stored is not None and _serves(stored, digest, noise, most):
        noise, most = min(noise, stored.noise), max(most, stored.most)
        triangles.leave_out({mesh.shape for mesh in triangles.meshes if mesh.first not in stored.laid})
        cache = stored.cache(triangles, len(triangles.meshes) == len(surfaces), translucent)
        if cache is not None:
            missing, lacking = _coverage(seen, cache)
            if lacking > COARSE:
                cache, missing = None, 1.0
    return Found(triangles, view, seen, translucent, stored, cache, missing, digest, noise, most, note)


def found_in(
    store: BakeStore,
    worth: Callable[[int], bool],
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    near: float,
    optics: FirstHits | SpecularChains,
    settings: Settings,
    noise: float,
    most: int,
) -> float | None:
    """Share of a view whose light a store has, as good as asked for, None where it has none of the scene.

    What was found is kept for the baking that may follow. Arguments are those of `find`, and:

    Parameters
    ----------
    worth : callable
        ``worth(texels)``: whether to load so many, which may take a second or two. Else the share is taken for 1.
    """
    store.keep((), None)  # what an earlier plan found may be of other light
    if not store.files():  # to sort a million triangles takes a second
        return None
    triangles = _triangles(scene)
    head = store.head(triangles)
    if head is None or not _serves(head, _digest(scene, settings), noise, most):
        return None
    if not worth(head.texels):
        return 1.0
    found = find(scene, camera, hologram, near, optics, settings, noise, most, store, triangles)
    store.keep((scene, camera, hologram, near, settings, noise, most), found)
    if found.cache is None:
        return None
    return 1.0 if found.missing <= MISSING else 1 - found.missing


def _coverage(seen, cache):
    """Shares of the view that a cache lacks, and that it has no fine texels for."""
    missing, lost, coarse = seen.coverage(cache)
    cache.complete &= lost == 0  # sides that no probe met when the texture was laid out
    return missing, lost + coarse


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
    clock = _Clock()
    progress(0.0, "Looking for baked light")
    wanted = plan.texel_noise, plan.texel_samples
    found = (
        store.take((scene, camera, hologram, plan.near, settings, *wanted)) if store and not anew else None
    )
    if found is None:
        used = None if anew else store
        found = find(scene, camera, hologram, plan.near, optics, settings, *wanted, used)
    triangles, view, cache, missing = found.triangles, found.view, found.cache, found.missing
    noise, most, stored, note, charted = found.noise, found.most, found.stored, found.note, False
    fresh, surfaces = cache is None, surfaces_of(scene)
    clock("look")
    if cache is None:
        texel, sides = view.reach(triangles)
        triangles.leave_out(unfit(triangles, texel, sides))
        charted = stored is not None and stored.layout.serves(triangles, texel, sides)
        if charted:
            layout = stored.layout
        else:
            layout = lay_out(triangles, texel, sides, lambda done: progress(0.1 * done, "Unwrapping"))
        complete = len(triangles.meshes) == len(surfaces)
        cache = RadianceCache(Atlas(triangles, layout), complete, found.translucent)
        missing, _ = _coverage(found.seen, cache)
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
                store.save(triangles, Stored.of(cache, found.digest, noise, most))
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
