"""Looks at the scene and decides how much has to be modelled, and says why."""

import math
import time
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from . import backend
from .errors import InvalidInput
from .hologram import Settings
from .kernel_table import LEVELS, Lattice
from .mapping import DepthMapping

CONE = {
    "preview": 1.0,
    "balanced": 1.15,
    "full": 1.3,
}  # of the recordable slope: how much of the kernel's tails
GRAIN_NOISE = {"preview": 0.5, "balanced": 0.3, "full": 0.15}  # of a grain's mean, as a share of the speckle
PASSES = {
    "preview": (8, 64),
    "balanced": (16, 256),
    "full": (32, 1024),
}  # fewest and most radiance paths a pixel
PAPER_RAYS = {"preview": 256, "balanced": 1024, "full": 4096}
SLAB = 0.15e-3  # metres; a small part of the depth of focus, 2 wavelength / slope^2 = 1 mm at 8 µm
MOST_SLABS = 48
GLOSSY_BINS = 2
PILOT_GRAINS, PILOT_PATHS = 4096, 32
IMAGE_LIMITS = (-0.5, 1.5)  # of the near end's vergence: images beyond, as of caustics, are put there
MOST_REACH = 256  # pixels: beyond, the kernel table would outgrow memory
CHUNK_BYTES = 256 << 20  # Mitsuba and the kernels' working memory
MAP_BYTES = 1 << 30  # largest index of the radiance map
CELL_BYTES = 48  # of an occupied cell: three sums and a count of 8 bytes, and the amplitudes made of them
SURFACES = 2  # occupied slabs of a pixel column, roughly


@dataclass(frozen=True)
class Decision:
    """One choice of the plan: what, which value, and why, in plain words."""

    name: str
    value: str
    reason: str


@dataclass(frozen=True)
class Plan:
    """What will be computed. Distances in metres.

    Attributes
    ----------
    near : float
        World depth at the near end of the volume (`fit`), or of the nearest surface (`eyepiece`).
    wrp : float
        z of the recording plane.
    z_low, z_high : float
        Hologram-space depths between which surfaces were seen.
    depth_limit : float
        Largest distance of a surface from the recording plane.
    rays_per_pixel, passes, margin, slabs, bins : int
        Rays of the wave, radiance paths, and the radiance map's pixels beyond each edge, depth slabs and
        pupil bins.
    chain : int
        Longest chain of specular hits; 0 leaves the code for them out.
    splits : int
        Hits of a chain at which both branches are followed.
    cone : float
        Half-angle of the lattice in recordable slopes.
    seconds : float
        Estimated time on this machine.
    memory_bytes : int
        Estimated peak of the arrays.
    decisions : tuple of Decision
    warnings : tuple of str
    """

    near: float
    wrp: float
    z_low: float
    z_high: float
    depth_limit: float
    rays_per_pixel: int
    passes: int
    margin: int
    slabs: int
    bins: int
    chain: int
    splits: int
    cone: float
    seconds: float
    memory_bytes: int
    decisions: tuple = field(repr=False)
    warnings: tuple = ()

    def to_dict(self):
        """JSON-able form."""
        return asdict(self)

    def __str__(self):
        lines = [f"{d.name}: {d.value} ({d.reason})" for d in self.decisions]
        lines.append(f"time: about {self.seconds:.0f} s, memory: about {self.memory_bytes / 1e6:.0f} MB")
        return "\n".join(lines + [f"warning: {w}" for w in self.warnings])


