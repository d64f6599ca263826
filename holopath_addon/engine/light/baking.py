"""Baking for one view: load light from the store, bake the rest, and report it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..errors import InvalidInput
from ..progress import Clock
from ..scene.fingerprint import scene_digest
from ..scene.lobes import DIFFUSE, TRANSLUCENT, surfaces_of
from ..scene.specular_chains import image_finder_of
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
    from .bake_store import BakeStore

MAX_MISSING = 0.02  # fraction of the view: less is traced instead, after the camera moved
TOLERANCE = 1.1  # stored light may be noisier than requested by this factor
MAX_COARSE = 0.05  # fraction of the view that may lack texels, or have some of over two pixels


@dataclass(frozen=True)
class Bake:
    """Report of a bake.

    Attributes
    ----------
    reused : {'all', 'part', 'charts', 'nothing'}
        Stored data that were used: all light, some of it, or only the layout of the texture.
    texels, groups : int
        Texels in view, and groups of texels that share samples.
    samples : int
        Samples of this bake, for the view.
    noise, error : float or None
        Relative standard error of the light of this bake, see `gathering.Gathered`.
    coarser : float
        Size of texels over that of pixels, to bound memory.
    dense : int
        Triangles too small or too many for charts.
    traced : tuple of str
        Names of shapes whose diffuse light is not cached.
    bytes : int
        Size of the stored file; 0: none.
    seconds : dict of str to float
        Seconds of each stage.
    note : str
        Fault of a stored bake, or reason why none is stored; empty if there is none.
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
    """Look in a store for light as accurate as requested.

    Parameters
    ----------
    request : BakeRequest
    store : BakeStore or None
    triangles : Triangles, optional
        Triangles of the scene, if they are known already.
    """
    triangles, digest = triangles or _triangles(request.scene), _digest(request)
    triangles.leave_out(inseparable(triangles))
    wide_view, view = CameraView(request), CameraView(request, margin=1.0)
    surfaces = surfaces_of(request.scene)
    translucent = any(surface.bsdf().flags() & TRANSLUCENT for surface in surfaces)
    cache, missing = None, 1.0
    stored, note = store.load(triangles) if store else (None, "")
    if stored is not None and _serves(stored, digest, request):
        noise, samples = min(request.noise, stored.noise), max(request.max_samples, stored.max_samples)
        request = replace(request, noise=noise, max_samples=samples)
        triangles.leave_out({mesh.shape for mesh in triangles.meshes if mesh.first not in stored.laid})
        cache = stored.cache(triangles, len(triangles.meshes) == len(surfaces), translucent)
        if cache is not None:
            missing, lacking = _coverage(view, cache)
            if lacking > MAX_COARSE:
                cache, missing = None, 1.0
    return Found(request, triangles, wide_view, view, translucent, stored, cache, missing, digest, note)


def found_in(store: BakeStore, request: BakeRequest, worth: Callable[[int], bool]) -> float | None:
    """Fraction of a view for which a store has light as accurate as requested; None if it has none of the scene.

    The store keeps the result of `find` for the bake that may follow.

    Parameters
    ----------
    store : BakeStore
    request : BakeRequest
    worth : callable
        ``worth(texels)``: whether loading so many texels, which may take seconds, is worth it. Else 1 is returned.
    """
    store.kept = None  # the result for an earlier plan may be outdated
    if store.empty:  # sorting a million triangles takes a second
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
    return 1.0 if found.missing <= MAX_MISSING else 1 - found.missing


def _coverage(view, cache):
    """Fractions of the view that are not baked, and that have no texels or coarse ones."""
    missing, lost, coarse = view.coverage(cache)
    cache.complete &= lost == 0  # sides that no probe ray met when the texture was laid out
    return missing, lost + coarse


def _serves(stored, digest, request):
    return (
        stored.digest == digest
        and stored.noise <= TOLERANCE * request.noise
        and stored.max_samples >= request.max_samples
    )


def _triangles(scene):
    return Triangles(scene, lambda shape: bool(shape.bsdf().flags() & DIFFUSE))


def _digest(request):
    return f"{scene_digest(request.scene)} {request.settings.max_depth}"


def bake(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    plan: Plan,
    *,
    store: BakeStore | None = None,
    progress: Progress | None = None,
    anew: bool = False,
) -> tuple[RadianceCache, Bake]:
    """Bake the radiance cache of a camera's view, with light from a store as far as it is there.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    plan : Plan
    store : BakeStore, optional
    progress : callable, optional
        ``progress(done, message)``, may raise.
    anew : bool
        Whether to bake all light again, and replace that in the store.

    Returns
    -------
    RadianceCache, Bake
    """
    progress = progress or (lambda done, message: None)
    image_finder = image_finder_of(scene, camera, plan)
    clock = Clock()
    progress(0.0, "Looking for baked light")
    with clock("look"):
        request = BakeRequest(
            scene,
            camera,
            hologram,
            plan.near,
            image_finder,
            plan.settings,
            plan.texel_noise,
            plan.texel_samples,
        )
        found = store.take(request) if store and not anew else None
        found = found or find(request, None if anew else store)
    request, cache, missing = found.request, found.cache, found.missing
    fresh, charted, gathered = cache is None, False, Gathered(0, None, None)
    if cache is None:
        with clock("unwrap"):
            cache, charted = _laid_out(found, lambda done: progress(0.1 * done, "Unwrapping"))
            missing, _ = _coverage(found.view, cache)
        with clock("solve"):
            solve(request, cache, lambda done: progress(0.1 + 0.3 * done, "Baking light between surfaces"))
    with clock("gather"):
        texels, side = found.wide_view.texels(cache.atlas)
        new = ~cache.baked(texels)
        if (fresh or missing > MAX_MISSING) and new.any():
            groups = Groups.of(cache.atlas, texels[new], side[new])
            limit = plan.radiance_limit
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
    """Cache without light, and whether it uses the stored layout."""
    triangles, stored = found.triangles, found.stored
    texel, sides = found.wide_view.reach(triangles)
    triangles.leave_out(unfit(triangles, texel, sides))
    charted = stored is not None and stored.layout.serves(triangles, texel, sides)
    layout = stored.layout if charted else lay_out(triangles, texel, sides, progress)
    complete = len(triangles.meshes) == len(surfaces_of(found.request.scene))
    return RadianceCache(Atlas(triangles, layout), complete, found.translucent), charted


def _stored(store, found, cache, changed):
    """Size of the stored file in bytes, and its fault; light that `changed` is saved first."""
    note = found.note
    if changed:
        try:
            stored = Stored.of(cache, found.digest, found.request.noise, found.request.max_samples)
            store.save(found.triangles, stored)
        except InvalidInput as fault:  # the light can be used nevertheless
            note = str(fault)
    return store.size(found.triangles), note


def _traced(scene, triangles):
    """Names of the shapes whose diffuse light is not cached."""
    cached = {mesh.shape for mesh in triangles.meshes}
    shapes = (s for s in surfaces_of(scene) if s.bsdf().flags() & DIFFUSE and number_of(s) not in cached)
    return tuple(sorted(shape.id() for shape in shapes))
