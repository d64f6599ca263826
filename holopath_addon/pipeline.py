"""From a scene to refocused pictures in one call: what the command line and Blender share. Imports no bpy."""

import math
from dataclasses import dataclass, field

import numpy as np

from . import engine

LARGE_DISPLAY = 6e-3  # metres of the shorter side from which on the engine's own depth range suits
SMALL_DISPLAY = 4.096e-3  # 512 pixels of 8 µm
SMALL_DEPTH_RANGE = (10e-3, 15e-3)
COARSER = 1.5  # times larger texels than pixels show
MOST_NAMES = 8  # in one line


@dataclass
class Result:
    """What `compute` brings.

    Attributes
    ----------
    plan : engine.Plan
    field : engine.WaveField
    focus : list of float
        World depths of the pictures, metres.
    images : numpy.ndarray, float32, shape (focus, y, x, wavelength)
    """

    plan: object
    field: object
    focus: list
    images: np.ndarray = field(repr=False)


def default_depth_range(width, height, pitch):
    """Depth range that a display's aperture can show without dark edges.

    Light spreads on its way to the SLM; a small display far from its volume loses most of it.

    Parameters
    ----------
    width, height : int
        Pixels.
    pitch : float
        Metres.

    Returns
    -------
    (float, float)
        Distances of the far and the near end from the SLM, metres.
    """
    side = min(width, height) * pitch
    if side >= LARGE_DISPLAY:
        return engine.Hologram.depth_far, engine.Hologram.depth_near
    scale = min(1.0, side / SMALL_DISPLAY)
    return SMALL_DEPTH_RANGE[0] * scale, SMALL_DEPTH_RANGE[1] * scale


def dioptres_in_view(plan, camera, hologram):
    """Nearest and farthest depth in view, in dioptres; 0 is infinity.

    Parameters
    ----------
    plan : engine.Plan
    camera : engine.Camera
    hologram : engine.Hologram

    Returns
    -------
    (float, float)
    """
    from .engine.mapping import DepthMapping

    mapping = DepthMapping.of(hologram, camera, plan.near)
    return tuple(1 / float(mapping.z_to_depth(z)) for z in (plan.z_high, plan.z_low))


def default_focus(plan, camera, hologram):
    """Three world depths spread evenly in dioptres over what is in view: near, middle and far, metres.

    Parameters
    ----------
    plan, camera, hologram
        See `dioptres_in_view`.

    Returns
    -------
    list of float
        Nearest first, `math.inf` where the view reaches infinity; fewer where depths coincide.
    """
    near, far = dioptres_in_view(plan, camera, hologram)
    depths = []
    for dioptres in (near, (near + far) / 2, far):
        depth = float(f"{1 / dioptres:.3g}") if dioptres > 1e-6 else math.inf
        if depth not in depths:
            depths.append(depth)
    return depths


def centre_depth(scene, camera):
    """Depth of what is in the middle of the view, as an autofocus finds it.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : engine.Camera

    Returns
    -------
    float or None
        World depth in metres: the median over the middle tenth of the view; None where nothing is.
    """
    import mitsuba as mi

    tangent = math.tan(camera.fov_x / 2)
    offsets = np.linspace(-0.1, 0.1, 15) * tangent
    across, upward = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    right, up, forward = camera.axes
    across, upward = across + 2 * tangent * camera.shift_x, upward + 2 * tangent * camera.shift_y
    directions = forward[:, None] + right[:, None] * across + up[:, None] * upward
    origins = camera.position[:, None] + camera.clip_start * directions
    rays = mi.Ray3f(mi.Point3f(origins.astype(np.float32)), mi.Vector3f(directions.astype(np.float32)))
    distances = np.asarray(scene.ray_intersect_preliminary(rays).t)
    depths = camera.clip_start + distances
    depths = depths[depths < camera.clip_end]
    return float(f"{np.median(depths):.3g}") if len(depths) >= len(distances) / 10 else None


def bake_notes(bake):
    """What to know of baked light, a line each.

    Parameters
    ----------
    bake : dict or None
        An `engine.baking.Bake`, as `WaveField.report` has it.

    Returns
    -------
    list of str
    """
    if bake is None:
        return []
    notes = [bake["note"]] if bake["note"] else []
    if bake["coarser"] > COARSER:
        notes.append(
            f"The texels of the baked light are {bake['coarser']:.1f} times larger than pixels, to bound memory: "
            f"shadows are softer; the method full has none of that."
        )
    if bake["traced"]:
        count = len(bake["traced"])
        names = ", ".join(bake["traced"][:MOST_NAMES]) + (", ..." if count > MOST_NAMES else "")
        things = "1 shape's" if count == 1 else f"{count} shapes'"
        notes.append(f"{things} diffuse light is traced, not baked: {names}.")
    return notes


def stage(progress, start, end):
    """Progress callback of a part of the work that runs from `start` to `end` of the whole (0..1)."""
    return lambda done, message: progress(start + (end - start) * min(max(done, 0.0), 1.0), message)


def _check_view(plan, camera, hologram, focus, pupil):
    """Refuse what `engine.reconstruct` would, before the long work."""
    from .engine.mapping import DepthMapping
    from .engine.reconstruction import pupil_mask

    mapping = DepthMapping.of(hologram, camera, plan.near)
    mapping.depth_to_z(list(focus))
    if pupil is not None:
        for wavelength in hologram.wavelengths:
            pupil_mask((hologram.height, hologram.width), hologram.pitch, wavelength, mapping, pupil)


def compute(scene, camera, hologram, settings=None, focus=None, pupil=None, progress=None, store=None):
    """Plan, render and refocus.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : engine.Camera
    hologram : engine.Hologram
    settings : engine.Settings, optional
    focus : sequence of float or 'centre', optional
        World depths, metres; `centre_depth`, else the nearest surface. Default: `default_focus`.
    pupil : engine.Pupil, optional
    progress : callable, optional
        ``progress(done, message)``, may raise `engine.Cancelled`.
    store : engine.BakeStore, optional
        Where baked light is kept.

    Returns
    -------
    Result

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled
    """
    progress = progress or (lambda done, message: None)
    settings = settings or engine.Settings()
    progress(0.0, "Planning")
    plan = engine.plan(scene, camera, hologram, settings, store)
    if focus == "centre":
        focus = [centre_depth(scene, camera) or default_focus(plan, camera, hologram)[0]]
    focus = list(focus) if focus else default_focus(plan, camera, hologram)
    _check_view(plan, camera, hologram, focus, pupil)
    field = engine.render(scene, camera, hologram, settings, plan, stage(progress, 0.02, 0.85), store)
    images = engine.reconstruct(field, focus, pupil, progress=stage(progress, 0.85, 1.0))
    return Result(plan, field, focus, images)