@dataclass(frozen=True)
class Probe:
    """What a few rays saw.

    Attributes
    ----------
    vergence : numpy.ndarray
        Inverse world depths of what was hit, 1/m; through mirrors and lenses of the image, which may be negative.
    misses : bool
        Whether some rays hit nothing.
    sky : bool
        Whether rays that hit nothing meet an environment.
    glossy, specular : float
        Shares of rays that meet glossy, and mirror-like or clear, surfaces.
    rays_per_second, paths_per_second : float
        Speed of this machine on this scene; 0 paths when the radiance was not asked for.
    noise : float
        Variance of one radiance path relative to its grain's squared mean, weighted by brightness.
    splits : int
        Hits at which chains divide into a reflected and a transmitted branch.
    """

    vergence: np.ndarray
    misses: bool
    sky: bool
    glossy: float
    specular: float
    rays_per_second: float
    noise: float
    paths_per_second: float
    splits: int


def probe(scene, hologram, camera, mapping, plane, seed=0, max_depth=0, optics=None):
    """Trace up to about a million rays over the hologram and the pupil.

    Parameters
    ----------
    scene : mitsuba.Scene
    hologram : Hologram
    camera : Camera
    mapping : DepthMapping
        With beta = 0 the rays start at the pupil's centre.
    plane : float
        z of the plane that the rays start from, metres.
    seed : int
    max_depth : int
        Of radiance paths; 0 does not look at the radiance.
    optics : FirstHits or SpecularChains, optional
        Default: first hits.

    Returns
    -------
    Probe
    """
    import drjit as dr
    import mitsuba as mi

    from .chains import SPLITS, FirstHits, specular_lobes
    from .rays import Rays

    optics = optics or FirstHits()

    rays = Rays(hologram, camera, mapping, plane)
    stride = max(1, math.ceil(math.sqrt(hologram.width * hologram.height / (1 << 16))))
    columns, rows, directions = -(-hologram.width // stride), -(-hologram.height // stride), 16
    size = columns * rows * directions
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, size)
    index = dr.arange(mi.UInt32, size)
    pixel, number = index // directions, index % directions
    jitter = sampler.next_2d()
    column = dr.minimum((pixel % columns + jitter.x) * stride, hologram.width) - 0.5
    row = dr.minimum((pixel // columns + jitter.y) * stride, hologram.height) - 0.5
    turn = sampler.next_2d()
    u = mi.Point2f(number * 0.7548776662466927 + turn.x, number * 0.5698402909980532 + turn.y)
    limit = max(hologram.max_slope(w) for w in hologram.wavelengths)
    slope = limit * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
    ray, depth_rate = rays.world(*rays.place(column, row), slope.x, slope.y)
    si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.Minimal, coherent=True)
    hit = si.is_valid()
    flags = si.bsdf().flags()
    glossy = hit & mi.has_flag(flags, mi.BSDFFlags.Glossy)
    reflects, transmits = specular_lobes(flags)
    specular = hit & (reflects | transmits)
    shares = [float(dr.mean(dr.select(mask, mi.Float(1), 0))[0]) for mask in (glossy, specular)]
    noise, paths_per_second = _radiance_noise(scene, ray, max_depth, seed) if max_depth else (0.0, 0.0)
    speed = size / _timed(lambda: dr.eval(scene.ray_intersect_preliminary(ray, coherent=True).t))
    view = optics.view(scene, ray, mi.UInt32(sampler.next_1d() * optics.branches))
    depth = camera.clip_start + view.distance * depth_rate
    exists, seen = np.broadcast_to(view.exists, size), np.asarray(view.hit)
    vergence = 1 / np.asarray(depth)[exists & seen].astype(np.float64)
    vergence = vergence[np.isfinite(vergence)]
    splits = SPLITS if np.asarray(view.branch).any() else 0
    sky = scene.environment() is not None
    return Probe(vergence, bool((exists & ~seen).any()), sky, *shares, speed, noise, paths_per_second, splits)


def _timed(work):
    """Seconds of the second of two calls, which compiles nothing."""
    import drjit as dr

    for _ in range(2):
        dr.sync_thread()
        start = time.perf_counter()
        work()
        dr.sync_thread()
    return time.perf_counter() - start


def _radiance_noise(scene, ray, max_depth, seed):
    """Relative variance of a radiance path, and paths a second, from a few paths along some of the rays."""
    import drjit as dr
    import mitsuba as mi

    from .grains import radiance_integrator

    integrator = radiance_integrator(max_depth)
    rays = dr.width(ray)
    grains = min(rays, PILOT_GRAINS)
    index = dr.arange(mi.UInt32, grains * PILOT_PATHS) // PILOT_PATHS
    chosen = dr.gather(mi.Ray3f, ray, mi.UInt32(mi.Float(index) * (rays / grains)))
    dr.eval(chosen)
    light = None

    def trace():
        nonlocal light
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, grains * PILOT_PATHS)
        colour, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(chosen), None, True)
        light = colour.x + colour.y + colour.z
        dr.eval(light)

    seconds = _timed(trace)
    light = np.nan_to_num(np.asarray(light, np.float64)).reshape(grains, PILOT_PATHS)
    mean, variance = light.mean(1), light.var(1, ddof=1)
    lit = mean > 0
    if not lit.any():
        return 0.0, grains * PILOT_PATHS / seconds
    # weighted by brightness, in which lamps in view must not hide the rest
    weight = np.minimum(mean[lit], np.percentile(mean[lit], 75))
    noise = (weight * variance[lit] / mean[lit] ** 2).sum() / weight.sum()
    return float(noise), grains * PILOT_PATHS / seconds


