"""Baking for one view: what of the cache is there already, what has to be baked, and what was done."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..errors import InvalidInput
from ..progress import Clock
from ..scene.fingerprint import scene_digest
from ..scene.lobes import DIFFUSE, TRANSLUCENT, surfaces_of
from .atlas import Atlas, Triangles, lay_out, number_of, unfit
from .bake_store import Found, Stored
from .camera_view import BakeRequest, CameraView
from .gathering import Gathered, gather, solve
from .groups import Groups
from .radiance_cache import RadianceCache, inseparable

if TYPE_CHECKING:
    from collections.abc import Callable

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..plan import Plan
    from ..progress import Progress
    from ..scene.specular_chains import FirstHits, SpecularChains
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


def find(request: BakeRequest, store: BakeStore | None, triangles: Triangles | None = None) -> Found:
    """Look for light in a store, as good as asked for.

    Parameters
    ----------
    request : BakeRequest
    store : BakeStore or None
    triangles : Triangles, optional
        Of the scene.

    Returns
    -------
    Found
    """
    triangles, digest = triangles or _triangles(request.scene), _digest(request)
    triangles.leave_out(inseparable(triangles))
    view, seen = CameraView(request), CameraView(request, margin=1.0)
    surfaces = surfaces_of(request.scene)
    translucent = any(surface.bsdf().flags() & TRANSLUCENT for surface in surfaces)
    cache, missing = None, 1.0
    stored, note = store.load(triangles) if store else (None, "")
    if stored is not None and _serves(stored, digest, request):
        request = replace(
            request, noise=min(request.noise, stored.noise), most=max(request.most, stored.most)
        )
        triangles.leave_out({mesh.shape for mesh in triangles.meshes if mesh.first not in stored.laid})
        cache = stored.cache(triangles, len(triangles.meshes) == len(surfaces), translucent)
        if cache is not None:
            missing, lacking = _coverage(seen, cache)
            if lacking > COARSE:
                cache, missing = None, 1.0
    return Found(request, triangles, view, seen, translucent, stored, cache, missing, digest, note)


def found_in(store: BakeStore, request: BakeRequest, worth: Callable[[int], bool]) -> float | None:
    """Share of a view whose light a store has, as good as asked for, None where it has none of the scene.

    What was found is kept for the baking that may follow.

    Parameters
    ----------
    store : BakeStore
    request : BakeRequest
    worth : callable
        ``worth(texels)``: whether to load so many, which may take a second or two. Else the share is taken for 1.
    """
    store.kept = None  # what an earlier plan found may be of other light
    if store.empty:  # to sort a million triangles takes a second
        return None
    triangles = _triangles(request.scene)
    head = store.head(triangles)
    if head is None or not _serves(head, _digest(request), request):
        return None
    if not worth(head.texels):
        return 1.0
    found = find(request, store, triangles)
    store.kept = request, found
    if found.cache is None:
        return None
    return 1.0 if found.missing <= MISSING else 1 - found.missing


def _coverage(seen, cache):
    """Shares of the view that a cache lacks, and that it has no fine texels for."""
    missing, lost, coarse = seen.coverage(cache)
    cache.complete &= lost == 0  # sides that no probe met when the texture was laid out
    return missing, lost + coarse


def _serves(stored, digest, request):
    return stored.digest == digest and stored.noise <= NOISIER * request.noise and stored.most >= request.most


def _triangles(scene):
    return Triangles(scene, lambda shape: bool(shape.bsdf().flags() & DIFFUSE))


def _digest(request):
    return f"{scene_digest(request.scene)} {request.settings.max_depth}"


def bake(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    plan: Plan,
    optics: FirstHits | SpecularChains,
    *,
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
    clock = Clock()
    progress(0.0, "Looking for baked light")
    with clock("look"):
        request = BakeRequest(
            scene, camera, hologram, plan.near, optics, plan.settings, plan.texel_noise, plan.texel_samples
        )
        found = store.take(request) if store and not anew else None
        found = found or find(request, None if anew else store)
    request, cache, missing = found.request, found.cache, found.missing
    fresh, charted, gathered = cache is None, False, Gathered(0, None, None)
    if cache is None:
        with clock("unwrap"):
            cache, charted = _laid_out(found, lambda done: progress(0.1 * done, "Unwrapping"))
            missing, _ = _coverage(found.seen, cache)
        with clock("solve"):
            solve(request, cache, lambda done: progress(0.1 + 0.3 * done, "Baking light between surfaces"))
    with clock("gather"):
        texels, side = found.view.seen(cache.atlas)
        new = ~cache.baked(texels)
        if (fresh or missing > MISSING) and new.any():
            groups = Groups.of(cache.atlas, texels[new], side[new])
            limit = plan.radiance_limit or math.inf  # a view in the dark says nothing of others
            gathered = gather(
                request, cache, groups, limit, lambda done: progress(0.4 + 0.6 * done, "Baking light in view")
            )
    progress(1.0, "Baking light in view")
    with clock("store"):
        size, note = _stored(store, found, cache, fresh or gathered.samples) if store else (0, found.note)
    return cache, Bake(
        reused=("charts" if charted else "nothing") if fresh else "part" if gathered.samples else "all",
        texels=len(texels),
        groups=sum(map(len, cache.groups)),
        **gathered._asdict(),
        coarser=cache.atlas.layout.coarser,
        dense=cache.atlas.layout.dense,
        traced=_traced(scene, found.triangles),
        bytes=size,
        seconds=clock.seconds,
        note=note,
    )


def _laid_out(found, progress):
    """A cache of no light yet, and whether the stored charts serve it."""
    triangles, stored = found.triangles, found.stored
    texel, sides = found.view.reach(triangles)
    triangles.leave_out(unfit(triangles, texel, sides))
    charted = stored is not None and stored.layout.serves(triangles, texel, sides)
    layout = stored.layout if charted else lay_out(triangles, texel, sides, progress)
    complete = len(triangles.meshes) == len(surfaces_of(found.request.scene))
    return RadianceCache(Atlas(triangles, layout), complete, found.translucent), charted


def _stored(store, found, cache, changed):
    """Bytes of the stored file, and what is wrong; what has `changed` is saved first."""
    note = found.note
    if changed:
        try:
            store.save(
                found.triangles, Stored.of(cache, found.digest, found.request.noise, found.request.most)
            )
        except InvalidInput as fault:  # the light is good all the same
            note = str(fault)
    return store.size(found.triangles), note


def _traced(scene, triangles):
    """Names of the shapes whose diffuse light is not cached."""
    cached = {mesh.shape for mesh in triangles.meshes}
    shapes = (s for s in surfaces_of(scene) if s.bsdf().flags() & DIFFUSE and number_of(s) not in cached)
    return tuple(sorted(shape.id() for shape in shapes))