def plan(scene, camera, hologram, settings=None):
    """Decide what to compute for a scene on a display; computes nothing but a few probe rays.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings, optional

    Returns
    -------
    Plan

    Raises
    ------
    InvalidInput
        If nothing is in view.
    BackendUnavailable
        If Mitsuba cannot compute here.
    """
    backend.activate()
    from .chains import SpecularChains

    settings = (settings or Settings()).resolved()
    decisions, warnings = [], []
    near = near_end(scene, camera, hologram, settings.seed)
    mapping = DepthMapping.of(hologram, camera, near)
    seen = probe(scene, hologram, camera, mapping, mapping.z_far, settings.seed, settings.max_depth)
    chain = settings.most_hits if seen.specular > 1e-4 else 0
    if chain:
        optics = SpecularChains(settings.virtual_image, chain)
        images = probe(scene, hologram, camera, mapping, mapping.z_far, settings.seed, 0, optics)
        seen = replace(seen, vergence=images.vergence, misses=images.misses, splits=images.splits)
    low, high = vergence_range(seen, chain)
    if chain:
        low, high = max(low, IMAGE_LIMITS[0] / near), min(high, IMAGE_LIMITS[1] / near)
    z_low, z_high = mapping.z_far + mapping.beta * low, mapping.z_far + mapping.beta * high
    decisions.append(
        Decision(
            "depth",
            f"{near:.3g} m to {'infinity' if z_low <= mapping.z_far else f'{mapping.z_to_depth(z_low):.3g} m'} "
            f"at {z_high * 1e3:.2f} to {z_low * 1e3:.2f} mm from the SLM",
            "the volume ends at the nearest surface in view"
            if hologram.depth_mapping == "fit" and not hologram.near
            else f"{hologram.depth_mapping} mapping",
        )
    )

    if settings.method == "direct":
        wrp, reason = 0.0, "the SLM itself: method direct"
    elif settings.wrp == "auto":
        wrp = 0.5 * (z_low + z_high)
        reason = "the middle of the depths in view needs the fewest rays"
    else:
        wrp, reason = float(settings.wrp), "as asked"
    decisions.append(Decision("recording plane", f"{wrp * 1e3:.3f} mm from the SLM", reason))
    # rays between the probe's may meet surfaces a little beyond what it saw
    depth_limit = 1.02 * max(z_high - wrp, wrp - z_low) + 0.1 * hologram.pitch / _slope(hologram)

    rays, reach = _rays(hologram, settings, depth_limit, decisions, warnings)
    margin = reach + 1
    passes, slabs, bins = _radiance(hologram, settings, seen, margin, z_high - z_low, decisions)

    if chain:
        reason = (
            f"{seen.specular:.1%} of the view is mirror or clear glass; images by {settings.virtual_image}"
        )
        reason += f"; {1 << seen.splits} branches of each ray" if seen.splits else ""
        decisions.append(Decision("specular hits", f"up to {chain}", reason))
    elif seen.specular > 1e-4:
        warnings.append(
            f"{seen.specular:.0%} of the view is mirror or clear glass: it is shown as a picture on its own "
            f"surface, not at the depth of what it reflects; allow chains of mirrors to change that."
        )
    captured = captured_share(hologram, 0.5 * (z_low + z_high))
    if captured < 0.75:
        warnings.append(
            f"Only {captured:.0%} of the light fits through the SLM's aperture at {z_high * 1e3:.0f} mm: edges darken; "
            f"bring the depth range nearer to the SLM or use more pixels."
        )

    decisions.append(
        Decision(
            "frames",
            str(settings.frames),
            f"speckle contrast about {1 / math.sqrt(settings.frames):.0%}",
        )
    )
    seconds, memory = _costs(hologram, settings, seen, rays << seen.splits, passes, margin, slabs, bins)
    return Plan(
        near,
        wrp,
        z_low,
        z_high,
        depth_limit,
        rays,
        passes,
        margin,
        slabs,
        bins,
        chain,
        seen.splits,
        CONE[settings.quality],
        seconds,
        memory,
        tuple(decisions),
        tuple(warnings),
    )


def _rays(hologram, settings, depth_limit, decisions, warnings):
    """Rays a pixel, and the farthest grain in pixels that they reach."""
    slope, cone = _slope(hologram), CONE[settings.quality]
    if settings.estimator == "paper":
        rays = settings.spp or PAPER_RAYS[settings.quality]
        decisions.append(Decision("rays a pixel", str(rays), "random directions, the paper's estimator"))
        return rays, math.ceil(slope * depth_limit / hologram.pitch) + 1
    if cone * slope * depth_limit / hologram.pitch > MOST_REACH:
        raise InvalidInput(
            f"The recording plane is {depth_limit * 1e3:.1f} mm from a surface, which would need over "
            f"{math.pi * MOST_REACH**2:.0f} rays a pixel: put it nearer to the scene (auto does), reduce the depth "
            f"range, or use the paper's estimator."
        )
    whole = Lattice.of(slope, depth_limit, hologram.pitch, cone)
    lattice = Lattice.of(slope, depth_limit, hologram.pitch, cone, settings.spp)
    reason = (
        f"one a grain at {depth_limit * 1e3:.2f} mm from the recording plane, cone {cone:g} of the recordable"
    )
    decisions.append(Decision("rays a pixel", str(lattice.rays), reason))
    if lattice.rays < whole.rays:
        warnings.append(
            f"{lattice.rays} rays a pixel are fewer than the {whole.rays} that this depth range needs: the farthest "
            f"depths lose contrast; raise the rays a pixel or reduce the depth range."
        )
    return lattice.rays, int(lattice.offsets(hologram.pitch).max())


def _radiance(hologram, settings, seen, margin, thickness, decisions):
    """Radiance paths a pixel, depth slabs and pupil bins."""
    if settings.radiance == "ray":
        decisions.append(Decision("radiance", "one path a ray", "as asked; dark where light is indirect"))
        return 0, 1, 1
    fewest, most = PASSES[settings.quality]
    wanted = GRAIN_NOISE[settings.quality] / math.sqrt(settings.frames)
    passes = min(max(fewest, math.ceil(seen.noise / wanted**2)), most)
    left = math.sqrt(seen.noise / passes)
    glossy = seen.glossy + seen.specular > 1e-3
    bins = GLOSSY_BINS if glossy else 1
    columns = (hologram.width + 2 * margin) * (hologram.height + 2 * margin)
    slabs = max(1, min(MOST_SLABS, MAP_BYTES // (4 * columns), math.ceil(thickness / SLAB)))
    decisions.append(
        Decision(
            "radiance paths a pixel",
            str(passes),
            f"leaves {left:.1%} noise in a grain's mean where {1 / math.sqrt(settings.frames):.0%} is speckle",
        )
    )
    decisions.append(
        Decision(
            "radiance map",
            f"{slabs} depth slabs, {bins} x {bins} pupil bins",
            "glossy surfaces look different across the pupil"
            if glossy
            else "all surfaces in view are diffuse",
        )
    )
    return passes, slabs, bins


def _costs(hologram, settings, seen, rays, passes, margin, slabs, bins):
    """Estimated seconds and bytes, from the probe's speed and the sizes of the arrays."""
    pixels, frames, colours = hologram.width * hologram.height, settings.frames, len(hologram.wavelengths)
    columns = (hologram.width + 2 * margin) * (hologram.height + 2 * margin)
    seconds = 2.0 + pixels * rays * (1.3 / seen.rays_per_second + (2 + 0.3 * frames * colours) * 1e-9)
    paths = columns * passes if settings.radiance == "grain" else pixels * rays
    seconds += 0.6 * paths / seen.paths_per_second + pixels * frames * colours * 0.1e-6
    fields = pixels * frames * (colours + 1) * 8
    tables = LEVELS * margin**2 * 8 * colours
    radiance = columns * (4 * slabs + SURFACES * bins**2 * CELL_BYTES)
    return seconds, fields + tables + radiance + CHUNK_BYTES


def _slope(hologram):
    return max(hologram.max_slope(w) for w in hologram.wavelengths)


def vergence_range(seen, chain):
    """Smallest and largest inverse depth in view, 1/m.

    Caustics spread a few images over all depths, behind the viewer too: with chains a hundredth at either
    end is left to the nearest depth inside.
    """
    if not len(seen.vergence):
        return 0.0, 0.0
    low, high = np.quantile(seen.vergence, (0.01, 0.99) if chain else (0, 1))
    return float(min(low, 0.0) if seen.sky and seen.misses else low), float(high)


def near_end(scene, camera, hologram, seed=0):
    """World depth of the volume's near end: as given, or the nearest surface that the pupil sees."""
    pinhole = DepthMapping.of(replace(hologram, depth_mapping="fit"), camera, 1e-9)
    seen = probe(scene, hologram, camera, pinhole, pinhole.z_far, seed)
    if not len(seen.vergence):
        if scene.environment() is None:
            raise InvalidInput(
                "Nothing is in the camera's view: point the camera at an object or light the world."
            )
        return hologram.near or 1.0
    if hologram.near:
        return hologram.near
    if hologram.depth_mapping == "eyepiece":
        return float(1 / seen.vergence.max())
    mapping = DepthMapping.of(hologram, camera, 1 / seen.vergence.max())
    wide = probe(scene, hologram, camera, mapping, mapping.z_far, seed)
    return float(1 / max(seen.vergence.max(), wide.vergence.max()))


def captured_share(hologram, distance):
    """Share of the recordable cones' light, from a picture at `distance`, that passes the SLM's aperture.

    Geometric: the overlap of the picture and its copies shifted by slope times distance, averaged over
    the cone of the widest wavelength.
    """
    n = 33
    axis = np.linspace(-1, 1, n)
    slope_y, slope_x = np.meshgrid(axis, axis, indexing="ij")
    disk = slope_x**2 + slope_y**2 <= 1
    walk = _slope(hologram) * abs(distance) / hologram.pitch
    kept = np.clip(1 - np.abs(slope_x) * walk / hologram.width, 0, 1) * np.clip(
        1 - np.abs(slope_y) * walk / hologram.height, 0, 1
    )
    return float(kept[disk].mean())
